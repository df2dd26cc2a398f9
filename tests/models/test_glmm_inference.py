"""What goes beyond the table of coefficients: intercepts, averages over people, variance, residuals, influence."""

import warnings

import numpy as np
import pandas as pd
import pytest
from scipy.integrate import quad
from scipy.stats import chi2, kstest, norm

from models.errors import InputError
from models.glmm import LogisticMixedModel
from models.glmm_climb import climb
from models.glmm_data import Likelihood
from models.glmm_influence import influence, without_group
from models.glmm_marginal import (
    marginal_contrast,
    marginal_probabilities,
    mean_probability,
    probability_and_slopes,
)
from models.glmm_optimise import maximise
from models.glmm_posterior import intercepts
from models.glmm_residuals import residual_check
from models.glmm_simulation import patterns_of, simulate_successes
from models.glmm_variance import variance_test
from tests.models.test_glmm_model import FORMULA, study
from tests.reference import glmm as reference


@pytest.fixture(scope="module")
def data():
    return study()


@pytest.fixture(scope="module")
def fit(data):
    return LogisticMixedModel.from_formula(FORMULA, data).fit()


# -- random effects ------------------------------------------------------------------------------------
def test_random_effects_are_the_posterior_given_the_estimates(fit, data):
    table, theta = fit.random_effects, fit.params.to_numpy()
    assert list(table.index) == sorted(data["person"].unique())
    assert table.index.name == "person"
    for label in ("p000", "p017", "p101"):
        mine = (data["person"] == label).to_numpy()
        eta = fit.model.exog[mine] @ theta[:-1]
        y, m = data["help"].to_numpy(float)[mine], np.ones(mine.sum())

        def density(u, power=0, eta=eta, y=y, m=m):
            return u**power * np.exp(reference.log_joint(u, eta, y, m, theta[-1]))

        total, first, second = (quad(density, -10, 10, args=(k,), epsabs=0)[0] for k in range(3))
        row = table.loc[label]
        assert row["mode"] == pytest.approx(theta[-1] * reference.mode(eta, y, m, theta[-1]), abs=1e-8)
        assert row["mean"] == pytest.approx(theta[-1] * first / total, abs=1e-8)
        assert row["sd"] == pytest.approx(theta[-1] * np.sqrt(second / total - (first / total) ** 2), abs=1e-8)
        below = quad(density, -12, row["lower"] / theta[-1])[0] / total
        above = quad(density, row["upper"] / theta[-1], 12)[0] / total
        assert (below, above) == pytest.approx((0.025, 0.025), abs=2e-5)
    wide = fit.random_effects_interval(alpha=0.5)
    assert (wide["upper"] - wide["lower"] < table["upper"] - table["lower"]).all()


@pytest.mark.parametrize("s", [0.3, 3.0, 25.0])
def test_posteriors_far_from_normal(s):
    data = study(30, rows=5)
    data.loc[data["person"] < "p010", "help"] = 1
    model = LogisticMixedModel.from_formula("help ~ signal + (1|person)", data)
    theta = np.array([-1.0, 0.5, s])
    got = intercepts(Likelihood(model.patterns, model.rule), theta)
    for i in range(model.patterns.n_patterns):
        rows = slice(model.patterns.start[i], model.patterns.start[i + 1])
        eta = model.patterns.design[rows] @ theta[:-1]
        y, m = model.patterns.successes[rows], model.patterns.trials[rows]
        top = reference.log_joint(got.mode[i] / s, eta, y, m, s)
        u = np.linspace(-12, 12, 200_001)
        p = np.exp([reference.log_joint(x, eta, y, m, s) - top for x in u[::20]])
        mean = np.sum(u[::20] * p) / p.sum()
        assert got.mean[i] == pytest.approx(s * mean, abs=1e-3 * s)


# -- averages over people -----------------------------------------------------------------------------
@pytest.mark.parametrize("sd", [0.0, 0.5, 3.0, 20.0])
def test_mean_probability_is_the_integral(sd):
    for eta in (-7.0, -0.3, 0.0, 2.0):
        want = quad(
            lambda u, eta=eta: norm.pdf(u) / (1 + np.exp(-eta - sd * u)), -9, 9, points=[-eta / max(sd, 1)]
        )[0]
        assert mean_probability(np.array([eta]), sd)[0] == pytest.approx(want, rel=1e-9)
    h = 1e-5
    eta = np.array([-1.0, 0.4])
    _, by_eta, by_sd = probability_and_slopes(eta, sd)
    assert by_eta == pytest.approx(
        (mean_probability(eta + h, sd) - mean_probability(eta - h, sd)) / (2 * h), abs=1e-9
    )
    if sd > 0:
        want = (mean_probability(eta, sd + h) - mean_probability(eta, sd - h)) / (2 * h)
        assert by_sd == pytest.approx(want, abs=1e-9)


def test_marginal_contrast_is_standardisation(fit, data):
    got = marginal_contrast(fit, {"signal": 1}, {"signal": 0})
    first, second = (fit.predict(data.assign(signal=value)).mean() for value in (1, 0))
    assert (got.probability.value, got.reference_probability.value) == pytest.approx((first, second))
    assert got.odds_ratio.value == pytest.approx(first / (1 - first) / (second / (1 - second)))
    assert got.difference.value == pytest.approx(first - second)
    assert got.conditional_odds_ratio.value == pytest.approx(np.exp(fit.params["signal"]))
    assert 1 < got.odds_ratio.value < got.conditional_odds_ratio.value
    assert "odds ratio over people" in got.text


def test_delta_and_simulation_agree(fit):
    delta = marginal_contrast(fit, {"signal": 1}, {"signal": 0})
    drawn = marginal_contrast(fit, {"signal": 1}, {"signal": 0}, method="simulation", draws=4000)
    for name in ("probability", "reference_probability", "difference"):
        ours, theirs = getattr(delta, name), getattr(drawn, name)
        width = ours.upper - ours.lower
        assert (ours.lower, ours.upper) == pytest.approx((theirs.lower, theirs.upper), abs=0.12 * width)


def test_delta_errors_are_those_of_a_numerical_derivative(fit):
    rows = pd.DataFrame({"signal": [0, 1], "age": [0.5, -1.0]})
    theta, covariance = fit.params.to_numpy(), fit.cov_params().to_numpy()
    table = marginal_probabilities(fit, rows)
    design = np.column_stack([np.ones(2), rows["signal"], rows["age"]])

    def logit(at):
        p = mean_probability(design @ at[:-1], at[-1])
        return np.log(p / (1 - p))

    slopes = np.array([(logit(theta + h) - logit(theta - h)) / 2e-6 for h in 1e-6 * np.eye(4)])
    half = norm.ppf(0.975) * np.sqrt(np.einsum("ij,ik,kj->j", slopes, covariance, slopes))
    odds = np.log(table / (1 - table))
    assert (odds["upper"] - odds["probability"]).to_numpy() == pytest.approx(half, rel=1e-5)
    assert (odds["probability"] - odds["lower"]).to_numpy() == pytest.approx(half, rel=1e-5)


def test_marginal_contrasts_know_interactions_arrays_and_missing_rows(data, fit):
    holes = data.assign(age=data["age"].where(data.index != 3))
    crossed = LogisticMixedModel.from_formula("help ~ signal * age + (1|person)", holes).fit()
    got = marginal_contrast(crossed, {"signal": 1}, {"signal": 0})
    assert got.conditional_odds_ratio is None
    left = holes.dropna()
    assert got.probability.value == pytest.approx(crossed.predict(left.assign(signal=1)).mean())
    arrays = LogisticMixedModel(data["help"].to_numpy(), fit.model.exog, data["person"]).fit()
    assert marginal_contrast(arrays, {"x1": 1}, {"x1": 0}).probability.value == pytest.approx(
        marginal_contrast(fit, {"signal": 1}, {"signal": 0}).probability.value
    )
    for result, name in ((fit, "sginal"), (arrays, "signal")):
        with pytest.raises(InputError, match=name):
            marginal_contrast(result, {name: 1}, {name: 0})
    with pytest.raises(InputError, match="method"):
        marginal_contrast(fit, {"signal": 1}, {"signal": 0}, method="magic")


# -- variance ----------------------------------------------------------------------------------------
def test_variance_test_halves_the_tail(fit):
    got = variance_test(fit)
    lr = 2 * (fit.llf - fit.maximum.pooled_value)
    assert got.lr == pytest.approx(lr)
    assert got.p == pytest.approx(0.5 * chi2.sf(lr, 1))
    with pytest.raises(InputError, match="method"):
        variance_test(fit, method="wald")
    with pytest.raises(InputError, match="draws"):
        variance_test(fit, method="bootstrap", draws=3)


def test_variance_bootstrap_is_reproducible_and_near_the_mixture():
    result = LogisticMixedModel.from_formula("help ~ signal + (1|person)", study(100, sd=0.45, seed=9)).fit(
        warn=False
    )
    first, again = (variance_test(result, "bootstrap", draws=99, seed=3) for _ in range(2))
    assert np.array_equal(first.simulated, again.simulated)
    assert first.p == (1 + np.sum(first.simulated >= first.lr)) / 100
    assert (first.draws, first.failed) == (99, 0)
    assert 0.3 < first.share_zero < 0.75
    assert "parametric bootstrap, 99 samples, seed 3" in first.text


def test_a_fit_on_the_boundary_has_p_one():
    for seed in range(20):
        result = LogisticMixedModel.from_formula("help ~ 1 + (1|person)", study(40, sd=0.0, seed=seed)).fit(
            warn=False
        )
        if result.boundary:
            break
    assert result.boundary
    assert (variance_test(result).lr, variance_test(result).p) == (0.0, 1.0)


def test_simulated_data_have_the_model_s_averages(fit):
    rng = np.random.default_rng(1)
    theta = fit.params.to_numpy()
    mean = np.mean([simulate_successes(fit.model, theta, rng) for _ in range(400)], axis=0)
    z = (mean - fit.fittedvalues) / np.sqrt(fit.fittedvalues * (1 - fit.fittedvalues) / 400)
    assert np.std(z) == pytest.approx(1, abs=0.1)
    assert abs(z.mean()) < 0.2
    patterns = patterns_of(fit.model, simulate_successes(fit.model, theta, rng))
    assert patterns.n_groups == fit.model.n_groups


# -- residuals ---------------------------------------------------------------------------------------
def test_sequential_probabilities_are_ratios_of_likelihoods(fit):
    """The chance of a success after the earlier rows, by the likelihood kernel with one row more."""
    from models.glmm_residuals import sequential_distribution

    theta = fit.params.to_numpy()
    eta = fit.model.exog[:4] @ theta[:-1]
    y, m = np.array([1.0, 0.0, 1.0, 1.0]), np.array([1.0, 2.0, 1.0, 3.0])
    grid = np.arange(-9, 9.05, 0.05)
    lower, upper = np.empty(4), np.empty(4)
    sequential_distribution(eta, y, m, np.array([0, 4]), theta[-1], grid, lower, upper)

    def log_likelihood(rows, hits):
        value = reference.group(eta[:rows], hits, m[:rows], theta[-1], 101)[0]
        from scipy.special import gammaln

        return value + np.sum(gammaln(m[:rows] + 1) - gammaln(hits + 1) - gammaln(m[:rows] - hits + 1))

    for row in range(4):
        before = log_likelihood(row, y[:row]) if row else 0.0
        chances = [np.exp(log_likelihood(row + 1, np.append(y[:row], k)) - before) for k in range(int(m[row]) + 1)]
        assert sum(chances) == pytest.approx(1, abs=1e-9)
        assert lower[row] == pytest.approx(sum(chances[: int(y[row])]), abs=1e-9)
        assert upper[row] == pytest.approx(sum(chances[: int(y[row]) + 1]), abs=1e-9)


def test_residuals_are_uniform_and_independent_under_the_truth():
    u = []
    for seed in range(6):
        model = LogisticMixedModel.from_formula("help ~ signal + (1|person)", study(250, seed=seed, sd=2.5))
        check = residual_check(model.fit(), seed=seed)
        u.append(check.uniform)
    u = np.concatenate(u)
    assert kstest(u, "uniform").pvalue > 0.001
    z = norm.ppf(u).reshape(-1, 4)  # four rows a person
    assert np.abs(np.corrcoef(z.T) - np.eye(4)).max() < 4.5 / np.sqrt(len(z))


def test_residuals_show_a_variable_that_was_left_out():
    data = study(400, seed=2)
    result = LogisticMixedModel.from_formula("help ~ age + (1|person)", data).fit()
    check = residual_check(result)
    table = check.by(data["signal"], "signal")
    assert list(table.columns) == ["rows", "mean", "z", "p"]
    assert table["p"].max() < 0.05
    assert table["mean"][0] < 0 < table["mean"][1]
    assert "seed 1" in check.text
    right = residual_check(LogisticMixedModel.from_formula(FORMULA, data).fit())
    assert right.by(data["signal"])["p"].min() > 0.01
    with pytest.raises(InputError, match="3 values"):
        check.by([1, 2, 3])


def test_residuals_show_a_missing_random_intercept():
    data = study(400, sd=2.5, seed=6)
    whole = LogisticMixedModel.from_formula(FORMULA, data)
    result = whole.fit()
    result._results.params = climb(Likelihood(whole.patterns, whole.rule), np.zeros(4), fixed=3).theta
    z = residual_check(result).normal.reshape(-1, 4)
    assert np.corrcoef(z.T)[0, 1] > 0.2


# -- influence ---------------------------------------------------------------------------------------
def test_influence_is_what_leaving_out_does(data, fit):
    table = influence(fit)
    assert list(table.columns[:3]) == ["rows", "trials", "successes"]
    assert table["cook"].is_monotonic_decreasing
    assert len(table) == 120
    errors = fit.bse.to_numpy()
    for label in table.index[[0, 1, 60]]:
        again = LogisticMixedModel.from_formula(FORMULA, data[data["person"] != label]).fit()
        assert without_group(fit, label) == pytest.approx(again.params.to_numpy(), abs=1e-6)
        moved = (again.params.to_numpy() - fit.params.to_numpy()) / errors
        assert table.loc[label].to_numpy()[3:7] == pytest.approx(moved, abs=0.12)
    with pytest.raises(InputError, match="nobody"):
        without_group(fit, "nobody")


def test_influence_knows_patterns_and_the_boundary():
    for seed in range(20):
        data = study(40, sd=0.0, seed=seed)
        model = LogisticMixedModel.from_formula("help ~ signal + (1|person)", data)
        if maximise(model.patterns, model.rule).boundary:
            break
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = model.fit()
    assert (result.random_effects == 0).all(axis=None)
    contrast = marginal_contrast(result, {"signal": 1}, {"signal": 0})
    assert contrast.odds_ratio.value > 0
    table = influence(result)
    assert (table["d sd(person)"] == 0).all()
    assert table["cook"].notna().all()
    assert len(table) == 40


@pytest.mark.filterwarnings("ignore::models.glmm_warnings.MixedModelWarning")
@pytest.mark.parametrize("rule", [25, "laplace"])
@pytest.mark.parametrize(("scale", "shift"), [(1e6, 0.0), (1e-6, 0.0), (1e5, 3e4), (1.0, 10.0)])
def test_errors_do_not_depend_on_the_unit_of_a_covariate(rule, scale, shift):
    rng = np.random.default_rng(11)
    group = np.repeat(np.arange(120), 4)
    x = rng.lognormal(size=len(group))
    u = rng.normal(size=120)[group]
    y = (rng.random(len(group)) < 1 / (1 + np.exp(-(-0.5 + 0.4 * x + u)))).astype(float)

    def z(values):
        frame = pd.DataFrame({"y": y, "x": values, "g": group})
        return LogisticMixedModel.from_formula("y ~ x + (1|g)", frame, quadrature=rule).fit().tvalues["x"]

    assert z(scale * x + shift) == pytest.approx(z(x), rel=1e-5)
