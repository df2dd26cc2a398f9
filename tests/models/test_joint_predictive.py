"""Log predictive of people left out: closed form, plain mean over draws, difference of marginal likelihoods."""

import numpy as np
import pytest
from scipy.special import logsumexp

from analysis.simulate import simulate_study1
from models.bayesian_fit import fit
from models.draw_kernels import history_log_likelihoods
from models.errors import InputError
from models.hmm_density import HmmDensity
from models.joint_predictive import FEWER, LETTING_IN, latent_log_predictive
from models.nuts import NutsSettings
from models.parameters import STICKY, DirichletPrior, Layout
from models.person_offset import PersonOffset, quadrature
from models.posterior import TABLES
from models.protocol import PUBLISHED
from models.rivals import constant
from models.smc import SmcSettings, log_marginal_likelihood
from models.study_density import ModelSpec, StudyDensity
from tests.analysis.report_cases import CORRIDOR, log_of, random_log

CELL = "help+signal"


def parts(log, name=CELL):
    return log.select(conditions=[c for c in log.conditions if c != name]), log.select(conditions=[name])


def vectors(posterior):
    tables = [posterior.table(name) for name in TABLES]
    return np.concatenate([t.reshape(len(t), -1) for t in tables], axis=1)


def sampled(rest, states, **options):
    return vectors(fit(rest, states, sampler=NutsSettings(500, 400, 4), **options))


def by_run(log, theta, states):
    """Log-likelihood of each run under each draw."""
    tree = log.tree()
    values = history_log_likelihoods(tree, Layout(log.protocol, states), theta)
    return values[:, np.searchsorted(tree.terminals, tree.run_node)]


@pytest.mark.parametrize("protocol", [PUBLISHED, CORRIDOR])
def test_one_state_is_the_closed_form(protocol):
    """With one state the probabilities of each action have a Dirichlet posterior."""
    log = simulate_study1(participants=200) if protocol is PUBLISHED else random_log(CORRIDOR, people=80)
    rest, held = parts(log, log.conditions[0])
    rival, both = constant(rest), constant(held)
    exact = type(rival)("both", rival.cells, np.concatenate([rival.counts, both.counts]))
    theta = sampled(rest, 1)
    found = latent_log_predictive(rest, held, theta, STICKY, {}, 1)
    wanted = exact.log_marginal_likelihood - rival.log_marginal_likelihood
    assert abs(found.joint - wanted) < 4 * found.error + 0.02
    assert found.error < 0.2
    inside = np.arange(len(exact.counts)) >= len(rival.counts)
    likelihood = np.exp(by_run(held, theta, 1))  # one run a person
    noise = likelihood.std(axis=0) / likelihood.mean(axis=0) / np.sqrt(len(theta) / 4)  # draws are correlated
    assert np.all(np.abs(found.by_person - exact.log_predictive(inside)) < 4 * noise)
    assert noise.max() < 0.1


def test_few_people_are_the_plain_mean_over_draws():
    """One step is enough for three people, so this is the mean of their likelihoods, run by run."""
    rest, held = parts(simulate_study1(participants=120))
    few = held.select(runs=np.arange(3))
    theta = sampled(rest, 2)
    found = latent_log_predictive(rest, few, theta, STICKY, {}, 2)
    together = by_run(few, theta, 2).sum(axis=1)
    assert found.joint == pytest.approx(logsumexp(together) - np.log(len(theta)), abs=4 * found.error + 0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("states", "pins"), [(2, {}), (3, {"no_help": None})])
def test_it_is_the_difference_of_marginal_likelihoods(states, pins):
    log = simulate_study1(participants=160)
    rest, held = parts(log)
    layout = Layout(PUBLISHED, states)
    alpha = 1.0 + STICKY.pseudo_counts(layout)
    settings = SmcSettings(1500, 8, moves=4)
    both, some = (
        log_marginal_likelihood(HmmDensity(x.tree(), layout, alpha, pins), settings) for x in (log, rest)
    )  # fmt: skip
    found = latent_log_predictive(rest, held, sampled(rest, states, pins=pins), STICKY, pins, states)
    error = np.sqrt(both.error**2 + some.error**2 + found.error**2)
    assert abs(found.joint - (both.estimate - some.estimate)) < 4 * error
    assert error < 0.3


def test_a_person_is_all_their_runs():
    a, b = [("signal", "help")] * 2, [("no_signal", "no_help"), ("signal", "help")]
    rest = log_of([(i, 0, "c", a if i % 3 else b) for i in range(30)])
    held = log_of([(50, 0, "d", a), (50, 1, "d", b), (51, 0, "d", b)])
    theta = sampled(rest, 2)
    found = latent_log_predictive(rest, held, theta, STICKY, {}, 2)
    by_hand = []
    for person in (50, 51):
        together = by_run(held.select(participants=np.array([person])), theta, 2).sum(axis=1)
        by_hand.append(logsumexp(together) - np.log(len(theta)))
    assert np.allclose(found.by_person, by_hand)


# -- people who differ -------------------------------------------------------------------------------------
def hierarchical(rest, states, people, draws=500, **options):
    posterior = fit(rest, states, people=people, sampler=NutsSettings(draws, 400, 4), **options)
    return np.column_stack([vectors(posterior), posterior.table("person_sd")])


def test_people_who_hardly_differ_at_one_state_are_the_closed_form():
    """A prior that holds sigma at zero leaves the constant rival."""
    rest, held = parts(simulate_study1(participants=200))
    people = PersonOffset(1e-3)
    found = latent_log_predictive(rest, held, hierarchical(rest, 1, people), STICKY, {}, 1, people=people)
    rival, both = constant(rest), constant(held)
    exact = type(rival)("both", rival.cells, np.concatenate([rival.counts, both.counts]))
    wanted = exact.log_marginal_likelihood - rival.log_marginal_likelihood
    assert abs(found.joint - wanted) < 4 * found.error + 0.03
    assert found.error < 0.2


def test_few_people_who_differ_are_the_plain_mean_over_draws():
    """Each person's offset is integrated over all their runs before the mean over draws is taken."""
    a, b = [("signal", "help")] * 2, [("no_signal", "no_help"), ("signal", "help")]
    rest = log_of([(i, j, "c", a if (i + j) % 3 else b) for i in range(40) for j in range(2)])
    held = log_of([(50, 0, "d", a), (50, 1, "d", a), (51, 0, "d", b)])
    people = PersonOffset(nodes=21)
    theta = hierarchical(rest, 1, people)
    found = latent_log_predictive(rest, held, theta, STICKY, {}, 1, people=people)
    z, log_weight = quadrature(21)
    index, runs = np.asarray(PUBLISHED.emission_index), [np.flatnonzero(held.participant == i) for i in (50, 51)]
    emission, sigma = theta[:, -5:-1].reshape(-1, 2, 2), theta[:, -1:]
    alone = []
    for mine in runs:
        by_node = np.tile(log_weight, (len(theta), 1))
        for event in np.flatnonzero(np.isin(held.run_of_event, mine)):
            table = np.log(emission[:, index[held.action[event]]])
            tilted = table[:, None, :] + sigma[:, :, None] * z[:, None] * np.array(PUBLISHED.scores)
            by_node += tilted[..., held.response[event]] - logsumexp(tilted, axis=-1)
        alone.append(logsumexp(by_node, axis=1))
    kept = np.array(alone)[:, :: max(1, len(theta) // FEWER)]
    assert np.allclose(found.by_person, logsumexp(kept, axis=1) - np.log(kept.shape[1]), atol=1e-9)
    together = logsumexp(np.sum(alone, axis=0)) - np.log(len(theta))
    assert found.joint == pytest.approx(together, abs=4 * found.error + 0.01)


@pytest.mark.slow
@pytest.mark.parametrize("states", [1, 2])
def test_where_people_differ_it_is_the_difference_of_marginal_likelihoods(states):
    rest, held = parts(simulate_study1(participants=160))
    people = PersonOffset(nodes=21)
    settings = SmcSettings(1000, 6, moves=4)
    spec = ModelSpec(states, STICKY, {}, None, people)
    both, some = (
        log_marginal_likelihood(StudyDensity(x, spec).density, settings)
        for x in (simulate_study1(participants=160), rest)
    )
    theta = hierarchical(rest, states, people, 1000)
    found = latent_log_predictive(rest, held, theta, STICKY, {}, states, people=people)
    error = np.sqrt(both.error**2 + some.error**2 + found.error**2)
    assert abs(found.joint - (both.estimate - some.estimate)) < 4 * error
    assert error < 0.4


def test_somebody_in_both_logs_is_refused():
    rest, _ = parts(simulate_study1(participants=60))
    with pytest.raises(InputError, match="held-out people, in both logs: found"):
        latent_log_predictive(rest, rest, np.zeros((1, 1)), STICKY, {}, 2)


def test_seed_settings_and_refusals():
    rest, held = parts(simulate_study1(participants=80))
    theta = sampled(rest, 2)
    one, two = (latent_log_predictive(rest, held, theta, STICKY, {}, 2) for _ in range(2))
    assert (one.joint, one.error) == (two.joint, two.error)
    other = SmcSettings(LETTING_IN.particles, LETTING_IN.runs, moves=LETTING_IN.moves, seed=2)
    assert latent_log_predictive(rest, held, theta, STICKY, {}, 2, other).joint != one.joint
    single = latent_log_predictive(rest, held, theta, STICKY, {}, 2, SmcSettings(100, 1))
    assert np.isnan(single.error)
    with pytest.raises(InputError, match="held-out people, protocol: found 'corridor', wanted 'published'"):
        latent_log_predictive(rest, random_log(CORRIDOR, people=5), theta, DirichletPrior(), {}, 2)
