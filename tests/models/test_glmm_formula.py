"""Formulas of the mixed model: names in backticks, and new rows that must be refused, under both engines."""

import pickle

import numpy as np
import pandas as pd
import pytest
import statsmodels.formula

from models.errors import InputError
from models.glmm import LogisticMixedModel
from models.glmm_formula import column_error, split_groups


@pytest.fixture(params=["patsy", "formulaic"])
def engine(request):
    before = statsmodels.formula.options.formula_engine
    statsmodels.formula.options.formula_engine = request.param
    yield request.param
    statsmodels.formula.options.formula_engine = before


@pytest.fixture(scope="module")
def data():
    rng = np.random.default_rng(5)
    person = np.repeat(np.arange(60), 3)
    frame = pd.DataFrame({"person": person, "arm": rng.choice(["a", "b", "c"], 180), "x": rng.normal(size=180)})
    frame = frame.assign(k=rng.integers(1, 4, 180), late=rng.random(180) < 0.5)
    frame["clinic.id"], frame["dose (mg)"] = frame["person"], frame["x"]
    eta = frame["x"] + rng.normal(size=60)[person]
    return frame.assign(help=(rng.random(180) < 1 / (1 + np.exp(-eta))).astype(int))


def fitted(formula, data):
    return LogisticMixedModel.from_formula(formula, data).fit(warn=False)


# -- unknown levels ------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["text", "category of the fit's table", "category of the new table"])
@pytest.mark.parametrize("term", ["arm", "C(arm)", "C(arm, Treatment('b'))", "arm:late", "C(Q('arm'))", "x * arm"])
def test_an_unknown_level_is_refused_by_name(data, engine, term, kind):
    """Formulaic would give the reference level's probability for it."""
    learned = data.astype({"arm": "category"}) if kind == "category of the fit's table" else data
    fit = fitted(f"help ~ {term} + x + (1|person)", learned)
    new = pd.DataFrame({"arm": ["c", "zz", "a"], "x": 0.0, "late": True}, index=[7, 8, 9])
    if kind == "category of the new table":
        new["arm"] = new["arm"].astype("category")
    with pytest.raises(
        InputError, match="exog, row 8, column 'arm': found 'zz', wanted one of the levels 'a', 'b', 'c'"
    ):
        fit.predict(new)
    assert fit.predict(new.drop(8)).index.tolist() == [7, 9]


def test_an_unknown_level_among_numbers_and_truth_values(data, engine):
    with pytest.raises(InputError, match="column 'k': found 9, wanted one of the levels 1, 2, 3"):
        fitted("help ~ C(k) + (1|person)", data).predict(pd.DataFrame({"k": [1, 9]}))
    fit = fitted("help ~ C(k) + late + (1|person)", data)
    new = pd.DataFrame({"k": [1.0, 3.0], "late": [1, 0]})
    again = fit.predict(new.astype({"k": int, "late": bool}))
    np.testing.assert_array_equal(fit.predict(new), again)
    with pytest.raises(InputError, match="row 1, column 'late': found 'yes', wanted"):
        fit.predict(new.assign(late=[True, "yes"]))


def test_an_unknown_level_of_what_is_computed_is_refused(data, engine):
    fit = fitted("help ~ C(k - 1) + (1|person)", data)
    with pytest.raises(InputError, match=r"exog: found .*8.*, wanted one of the levels 0, 1, 2 of C\(k - 1\)"):
        fit.predict(pd.DataFrame({"k": [2, 9]}))
    only_high = fitted("help ~ C(k > 0) + x + (1|person)", data.assign(k=data["k"] - 2))
    expected = only_high.predict(pd.DataFrame({"k": [0, 1], "x": 0.0}))
    assert expected.notna().all()


def test_some_levels_of_a_category_predict_as_all_do(data, engine):
    """A category that lists fewer levels, or in another order, or a gap, says nothing of the model's."""
    fit = fitted("help ~ arm + x + (1|person)", data.astype({"arm": "category"}))
    every = fit.predict(pd.DataFrame({"arm": ["a", "b", "c"], "x": 0.5})).to_numpy()
    some = pd.DataFrame({"arm": pd.Categorical(["c", None, "b"], categories=["c", "b"]), "x": 0.5})
    np.testing.assert_array_equal(fit.predict(some), [every[2], np.nan, every[1]])
    text = pd.DataFrame({"arm": pd.array(["b", pd.NA], dtype="string"), "x": 0.5})
    np.testing.assert_array_equal(fit.predict(text), [every[1], np.nan])


def test_text_where_numbers_were_is_refused(data, engine):
    fit = fitted("help ~ arm + x + (1|person)", data)
    for text in (["1.5", "2"], ["1.5", "many"]):
        with pytest.raises(InputError, match=r"exog, row 0, column 'x': found '1.5', wanted a number"):
            fit.predict(pd.DataFrame({"arm": "a", "x": text}))
    mixed = pd.DataFrame({"arm": "a", "x": pd.Series([1.5, None], dtype=object)})
    assert fit.predict(mixed).isna().tolist() == [False, True]


# -- columns -------------------------------------------------------------------------------------------
def test_an_absent_column_is_named_and_not_taken_from_elsewhere(data, engine):
    x = np.array([9.0, 9.0])
    fit = fitted("help ~ np.exp(x / 4) + arm + (1|person)", data)
    with pytest.raises(InputError, match="exog, columns: found arm, wanted also 'x', as in the data of the fit"):
        fit.predict(pd.DataFrame({"arm": ["a", "b"]}))
    with pytest.raises(InputError, match="exog, columns: found x, wanted also 'arm'"):
        fit.predict(pd.DataFrame({"x": x}))


@pytest.mark.parametrize(
    "formula", ["help ~ arm + ages", "help ~ np.log(ages)", "help ~ arm + Q('ages')", "ages ~ x"]
)
def test_unknown_columns_of_a_formula(data, engine, formula):
    with pytest.raises(InputError, match=r"found 'ages', wanted one of the columns .*did you mean 'age'"):
        LogisticMixedModel.from_formula(f"{formula} + (1|person)", data.assign(age=1.0))


def test_a_name_with_a_dot_is_explained(data, engine):
    with pytest.raises(InputError, match=r"after the bar: in backticks, \(1\|`clinic.id`\)"):
        LogisticMixedModel.from_formula("help ~ x + (1|clinic.id)", data)
    text = "help ~ x + clinic.id + (1|person)"
    if engine == "formulaic":  # which takes the dot for a part of the name
        assert fitted(text, data).params.index[2] == "clinic.id"
        return
    with pytest.raises(InputError, match=r"names that are no words stand in backticks: `clinic.id`"):
        LogisticMixedModel.from_formula(text, data)


def test_what_cannot_be_parsed_is_explained_where_a_name_has_a_blank(data):
    told = column_error("help ~ dose (mg)", data, SyntaxError("invalid syntax (<unknown>, line 1)"))
    assert str(told).endswith(
        "invalid syntax (<unknown>, line 1) (names that are no words stand in backticks: `dose (mg)`)"
    )
    assert "backticks" not in str(column_error("help ~ Q('dose (mg)') +", data, SyntaxError("invalid syntax")))


# -- backticks -----------------------------------------------------------------------------------------
def test_backticks_name_any_column(data, engine):
    plain = fitted("help ~ x + (1|person)", data)
    named = fitted("`help` ~ `dose (mg)` + (1|`clinic.id`)", data)
    assert [str(name) for name in named.params.index] == ["Intercept", "Q('dose (mg)')", "sd(clinic.id)"]
    np.testing.assert_allclose(named.params, plain.params, rtol=1e-6)
    new = pd.DataFrame({"dose (mg)": [0.0, 1.0]})
    np.testing.assert_allclose(named.predict(new), plain.predict(new.rename(columns={"dose (mg)": "x"})), rtol=1e-6)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(named)).predict(new), named.predict(new))
    odd = data.rename(columns={"help": "did (help|not)?", "x": "class"}).astype({"did (help|not)?": bool})
    other = fitted("`did (help|not)?` ~ `class` + (1|person)", odd)
    np.testing.assert_allclose(other.params, plain.params, rtol=1e-6)


@pytest.mark.parametrize(
    ("formula", "found"),
    [
        ("y ~ `a b` + (1|`g.h`)", ("y ~ Q('a b')", "g.h")),
        ("`y` ~ x + (1|`g`)", ("y ~ x", "g")),
        ("y ~ `lambda` + `it's` + (1|g)", ("y ~ Q('lambda') + Q(\"it's\")", "g")),
        ("y ~ `(1|x)` + (1|`g|h`)", ("y ~ Q('(1|x)')", "g|h")),
    ],
)
def test_backticks_are_spelled_as_the_engines_do(formula, found):
    assert split_groups(formula, None) == found


@pytest.mark.parametrize("formula", ["y ~ `x + (1|g)", "y ~ `` + (1|g)"])
def test_a_lonely_backtick_is_refused(formula):
    with pytest.raises(InputError, match="a backtick without its pair"):
        split_groups(formula, None)


def test_a_tilde_in_a_name_is_refused():
    with pytest.raises(InputError, match="found 'a~b', wanted a column's name without ~"):
        split_groups("y ~ `a~b` + (1|g)", None)
