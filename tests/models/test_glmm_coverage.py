"""Coverage of intervals when the truth is the model itself, near the ceiling where people nearly always help."""

import numpy as np
from scipy.stats import binom, chi2

from models.glmm import LogisticMixedModel
from models.glmm_data import Likelihood, Rule
from models.glmm_optimise import maximise
from models.glmm_profile import profile_intervals
from models.glmm_simulation import patterns_of, simulate_successes

TRUTH = np.array([1.9, 0.83, np.log(10.42), 1.387])
"""Intercept, signal, help, sd: conditional odds ratio of help 10.42, nine helping responses in ten."""

CEILING = TRUTH + np.array([1.1, 0, 0, 0])
"""Nineteen in twenty."""


def design(n_people=540, seed=1):
    """People in four conditions, two or three binary responses each."""
    rng = np.random.default_rng(seed)
    person = np.repeat(np.arange(n_people), rng.integers(2, 4, n_people))
    exog = np.column_stack([np.ones(len(person)), (person // 2) % 2, person % 2]).astype(float)
    outcome = np.arange(len(person)) % 2
    return LogisticMixedModel(outcome, exog, person)


def study(n_studies, quadrature, truth=TRUTH, seed=1):
    """Estimates and 95% intervals (profile, Wald) of the help coefficient, one row a study."""
    model, rows = design(), []
    rule = Rule.hermite(quadrature)
    for i in range(n_studies):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
        patterns = patterns_of(model, simulate_successes(model, truth, rng))
        best = maximise(patterns, rule)
        profile = profile_intervals(Likelihood(patterns, rule), best, [2])[0]
        size = 3 if best.boundary else 4
        error = np.sqrt(max(np.linalg.inv(-best.hessian[:size, :size])[2, 2], 0.0))
        rows.append([best.theta[2], best.theta[3], *profile, *(best.theta[2] + np.array([-1.96, 1.96]) * error)])
    return np.array(rows)


def covered(rows, columns):
    return int(np.sum((rows[:, columns[0]] <= TRUTH[2]) & (TRUTH[2] <= rows[:, columns[1]])))


def test_profile_intervals_cover_as_often_as_they_say():
    rows = study(500, 25)
    low, high = binom.ppf([0.001, 0.999], 500, 0.95)
    assert low <= covered(rows, (2, 3)) <= high
    assert abs(rows[:, 0].mean() - TRUTH[2]) < 0.1  # odds ratio within a tenth, the small-sample bias included
    assert np.isfinite(rows[:, 2:4]).all()


def test_laplace_overstates_the_variance_and_near_the_ceiling_jumps_to_another_mode():
    exact, laplace = study(100, 25), study(100, 1)
    assert abs(np.median(exact[:, 1]) - TRUTH[3]) < 0.15
    assert np.quantile(laplace[:, 1] - exact[:, 1], 0.05) > 0.15  # nearly always, on the same data
    exact, laplace = study(100, 25, CEILING), study(100, 1, CEILING)
    assert abs(np.median(exact[:, 1]) - TRUTH[3]) < 0.3
    assert np.median(laplace[:, 1]) > 4.0


def test_the_variance_test_rejects_as_often_as_it_says():
    model, null = design(), np.array([0.5, 0.8, 1.0, 0.0])
    ratios = []
    for i in range(400):
        rng = np.random.default_rng(np.random.SeedSequence(3, spawn_key=(i,)))
        best = maximise(patterns_of(model, simulate_successes(model, null, rng)), model.rule)
        ratios.append(2 * (best.value - best.pooled_value))
    rejected = int(np.sum(0.5 * chi2.sf(np.maximum(ratios, 0), 1) < 0.05))
    low, high = binom.ppf([0.001, 0.999], 400, 0.05)
    assert low <= rejected <= high
    assert binom.ppf(0.001, 400, 0.4) <= np.sum(np.array(ratios) < 1e-8) <= binom.ppf(0.999, 400, 0.6)
