"""Counting rivals: closed forms against brute force, and against the latent-state model they are limits of."""

import math

import numpy as np
import pytest
from hypothesis import given
from scipy import integrate, special, stats

from models.baum_welch import BaumWelch
from models.errors import InputError
from models.hmm_density import HmmDensity
from models.parameters import DirichletPrior, Layout
from models.protocol import PUBLISHED
from models.rivals import constant, first_order_markov, last_response, static_pins
from tests.models.test_protocol import THREE
from tests.models.test_simulation import design_of
from tests.random_cases import cases, random_run

NS, S, HELP = PUBLISHED.action("no_signal"), PUBLISHED.action("signal"), PUBLISHED.action("help")
SMALL = design_of([[(NS, 1), (HELP, -1), (NS, 0)], [(S, 1), (S, -1), (S, 1)], [(S, 0)]])


def random_log(protocol, n=30, seed=3):
    rng = np.random.default_rng(seed)
    return design_of([random_run(rng, protocol, int(k), 0.2) for k in rng.integers(1, 7, size=n)], protocol)


def seen_before(run):
    """(emission table, last response seen, response) of every recorded response, the slow way."""
    last = -1
    for action, response in run:
        if response >= 0:
            yield action, last, response
            last = response


@given(cases(max_paths=10**9))
def test_cells_are_counted_as_by_hand(case):
    log = design_of(case.runs, case.protocol)
    if not (log.response >= 0).any():
        with pytest.raises(InputError, match="nothing can be learned"):
            constant(log)
        return
    plain, markov = constant(log), first_order_markov(log)
    wanted = np.zeros_like(plain.counts), np.zeros_like(markov.counts)
    for person, run in enumerate(case.runs):
        for action, last, response in seen_before(run):
            e = case.protocol.emission_index[action]
            wanted[0][person, e, response] += 1
            wanted[1][person, e * (case.protocol.n_responses + 1) + last + 1, response] += 1
    assert np.array_equal(plain.counts, wanted[0])
    assert np.array_equal(markov.counts, wanted[1])
    assert len(markov.cells) == markov.counts.shape[1]


def test_a_run_does_not_remember_the_run_before():
    assert last_response(SMALL).tolist() == [-1, 1, 1, -1, 1, 1, -1]
    assert dict(zip(first_order_markov(SMALL).cells, first_order_markov(SMALL).total.tolist(), strict=True)) == {
        "no_signal, at first": [0, 1], "no_signal, after no_help": [0, 0], "no_signal, after help": [1, 0],
        "signal, at first": [1, 1], "signal, after no_help": [0, 0], "signal, after help": [0, 1],
    }  # fmt: skip


def test_likelihood_by_hand():
    rival = constant(SMALL)
    assert rival.log_likelihood == pytest.approx(2 * math.log(0.5) + 2 * math.log(2 / 3) + math.log(1 / 3))
    assert (rival.n_parameters, rival.n_responses) == (2, 5)
    assert rival.bic == pytest.approx(2 * math.log(5) - 2 * rival.log_likelihood)
    assert rival.aic == pytest.approx(4 - 2 * rival.log_likelihood)
    assert first_order_markov(SMALL).n_parameters == 4  # two cells were never seen


@pytest.mark.parametrize("alpha", [1.0, 2.5])
def test_marginal_likelihood_is_the_integral(alpha):
    rival = constant(SMALL, alpha)
    wanted = 0.0
    for failures, successes in rival.total:
        value, _ = integrate.quad(
            lambda p, a=failures, b=successes: p**b * (1 - p) ** a * stats.beta.pdf(p, alpha, alpha), 0, 1
        )
        wanted += math.log(value)
    assert rival.log_marginal_likelihood == pytest.approx(wanted, abs=1e-9)


@pytest.mark.parametrize("protocol", [PUBLISHED, THREE])
def test_predictives_chain_to_the_marginal_likelihood(protocol):
    """p(y) = p(y_1) p(y_2 | y_1) ...; leaving one out is p(y) / p(y without)."""
    log = random_log(protocol)
    for rival in (constant(log, 1.5), first_order_markov(log)):
        n = len(rival.counts)
        half = np.arange(n) < n // 2
        rest = type(rival)("rest", rival.cells, rival.counts[~half], rival.alpha)
        one_by_one = rest.log_marginal_likelihood
        known = ~half
        for i in np.flatnonzero(half):
            some = type(rival)("some", rival.cells, rival.counts[known | (np.arange(n) == i)], rival.alpha)
            place = np.flatnonzero(known | (np.arange(n) == i)).tolist().index(i)
            one_by_one += some.exact_loo()[place]
            known[i] = True
        assert one_by_one == pytest.approx(rival.log_marginal_likelihood)
        first = np.arange(n) == 0
        without = type(rival)("without", rival.cells, rival.counts[1:], rival.alpha)
        gap = rival.log_marginal_likelihood - without.log_marginal_likelihood
        assert rival.log_predictive(first)[0] == pytest.approx(gap)
        assert rival.exact_loo()[0] == pytest.approx(gap)


def test_draws_are_the_conjugate_posterior():
    log = random_log(PUBLISHED, 60)
    rival = first_order_markov(log)
    draws = rival.draws(2, 4000, np.random.default_rng(1)).reshape(-1, *rival.total.shape)
    wanted = (rival.alpha + rival.total) / (rival.alpha + rival.total).sum(axis=1, keepdims=True)
    error = np.sqrt(wanted * (1 - wanted) / len(draws))
    assert np.all(np.abs(draws.mean(axis=0) - wanted) < 4 * error)
    sample = rival.tree(2, 50, seed=1)
    by_hand = np.einsum(
        "cdko,pko->cdp", np.log(sample["posterior"]["probability"].to_numpy()), rival.counts
    )  # fmt: skip
    assert np.allclose(sample["log_likelihood"]["participant"].to_numpy(), by_hand)


@pytest.mark.parametrize("protocol", [PUBLISHED, THREE])
def test_constant_is_the_model_with_one_state(protocol):
    log = random_log(protocol)
    rival = constant(log)
    em = BaumWelch(1, restarts=1, finalists=1).fit(log)
    assert em.log_likelihood == pytest.approx(rival.log_likelihood)
    assert em.n_parameters == rival.n_parameters
    assert em.bic == pytest.approx(rival.bic)
    layout = Layout(protocol, 1)
    density = HmmDensity(log.tree(), layout, 1.0 + DirichletPrior(stay=2.0).pseudo_counts(layout), {})
    assert density.dimension == rival.total.size - len(rival.total)
    x = np.random.default_rng(2).normal(size=density.dimension)
    emission = layout.unpack(density.theta(x))[2][:, 0]
    posterior = sum(stats.dirichlet.logpdf(row, 1 + n) for row, n in zip(emission, rival.total, strict=True))
    if protocol is PUBLISHED:
        jacobian = np.log(emission).sum()
    else:
        jacobian = np.log(emission).sum() + len(emission) * math.log(protocol.n_responses)
    assert density(x)[0] == pytest.approx(rival.log_marginal_likelihood + posterior + jacobian)


@pytest.mark.parametrize("protocol", [PUBLISHED, THREE])
def test_static_mixture_is_a_mixture(protocol):
    """With every table held, the likelihood of a run is the mixture of its likelihood under each type."""
    log = random_log(protocol)
    layout = Layout(protocol, 3)
    density = HmmDensity(log.tree(), layout, np.ones(layout.size), static_pins(protocol))
    assert density.dimension == 2 + 3 * len(protocol.emission_actions) * (protocol.n_responses - 1)
    x = np.random.default_rng(5).normal(size=density.dimension)
    theta = density.theta(x)
    initial, _, emission = layout.unpack(theta)
    by_type = np.einsum("pko,kso->ps", constant(log).counts, np.log(emission))
    wanted = special.logsumexp(by_type + np.log(initial), axis=1).sum()
    whole = density(x)[0]
    nobody = log.tree().with_runs(np.zeros(log.n_runs))
    empty = HmmDensity(nobody, layout, np.ones(layout.size), static_pins(protocol))
    assert whole - empty(x)[0] == pytest.approx(wanted)
    em = BaumWelch(3, restarts=3, finalists=1, pins=static_pins(protocol)).fit(log)
    assert em.n_parameters <= density.dimension
    assert np.array_equal(em.model.transition[0], np.eye(3))


def test_a_silent_study_and_a_bad_prior_are_refused():
    with pytest.raises(InputError, match="nothing can be learned"):
        first_order_markov(design_of([[(HELP, -1)]]))
    with pytest.raises(InputError, match="alpha"):
        constant(SMALL, 0.0)
