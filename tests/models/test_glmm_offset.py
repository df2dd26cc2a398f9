"""Offsets in formulas, gaps and dates, predictions with intervals: what statsmodels' and lme4's users expect."""

import numpy as np
import pandas as pd
import pytest
from scipy.special import expit
from statsmodels.formula import options

from models.errors import InputError
from models.glmm import LogisticMixedModel
from models.glmm_marginal import marginal_probabilities
from models.glmm_warnings import DroppedRowsWarning
from tests.models.test_glmm_model import study

FORMULA = "help ~ signal + age + (1|person)"


@pytest.fixture(scope="module")
def data():
    rows = study(60, seed=4)
    days = pd.Timestamp("2026-01-01") + pd.to_timedelta(rows.index, "D")
    return rows.assign(n=np.exp(rows["age"]).round(3), day=days)


@pytest.fixture(scope="module")
def fit(data):
    return LogisticMixedModel.from_formula(FORMULA, data).fit()


@pytest.fixture(params=["patsy", "formulaic"])
def engine(request, monkeypatch):
    monkeypatch.setattr(options, "_formula_engine", request.param)
    return request.param


# -- offsets -------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("formula", "same"),
    [
        ("help ~ signal + offset(age) + (1|person)", lambda d: d["age"]),
        ("help ~ offset(log(n)) + signal + (1|person)", lambda d: np.log(d["n"])),
        (
            "help ~ signal + (1|person) + offset(0.5 * age) + offset(np.log(n))",
            lambda d: d["age"] / 2 + np.log(d["n"]),
        ),
        ("help ~ signal + offset(`age`) + (1|person)", lambda d: d["age"]),
        ("help ~ C(signal) + offset(1) + (1|person)", lambda d: 1.0),
    ],
)
def test_an_offset_of_the_formula_is_the_argument(data, formula, same, engine):
    ours = LogisticMixedModel.from_formula(formula, data).fit(warn=False)
    plain = "help ~ C(signal) + (1|person)" if "C(" in formula else "help ~ signal + (1|person)"
    wanted = LogisticMixedModel.from_formula(plain, data, offset=same(data)).fit(warn=False)
    assert ours.llf == pytest.approx(wanted.llf, abs=1e-9)
    assert ours.params.to_numpy() == pytest.approx(wanted.params.to_numpy(), abs=1e-7)
    rows = data.iloc[:5]
    own = ours.predict().iloc[:5].to_numpy()
    assert ours.predict(rows).to_numpy() == pytest.approx(own)  # computed for new rows too
    assert marginal_probabilities(ours, rows)["probability"].to_numpy() == pytest.approx(own)
    assert ours.predict(rows, offset=0).to_numpy() != pytest.approx(own)


def test_rows_without_an_offset_are_dropped_and_predictions_name_the_column(data):
    gaps = data.assign(n=data["n"].where(data.index > 3))
    model = LogisticMixedModel.from_formula("help ~ signal + offset(log(n)) + (1|person)", gaps)
    assert model.n_dropped == 4
    result = model.fit(warn=False)
    with pytest.raises(InputError, match=r"exog, offset\(log\(n\)\): found 'n', wanted one of the columns signal"):
        result.predict(data[["signal"]])
    assert result.predict(data[["signal"]], offset=0).notna().all()


@pytest.mark.parametrize(
    ("formula", "options", "message"),
    [
        (
            "help ~ signal + offset(age) + (1|person)",
            {"offset": "n"},
            r"offset: found offset\(age\) in the formula",
        ),
        ("help ~ signal * offset(age) + (1|person)", {}, "an offset within another term"),
        ("help ~ signal + offset(age + (1|person)", {}, "formula"),
        ("help ~ signal + offset(place) + (1|person)", {}, r"offset\(place\): found ValueError"),
        ("help ~ signal + offset(day) + (1|person)", {}, r"offset\(day\)"),
        ("help ~ signal + offset([1, 2]) + (1|person)", {}, r"found shape \(2,\), wanted one number for each"),
    ],
)
def test_offsets_that_are_none(data, formula, options, message):
    with pytest.raises(InputError, match=message):
        LogisticMixedModel.from_formula(formula, data, **options)


# -- gaps, dates, lengths --------------------------------------------------------------------------------
@pytest.mark.filterwarnings("ignore:invalid value encountered in log")
def test_rows_that_a_term_drops_are_named(data, engine):
    model = LogisticMixedModel.from_formula("help ~ signal + np.log(age + 0.05) + (1|person)", data)
    lost = int((data["age"] < -0.05).sum())
    assert model.dropped_by_terms == {"np.log(age + 0.05)": lost}
    assert model.n_dropped == lost
    with pytest.warns(DroppedRowsWarning, match=rf"\) is no number in {lost} of {len(data)}"):
        model.fit()
    assert not LogisticMixedModel.from_formula(FORMULA, data).dropped_by_terms


def test_gaps_are_refused_by_row_and_column_where_they_must_be(data, engine):
    gaps = data.assign(age=data["age"].where(data.index != 6))
    with pytest.raises(InputError, match="data, row 7, column 'age': found a missing value"):
        LogisticMixedModel.from_formula(FORMULA, gaps, missing="raise")


def test_dates_are_no_numbers(data, engine):
    with pytest.raises(InputError, match="column 'day': found dates, wanted numbers"):
        LogisticMixedModel.from_formula("help ~ signal + day + (1|person)", data)
    since = data.assign(days=(data["day"] - data["day"].min()).dt.days)
    assert LogisticMixedModel.from_formula("help ~ days + (1|person)", since).nobs == len(data)


def test_a_term_of_another_length_is_named(data, engine):
    with pytest.raises(InputError, match="formula 'help ~ signal"):
        LogisticMixedModel.from_formula("help ~ signal + np.ones(3) + (1|person)", data)


# -- statsmodels' surface --------------------------------------------------------------------------------
@pytest.mark.parametrize("which", ["marginal", "conditional", "linear"])
def test_predictions_with_intervals(fit, data, which):
    rows = data.iloc[:6]
    found = fit.get_prediction(rows, which=which)
    assert found.predicted == pytest.approx(fit.predict(rows, which=which).to_numpy())
    table = found.summary_frame(alpha=0.1)
    assert list(table) == ["predicted", "se", "ci_lower", "ci_upper"]
    assert table.index.equals(rows.index)
    assert (table["ci_lower"] < table["predicted"]).all()
    assert (table["predicted"] < table["ci_upper"]).all()
    # By draws of the parameters.
    rng = np.random.default_rng(1)
    draws = rng.multivariate_normal(fit.params, fit.cov_params(), 4000)
    design = fit.design_of(rows)[0]
    values = np.array([fit.model.predict(theta, design, which=which) for theta in draws])
    assert found.se == pytest.approx(values.std(axis=0), rel=0.1)
    if which == "linear":
        wald = fit.t_test(np.column_stack([design, np.zeros(6)]))
        assert found.conf_int() == pytest.approx(wald.conf_int())
        conditional = fit.get_prediction(rows, which="conditional")
        assert conditional.conf_int() == pytest.approx(expit(found.conf_int()))
    own = fit.get_prediction(which=which).predicted
    assert own == pytest.approx(fit.predict(which=which).to_numpy())


def test_columns_of_the_design_are_predicted_as_they_are(fit, data):
    design, _ = fit.design_of(data.iloc[:4])
    wanted = fit.predict(data.iloc[:4]).to_numpy()
    assert fit.predict(design, transform=False).to_numpy() == pytest.approx(wanted)
    assert fit.get_prediction(design, transform=False).predicted == pytest.approx(wanted)
    with pytest.raises(InputError, match="exog: found 2 columns"):
        fit.predict(design[:, :2], transform=False)


def test_intervals_of_some_parameters(fit):
    whole = fit.conf_int()
    assert fit.conf_int(cols=[1]).equals(whole.iloc[[1]])
    assert fit.conf_int(cols=["age", "signal"]).equals(whole.loc[["age", "signal"]])
    profile = fit.conf_int(method="profile")
    some = fit.conf_int(method="profile", cols=[3, 1])
    pd.testing.assert_frame_equal(some, profile.iloc[[3, 1]], rtol=1e-6)
    for bad in ([7], ["colour"], 1.5, [True]):
        with pytest.raises(InputError, match="cols: found"):
            fit.conf_int(cols=bad)
    with pytest.raises(InputError, match="which: found cols as well"):
        fit.conf_int(method="profile", cols=[1], which="age")
    assert str(fit.summary2(alpha=0.1)) == str(fit.summary(alpha=0.1))
