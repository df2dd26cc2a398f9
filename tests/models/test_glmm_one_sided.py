"""Profile intervals that are open on one side, against lme4, brute force and theory."""

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize
from scipy.stats import chi2

from models.glmm import LogisticMixedModel
from models.glmm_exact import ExactLikelihood
from tests.models.test_glmm_separated import FORMULA, LOST, data  # noqa: F401


@pytest.mark.parametrize(
    ("quadrature", "lme4"),
    # glmer (bobyqa, rhoend 1e-9) with offset c * arm[T.c] and uniroot on its log-likelihood, lme4 1.1-31.
    [(25, 4.412539287), ("laplace", 4.208455691)],
)
def test_the_finite_end_is_that_of_lme4_with_the_coefficient_as_an_offset(data, quadrature, lme4):  # noqa: F811
    fit = LogisticMixedModel.from_formula(FORMULA, data, quadrature=quadrature).fit(warn=False)
    low, high = fit.conf_int(method="profile").loc[LOST]
    assert low == pytest.approx(lme4, abs=2e-5)
    assert high == np.inf
    ratios = fit.odds_ratios(method="profile").loc[LOST]
    assert (ratios["lower"], ratios["upper"]) == (pytest.approx(np.exp(low)), np.inf)
    only = fit.conf_int(method="profile", which=LOST)
    assert only.loc[LOST, 0] == low
    assert only.drop(index=LOST).isna().all(axis=None)


def test_signs_units_and_levels(data):  # noqa: F811
    """Failures instead of successes turn the interval round; a covariate in other units scales it."""
    known = LogisticMixedModel.from_formula(FORMULA, data).fit(warn=False).conf_int(method="profile").loc[LOST]
    turned = LogisticMixedModel.from_formula(FORMULA, data.assign(help=1 - data["help"])).fit(warn=False)
    assert turned.conf_int(method="profile").loc[LOST].tolist() == [-np.inf, pytest.approx(-known[0], abs=1e-4)]
    c = (data["arm"] == "c") * 1e-3
    b = (data["arm"] == "b").astype(float)
    scaled = LogisticMixedModel.from_formula("help ~ b + c + age + (1|person)", data.assign(b=b, c=c)).fit(
        warn=False
    )
    assert scaled.conf_int(method="profile").loc["c", 0] == pytest.approx(1e3 * known[0], rel=1e-4)
    wide, narrow = (scaled.conf_int(alpha, "profile").loc["c", 0] for alpha in (0.01, 0.2))
    assert wide < scaled.conf_int(0.05, "profile").loc["c", 0] < narrow


def small(seed):
    """Few groups of three; separated by a covariate, within the groups, or both."""
    rng = np.random.default_rng(seed)
    groups = int(rng.integers(6, 15))
    g = np.repeat(np.arange(groups), 3)
    x, a = rng.normal(size=len(g)), (rng.random(len(g)) < 0.3).astype(int)
    own = rng.normal(size=groups)[g]
    if seed % 3 == 0:
        y = np.where(a == 1, 1, rng.random(len(g)) < 1 / (1 + np.exp(-(x + own))))
    elif seed % 3 == 1:
        y = x + 0.3 * rng.normal(size=len(g)) > 0
    else:
        y = np.where(a == 1, 1, x > own)
    return pd.DataFrame({"y": y.astype(int), "x": x, "a": a, "g": g})


def highest(model, index, value, starts):
    """Brute force: the exact likelihood with one parameter held, by scipy from many points."""
    likelihood = ExactLikelihood(model.patterns)
    free = [i for i in range(model.patterns.n_fixed + 1) if i != index]

    def loss(part):
        theta = np.full(len(free) + 1, float(value))
        theta[free] = part
        found, gradient = likelihood(theta)
        return -found, -gradient[free]

    options = {"gtol": 1e-8, "maxiter": 500}
    return max(-minimize(loss, s[free], jac=True, method="BFGS", options=options).fun for s in starts)


# 0, 21, 39: a covariate; 2, 47, 59: every group within as well; 7, 22: only that; 35, 43: all rows.
@pytest.mark.parametrize("seed", [0, 21, 39, 2, 47, 59, 7, 22, 35, 43])
def test_at_finite_ends_the_likelihood_has_fallen_by_the_quantile(seed):
    fit = LogisticMixedModel.from_formula("y ~ x + a + (1|g)", small(seed)).fit(warn=False)
    unbounded = fit.escape.unbounded
    assert unbounded.any()
    ends = fit.conf_int(method="profile").to_numpy()
    assert not np.isnan(ends).any()
    params = np.array(fit.params)
    top = fit.llf
    if not fit.escape.within_groups and not fit.escape.separation.complete:
        top = highest(fit.model, int(np.flatnonzero(unbounded)[0]), 30.0, [params, 0.3 * params])
    starts = [params, 0.2 * params, *(np.append(np.zeros(3), sd) for sd in (1.0, 5.0, 30.0))]
    for index in np.flatnonzero(unbounded):
        assert np.isinf(ends[index]).any()
        for end in ends[index]:
            if np.isfinite(end) and (index < 3 or end > 0):
                fall = 2 * (top - highest(fit.model, index, end, starts))
                assert fall == pytest.approx(chi2.ppf(0.95, 1), abs=2e-3)


def test_where_another_coefficient_can_run_off_instead_the_interval_is_the_whole_line():
    rng = np.random.default_rng(1)
    g = np.repeat(np.arange(30), 4)
    x = rng.normal(size=120)
    a = (np.arange(120) % 4 == 0).astype(int)
    b = np.where(a == 1, rng.normal(size=120), 0.0)  # there only where everybody helps
    y = np.where(a == 1, 1, rng.random(120) < 1 / (1 + np.exp(-x - rng.normal(size=30)[g]))).astype(int)
    rows = pd.DataFrame({"y": y, "x": x, "a": a, "b": b, "g": g})
    fit = LogisticMixedModel.from_formula("y ~ x + a + b + (1|g)", rows).fit(warn=False)
    ends = fit.conf_int(method="profile")
    assert ends.loc["b"].tolist() == [-np.inf, np.inf]
    assert ends.loc["a", 1] == np.inf
    assert np.isfinite(ends.loc["x"]).all()
    # With every row predicted perfectly any standard deviation will do.
    whole = LogisticMixedModel.from_formula("y ~ a + (1|g)", rows.assign(y=a)).fit(warn=False)
    assert whole.conf_int(method="profile").loc["sd(g)"].tolist() == [0.0, np.inf]
    assert whole.conf_int(method="profile").loc["a", 0] > 0
