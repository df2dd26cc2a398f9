"""Random slopes where there is no maximum, no number or no such thing: named, never a traceback or an estimate."""

import warnings

import numpy as np
import pandas as pd
import pytest
from statsmodels.formula import options

from models.errors import InputError
from models.glmm import LogisticMixedModel
from models.glmm_comparison import aic_table
from models.glmm_influence import influence
from models.glmm_marginal import marginal_contrast
from models.glmm_nodes import node_table
from models.glmm_residuals import residual_check
from models.glmm_variance import variance_test
from models.glmm_warnings import ConvergenceWarning, DroppedRowsWarning, SeparationWarning
from tests.models.test_glmm_slope import fitted, study


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(4)
    rows = study(2, rho=-0.5)
    return rows.assign(b=rng.normal(size=len(rows)), f=rng.choice(list("uvw"), len(rows)))


@pytest.fixture(scope="module")
def fit(data):
    return fitted(data, "(1 + x|g)")


def told(formula, rows, **kwargs):
    """Warnings of a fit, and the fit."""
    with warnings.catch_warnings(record=True) as found:
        warnings.simplefilter("always")
        result = LogisticMixedModel.from_formula(formula, rows, quadrature="laplace", **kwargs).fit()
    return {note.category: str(note.message) for note in found}, result


# -- separation ----------------------------------------------------------------------------------------
def test_a_separated_cell_is_named_and_the_rest_is_the_fit_without_it(data):
    rows = data.assign(cell=((data["y"] == 1) & (data["b"] > 1)) * 1.0)
    notes, found = told("y ~ a + cell + (1 + x|g)", rows)
    assert notes.keys() == {SeparationWarning}
    assert notes[SeparationWarning].startswith("cell: no finite estimate")
    assert "profile" not in notes[SeparationWarning]
    assert not found.converged
    rest = fitted(rows[rows["cell"] == 0], "(1 + x|g)", fixed="a")
    assert found.llf == pytest.approx(rest.llf, abs=1e-8)
    for name in rest.params.index:
        assert found.params[name] == pytest.approx(rest.params[name], abs=1e-5)
        assert found.bse[name] == pytest.approx(rest.bse[name], rel=1e-5)
    assert found.params["cell"] > 10
    assert found.estimates[list(found.params.index).index("cell")] == np.inf
    assert np.isnan([found.bse["cell"], found.pvalues["cell"], *found.conf_int().loc["cell"]]).all()
    assert found.odds_ratios().loc["cell", "odds ratio"] == np.inf
    assert np.isnan(found.wald_test("cell = 0").pvalue)
    assert np.isnan(found.t_test("cell = 0").pvalue)
    assert found.wald_test("a = 0").pvalue == pytest.approx(rest.pvalues["a"], rel=1e-4)
    # The likelihood that it rises to can be tested.
    lr, p, df = found.compare_lr_test(fitted(rows, "(1 + x|g)", fixed="a"))
    assert (df, p < 1e-4) == (1, True)
    assert lr > 10
    assert "SeparationWarning: cell" in str(found.summary())


def test_a_separated_reference_level_leaves_the_others(data):
    hit = (data["y"] == 1) & (data["b"] > 0.8)
    rows = data.assign(f=np.where(hit, "u", np.where(data["f"] == "u", "v", data["f"])))
    notes, found = told("y ~ f + x + (1 + x|g)", rows)
    assert "Intercept and f[T.v] and f[T.w]: no finite estimate" in notes[SeparationWarning]
    rest = fitted(rows[rows["f"] != "u"], "(1 + x|g)", fixed="f + x")
    names = ["x", "sd(g)", "sd(g: x)", "corr(g: Intercept, x)"]
    assert found.params[names].to_numpy() == pytest.approx(rest.params[names].to_numpy(), abs=1e-4)
    assert found.bse[names].to_numpy() == pytest.approx(rest.bse[names].to_numpy(), rel=1e-3)
    assert found.bse.drop(names).isna().all()


@pytest.mark.parametrize(
    ("outcome", "category", "text"),
    [
        (lambda d: d.assign(cell=1.0 * d["y"]), SeparationWarning, "every row predicted perfectly"),
        (lambda d: d.assign(y=d["g"] % 2, cell=d["b"]), SeparationWarning, "every group is constant"),
        (lambda d: d.assign(y=(d["x"] > 0) * 1, cell=d["b"]), ConvergenceWarning, "no maximum found"),
        (
            lambda d: d.assign(y=(d["x"] * (2 * (d["g"] % 2) - 1) > 0) * 1, cell=d["b"]),
            ConvergenceWarning,
            "logits",
        ),
    ],
)
def test_what_runs_off_is_never_an_estimate(data, outcome, category, text):
    notes, found = told("y ~ cell + (1 + x|g)", outcome(data))
    assert text in notes[category]
    assert not found.converged
    assert found.bse.isna().all()
    with pytest.raises(InputError, match="without a maximum"):
        found.compare_lr_test(fitted(outcome(data), "(1 + x|g)", fixed="1"))


# -- comparisons ---------------------------------------------------------------------------------------
def test_other_values_of_a_random_column_are_other_random_effects(data, fit):
    other = fitted(data.assign(x=data["b"]), "(1 + x|g)", fixed="a")
    with pytest.raises(InputError, match="of the same names and other values"):
        fit.compare_lr_test(other)
    renamed = fitted(data.assign(t=data["x"]), "(1 + t|g)", fixed="x")
    assert fit.compare_lr_test(renamed)[2] == 1
    with pytest.raises(InputError, match="restricted model: found random slopes"):
        told("y ~ x + a + (1|g)", data)[1].compare_lr_test(fitted(data, "(1 + x|g)", fixed="x"))


def test_slopes_beside_an_intercept_by_aic(data, fit):
    plain = told("y ~ x + a + (1|g)", data)[1]
    table = aic_table([plain, fit, plain])
    assert set(table.index) == {"y ~ x + a", "y ~ x + a [2]", "y ~ x + a + (1 + x|g)"}
    assert table.loc["y ~ x + a + (1 + x|g)", "AIC"] == pytest.approx(fit.aic)


def test_tests_of_terms_are_those_of_their_coefficients(fit):
    table = fit.wald_test_terms(scalar=True).table
    assert table.loc["a", "pvalue"] == pytest.approx(fit.pvalues["a"])
    with pytest.raises(InputError, match="hypothesis: found one about a variance parameter"):
        fit.t_test(np.eye(6)[4])


# -- rows and columns ----------------------------------------------------------------------------------
@pytest.mark.parametrize("engine", ["patsy", "formulaic"])
def test_rows_that_a_random_term_loses_are_told(data, engine, monkeypatch):
    monkeypatch.setattr(options, "_formula_engine", engine)
    rows = data.assign(z=data["b"] + 1.5)
    lost = int((rows["z"] <= 0).sum())
    assert lost
    rows.loc[[3, 5], "z"] = np.nan
    lost = int((rows["z"] < 0).sum())
    notes, found = told("y ~ x + (1 + np.log(z)|g)", rows)
    assert f"np.log(z) is no number in {lost} of {len(rows)}" in notes[DroppedRowsWarning]
    assert found.model.n_dropped == lost + 2


@pytest.mark.parametrize("random", ["(1|g)", "(1 + x|g)"])
def test_rows_that_an_offset_loses_are_told(data, random):
    rows = data.assign(z=data["b"] + 1.5)
    rows.loc[3, "z"] = np.nan
    lost = int((rows["z"] < 0).sum())
    notes, found = told(f"y ~ x + offset(log(z)) + {random}", rows)
    assert f"offset(log(z)) is no number in {lost} of {len(rows)}" in notes[DroppedRowsWarning]
    assert found.model.n_dropped == lost + 1


@pytest.mark.parametrize(
    ("formula", "change", "message"),
    [
        ("y ~ a + (1 + x|g)", {"x": "n/a"}, "data, row 4, column 'x': found 'n/a', wanted a number, as in 479"),
        ("y ~ x + a + (1|g)", {"x": "n/a"}, "data, row 4, column 'x': found 'n/a', wanted a number"),
        ("y ~ a + (1 + x|g)", {"x": np.inf}, "random effects, x, row 4: found inf"),
        ("y ~ a + (0|g)", {}, "found nothing that varies between groups"),
        ("y ~ x + (f||g)", {}, r"random term \(f\|\|...\): found the category f, wanted numbers, or \(f\|"),
        ("y ~ x + offset(b^2) + (1|g)", {}, "found '\\^', wanted \\*\\*"),
        ("y ~ x + offset(I(b)) + (1|g)", {}, "an offset needs no I"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_refused_by_name(data, formula, change, message):
    rows = data.copy()
    for name, value in change.items():
        rows[name] = rows[name].astype(object) if isinstance(value, str) else rows[name]
        rows.loc[3, name] = value
    with pytest.raises(InputError, match=message):
        LogisticMixedModel.from_formula(formula, rows, quadrature="laplace")


def test_a_category_with_few_numbers_stays_one(data):
    words = data.assign(f=data["f"].where(data["f"] != "u", 3).astype(object))
    assert fitted(words, "(1|g)", fixed="C(f)").llf == pytest.approx(fitted(data, "(1|g)", fixed="f").llf)


def test_new_rows_lack_a_column_of_the_slope(fit):
    with pytest.raises(InputError, match="exog, columns: found a, wanted also 'x', as in the data of the fit"):
        fit.predict(pd.DataFrame({"a": [0, 1]}))


def test_new_rows_with_an_unknown_level_in_the_slope(data):
    found = fitted(data, "(1 + f|g)", fixed="a")
    with pytest.raises(InputError, match="exog, row 0, column 'f': found 'z', wanted one of the levels"):
        found.predict(pd.DataFrame({"a": [0], "f": ["z"]}))


# -- blocks --------------------------------------------------------------------------------------------
def test_bars_of_one_term_leave_the_others_correlated():
    """glmer, lme4 1.1-31, nAGQ = 1, bobyqa with rhoend 1e-9, tolPwrss 1e-12, of the same data."""
    rows, rng = study(8, groups=60, size=10), np.random.default_rng(88)
    rows["b"], rows["c"] = rng.normal(size=(2, len(rows))).round(4)
    u = rng.multivariate_normal([0, 0], [[0.8, 0.4], [0.4, 0.6]], size=60)
    eta = 0.2 + 0.6 * rows["x"] + u[rows["g"], 0] * rows["b"] + u[rows["g"], 1] * rows["c"]
    rows["y"] = rng.binomial(1, 1 / (1 + np.exp(-eta - rng.normal(size=60)[rows["g"]])))
    found = fitted(rows, "(x||g) + (0 + b + c|g)")
    assert list(found.params.index[3:]) == ["sd(g)", "sd(g: x)", "sd(g: b)", "sd(g: c)", "corr(g: b, c)"]
    assert found.llf == pytest.approx(-358.977696, abs=1e-4)
    wanted = [0.238159, 0.749648, 0.167692, 1.056080, 0.0, 0.817318, 1.264278, 0.662295]
    assert found.params.to_numpy() == pytest.approx(wanted, abs=1e-4)
    assert found.bse.to_numpy()[:3] == pytest.approx([0.207706, 0.130600, 0.218639], rel=1e-3)


# -- what there is not ---------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda f: f.model.fit(cov_type="robust"), "cov_type: found 'robust'"),
        (lambda f: f.model.fit(start_params=[0]), "fit: found the argument start_params"),
        (lambda f: f.model.fit(method="newton"), "method: found 'newton'"),
        (lambda f: f.model.fit(maxiter=0), "max_iterations"),
        (lambda f: f.cov_params(kind="robust"), "kind: found 'robust'"),
        (lambda f: f.node_check, "node_check: found a fit with random slopes"),
        (lambda f: f.random_effects_interval(), "random_effects_interval: found a fit with"),
        (influence, "influence: found a fit with random slopes"),
        (variance_test, "variance_test: found a fit with random slopes"),
        (residual_check, "residual_check: found a fit with random slopes"),
        (node_table, "node_table: found a fit with random slopes"),
        (lambda f: marginal_contrast(f, {"a": 1}, {"a": 0}), "marginal_contrast: found a fit with random slopes"),
    ],
)
def test_what_only_an_intercept_has_is_refused_by_name(fit, ask, message):
    with pytest.raises(InputError, match=message):
        ask(fit)


def test_statsmodels_arguments_that_change_nothing(fit):
    again = fit.model.fit(disp=1, method="bfgs", maxiter=500, warn=False)
    assert again.llf == fit.llf
