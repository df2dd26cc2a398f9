"""Random slopes: lme4's numbers, the exact gradient, the fit with a random intercept, and what there is not."""

import pickle

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize
from scipy.special import expit
from statsmodels.formula import options

from models.errors import InputError
from models.glmm import LogisticMixedModel
from models.glmm_slope import LogisticSlopeModel
from models.glmm_slope_likelihood import SlopeLikelihood
from models.glmm_slope_terms import RandomTerms
from models.glmm_warnings import BoundaryWarning


def study(seed, groups=60, size=8, sd=(1.0, 0.8), rho=0.4, counts=False):
    rng = np.random.default_rng(seed)
    g = np.repeat(np.arange(groups), size)
    n = len(g)
    x, a = rng.normal(size=n).round(4), np.tile([0, 1], n // 2)
    covariance = rho * sd[0] * sd[1]
    u = rng.multivariate_normal([0, 0], [[sd[0] ** 2, covariance], [covariance, sd[1] ** 2]], size=groups)
    eta = 0.3 + 0.6 * x - 0.4 * a + u[g, 0] + u[g, 1] * x
    k = rng.integers(1, 6, n) if counts else np.ones(n, int)
    return pd.DataFrame({"y": rng.binomial(k, expit(eta)), "k": k, "x": x, "a": a, "g": g})


STUDIES = {
    1: {}, 2: {"rho": -0.5}, 3: {"groups": 120, "size": 6}, 4: {"counts": True}, 5: {"sd": (1.0, 0.05), "rho": 0},
    6: {"groups": 30, "size": 20}, 7: {"sd": (0.0, 0.8), "rho": 0},
}  # fmt: skip

# glmer, lme4 1.1-31, nAGQ = 1, bobyqa with rhoend 1e-9, tolPwrss 1e-12, of the studies above: log-likelihood, fixed
# effects, standard deviations, correlation; standard errors of the fixed effects.
TABLE = """
1 (1+x|g) -314.707671 0.155003 0.507110 -0.328893 0.739543 0.494870 0.126514 / 0.17455 0.14772 0.20564
1 (x||g) -314.750378 0.152261 0.506099 -0.328351 0.738722 0.490122 / 0.17417 0.14732 0.20556
2 (1+x|g) -312.129180 0.637596 0.247383 -0.634992 0.646375 0.540221 -0.857047 / 0.17143 0.13019 0.20611
2 (x||g) -314.046935 0.657412 0.271787 -0.632277 0.640078 0.540357 / 0.17190 0.13099 0.20778
3 (1+x|g) -478.845171 0.291996 0.227448 -0.636535 0.781490 0.362393 0.759227 / 0.13764 0.09601 0.16967
3 (x||g) -480.238086 0.279331 0.224361 -0.627327 0.773964 0.306580 / 0.13700 0.09477 0.16927
4 (1+x|g) -556.525066 0.246952 0.580604 -0.197557 0.931498 0.748332 0.187697 / 0.15431 0.12698 0.12924
4 (x||g) -556.867077 0.240490 0.575995 -0.198878 0.923287 0.758734 / 0.15329 0.12796 0.12942
5 (1+x|g) -305.057166 0.364455 0.584827 -0.765065 0.915694 0.038169 1.0 / 0.19025 0.12309 0.20866
5 (x||g) -305.083733 0.358152 0.583875 -0.767364 0.916159 0.0 / 0.18824 0.12277 0.20844
6 (1+x|g) -379.120504 0.128291 0.585637 -0.179847 0.686619 0.772979 0.744632 / 0.18267 0.17930 0.18402
6 (x||g) -382.458316 0.086453 0.579242 -0.176619 0.668085 0.754025 / 0.17957 0.17678 0.18465
7 (1+x|g) -297.754465 0.295687 0.968384 -0.514002 0.019919 0.949961 -1.0 / 0.15017 0.20223 0.20878
7 (x||g) -297.762595 0.298763 0.969390 -0.513849 0.0 0.953418 / 0.14828 0.20252 0.20880
"""
LME4 = [line.split(maxsplit=2) for line in TABLE.strip().splitlines()]


def fitted(data, random, fixed="x + a", **kwargs):
    formula = f"y ~ {fixed} + {random}"
    return LogisticMixedModel.from_formula(formula, data, quadrature="laplace", **kwargs).fit(warn=False)


@pytest.fixture(scope="module")
def data():
    return study(2, rho=-0.5)


@pytest.fixture(scope="module")
def fit(data):
    return fitted(data, "(1 + x|g)")


# -- against lme4 --------------------------------------------------------------------------------------
@pytest.mark.parametrize(("number", "random", "numbers"), LME4)
def test_lme4_finds_the_same(number, random, numbers):
    options = STUDIES[int(number)]
    found = fitted(study(int(number), **options), random, trials="k" if "counts" in options else None)
    (value, *params), errors = ([float(v) for v in part.split()] for part in numbers.split("/"))
    assert found.converged
    assert found.llf == pytest.approx(value, abs=1e-5)
    assert found.params.to_numpy()[:3] == pytest.approx(params[:3], abs=1e-4)
    assert found.params.to_numpy()[3:] == pytest.approx(params[3:], abs=1e-3)
    assert found.bse.to_numpy()[:3] == pytest.approx(errors, rel=1e-3)
    assert found.singular == (number in "57")
    if found.singular:
        assert [note.category for note in found.notes] == [BoundaryWarning]
        assert "singular fit" in found.notes[0].text
        assert found.bse.iloc[3:].isna().all()
    else:
        assert not found.notes
        assert found.bse.notna().all()


# -- the likelihood ------------------------------------------------------------------------------------
@pytest.mark.parametrize("entries", [((0, 0), (1, 0), (1, 1)), ((0, 0), (1, 1)), ((0, 0), (1, 0), (1, 1), (2, 2))])
def test_the_gradient_is_that_of_the_value(entries):
    rows = study(3, groups=20, size=6, counts=True)
    design = np.column_stack([np.ones(len(rows)), rows["x"], rows["a"]])
    columns = design[:, : 1 + max(i for i, _ in entries)]
    start = np.arange(0, len(rows), 6)
    arguments = (0.1 * design[:, 1], rows["y"].to_numpy(float), rows["k"].to_numpy(float), columns, start)
    likelihood = SlopeLikelihood(design, *arguments, entries, -1.5)
    theta = np.random.default_rng(1).normal(size=3 + len(entries))
    value, gradient = likelihood(theta)
    assert likelihood.scores.sum(axis=0) == pytest.approx(gradient)
    for i, unit in enumerate(np.eye(len(theta))):
        step = (likelihood(theta + 1e-5 * unit)[0] - likelihood(theta - 1e-5 * unit)[0]) / 2e-5
        assert step == pytest.approx(gradient[i], rel=1e-6, abs=1e-6)
    # One group by hand: mode by scipy, determinant by the formula.
    factor = likelihood.factor(theta)
    y, m = arguments[1][:6], arguments[2][:6]
    eta = arguments[0][:6] + design[:6] @ theta[:3]
    a = columns[:6] @ factor

    def depth(u):
        x = eta + a @ u
        return -np.sum(y * x - m * np.logaddexp(0, x)) + u @ u / 2

    mode = minimize(depth, np.zeros(len(factor)), options={"gtol": 1e-9}).x
    p = expit(eta + a @ mode)
    _, determinant = np.linalg.slogdet(np.eye(len(factor)) + a.T @ ((m * p * (1 - p))[:, None] * a))
    alone = SlopeLikelihood(design[:6], *(v[:6] for v in arguments[:4]), np.array([0]), entries, 0.0)
    assert alone(theta)[0] == pytest.approx(-depth(mode) - determinant / 2, abs=1e-6)
    assert value == pytest.approx(likelihood(theta)[0], abs=1e-10)


def test_one_random_effect_is_the_random_intercept(data):
    wanted = LogisticMixedModel.from_formula("y ~ x + a + (1|g)", data, quadrature="laplace").fit(warn=False)
    found = fitted(data.assign(one=1.0), "(0 + one|g)")
    assert found.llf == pytest.approx(wanted.llf, abs=1e-8)
    assert found.params.to_numpy() == pytest.approx(wanted.params.to_numpy(), abs=1e-5)
    assert found.bse.to_numpy() == pytest.approx(wanted.bse.to_numpy(), rel=1e-4)
    assert (found.aic, found.bic) == pytest.approx((wanted.aic, wanted.bic))
    assert found.random_effects["one"].to_numpy() == pytest.approx(
        wanted.random_effects["mode"].to_numpy(), abs=1e-5
    )


def test_units_and_weights_change_nothing(data, fit):
    scaled = fitted(data.assign(x=1e4 * data["x"]), "(1 + x|g)")
    assert scaled.llf == pytest.approx(fit.llf, abs=1e-7)
    factors = np.array([1, 1e4, 1, 1, 1e4, 1])
    assert scaled.params.to_numpy() * factors == pytest.approx(fit.params.to_numpy(), abs=1e-4)
    assert scaled.bse.to_numpy() * factors == pytest.approx(fit.bse.to_numpy(), rel=1e-3)
    rows = data.sample(frac=1, random_state=1)
    twice = fitted(pd.concat([rows, rows]), "(1 + x|g)")
    weighted = fitted(data.assign(w=2), "(1 + x|g)", freq_weights="w")
    assert weighted.llf == pytest.approx(twice.llf, abs=1e-7)
    assert weighted.params.to_numpy() == pytest.approx(twice.params.to_numpy(), abs=1e-4)


# -- results -------------------------------------------------------------------------------------------
def test_names_criteria_and_tests(fit, data):
    assert list(fit.params.index) == ["Intercept", "x", "a", "sd(g)", "sd(g: x)", "corr(g: Intercept, x)"]
    assert fit.aic == pytest.approx(-2 * fit.llf + 2 * 6)
    assert fit.bic == pytest.approx(-2 * fit.llf + np.log(len(data)) * 6)
    assert fit.tvalues.iloc[3:].isna().all()
    assert fit.t_test("x = 0").pvalue == pytest.approx(fit.pvalues["x"])
    assert fit.t_test([0, 1, 0]).pvalue == pytest.approx(fit.pvalues["x"])
    assert fit.wald_test("x = 0, a = 0").df_denom == 2
    assert fit.conf_int(cols=["a"]).equals(fit.conf_int().loc[["a"]])
    assert fit.odds_ratios().loc["a", "odds ratio"] == pytest.approx(np.exp(fit.params["a"]))
    smaller = fitted(data, "(1 + x|g)", fixed="x")
    lr, p, df = fit.compare_lr_test(smaller)
    assert (lr, df) == (pytest.approx(2 * (fit.llf - smaller.llf)), 1)
    assert p == pytest.approx(fit.pvalues["a"], rel=0.2)
    text = str(fit.summary())
    for part in ("random slopes", "corr(g: Intercept, x)", "Laplace", "Random effects:"):
        assert part in text
    assert max(map(len, text.splitlines())) <= 110


def test_errors_of_standard_deviations_are_those_of_other_coordinates(fit):
    """Differences of the log-likelihood in the natural parameters themselves."""
    model = fit.model
    from models.glmm_coordinates import Coordinates

    likelihood = model.likelihood(Coordinates.same(3), np.ones(2))

    def value(natural):
        *beta, first, second, corr = natural
        return likelihood(np.array([*beta, first, corr * second, second * np.sqrt(1 - corr**2)]))[0]

    at, size = fit.params.to_numpy(), 1e-4
    hessian = np.empty((6, 6))
    for i, e in enumerate(size * np.eye(6)):
        for j, f in enumerate(size * np.eye(6)):
            four = value(at + e + f) - value(at + e - f) - value(at - e + f) + value(at - e - f)
            hessian[i, j] = four / (4 * size**2)
    assert fit.bse.to_numpy() == pytest.approx(np.sqrt(np.diag(np.linalg.inv(-hessian))), rel=1e-3)


@pytest.mark.parametrize("engine", ["patsy", "formulaic"])
def test_predictions(data, fit, engine, monkeypatch):
    monkeypatch.setattr(options, "_formula_engine", engine)
    ours = fitted(data, "(1 + x|g)")
    assert ours.params.to_numpy() == pytest.approx(fit.params.to_numpy(), abs=1e-6)
    rows = data.iloc[:5]
    for which in ("marginal", "conditional", "linear"):
        own = ours.predict(which=which)
        assert own.index.equals(data.index)
        assert ours.predict(rows, which=which).to_numpy() == pytest.approx(own.iloc[:5].to_numpy())
    draws = np.random.default_rng(1).multivariate_normal([0, 0], fit.covariance, 200_000)
    eta = fit.predict(rows, which="linear").to_numpy()
    simulated = expit(eta[:, None] + np.column_stack([np.ones(5), rows["x"]]) @ draws.T).mean(axis=1)
    assert fit.predict(rows).to_numpy() == pytest.approx(simulated, abs=3e-3)
    with pytest.raises(InputError, match="which: found 'odds'"):
        fit.predict(rows, which="odds")


def test_modes_are_those_of_the_groups(fit, data):
    effects = fit.random_effects
    assert list(effects) == ["Intercept", "x"]
    group = data[data["g"] == 7]
    eta = fit.predict(group, which="linear").to_numpy()
    z = np.column_stack([np.ones(len(group)), group["x"]])

    def depth(b):
        x = eta + z @ b
        return -np.sum(group["y"] * x - np.logaddexp(0, x)) + b @ np.linalg.solve(fit.covariance, b) / 2

    assert effects.loc[7].to_numpy() == pytest.approx(minimize(depth, [0, 0]).x, abs=1e-4)


def test_pickles(fit, data):
    again = pickle.loads(pickle.dumps(fit))
    assert again.params.equals(fit.params)
    assert again.predict(data.iloc[:3]).to_numpy() == pytest.approx(fit.predict(data.iloc[:3]).to_numpy())
    assert isinstance(again.model, LogisticSlopeModel)


def test_rows_without_a_value_are_left_out(data):
    gaps = data.assign(z=data["x"].where(data.index > 4), y=data["y"].astype(float).where(data.index < 470))
    model = LogisticMixedModel.from_formula("y ~ a + (1 + z|g)", gaps, quadrature="laplace")
    assert model.n_dropped == 15
    whole = gaps.dropna()
    assert model.fit(warn=False).llf == pytest.approx(fitted(whole, "(1 + z|g)", fixed="a").llf, abs=1e-8)


# -- the formula ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("formula", "blocks", "separate"),
    [
        ("y ~ x + (x|g)", ("x",), (False,)), ("y ~ (1 + x + a | g) + x", ("1 + x + a",), (False,)),
        ("y ~ x + (1|g) + (0 + x|g)", ("1", "0 + x"), (False, False)), ("y ~ x + (x||g)", ("x",), (True,)),
        ("y ~ x + (np.log(x) | g)", ("np.log(x)",), (False,)),
    ],
)  # fmt: skip
def test_random_terms_are_read(formula, blocks, separate):
    terms = RandomTerms.read(formula)
    assert (terms.blocks, terms.separate, terms.groups) == (blocks, separate, "g")
    assert terms.fixed.count("|") == 1


def test_several_effects_and_categories(data):
    three = fitted(data, "(1 + x + a || g)")
    assert list(three.params.index[3:]) == ["sd(g)", "sd(g: x)", "sd(g: a)"]
    words = data.assign(arm=np.where(data["a"] == 1, "new", "old"))
    coded = fitted(words, "(1 + x|g)", fixed="x + arm")
    assert coded.llf == pytest.approx(fitted(data, "(1 + x|g)").llf, abs=1e-7)


@pytest.mark.parametrize(
    ("formula", "options", "message"),
    [
        ("y ~ x + (1 + x|g)", {"quadrature": 25}, "quadrature: found 25, wanted 'laplace', by name"),
        ("y ~ x + (1|g) + (0 + x|a)", {}, "found random terms of g and a"),
        ("y ~ x + (x|g)", {"groups": "g"}, "groups: found given"),
        ("y ~ x + (z|g)", {}, "found 'z', wanted one of the columns"),
        ("y ~ x + (x|h)", {}, "groups: found 'h'"),
        ("y ~ x + (1|g) + (1 + x|g)", {}, "random effects: found Intercept twice"),
        ("y ~ x + (1 + x + k|g)", {}, "random effects: found k, wanted columns that vary"),
    ],
)
def test_what_cannot_be_fitted(data, formula, options, message):
    with pytest.raises(InputError, match=message):
        LogisticMixedModel.from_formula(formula, data, **{"quadrature": "laplace", **options})


def test_what_there_is_not_is_said(fit, data):
    intercept = LogisticMixedModel.from_formula("y ~ x + a + (1|g)", data, quadrature="laplace").fit(warn=False)
    for ask, message in (
        (lambda: fit.conf_int(method="profile"), "method: found 'profile', wanted 'wald'"),
        (fit.get_prediction, "get_prediction: found a fit with random slopes"),
        (lambda: fit.compare_lr_test(intercept), "other random effects"),
        (fit.bootstrap, "bootstrap"),
        (fit.remove_data, "remove_data"),
    ):
        with pytest.raises(InputError, match=message):
            ask()
