"""Log predictive of people left out: closed form, plain mean over draws, difference of marginal likelihoods."""

import numpy as np
import pytest
from scipy.special import logsumexp

from analysis.simulate import simulate_study1
from models.bayesian_fit import fit
from models.draw_kernels import history_log_likelihoods
from models.errors import InputError
from models.hmm_density import HmmDensity
from models.joint_predictive import LETTING_IN, latent_log_predictive
from models.nuts import NutsSettings
from models.parameters import STICKY, DirichletPrior, Layout
from models.posterior import TABLES
from models.protocol import PUBLISHED
from models.rivals import constant
from models.smc import SmcSettings, log_marginal_likelihood
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
