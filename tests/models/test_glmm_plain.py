"""Plain formulas: the same model as by either engine, without asking it; everything else is left to the engines."""

import pickle

import numpy as np
import pandas as pd
import pytest
import statsmodels.formula

from models.errors import InputError
from models.glmm import LogisticMixedModel
from models.glmm_plain import PlainData, PlainDesign
from tests.models.test_glmm_model import study

FORMULA = "help ~ x + signal + (1|person)"


@pytest.fixture
def data():
    table = study(60, seed=2)
    table["x"] = np.random.default_rng(4).normal(size=len(table))
    return table.set_index(pd.Index([f"row {i}" for i in range(len(table))]))


@pytest.fixture(params=["patsy", "formulaic"])
def engine(request):
    before = statsmodels.formula.options.formula_engine
    statsmodels.formula.options.formula_engine = request.param
    yield request.param
    statsmodels.formula.options.formula_engine = before


def by_engine(monkeypatch, formula, data, **options):
    with monkeypatch.context() as patch:
        patch.setattr(PlainDesign, "read", classmethod(lambda *_: None))
        return LogisticMixedModel.from_formula(formula, data, **options)


@pytest.mark.parametrize("formula", [FORMULA, "help ~ 1 + signal + (1|person)", "help~signal+x+1+(1|person)"])
def test_the_model_is_that_of_the_engine(monkeypatch, data, engine, formula):
    plain, other = LogisticMixedModel.from_formula(formula, data), by_engine(monkeypatch, formula, data)
    assert isinstance(plain.data, PlainData)
    assert not isinstance(other.data, PlainData)
    assert plain.exog_names == other.exog_names
    assert plain.endog_names == other.endog_names
    assert np.array_equal(plain.exog, other.exog)
    assert np.array_equal(plain.endog, other.endog)
    assert list(plain.data.row_labels) == list(other.data.row_labels) == list(data.index)
    assert plain.data.frame is data
    assert (plain.formula, plain.k_constant, plain.df_resid) == (other.formula, other.k_constant, other.df_resid)
    one, two = plain.fit(warn=False), other.fit(warn=False)
    assert one.params.equals(two.params)
    assert str(one.summary()) == str(two.summary())
    new = data.iloc[:5].drop(columns="help")
    assert one.predict(new).equals(two.predict(new))
    assert type(plain.data.model_spec) is type(other.data.model_spec)
    assert list(plain.data.model_spec.column_names) == list(other.data.model_spec.column_names)


def test_the_description_is_made_by_the_engine_of_the_fit(data, engine):
    model = LogisticMixedModel.from_formula(FORMULA, data)
    statsmodels.formula.options.formula_engine = {"patsy": "formulaic", "formulaic": "patsy"}[engine]
    assert type(model.data.model_spec).__module__.startswith(engine)


def test_pickles_before_and_after_the_description_is_made(data, engine):
    result = LogisticMixedModel.from_formula(FORMULA, data).fit(warn=False)
    early = pickle.loads(pickle.dumps(result))
    want = result.predict(data)
    late = pickle.loads(pickle.dumps(result))
    for again in (early, late):
        assert again.predict(data).equals(want)
        assert type(again.model.data.model_spec) is type(result.model.data.model_spec)


@pytest.mark.parametrize(
    "formula", ["help ~ signal * x", "help ~ 0 + signal", "help ~ signal - 1", "help ~ np.exp(x)", "help ~ x + x",
                "I(help) ~ x", "help ~ mode", "help ~ flag", "help ~ gap", "help ~ maybe", "help ~ help",
                "help ~ nobody", "help + x ~ signal", "help ~ Q('x')"],
)  # fmt: skip
def test_other_formulas_are_the_engines(data, formula):
    data = data.assign(
        mode="a", flag=data["signal"] == 1, gap=data["x"].where(data["x"] < 1),
        maybe=data["signal"].astype("Int64"),
    )  # fmt: skip
    assert PlainDesign.read(formula, data) is None


def test_columns_twice_are_the_engines(data):
    twice = pd.concat([data, data[["x"]]], axis=1)
    assert PlainDesign.read("help ~ x", twice) is None


def test_gaps_in_other_columns_are_dropped_and_counted(monkeypatch, data):
    data.loc["row 3", "person"] = np.nan
    plain, other = LogisticMixedModel.from_formula(FORMULA, data), by_engine(monkeypatch, FORMULA, data)
    assert isinstance(plain.data, PlainData)
    assert plain.n_dropped == other.n_dropped == 1
    assert list(plain.data.row_labels) == list(other.data.row_labels)
    with pytest.raises(InputError, match="groups"):
        LogisticMixedModel.from_formula(FORMULA, data, missing="raise")


def test_infinite_covariates_are_refused_by_name(data):
    data.loc["row 7", "x"] = np.inf
    with pytest.raises(InputError, match="covariate x, row 8"):
        LogisticMixedModel.from_formula(FORMULA, data)


def test_weights_trials_offsets_and_subsets_go_along(monkeypatch, data):
    data = data.assign(n=3, often=2, shift=0.5)
    options = {"trials": "n", "freq_weights": "often", "offset": "shift", "subset": data["x"] > -1}
    plain, other = (make(FORMULA) for make in (
        lambda f: LogisticMixedModel.from_formula(f, data, **options),
        lambda f: by_engine(monkeypatch, f, data, **options),
    ))  # fmt: skip
    assert isinstance(plain.data, PlainData)
    assert plain.loglike([0.1, 0.2, 0.3, 0.9]) == other.loglike([0.1, 0.2, 0.3, 0.9])
