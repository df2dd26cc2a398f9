"""Separated data: what runs off is named and has no errors; all else is as if the rows predicted were not there."""

import warnings

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from models.errors import InputError
from models.glmm import LogisticMixedModel
from models.glmm_comparison import aic_table
from models.glmm_influence import influence
from models.glmm_marginal import marginal_contrast
from models.glmm_optimise import maximise
from models.glmm_separation import find_separation
from models.glmm_supremum import supremum
from models.glmm_variance import variance_test
from models.glmm_warnings import ConvergenceWarning, SeparationWarning
from tests.models.test_glmm_model import study


@pytest.fixture(scope="module")
def data():
    """A third arm in which everybody helps always."""
    data = study(150, seed=5)
    data["arm"] = np.where(data["signal"] == 1, "b", "a")
    third = np.random.default_rng(1).random(len(data)) < 0.15
    data.loc[third, ["arm", "help"]] = "c", 1
    return data.astype({"help": int})


FORMULA = "help ~ arm + age + (1|person)"
LOST, LEFT = "arm[T.c]", ["Intercept", "arm[T.b]", "age", "sd(person)"]


@pytest.fixture(scope="module")
def both(data):
    with pytest.warns(SeparationWarning, match=r"arm\[T.c\]: no finite estimate"):
        separated = LogisticMixedModel.from_formula(FORMULA, data).fit()
    rest = data[data["arm"] != "c"]
    return separated, LogisticMixedModel.from_formula(FORMULA, rest).fit()


def test_other_parameters_are_those_of_the_other_rows(both):
    separated, rest = both
    assert separated.params[LEFT].to_numpy() == pytest.approx(rest.params[LEFT].to_numpy(), abs=1e-4)
    assert separated.llf == pytest.approx(rest.llf, abs=1e-5)
    assert separated.bse[LEFT].to_numpy() == pytest.approx(rest.bse[LEFT].to_numpy(), rel=1e-6)
    for method in ("wald", "profile"):
        ours, theirs = (fit.conf_int(method=method).loc[LEFT].to_numpy() for fit in both)
        assert ours == pytest.approx(theirs, abs=2e-4)
    ours, theirs = (fit.cov_params(kind="robust").loc[LEFT, LEFT].to_numpy() for fit in both)
    assert ours == pytest.approx(theirs, rel=1e-5)


def test_what_runs_off_has_no_errors_tests_or_wald_intervals(both):
    separated, _ = both
    assert separated.escape.unbounded.tolist() == [False, False, True, False, False]
    assert separated.escape.signs[2] == 1
    for vector in (separated.bse, separated.tvalues, separated.pvalues):
        assert np.isnan(vector[LOST])
    assert separated.conf_int().loc[LOST].isna().all()
    row = separated.odds_ratios().loc[LOST]
    assert row["odds ratio"] == np.inf
    assert row[["lower", "upper", "z", "p"]].isna().all()
    line = next(x for x in str(separated.summary()).splitlines() if x.startswith("arm[T.c]"))
    assert line.split() == ["arm[T.c]", "inf", "inf"]


def test_hypotheses_about_finite_coefficients_still_have_tests(both):
    separated, rest = both
    ours, theirs = (fit.t_test("arm[T.b] - age = 0.1") for fit in both)
    assert ours.sd.item() == pytest.approx(theirs.sd.item(), rel=1e-5)
    assert np.isnan(separated.t_test("arm[T.c] = 0").pvalue)
    assert separated.wald_test("arm[T.b] = 0").statistic == pytest.approx(
        rest.wald_test("arm[T.b] = 0").statistic, rel=1e-3
    )
    assert np.isnan(separated.wald_test("arm[T.b] = 0, arm[T.c] = 0").pvalue)
    table = separated.wald_test_terms().table
    assert np.isnan(table.loc["arm", "statistic"])
    assert np.isfinite(table.loc["age", "statistic"])


def test_likelihood_ratios_are_of_what_the_likelihood_rises_to(both, data):
    """By brute force: the likelihood with the coefficient that runs off held far out."""
    separated, rest = both
    assert not separated.converged
    assert separated.comparable
    smaller = LogisticMixedModel.from_formula("help ~ age + (1|person)", data).fit(warn=False)
    lr, p, df = separated.compare_lr_test(smaller)
    far = np.array(separated.params)
    far[2] = 40.0
    assert lr == pytest.approx(2 * (separated.model.loglike(far) - smaller.llf), abs=1e-6)
    assert df == 2
    assert p == pytest.approx(chi2.sf(lr, 2))
    assert separated.llf == pytest.approx(rest.llf, abs=1e-9)
    # Where the sd runs off as well the limit stands for quadrature's values.
    constant = data.assign(help=data.groupby("person")["help"].transform("first"))
    runaway, null = (
        LogisticMixedModel.from_formula(f, constant).fit(warn=False)
        for f in ("help ~ age + (1|person)", "help ~ 1 + (1|person)")
    )
    assert runaway.llf == runaway.escape.limit.value
    assert runaway.compare_lr_test(null)[0] >= 0


def test_fits_cut_short_have_no_place_in_the_table_of_aic(data):
    model = LogisticMixedModel.from_formula("help ~ age + (1|person)", data)
    ended, cut = model.fit(warn=False), model.fit(warn=False, max_iterations=1)
    assert not cut.comparable
    table = aic_table({"cut": cut, "ended": ended})
    assert table.index.tolist() == ["ended", "cut"]
    assert table.loc["cut", ["log-likelihood", "AIC", "dAIC", "weight", "BIC"]].isna().all()
    assert table.loc["ended", "weight"] == 1.0


def test_the_supremum_of_bare_data_is_that_of_the_fit(both, data):
    for result in both:
        patterns, rule = result.model.patterns, result.model.rule
        found = supremum(patterns, rule, maximise(patterns, rule))
        assert found.value == pytest.approx(result.llf, abs=1e-9)
        assert found.attained == result.converged


def test_what_is_computed_from_them(both, data):
    separated, rest = both
    changed = influence(separated)
    assert changed[f"d {LOST}"].isna().all()
    assert changed[["d age", "cook"]].notna().all(axis=None)
    contrast = marginal_contrast(separated, {"arm": "b"}, {"arm": "a"})
    want = marginal_contrast(rest, {"arm": "b"}, {"arm": "a"})
    ours, theirs = contrast.conditional_odds_ratio, want.conditional_odds_ratio
    assert (ours.value, ours.lower, ours.upper) == pytest.approx(
        (theirs.value, theirs.lower, theirs.upper), rel=1e-3
    )
    assert np.isfinite([contrast.difference.lower, contrast.difference.upper]).all()
    assert marginal_contrast(separated, {"arm": "c"}, {"arm": "a"}).probability.value > 0.9999
    with pytest.raises(InputError, match="cannot be drawn"):
        marginal_contrast(separated, {"arm": "b"}, {"arm": "a"}, method="simulation")
    assert variance_test(separated).lr == pytest.approx(variance_test(rest).lr, abs=1e-3)


@pytest.mark.parametrize(("scale", "shift"), [(1e-5, 0.0), (86400.0, 1.7e9)])
def test_units_do_not_hide_it(data, both, scale, shift):
    moved = data.assign(age=scale * data["age"] + shift)
    with pytest.warns(SeparationWarning, match=r"arm\[T.c\]: no finite"):
        result = LogisticMixedModel.from_formula(FORMULA, moved).fit()
    assert result.tvalues["age"] == pytest.approx(both[0].tvalues["age"], rel=1e-4)


def test_two_separated_cells_are_both_named(data):
    changed = data.assign(place=np.where(data["age"] > 1.2, "roof", data["place"]))
    changed.loc[changed["place"] == "roof", "help"] = 0
    changed = changed[(changed["place"] != "roof") | (changed["arm"] != "c")]
    model = LogisticMixedModel.from_formula("help ~ arm + place + (1|person)", changed)
    with pytest.warns(SeparationWarning) as caught:
        result = model.fit()
    assert "arm[T.c] and place[T.roof]: no finite estimate" in str(caught[0].message)
    signs = dict(zip(model.data.param_names, result.escape.signs, strict=True))
    assert (signs["arm[T.c]"], signs["place[T.roof]"], signs.get("age", 0)) == (1, -1, 0)
    assert result.bse.isna().sum() == 2


def test_a_covariate_without_rows_left_is_named(data):
    changed = data.assign(cause=data["help"])
    with pytest.warns(
        SeparationWarning, match="every row predicted perfectly.*no row is left to estimate age"
    ) as caught:
        result = LogisticMixedModel.from_formula("help ~ cause + age + (1|person)", changed).fit()
    assert "Intercept and cause: no finite estimate" in str(caught[0].message)
    assert result.bse.isna().all()
    assert result.escape.unbounded.all()
    with pytest.raises(InputError, match="runs off"):
        variance_test(result)
    with pytest.raises(InputError, match="without a maximum"):
        influence(result)


def test_separation_and_constant_groups_together():
    """One cell is predicted perfectly, and in the other rows every person is constant."""
    data = study(60, seed=3)
    data["help"] = data.groupby("person")["help"].transform("first")
    extra = data.groupby("person").head(1).assign(place="roof", help=1)
    both = pd.concat([data, extra], ignore_index=True)
    both["roof"] = (both["place"] == "roof").astype(int)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = LogisticMixedModel.from_formula("help ~ roof + (1|person)", both).fit()
    said = [str(w.message) for w in caught]
    assert any("every group is constant" in text for text in said)
    assert any("roof: no finite estimate" in text for text in said)
    assert result.bse.isna().all()


def test_separation_and_thresholds_together():
    rng = np.random.default_rng(3)
    g = np.repeat(np.arange(30), 4)
    own = 3 * rng.normal(size=30)[g]
    x = own + rng.normal(size=120)
    roof = (rng.random(120) < 0.15).astype(int)
    data = pd.DataFrame({"g": g, "x": x, "roof": roof, "y": np.where(roof == 1, x < 10, x > own).astype(int)})
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = LogisticMixedModel.from_formula("y ~ x + roof + (1|g)", data).fit()
    said = " ".join(str(w.message) for w in caught)
    assert "separated by x, so that" in said
    assert "roof: no finite estimate" in said
    assert result.bse.isna().all()
    ends = result.conf_int(method="profile")
    assert (ends.loc[["x", "roof", "sd(g)"], 1] == np.inf).all()
    assert (ends.loc[["x", "roof"], 0] > 0).all()


@settings(max_examples=25)
@given(st.integers(0, 10**6))
def test_any_small_study_has_numbers_or_a_named_reason(seed):
    """And the same ones in other units."""
    rng = np.random.default_rng(seed)
    n_groups = int(rng.integers(3, 20))
    g = np.repeat(np.arange(n_groups), rng.integers(2, 5, n_groups))
    data = pd.DataFrame({"g": g, "x": rng.normal(size=len(g)), "arm": rng.integers(0, 2, len(g))})
    eta = rng.normal() + rng.choice([0, 5, 30]) * rng.normal(size=n_groups)[g] + rng.choice([0, 5]) * data["x"]
    data["y"] = (rng.random(len(g)) < 1 / (1 + np.exp(-np.clip(eta, -500, 500)))).astype(int)
    formula = "y ~ x + arm + (1|g)"
    try:
        models = [
            LogisticMixedModel.from_formula(formula, d) for d in (data, data.assign(x=1e3 * data["x"] + 1.7e6))
        ]
    except InputError:
        return
    near, far = (model.fit(warn=False) for model in models)
    assert near.escape.within_groups == far.escape.within_groups
    assert near.escape.unbounded[1:].tolist() == far.escape.unbounded[1:].tolist()
    told = {note.category for note in near.notes}
    finite = ~near.escape.unbounded[:-1]
    if near.escape.any:
        assert SeparationWarning in told
        assert near.bse.iloc[:-1][~finite].isna().all()
    elif ConvergenceWarning not in told:
        assert near.llf == pytest.approx(far.llf, rel=1e-7)
        assert near.bse.iloc[:-1].notna().all()
        assert near.conf_int(method="profile").notna().all(axis=None)
    assert str(near.summary())


def test_all_rows_that_any_direction_predicts_are_found():
    """The direction of the largest sum under bounds misses some; a cone has no bounds."""
    rng = np.random.default_rng(7)
    n = 400
    a, b = (rng.random(n) < 0.1).astype(int), (rng.random(n) < 0.1).astype(int)
    x = rng.normal(size=n)
    y = (rng.random(n) < 0.5).astype(int)
    y[a == 1], y[b == 1] = 1, 0
    keep = (a & b) == 0
    frame = pd.DataFrame({"y": y, "a": a, "b": b, "x": x, "g": np.arange(n) // 4})[keep]
    model = LogisticMixedModel.from_formula("y ~ a + b + x + (1|g)", frame)
    result = model.fit(warn=False)
    found = find_separation(model.patterns, result.maximum.pooled_beta, model.exog_names)
    assert found.coefficients == ("a", "b")
    assert found.n_cells == int((frame["a"] + frame["b"]).sum())
    assert not found.complete


@pytest.mark.parametrize("seed", range(8))
def test_ordinary_fits_lose_nothing(seed):
    result = LogisticMixedModel.from_formula("help ~ signal + age + (1|person)", study(50, seed=seed)).fit(
        warn=False
    )
    assert not result.escape.any
    assert result.escape.limit is None
    assert result.bse.iloc[:-1].notna().all()
