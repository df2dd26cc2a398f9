"""Bad input: a clear error or a named warning for each, never a number without one."""

import warnings

import numpy as np
import pandas as pd
import pytest

from models.errors import InputError
from models.glmm import LogisticMixedModel
from models.glmm_separation import find_separation
from models.glmm_warnings import (
    BoundaryWarning,
    CeilingWarning,
    ConvergenceWarning,
    SeparationWarning,
)
from tests.models.test_glmm_model import FORMULA, study


@pytest.fixture(scope="module")
def data():
    return study(n_groups=40)


def constant(d):
    return d.assign(help=1)


def with_nan(d):
    return d.assign(age=d["age"].where(d.index != 4))


REFUSED = {
    "constant outcome": (FORMULA, constant, {}, r"outcome 'help': found a success in all 160 trials"),
    "one group": (FORMULA, lambda d: d.assign(person="x"), {}, r"groups 'person': found one group"),
    "one row a group": (FORMULA, lambda d: d.assign(person=range(160)), {}, r"one trial in each of the 160 groups"),
    "outcome 0 and 2": (FORMULA, lambda d: d.assign(help=2 * d["help"]), {}, r"outcome 'help', row \d+: found 2.0"),
    "half an outcome": (FORMULA, lambda d: d.assign(help=d["help"] / 2), {}, r"found 0.5, wanted 0 or 1"),
    "negative outcome": (FORMULA, lambda d: d.assign(help=-d["help"]), {}, r"wanted 0 or 1"),
    "text outcome": (
        FORMULA,
        lambda d: d.assign(help=d["help"].map({0: "no", 1: "yes"})),
        {},
        r"no, yes, wanted 0",
    ),
    "category outcome": ("C(help) ~ signal + (1|person)", lambda d: d, {}, r"categories"),
    "unknown covariate": (
        "help ~ sginal + (1|person)",
        lambda d: d,
        {},
        r"'sginal', wanted.*did you mean 'signal'",
    ),
    "unknown outcome": ("halp ~ signal + (1|person)", lambda d: d, {}, r"'halp'.*did you mean 'help'"),
    "unknown group": ("help ~ signal + (1|preson)", lambda d: d, {}, r"groups: found 'preson'"),
    "unknown offset": (FORMULA, lambda d: d, {"offset": "none"}, r"offset: found 'none'"),
    "short offset": (FORMULA, lambda d: d, {"offset": np.zeros(7)}, r"offset: found 7 values"),
    "short groups": ("help ~ signal", lambda d: d, {"groups": [1, 2]}, r"groups: found 2 values"),
    "no groups": ("help ~ signal", lambda d: d, {}, r"found no groups"),
    "groups twice": (FORMULA, lambda d: d, {"groups": "place"}, r"groups both"),
    "random slope": (
        "help ~ signal + (1 + signal|person)",
        lambda d: d,
        {},
        r"wanted .laplace., by name",
    ),
    "two random terms": ("help ~ (1|person) + (1|place)", lambda d: d, {}, r"more than one random term"),
    "no tilde": ("help", lambda d: d, {}, r"outcome ~ covariates"),
    "cbind of three": ("cbind(help, age, signal) ~ 1 + (1|person)", lambda d: d, {}, r"3 columns in cbind"),
    "more successes than trials": (
        FORMULA,
        lambda d: d.assign(n=1, help=2),
        {"trials": "n"},
        r"to the number of tri",
    ),
    "no trials": (FORMULA, lambda d: d.assign(n=0), {"trials": "n"}, r"trials, row 1: found 0.0"),
    "half a weight": (FORMULA, lambda d: d.assign(n=0.5), {"freq_weights": "n"}, r"frequency weights, row 1"),
    "same column twice": (
        "help ~ signal + I(2 * signal) + (1|person)",
        lambda d: d,
        {},
        r"'I\(2 \* signal\)', which",
    ),
    "no covariate": ("help ~ 0 + (1|person)", lambda d: d, {}, r"covariates"),
    "NaN refused": (FORMULA, with_nan, {"missing": "raise"}, r"missing|NaN"),
    "infinite": (
        FORMULA,
        lambda d: d.assign(age=d["age"].where(d.index != 4, np.inf)),
        {},
        r"covariate age, row 5: found inf",
    ),
    "one node": (FORMULA, lambda d: d, {"quadrature": 1}, r"quadrature: found 1, wanted .*'laplace' for one"),
    "rule unknown": (FORMULA, lambda d: d, {"quadrature": "aghq"}, r"quadrature: found 'aghq'"),
    "half a node": (FORMULA, lambda d: d, {"quadrature": 2.5}, r"quadrature: found 2.5"),
    "unknown argument": (FORMULA, lambda d: d, {"wieghts": 1}, r"found 'wieghts'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_unusable_input_is_refused_by_name(data, case):
    formula, change, options, message = REFUSED[case]
    with pytest.raises(InputError, match=message):
        LogisticMixedModel.from_formula(formula, change(data), **options)


def test_arrays_are_checked_too(data):
    y, x, g = data["help"].to_numpy(float), np.column_stack([np.ones(160), data["age"]]), data["person"].to_numpy()
    holes = x.copy()
    holes[3, 1] = np.nan
    for arguments, message in (
        ((y, holes, g), r"covariate 1, row 4: found nan"),
        ((np.where(np.arange(160) == 8, np.nan, y), x, g), r"outcome 0, row 9: found nan"),
        ((y, x, np.where(np.arange(160) == 2, None, g)), r"groups 'group', row 3"),
        ((y, x[:50], g), r"50 rows"),
        ((y, x, g[:50]), r"groups: found shape \(50,\)"),
        ((y, x), r"groups: found none"),
        ((y, np.full((160, 1), "a"), g), r"no numbers"),
    ):
        with pytest.raises(InputError, match=message):
            LogisticMixedModel(*arguments)
    for name, value in (("offset", np.zeros(3)), ("trials", ["a"] * 160), ("freq_weights", np.ones((160, 1)))):
        with pytest.raises(InputError, match=name):
            LogisticMixedModel(y, x, g, **{name: value})


def test_fit_and_results_check_their_arguments(data):
    model = LogisticMixedModel.from_formula(FORMULA, data)
    fit = model.fit()
    arrays = LogisticMixedModel(model.endog, model.exog, data["person"]).fit()
    for call, message in (
        (lambda: model.fit(starts=(0.0,)), "starts"),
        (lambda: model.fit(starts=()), "starts"),
        (lambda: model.fit(cov_type="HC3"), "cov_type"),
        (lambda: fit.conf_int(method="bayes"), "method"),
        (lambda: fit.conf_int(method="profile", which=["sginal"]), "sginal"),
        (lambda: fit.conf_int(which=["signal"]), "profile"),
        (lambda: fit.cov_params(kind="hc0"), "kind"),
        (lambda: fit.predict(np.ones((2, 7))), "a DataFrame"),
        (lambda: arrays.predict(np.ones((2, 7))), "7 columns"),
    ):
        with pytest.raises(InputError, match=message):
            call()


@pytest.mark.parametrize("complete", [True, False])
def test_perfect_separation_is_named(data, complete):
    if complete:
        changed, formula = data.assign(cause=3 * data["help"] - 1), "help ~ cause + (1|person)"
    else:
        changed = data.assign(cause=((data["help"] == 1) & (data["age"] > 0.5)).astype(int))
        formula = "help ~ cause + signal + (1|person)"
    model = LogisticMixedModel.from_formula(formula, changed)
    with pytest.warns(SeparationWarning, match=r"cause.*no finite estimate") as caught:
        result = model.fit()
    assert "cause = " in str(caught[0].message)
    assert not any(issubclass(w.category, ConvergenceWarning) for w in caught)
    assert abs(result.params["cause"]) > 5
    found = find_separation(model.patterns, result.maximum.pooled_beta, model.exog_names)
    assert found.complete == complete
    assert "cause" in found.coefficients
    assert "signal" not in found.coefficients or complete


def test_separation_by_a_combination_of_covariates():
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(2, 200)).round(1)
    data = pd.DataFrame({"a": a, "b": b, "g": np.arange(200) // 4})
    data["y"] = (data["a"] + 2 * data["b"] > 0.33).astype(int)
    with pytest.warns(SeparationWarning, match="every row predicted perfectly"):
        LogisticMixedModel.from_formula("y ~ a + b + (1|g)", data).fit()


def test_large_effects_are_not_taken_for_separation(data):
    rng = np.random.default_rng(8)
    changed = data.assign(strong=np.where(data["help"] == 1, 1, -1) * 20.0)
    changed.loc[rng.choice(160, 6, replace=False), "strong"] *= -1
    with warnings.catch_warnings():
        warnings.simplefilter("error", SeparationWarning)
        warnings.simplefilter("ignore", BoundaryWarning)
        LogisticMixedModel.from_formula("help ~ strong + (1|person)", changed).fit()


def test_cells_at_the_ceiling_are_named():
    data = study(n_groups=200, seed=4)
    data["robot"] = (np.arange(len(data)) // 4) % 2
    data.loc[(data["signal"] == 1) & (data["robot"] == 1), "help"] = 1
    with pytest.warns(CeilingWarning, match=r"only one outcome in signal = 1, robot = 1: (\d+) of \1"):
        LogisticMixedModel.from_formula("help ~ signal + robot + (1|person)", data).fit()
    with pytest.warns(SeparationWarning, match="signal:robot"):
        LogisticMixedModel.from_formula("help ~ signal * robot + (1|person)", data).fit()


def test_a_search_cut_short_says_so(data):
    with pytest.warns(ConvergenceWarning, match="no maximum found"):
        result = LogisticMixedModel.from_formula(FORMULA, data).fit(max_iterations=1)
    assert not result.converged
    assert np.isnan(result.conf_int(method="profile").to_numpy()).all()
    with pytest.raises(InputError, match="without a maximum"):
        result.compare_lr_test(LogisticMixedModel.from_formula("help ~ 1 + (1|person)", data).fit())


def test_warnings_can_be_left_to_the_notes():
    data = study(n_groups=40, sd=0.0, seed=12)
    result = LogisticMixedModel.from_formula(FORMULA, data).fit(warn=False)
    assert [note.category for note in result.notes] == ([BoundaryWarning] if result.boundary else [])
