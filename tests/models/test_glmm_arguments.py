"""Arguments and tables of every kind: accepted where they mean something, refused by name where not."""

import pickle

import numpy as np
import pandas as pd
import pytest

from models.errors import InputError
from models.glmm import LogisticMixedModel
from models.glmm_influence import influence, without_group
from models.glmm_marginal import marginal_contrast, marginal_probabilities
from models.glmm_nodes import node_table
from models.glmm_residuals import residual_check
from models.glmm_variance import variance_test
from models.glmm_warnings import ConvergenceWarning
from tests.models.test_glmm_model import FORMULA, study


@pytest.fixture(scope="module")
def data():
    return study(60, seed=3)


@pytest.fixture(scope="module")
def fit(data):
    return LogisticMixedModel.from_formula(FORMULA, data).fit()


# -- tables --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("column", ["help", "signal", "age"])
@pytest.mark.parametrize("kind", ["Int64", "Float64", "int64[pyarrow]", "boolean"])
def test_nullable_columns_are_numbers_with_gaps(data, column, kind):
    if kind == "int64[pyarrow]":
        pytest.importorskip("pyarrow")
    whole = data.assign(age=np.where(data["age"] > 0, 1, 0))
    nullable = whole.astype({column: kind})
    nullable.loc[3, column] = pd.NA
    got = LogisticMixedModel.from_formula(FORMULA, nullable)
    want = LogisticMixedModel.from_formula(FORMULA, whole.drop(index=3))
    assert got.n_dropped == 1
    assert got.loglike([0.1, 0.2, 0.3, 0.9]) == pytest.approx(want.loglike([0.1, 0.2, 0.3, 0.9]), rel=1e-12)
    if column == "help":  # an engine calls a true/false covariate by its level
        assert got.endog_names == "help"
    with pytest.raises(InputError, match=r"missing|nan"):
        LogisticMixedModel.from_formula(FORMULA, nullable, missing="raise")


def test_nullable_arrays(data):
    design = data[["signal", "age"]].assign(one=1.0).astype({"signal": "Int64"})
    design.loc[3, "signal"] = pd.NA
    outcome = data["help"].astype("Int64")
    got = LogisticMixedModel(outcome, design, data["person"], missing="drop")
    assert (got.n_dropped, len(got.endog)) == (1, 239)
    with pytest.raises(InputError, match="covariate signal, row 4: found nan"):
        LogisticMixedModel(outcome, design, data["person"])
    offset = data["age"].astype("Float64")
    offset[5] = pd.NA
    with pytest.raises(InputError, match="offset, row 6: found nan"):
        LogisticMixedModel(outcome, design.fillna(0), data["person"], offset=offset)


def test_a_dict_is_a_table(data, fit):
    for columns in ({k: v.to_numpy() for k, v in data.items()}, {k: v.tolist() for k, v in data.items()}):
        assert LogisticMixedModel.from_formula(FORMULA, columns).fit().params.equals(fit.params)
    rows = {"signal": [0, 1], "age": [0.5, 1.0], "person": ["p003", "p001"], "shift": [0.0, 1.0]}
    table = pd.DataFrame(rows)
    for options in ({"offset": "shift"}, {"groups": "person", "which": "linear"}):
        assert fit.predict(rows, **options).equals(fit.predict(table, **options))


TABLES = {
    "a list": (lambda d: [1, 2], {}, r"data: found list, wanted a DataFrame"),
    "nothing": (lambda d: None, {}, r"data: found NoneType, wanted a DataFrame"),
    "records": (lambda d: d.to_records(), {}, r"data: found recarray"),
    "ragged": (lambda d: {"help": [0, 1], "signal": [1]}, {}, r"columns of one length"),
    "no rows": (lambda d: d.iloc[:0], {}, r"data: found no rows"),
    "a column of gaps": (lambda d: d.assign(age=np.nan), {}, r"in every one of 240 rows: nothing in age"),
    "an outcome of gaps": (lambda d: d.assign(help=np.nan), {}, r"nothing in help"),
    "a column of None": (lambda d: d.assign(age=None), {}, r"nothing in age"),
    "groups of gaps": (lambda d: d.assign(person=np.nan), {}, r"a missing value in every one of 240 rows"),
    "gaps in turn": (
        lambda d: d.assign(age=d["age"].where(d.index % 2 == 0), signal=d["signal"].where(d.index % 2 == 1)),
        {}, r"a missing value in every one of 240 rows",
    ),
    "empty subset": (lambda d: d, {"subset": np.zeros(240, bool)}, r"found no rows"),
    "short subset": (lambda d: d, {"subset": [True]}, r"subset: found .*wanted true or false for each of the 240"),
    "unknown subset": (lambda d: d, {"subset": ["x"]}, r"subset"),
    "twice": (lambda d: pd.concat([d, d[["age"]]], axis=1), {}, r"column 'age': found 2 columns, wanted one"),
    "missing=foo": (lambda d: d, {"missing": "foo"}, r"missing: found 'foo', wanted 'drop' or 'raise'"),
    "missing=None": (lambda d: d, {"missing": None}, r"missing: found None"),
    "offset in words": (lambda d: d, {"offset": ["a"] * 240}, r"offset: found values that are no numbers"),
    "complex offset": (lambda d: d, {"offset": object()}, r"offset"),
}  # fmt: skip


@pytest.mark.parametrize("case", TABLES)
def test_tables_that_cannot_be_used_are_refused_by_name(data, case):
    change, options, message = TABLES[case]
    with pytest.raises(InputError, match=message):
        LogisticMixedModel.from_formula(FORMULA, change(data), **options)


def test_arrays_that_cannot_be_used_are_refused_by_name(data, fit):
    y, x, g = fit.model.endog, fit.model.exog, data["person"].to_numpy()
    for arguments, options, message in (
        ((y, x, g), {"missing": "foo"}, "missing: found 'foo'"),
        ((y[:0], x[:0], g[:0]), {}, "no rows"),
        ((y, x[:, :, None], g), {}, "covariate: found 3 dimensions"),
        ((y, x * 1j, g), {}, "complex"),
        ((3.0, x, g), {}, "outcome: found 3.0, wanted one value a row"),
        ((y, np.full_like(x, np.nan), g), {"missing": "drop"}, "a missing value in every one"),
        ((y, x, g), {"offset": "age"}, "offset"),
    ):
        with pytest.raises(InputError, match=message):
            LogisticMixedModel(*arguments, **options)
    with pytest.raises(InputError, match="formula: found None"):
        LogisticMixedModel.from_formula(None, data)


def test_one_number_stands_for_all_rows(data, fit):
    shifted = LogisticMixedModel.from_formula(FORMULA, data, offset=0.5).fit()
    assert shifted.params["Intercept"] == pytest.approx(fit.params["Intercept"] - 0.5, abs=1e-7)
    arrays = LogisticMixedModel(fit.model.endog, fit.model.exog, data["person"].to_numpy(), offset=0.5).fit()
    assert np.asarray(arrays.params) == pytest.approx(shifted.params.to_numpy(), abs=1e-7)
    twice = LogisticMixedModel.from_formula(FORMULA, data, freq_weights=2)
    assert twice.nobs == 480
    assert LogisticMixedModel.from_formula(FORMULA, data, trials=2).trials.max() == 2
    rows = data.iloc[:4]
    assert fit.predict(rows, which="linear", offset=0.5).to_numpy() == pytest.approx(
        fit.predict(rows, which="linear").to_numpy() + 0.5
    )


# -- what methods accept -------------------------------------------------------------------------------
CALLS = {
    "short offset": (lambda f, d: f.predict(d.iloc[:5], offset=[1, 2]), r"offset: found shape \(2,\).*the 5 rows"),
    "short own offset": (lambda f, d: f.predict(offset=[1, 2]), r"the 240 rows"),
    "offset in words": (lambda f, d: f.predict(d.iloc[:5], offset=["a"] * 5), "offset: found values that are no"),
    "short groups": (lambda f, d: f.predict(d.iloc[:5], groups=["p001"]), "groups"),
    "short params": (lambda f, d: f.model.predict([1, 2]), r"params: found shape \(2,\), wanted 4 numbers"),
    "narrow design": (lambda f, d: f.model.predict(f.params, [1, 2]), "2 columns"),
    "short intercepts": (lambda f, d: f.model.predict(f.params, which="linear", intercepts=[1, 2]), "intercepts"),
    "loglike": (lambda f, d: f.model.loglike([1, 2]), "params"),
    "score": (lambda f, d: f.model.score(["a"] * 4), "params"),
    "level in percent": (lambda f, d: f.conf_int(alpha=95), "alpha: found 95, wanted a number between 0 and 1"),
    "level 2": (lambda f, d: f.conf_int(alpha=2, method="profile"), "alpha"),
    "level 0": (lambda f, d: f.odds_ratios(alpha=0), "alpha"),
    "level nan": (lambda f, d: f.summary(alpha=np.nan), "alpha"),
    "level in words": (lambda f, d: f.random_effects_interval(alpha="x"), "alpha"),
    "level true": (lambda f, d: f.conf_int(alpha=True), "alpha"),
    "marginal level": (lambda f, d: marginal_probabilities(f, alpha=95), "alpha"),
    "profile of nobody": (lambda f, d: f.conf_int(method="profile", which=["nope"]), "'nope', wanted one of Inter"),
    "profile of a number": (lambda f, d: f.conf_int(method="profile", which=[1]), "which: found 1"),
    "profile of number 1": (lambda f, d: f.conf_int(method="profile", which=1), "which: found 1, wanted a list"),
    "hypothesis": (lambda f, d: f.t_test("nope = 0"), "hypothesis: found 'nope = 0', wanted names"),
    "short hypothesis": (lambda f, d: f.wald_test([1, 2]), r"hypothesis: found shape \(2,\)"),
    "contrast text": (lambda f, d: marginal_contrast(f, "signal", {"signal": 0}), "setting: found 'signal'"),
    "contrast number": (lambda f, d: marginal_contrast(f, {"signal": 1}, 0), "reference: found 0, wanted"),
    "contrast list": (lambda f, d: marginal_contrast(f, {"signal": [1, 2]}, {}), "signal: found 2 values"),
    "contrast nan": (lambda f, d: marginal_contrast(f, {"signal": np.nan}, {}), "setting, signal: found nan"),
    "contrast level": (lambda f, d: marginal_contrast(f, {"signal": 1}, {"signal": 0}, alpha=2), "alpha"),
    "contrast draws": (
        lambda f, d: marginal_contrast(f, {"signal": 1}, {"signal": 0}, method="simulation", draws=0), "draws",
    ),
    "contrast of nothing": (lambda f, d: marginal_contrast(3, {}, {}), "results: found int"),
    "contrast of a bystander": (
        lambda f, d: marginal_contrast(f, {"place": "lab"}, {"place": "hall"}), "this one changes nothing",
    ),
    "max_iterations": (lambda f, d: f.model.fit(max_iterations=2.5), r"max_iterations \(maxiter\): found 2.5"),
    "maxiter": (lambda f, d: f.model.fit(maxiter=0), "maxiter"),
    "maxiter true": (lambda f, d: f.model.fit(maxiter=True), "maxiter"),
    "method": (lambda f, d: f.model.fit(method="newton"), "method: found 'newton', wanted 'bfgs'"),
    "short start": (lambda f, d: f.model.fit(start_params=[0, 0, 1]), "params: found shape"),
    "start at nan": (lambda f, d: f.model.fit(start_params=[np.nan] * 4), "start_params"),
    "start at zero": (lambda f, d: f.model.fit(start_params=[0, 0, 0, 0]), "positive standard deviation"),
    "starts": (lambda f, d: f.model.fit(starts=3.0), "starts: found 3.0, wanted a list"),
    "starts nan": (lambda f, d: f.model.fit(starts=[np.nan]), "starts"),
    "unknown": (lambda f, d: f.model.fit(full_output=1), "the argument full_output, wanted one of starts"),
    "cov_type": (lambda f, d: f.model.fit(cov_type="nonrobust"), "cov_type"),
}  # fmt: skip


@pytest.mark.parametrize("case", CALLS)
def test_arguments_that_mean_nothing_are_refused_by_name(fit, data, case):
    call, message = CALLS[case]
    with pytest.raises(InputError, match=message):
        call(fit, data)


def test_statsmodels_arguments_of_fit(fit):
    model = fit.model
    assert model.fit(method="bfgs", maxiter=100, disp=0).params.equals(fit.params)
    started = model.fit(start_params=fit.params, starts=(1.0,))
    assert started.params.to_numpy() == pytest.approx(fit.params.to_numpy(), abs=1e-7)
    assert started.maximum.searches[0].iterations <= 3
    assert len(started.maximum.searches) == 2
    with pytest.warns(ConvergenceWarning, match="cut short"):
        model.fit(maxiter=1)


def test_profile_of_one_name(fit):
    one, listed = fit.conf_int(method="profile", which="age"), fit.conf_int(method="profile", which=["age"])
    assert one.equals(listed)
    assert one.loc["age"].notna().all()


# -- offsets of new rows -------------------------------------------------------------------------------
def test_new_rows_need_an_offset_where_the_model_has_one(data, fit):
    result = LogisticMixedModel.from_formula("help ~ signal + (1|person)", data, offset="age").fit()
    rows = data.iloc[:6]
    with pytest.raises(InputError, match=r"offset: found none, wanted that of the new rows \(0 for none\)"):
        marginal_probabilities(result, rows)
    by_name = marginal_probabilities(result, rows, offset="age")
    assert by_name["probability"].to_numpy() == pytest.approx(result.predict(rows, offset="age").to_numpy())
    own = marginal_probabilities(result)
    assert own.iloc[:6].to_numpy() == pytest.approx(by_name.to_numpy())
    zero = marginal_probabilities(result, rows, offset=0)
    assert zero["probability"].to_numpy() == pytest.approx(result.predict(rows, offset=0).to_numpy())
    for ask in (result.predict, result.get_prediction):
        with pytest.raises(InputError, match=r"wanted that of the new rows \(0 for none\)"):
            ask(rows)
    with pytest.raises(InputError, match=r"wanted that of the new rows \(0 for none\)"):
        result.model.predict(result.params, result.model.exog[:2])
    assert marginal_probabilities(fit, rows)["probability"].to_numpy() == pytest.approx(
        fit.predict(rows).to_numpy()
    )
    with pytest.raises(InputError, match="offset: found shape"):
        marginal_probabilities(result, rows, offset=[1.0])


# -- after remove_data ---------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def bare(data):
    result = LogisticMixedModel.from_formula(FORMULA, data).fit()
    result.fittedvalues, result.resid  # noqa: B018  cached before, and gone all the same
    result.remove_data()
    return result


GONE = {
    "resid": lambda r: r.resid, "fittedvalues": lambda r: r.fittedvalues, "predict": lambda r: r.predict(),
    "robust": lambda r: r.cov_params(kind="robust"), "profile": lambda r: r.conf_int(method="profile"),
    "profile summary": lambda r: r.summary(method="profile"), "random effects": lambda r: r.random_effects,
    "compare": lambda r: r.compare_lr_test(r), "loglike": lambda r: r.model.loglike(r.params),
    "score": lambda r: r.model.score(r.params), "score_obs": lambda r: r.model.score_obs(r.params),
    "loglikeobs": lambda r: r.model.loglikeobs(r.params), "hessian": lambda r: r.model.hessian(r.params),
    "fit": lambda r: r.model.fit(), "groups": lambda r: r.model.groups, "residuals": residual_check,
    "model's predictions": lambda r: r.model.predict(r.params),
    "bootstrap": lambda r: variance_test(r, "bootstrap", 19), "influence": influence, "nodes": node_table,
    "without": lambda r: without_group(r, "p001"), "averages": marginal_probabilities,
    "contrast": lambda r: marginal_contrast(r, {"signal": 1}, {"signal": 0}),
}  # fmt: skip


@pytest.mark.parametrize("what", GONE)
def test_what_needs_the_data_says_that_they_were_removed(bare, what):
    with pytest.raises(InputError, match=r"data were removed, wanted the fit as it was before remove_data\(\)"):
        GONE[what](bare)


def test_the_rest_remains(bare, fit, data):
    assert bare.params.equals(fit.params)
    assert bare.bse.equals(fit.bse)
    assert bare.conf_int().equals(fit.conf_int())
    assert bare.odds_ratios().equals(fit.odds_ratios())
    assert (bare.llf, bare.aic, bare.bic, bare.converged, bare.notes) == (fit.llf, fit.aic, fit.bic, True, ())
    assert bare.t_test("signal = 0").pvalue == fit.t_test("signal = 0").pvalue
    assert bare.wald_test_terms().table.equals(fit.wald_test_terms().table)
    assert variance_test(bare).p == variance_test(fit).p
    rows = data.iloc[:5]
    assert bare.predict(rows).equals(fit.predict(rows))
    assert marginal_probabilities(bare, rows).equals(marginal_probabilities(fit, rows))
    text = str(bare.summary())
    assert "Trials per group:       4 to 4" in text
    assert "Wald for the sd" in text
    again = pickle.loads(pickle.dumps(bare))
    assert str(again.summary()) == text


def test_a_robust_fit_keeps_its_covariance(data):
    result = LogisticMixedModel.from_formula(FORMULA, data).fit(cov_type="robust")
    want = result.cov_params(kind="robust")
    result.remove_data()
    assert result.cov_params(kind="robust").equals(want)


def test_a_separated_fit_can_lose_its_data(data):
    changed = data.assign(rare=((data.index % 12 == 0) & (data["help"] == 1)).astype(int))
    result = LogisticMixedModel.from_formula("help ~ rare + (1|person)", changed).fit(warn=False)
    want = result.bse
    result.remove_data()
    assert result.escape.patterns is None
    assert result.bse.equals(want)
    assert "rare" in str(result.summary())
    with pytest.raises(InputError, match="removed"):
        result.conf_int(method="profile")
