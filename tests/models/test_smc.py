"""Marginal likelihood: closed forms and exact enumeration; folds of people: refitting and closed forms."""

import math
import threading
import time
from collections import Counter
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy import stats
from scipy.special import gammaln, logsumexp

from models.draw_kernels import constrained, history_log_likelihoods
from models.errors import InputError
from models.hmm_density import HmmDensity
from models.nuts import NutsSettings, sample
from models.parameters import STICKY, DirichletPrior, Layout, checked_pins
from models.people_folds import assign_folds, held_out_log_predictive, unconstrained_draws
from models.person_offset import person_of_run
from models.protocol import PUBLISHED
from models.rivals import constant, static_pins
from models.smc import SmcSettings, log_marginal_likelihood, next_temperature, prior_particles, systematic
from tests.models.test_protocol import THREE
from tests.models.test_rivals import random_log
from tests.models.test_simulation import design_of
from tests.random_cases import random_run

FAST = SmcSettings(particles=1000, runs=4, seed=3)
PRIOR = DirichletPrior(initial=1.5, transition=1.2, emission=2.0, stay=1.0)


def density_of(log, states, prior=STICKY, pins=None):
    layout = Layout(log.protocol, states)
    return HmmDensity(log.tree(), layout, 1 + prior.pseudo_counts(layout), checked_pins(layout, pins or {}))


def exact(runs, protocol, states, prior, pins):
    """Log marginal likelihood as a sum over the state paths of everybody, each with its conjugate integral."""
    layout = Layout(protocol, states)
    a_initial, a_transition, a_emission = layout.unpack(1 + prior.pseudo_counts(layout))
    held = checked_pins(layout, pins)
    tables = {protocol.action(a): t for a, t in held.items()}

    def log_dirichlet(alpha, n):  # n is [counts, entry of the row]
        after = gammaln(alpha + n).sum(axis=-1) - gammaln((alpha + n).sum(axis=-1))
        return gammaln(alpha.sum()) - gammaln(alpha).sum() + after

    # Paths matter through their counts only, so runs are added one at a time to the distribution of counts.
    total = Counter({((0,) * layout.size): 1.0})
    for run in runs:
        of_run = Counter()
        for path in product(range(states), repeat=len(run)):
            counts = np.zeros(layout.size)
            initial, transition, emission = layout.unpack(counts)
            initial[path[0]] += 1
            weight = 1.0
            for k, (action, response) in enumerate(run):
                if response >= 0:
                    emission[protocol.emission_index[action], path[k], response] += 1
                if k + 1 < len(run):
                    if action in tables:
                        weight *= tables[action][path[k], path[k + 1]]
                    else:
                        transition[action, path[k], path[k + 1]] += 1
            if weight:
                of_run[tuple(counts.astype(int))] += weight
        together = Counter()
        for before, w in total.items():
            for own, v in of_run.items():
                together[tuple(np.add(before, own))] += w * v
        total = together
    alpha = layout.pack(a_initial, a_transition, a_emission)
    n, weights = np.array(list(total)), np.array(list(total.values()))
    return logsumexp(np.log(weights) + sum(log_dirichlet(alpha[row], n[:, row]) for row in layout.rows))


def few_runs(protocol, n, length, seed):
    rng = np.random.default_rng(seed)
    return [random_run(rng, protocol, length, 0.1) for _ in range(n)]


@pytest.mark.parametrize("protocol", [PUBLISHED, THREE])
def test_one_state_has_a_closed_form(protocol):
    log = random_log(protocol, 60)
    found = log_marginal_likelihood(density_of(log, 1), FAST)
    assert found.estimate == pytest.approx(constant(log).log_marginal_likelihood, abs=4 * found.error + 0.01)
    assert found.error < 0.15
    assert all(t[0] == 0 and t[-1] == 1 and np.all(np.diff(t) > 0) for t in found.temperatures)


@pytest.mark.parametrize(
    ("protocol", "states", "prior", "pins", "n", "length"),
    [
        (PUBLISHED, 2, STICKY, {}, 3, 4),
        (PUBLISHED, 2, PRIOR, {"help": np.array([[0.7, 0.3], [0.3, 0.7]])}, 3, 4),
        (PUBLISHED, 2, STICKY, static_pins(PUBLISHED), 8, 6),
        (THREE, 2, STICKY, {"hint": None}, 3, 4),
        (PUBLISHED, 3, STICKY, {}, 3, 3),
    ],
)
def test_equals_the_sum_over_all_paths(protocol, states, prior, pins, n, length):
    runs = few_runs(protocol, n, length, seed=11)
    density = density_of(design_of(runs, protocol), states, prior, pins)
    found = log_marginal_likelihood(density, FAST)
    assert found.estimate == pytest.approx(exact(runs, protocol, states, prior, pins), abs=4 * found.error + 0.005)
    assert found.error < 0.05


def test_equals_quadrature_where_labels_switch():
    """Two types who are clearly apart: the integral has two modes, one a labelling."""
    runs = [[(3, 1)] * 6] * 8 + [[(3, 0)] * 6] * 5 + [[(3, 1), (3, 0)] * 3] * 2
    found = log_marginal_likelihood(density_of(design_of(runs), 2, pins=static_pins(PUBLISHED)), FAST)
    helped = np.array([sum(o for _, o in run) for run in runs])
    p, w = np.polynomial.legendre.leggauss(60)
    p, w = (p + 1) / 2, w / 2
    share, low, high = np.meshgrid(p, p, p, indexing="ij")
    value = np.ones_like(share)
    for y in helped:
        value *= share * low**y * (1 - low) ** (6 - y) + (1 - share) * high**y * (1 - high) ** (6 - y)
    wanted = math.log(np.einsum("ijk,i,j,k->", value, w, w, w))
    assert found.estimate == pytest.approx(wanted, abs=4 * found.error + 0.01)


def test_particles_start_in_the_prior():
    density = density_of(design_of(few_runs(THREE, 2, 2, 1), THREE), 2, PRIOR)
    theta = constrained(density, prior_particles(density, 4000, np.random.default_rng(1)))
    for start, width, *_ in zip(*density.plan, strict=True):
        a = density.alpha[start : start + width]
        assert stats.kstest(theta[:, start], stats.beta(a[0], a.sum() - a[0]).cdf).pvalue > 1e-4


def test_runs_are_reproducible_and_spread():
    density = density_of(design_of(few_runs(PUBLISHED, 6, 4, 2)), 2)
    small = SmcSettings(particles=100, runs=3, seed=5)
    one, two = log_marginal_likelihood(density, small), log_marginal_likelihood(density, small)
    assert np.array_equal(one.runs, two.runs)
    assert np.ptp(one.runs) > 0
    assert np.array_equal(log_marginal_likelihood(density, replace(small, runs=2)).runs, one.runs[:2])
    assert math.isnan(log_marginal_likelihood(density, replace(small, runs=1)).error)


def test_an_interruption_ends_the_running_threads():
    density = density_of(design_of(few_runs(PUBLISHED, 40, 6, 2)), 3)

    def interrupt(done, total):
        raise KeyboardInterrupt

    before = threading.active_count()
    started = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        log_marginal_likelihood(density, SmcSettings(particles=400, runs=40, moves=10), progress=interrupt)
    one_run = time.perf_counter() - started
    assert threading.active_count() == before
    log_marginal_likelihood(density, SmcSettings(particles=400, runs=1, moves=10))
    assert one_run < 4 * (time.perf_counter() - started - one_run) + 1


def test_temperature_keeps_the_effective_sample_size():
    values = np.random.default_rng(1).normal(scale=50, size=400)
    to = next_temperature(values, 0.1, 0.5)
    w = np.exp((to - 0.1) * (values - values.max()))
    assert w.sum() ** 2 / (w @ w) / len(w) == pytest.approx(0.5, abs=1e-6)
    assert next_temperature(np.zeros(10), 0.1, 0.5) == 1.0
    with pytest.raises(InputError, match="finite"):
        next_temperature(np.full(10, -np.inf), 0.1, 0.5)


def test_resampling_copies_in_proportion():
    share = np.array([0.5, 0.25, 0.25, 0.0])
    assert np.bincount(systematic(share, 0.3), minlength=4).tolist() == [2, 1, 1, 0]


@pytest.mark.parametrize(
    "wrong", [{"particles": 3}, {"runs": 0}, {"ess": 1.5}, {"path": 0.0}, {"moves": True}, {"seed": -1}]
)
def test_bad_settings_are_refused(wrong):
    with pytest.raises(InputError, match="marginal likelihood, " + next(iter(wrong))):
        SmcSettings(**wrong)


# -- folds of people -------------------------------------------------------------------------------------
def test_folds_are_even_within_conditions_and_reproducible():
    log = random_log(PUBLISHED, 53)
    fold = assign_folds(log, 5, seed=1)
    assert set(np.bincount(fold)) == {10, 11}
    assert np.array_equal(fold, assign_folds(log, 5, seed=1))
    assert not np.array_equal(fold, assign_folds(log, 5, seed=2))
    with pytest.raises(InputError, match="folds: found 54"):
        assign_folds(log, 54, seed=1)


def test_unconstrained_draws_are_the_inverse():
    density = density_of(random_log(THREE, 5), 3, pins={"hint": None})
    x = np.random.default_rng(1).normal(size=(7, density.dimension))
    assert np.allclose(unconstrained_draws(density, constrained(density, x)), x)


def test_held_out_people_of_one_state_in_closed_form():
    log = random_log(PUBLISHED, 80)
    density, rival = density_of(log, 1), constant(log)
    fold = assign_folds(log, 5, seed=1)
    x = np.random.default_rng(1).permutation(prior_particles(density, 2000, np.random.default_rng(1)))
    theta = np.tile(density.template, (4000, 1))
    draws = rival.draws(1, 4000, np.random.default_rng(2))[0]
    theta[:, -draws[0].size :] = draws.reshape(4000, -1)
    assert x.shape[1] == density.dimension
    found = held_out_log_predictive(log, density, theta, fold, SmcSettings(particles=2000, moves=5))
    wanted = np.concatenate([rival.log_predictive(fold == f) for f in range(5)])
    order = np.concatenate([np.flatnonzero(fold == f) for f in range(5)])
    assert np.allclose(found[order], wanted, atol=0.05)
    assert found.sum() == pytest.approx(wanted.sum(), abs=0.3)


def test_held_out_people_as_by_refitting():
    log = random_log(PUBLISHED, 60, seed=8)
    density = density_of(log, 2)
    fold = assign_folds(log, 2, seed=1)  # half of the people leave: far from the full posterior

    def posterior(d):
        chains = sample(d, NutsSettings(draws=1500, tune=400, chains=2, seed=2)).values()
        return constrained(d, np.concatenate([c.x for c in chains]))

    found = held_out_log_predictive(log, density, posterior(density), fold, SmcSettings(1500, moves=6))
    wanted = np.empty(len(fold))
    history = np.searchsorted(density.tree.terminals, density.tree.run_node)
    for number in range(2):
        out = fold[person_of_run(log)] == number
        theta = posterior(replace(density, tree=density.tree.with_runs(np.where(out, 0.0, 1.0))))
        values = history_log_likelihoods(density.tree, density.layout, theta)[:, history[out]]
        wanted[fold == number] = logsumexp(values, axis=0) - np.log(len(theta))
    assert np.allclose(found, wanted, atol=0.1)
    assert found.sum() == pytest.approx(wanted.sum(), abs=0.5)
