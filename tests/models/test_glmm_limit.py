"""The likelihood at infinity: where it is defined, what it is worth, and what follows for a fit."""

from itertools import pairwise

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.optimize import minimize
from scipy.stats import norm

from models.glmm import LogisticMixedModel
from models.glmm_coordinates import Coordinates
from models.glmm_data import Likelihood, Rule
from models.glmm_exact import exact_log_likelihood
from models.glmm_limit import find_limit
from models.glmm_warnings import FlatLikelihoodWarning, MixedModelWarning, SeparationWarning
from tests.models.test_glmm_kernel import Rows
from tests.models.test_glmm_model import study
from tests.reference import glmm_exact as reference


def limit_of(model):
    return find_limit(model.patterns, Coordinates.of(model.patterns.design))


def constant_groups(n_groups=60, seed=3):
    data = study(n_groups, seed=seed)
    return data.assign(help=data.groupby("person")["help"].transform("first"))


def thresholds(n_groups=40, rows=4, sd=3.0, seed=0):
    """Every person switches at a threshold of x of his own."""
    rng = np.random.default_rng(seed)
    g = np.repeat(np.arange(n_groups), rows)
    own = sd * rng.normal(size=n_groups)[g]
    x = own + rng.normal(size=len(g))
    return pd.DataFrame({"g": g, "x": x, "y": (x > own).astype(int), "z": rng.normal(size=len(g))})


# -- the exact likelihood ------------------------------------------------------------------------------
@pytest.mark.parametrize("sd", [0.0, 0.7, 30.0, 400.0])
def test_the_exact_likelihood_is_the_integral(sd):
    rng = np.random.default_rng(5)
    rows = Rows.random(rng, n_groups=4)
    patterns = rows.patterns(compress=False)
    beta = rng.normal(size=3) * max(1.0, sd / 10)
    want = patterns.constant
    for i in range(4):
        mine = slice(patterns.start[i], patterns.start[i + 1])
        eta = patterns.offset[mine] + patterns.design[mine] @ beta
        y, m = patterns.successes[mine], patterns.trials[mine]

        def density(u, eta=eta, y=y, m=m):
            x = eta + sd * u
            return norm.pdf(u) * np.exp(-np.sum(y * np.logaddexp(0, -x) + (m - y) * np.logaddexp(0, x)))

        breaks = sorted({-20.0, *np.clip(-eta / max(sd, 1e-9), -20, 20), 20.0})
        want += np.log(sum(quad(density, a, b, limit=400, epsabs=0)[0] for a, b in pairwise(breaks)))
    assert exact_log_likelihood(patterns, np.append(beta, sd)) == pytest.approx(want, rel=1e-7)


@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.3, 0.8, 2.0, 9.0, 60.0, 700.0]))
def test_the_exact_likelihood_is_that_of_the_specification(seed, sd):
    rng = np.random.default_rng(seed)
    patterns = Rows.random(rng).patterns()
    theta = np.append(rng.normal(size=3) * max(1.0, 0.7 * sd), sd)
    assert exact_log_likelihood(patterns, theta) == pytest.approx(
        reference.exact_log_likelihood(patterns, theta), rel=1e-9
    )


@settings(max_examples=15)
@given(st.integers(0, 10**6))
def test_it_agrees_with_quadrature_where_that_is_good(seed):
    rng = np.random.default_rng(seed)
    patterns = Rows.random(rng).patterns()
    theta = np.append(rng.normal(size=3), rng.uniform(0, 1.5))
    assert exact_log_likelihood(patterns, theta) == pytest.approx(
        Likelihood(patterns, Rule.hermite(51))(theta)[0], abs=1e-8
    )


# -- the limit -----------------------------------------------------------------------------------------
def test_the_limit_is_that_of_the_likelihood():
    """Along the direction found the exact likelihood tends to the value found, from whichever side."""
    for data, formula in (
        (constant_groups(), "help ~ signal + age + (1|person)"), (thresholds(), "y ~ x + z + (1|g)"),
    ):  # fmt: skip
        model = LogisticMixedModel.from_formula(formula, data)
        found = limit_of(model)
        far = [exact_log_likelihood(model.patterns, t * np.append(found.direction, 1.0)) for t in (5, 50, 500)]
        # Constant groups approach it with the reciprocal of t, distinct thresholds faster.
        gaps = np.abs(np.array(far) - found.value)
        assert gaps[2] < 0.3
        assert 5 * gaps[2] < gaps[1] + 1e-3
        assert 5 * gaps[1] < gaps[0] + 1e-3


def test_the_limit_of_constant_groups_is_their_share():
    data = constant_groups()
    hits, n = data.groupby("person")["help"].first().sum(), 60
    want = hits * np.log(hits / n) + (n - hits) * np.log(1 - hits / n)
    found = limit_of(LogisticMixedModel.from_formula("help ~ 1 + (1|person)", data))
    assert found.value == pytest.approx(want, abs=1e-8)
    assert found.direction[0] == pytest.approx(norm.ppf(hits / n), abs=1e-4)
    assert found.constant_groups
    # Covariates that vary within people cannot help, and none of them is needed.
    more = limit_of(LogisticMixedModel.from_formula("help ~ signal + age + (1|person)", data))
    assert more.value == pytest.approx(want, abs=1e-3)
    assert (more.direction[1:] == 0).all()


def test_no_direction_is_better():
    model = LogisticMixedModel.from_formula("y ~ x + (1|g)", thresholds())
    found = limit_of(model)
    eta, y = model.exog, model.endog
    group = model.group_code

    def fall(d):
        t = -(eta @ d)
        lower = np.array([t[(group == g) & (y == 1)].max(initial=-np.inf) for g in range(40)])
        upper = np.array([t[(group == g) & (y == 0)].min(initial=np.inf) for g in range(40)])
        p = norm.cdf(upper) - norm.cdf(lower)
        return np.inf if (p <= 0).any() else -np.log(p).sum()

    again = minimize(fall, found.direction, method="Nelder-Mead", options={"xatol": 1e-8, "fatol": 1e-10})
    assert found.value == pytest.approx(-fall(found.direction), abs=1e-9)
    assert found.value == pytest.approx(-again.fun, abs=1e-3)


@pytest.mark.parametrize("scale", [1.0, 1e6])
@pytest.mark.parametrize("shift", [0.0, 1e9])
def test_the_limit_knows_no_units(scale, shift):
    data = thresholds()
    want = limit_of(LogisticMixedModel.from_formula("y ~ x + (1|g)", data)).value
    moved = LogisticMixedModel.from_formula("y ~ x + (1|g)", data.assign(x=scale * data["x"] + shift))
    assert limit_of(moved).value == pytest.approx(want, abs=1e-3)


@pytest.mark.parametrize("seed", range(10))
def test_ordinary_data_have_none(seed):
    data = study(40, seed=seed)
    data["age"] += np.random.default_rng(seed).normal(size=len(data))
    assert limit_of(LogisticMixedModel.from_formula("help ~ signal + age + (1|person)", data)) is None
    assert limit_of(LogisticMixedModel.from_formula("help ~ 1 + (1|person)", data)) is None


def test_one_contradiction_within_one_group_is_enough():
    data = thresholds()
    pair = data.index[(data["g"] == 3)]
    order = data.loc[pair, "x"].sort_values().index
    data.loc[order, "y"] = [1, 0, 1, 0]
    assert limit_of(LogisticMixedModel.from_formula("y ~ x + (1|g)", data)) is None


# -- what follows for a fit ----------------------------------------------------------------------------
RUNAWAYS = {
    "constant": (constant_groups(), "help ~ 1 + (1|person)", r"every group is constant: sd\(person\) runs to inf"),
    "constant, covariates": (constant_groups(24), "help ~ signal + age + (1|person)", "every group is constant"),
    "thresholds": (thresholds(), "y ~ x + (1|g)", "separated by x, so that the coefficients and"),
    "thresholds, more": (thresholds(), "y ~ x + z + (1|g)", "separated by x and z|separated by x, so"),
    "pairs": (
        pd.DataFrame({"g": np.repeat(np.arange(60), 2), "x": np.tile([0, 1], 60)}).assign(
            y=lambda d: np.where(d["g"] < 20, 0, np.where(d["g"] < 40, 1, d["x"]))
        ),
        "y ~ x + (1|g)", "separated by x, so",
    ),
}  # fmt: skip


@pytest.mark.parametrize("rule", [25, 7, "laplace"])
@pytest.mark.parametrize("case", RUNAWAYS)
def test_fits_without_any_finite_estimate_show_no_number_that_means_nothing(case, rule):
    data, formula, message = RUNAWAYS[case]
    model = LogisticMixedModel.from_formula(formula, data, quadrature=rule)
    with pytest.warns(SeparationWarning, match=message) as caught:
        result = model.fit()
    assert len([w for w in caught if issubclass(w.category, MixedModelWarning)]) == 1
    assert not result.converged
    assert result.escape.within_groups
    for vector in (result.bse, result.tvalues, result.pvalues):
        assert vector.isna().all()
    assert result.conf_int().isna().all(axis=None)
    assert result.odds_ratios().drop(columns="odds ratio").isna().all(axis=None)
    text = str(result.summary())
    table = text.split("----\n")[-1].split("\n====")[0]
    assert not any(digit in table.split("sd(")[1] for digit in "123456789")
    assert "rises to" in text
    ends = result.conf_int(method="profile")
    assert not ends.isna().any(axis=None)
    assert ends.map(np.isinf).any(axis=1).all()
    assert result.odds_ratios(method="profile")[["lower", "upper"]].isin([0.0, np.inf]).any(axis=1).all()
    assert "inf" in str(result.summary(method="profile")).split("sd(")[-1].splitlines()[0]
    assert result.cov_params().isna().all(axis=None)
    assert result.cov_params(kind="robust").isna().all(axis=None)


def test_a_pair_study_has_the_saturated_limit():
    data, formula, _ = RUNAWAYS["pairs"]
    result = LogisticMixedModel.from_formula(formula, data).fit(warn=False)
    assert result.escape.limit.value == pytest.approx(60 * np.log(1 / 3), abs=1e-6)
    assert result.escape.signs.tolist() == [-1, 1, 1]


def test_separation_within_groups_does_not_hide_a_finite_maximum():
    """Thresholds far apart against the rows around them: the likelihood at infinity is far below the best."""
    data = thresholds(n_groups=12, rows=4, sd=1.0, seed=1)
    data["x"] = data["x"] + 30.0 * (data["g"] % 3)
    model = LogisticMixedModel.from_formula("y ~ x + (1|g)", data)
    result = model.fit(warn=False)
    assert result.escape.limit.value < result.escape.finite - 5
    assert not result.escape.any
    assert not any(note.category in (SeparationWarning, FlatLikelihoodWarning) for note in result.notes)
    assert result.converged
    assert np.isfinite(result.conf_int(method="profile").loc["x"]).all()


def test_a_limit_within_reach_opens_the_intervals():
    data = open_ended()
    model = LogisticMixedModel.from_formula("y ~ x + (1|g)", data)
    with pytest.warns(FlatLikelihoodWarning, match="profile intervals are open"):
        result = model.fit()
    assert result.converged
    assert result.bse.notna().all()
    assert 1e-3 < result.escape.finite - result.escape.limit.value < 1.92
    ends = result.conf_int(method="profile")
    assert ends.loc["sd(g)", 1] == np.inf
    assert ends.loc["x", 1] == np.inf
    narrow = result.conf_int(method="profile", alpha=0.97)
    assert np.isfinite(narrow.loc["sd(g)", 1])


def open_ended():
    """Data separated within groups whose likelihood has a finite maximum a little above its limit."""
    for seed in range(400):
        data = thresholds(n_groups=8, rows=3, sd=1.0, seed=seed)
        if data["y"].nunique() < 2:
            continue
        model = LogisticMixedModel.from_formula("y ~ x + (1|g)", data)
        escape = model.fit(warn=False).escape
        gap = escape.finite - escape.limit.value if escape.limit is not None else np.nan
        if not escape.any and 0.01 < gap < 1.9:
            return data
    raise AssertionError("no such data among these seeds")
