"""Profile-likelihood intervals against a plain search for the ends."""

import warnings

import numpy as np
import pytest
from scipy.optimize import brentq, minimize
from scipy.stats import chi2

from models.glmm import LogisticMixedModel
from models.glmm_data import Likelihood
from models.glmm_optimise import maximise
from models.glmm_profile import profile_intervals
from tests.models.test_glmm_model import FORMULA, study


def fall(likelihood, best, index, value):
    """Twice the fall of the profile at a value, by scipy; from zero no search leaves an sd of zero."""
    others = np.delete(np.arange(len(best.theta)), index)

    def objective(free):
        theta = np.empty(len(best.theta))
        theta[index], theta[others] = value, free
        log_likelihood, gradient = likelihood(theta)
        return -log_likelihood, -gradient[others]

    starts = [best.theta[others]]
    if best.boundary and index < len(others):
        starts.append(np.append(best.theta[others][:-1], 1.0))
    found = [minimize(objective, start, jac=True, method="BFGS", options={"gtol": 1e-7}).fun for start in starts]
    return 2 * (best.value + min(found))


@pytest.mark.parametrize("quadrature", ["laplace", 9])
@pytest.mark.parametrize("level", [0.9, 0.99])
def test_at_the_ends_the_profile_has_fallen_by_the_quantile(quadrature, level):
    model = LogisticMixedModel.from_formula(FORMULA, study(60), quadrature=quadrature)
    best = maximise(model.patterns, model.rule)
    likelihood = Likelihood(model.patterns, model.rule)
    ends = profile_intervals(likelihood, best, range(4), 1 - level)
    for index in range(4):
        assert ends[index, 0] < best.theta[index] < ends[index, 1]
        for value in ends[index]:
            if value > 0 or index < 3:
                assert fall(likelihood, best, index, value) == pytest.approx(chi2.ppf(level, 1), abs=1e-4)


def test_the_interval_of_the_standard_deviation_reaches_zero_where_it_should():
    model = LogisticMixedModel.from_formula("help ~ signal + (1|person)", study(40, sd=0.5, seed=3))
    result = model.fit(warn=False)
    ends = result.conf_int(method="profile")
    lr = 2 * (result.llf - result.maximum.pooled_value)
    assert lr < chi2.ppf(0.95, 1)
    assert ends.loc["sd(person)", 0] == 0.0
    assert ends.loc["sd(person)", 1] > result.sd
    narrow = 1 - chi2.cdf(0.5 * lr, 1) if lr > 0 else None
    if narrow:
        assert result.conf_int(alpha=narrow, method="profile").loc["sd(person)", 0] > 0


def test_on_the_boundary_all_other_parameters_still_move():
    seeds = (s for s in range(50) if maximise_boundary(s))
    model = LogisticMixedModel.from_formula("help ~ signal + (1|person)", study(40, sd=0.0, seed=next(seeds)))
    best = maximise(model.patterns, model.rule)
    likelihood = Likelihood(model.patterns, model.rule)
    ends = profile_intervals(likelihood, best, [1, 2])
    assert ends[1, 0] == 0.0
    want = brentq(lambda v: fall(likelihood, best, 2, v) - chi2.ppf(0.95, 1), 0.05, 5)
    assert ends[1, 1] == pytest.approx(want, abs=1e-4)
    for value in ends[0]:
        assert fall(likelihood, best, 1, value) == pytest.approx(chi2.ppf(0.95, 1), abs=1e-3)


def maximise_boundary(seed):
    model = LogisticMixedModel.from_formula("help ~ signal + (1|person)", study(40, sd=0.0, seed=seed))
    return maximise(model.patterns, model.rule).boundary


def test_a_coefficient_without_an_end_has_none():
    data = study(60, seed=4)
    data["rare"] = ((np.arange(len(data)) % 12 == 0) & (data["help"] == 1)).astype(int)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = LogisticMixedModel.from_formula("help ~ rare + (1|person)", data).fit()
    ends = result.conf_int(method="profile")
    assert np.isnan(ends.loc["rare"]).all() or ends.loc["rare", 1] == np.inf


def test_some_parameters_only():
    result = LogisticMixedModel.from_formula(FORMULA, study(60)).fit()
    ends = result.conf_int(method="profile", which=["signal"])
    assert np.isfinite(ends.loc["signal"]).all()
    assert np.isnan(ends.drop("signal")).to_numpy().all()
    assert ends.loc["signal"].to_numpy() == pytest.approx(
        result.conf_int(method="profile").loc["signal"].to_numpy()
    )


def test_four_intervals_cost_less_than_ten_fits():
    for seed in range(5):
        model = LogisticMixedModel.from_formula(FORMULA, study(150, seed=seed))
        best = maximise(model.patterns, model.rule)
        likelihood = Likelihood(model.patterns, model.rule)
        profile_intervals(likelihood, best, range(4))
        assert likelihood.calls < 10 * best.evaluations


@pytest.mark.parametrize("seed", [1, 11, 49])
def test_on_the_boundary_the_standard_deviation_leaves_zero_where_that_is_higher(seed):
    """With a coefficient moved the best standard deviation may be positive, though it is zero at the maximum."""
    data = boundary_study(seed)
    result = LogisticMixedModel(*data).fit(warn=False)
    assert result.boundary
    ends = np.asarray(result.conf_int(method="profile"))
    likelihood, params = Likelihood(result.model.patterns, result.model.rule), np.asarray(result.params)
    for index in (1, 2):
        for end in ends[index]:

            def objective(free, index=index, end=end):
                theta = np.insert(free, index, end)
                value, gradient = likelihood(theta)
                return -value, -np.delete(gradient, index)

            found = []
            for sd in (0.5, 2.0):
                start = np.append(np.delete(params, index)[:-1], sd)
                found.append(minimize(objective, start, jac=True, method="BFGS").fun)
            assert 2 * (result.llf + min(found)) == pytest.approx(chi2.ppf(0.95, 1), abs=1e-3)


def boundary_study(seed):
    """A few people with three outcomes each and hardly any variance between them."""
    rng = np.random.default_rng(seed)
    groups = int(rng.integers(15, 60))
    g = np.repeat(np.arange(groups), 3)
    x, b = rng.normal(size=3 * groups), rng.integers(0, 2, groups)[g]
    eta = 1.0 + 0.8 * x + b + 0.3 * rng.normal(size=groups)[g]
    y = (rng.random(3 * groups) < 1 / (1 + np.exp(-eta))).astype(int)
    return y, np.column_stack([np.ones(3 * groups), x, b]), g
