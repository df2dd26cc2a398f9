"""Working coordinates: other units and origins of covariates change nothing but the units of the answers."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.glmm import LogisticMixedModel
from models.glmm_coordinates import Coordinates
from models.glmm_influence import influence, without_group
from models.glmm_input import redundant_columns
from models.glmm_nodes import node_table
from tests.models.test_glmm_model import study

FORMULA = "help ~ signal + age + (1|person)"
UNITS = {
    "far": (1.0, 1e5), "seconds since 1970": (86400.0, 1.7e9), "microseconds": (86400e6, 1.7e15),
    "tiny": (1e-6, 0.0), "tinier": (1e-12, 0.0), "huge": (1e8, 0.0),
    "very far": (1.0, 1e9), "turned round": (-1e4, 3e7),
}  # fmt: skip


@pytest.fixture(scope="module")
def data():
    return study(60, seed=3)


@pytest.fixture(scope="module", params=[25, "laplace"])
def plain(request, data):
    return LogisticMixedModel.from_formula(FORMULA, data, quadrature=request.param).fit(warn=False)


def fitted(plain, data, **columns):
    return LogisticMixedModel.from_formula(FORMULA, data.assign(**columns), quadrature=plain.model.quadrature).fit(
        warn=False
    )


@pytest.mark.parametrize("unit", UNITS)
def test_units_and_origins_do_not_matter(plain, data, unit):
    scale, shift = UNITS[unit]
    got = fitted(plain, data, age=scale * data["age"] + shift)
    # Rounding of the shifted column itself, in its own standard deviations.
    lost = 10 * np.finfo(float).eps * abs(shift / scale)
    close = max(1e-6, 1e3 * lost)
    assert got.converged
    assert got.llf == pytest.approx(plain.llf, rel=max(1e-9, lost))
    back = np.array([scale, 1.0, scale])  # of age; signal and the sd have kept theirs
    for mine, names in ((got, ["age", "signal", "sd(person)"]),):
        factors = pd.Series([scale, 1.0, 1.0], index=names)
        assert (mine.params[names] * factors).to_numpy() == pytest.approx(plain.params[names].to_numpy(), rel=close)
        assert (mine.bse[names] * np.abs(factors)).to_numpy() == pytest.approx(
            plain.bse[names].to_numpy(), rel=close
        )
        robust = mine.cov_params(kind="robust").loc["age", "age"] * back[0] ** 2
        assert robust == pytest.approx(plain.cov_params(kind="robust").loc["age", "age"], rel=close)
        ends, want = mine.conf_int(method="profile"), plain.conf_int(method="profile")
        theirs = want.loc["age"].to_numpy()[:: int(np.sign(scale))]
        assert ends.loc["age"].to_numpy() * scale == pytest.approx(theirs, rel=max(1e-5, close))
        assert ends.loc["sd(person)"].to_numpy() == pytest.approx(want.loc["sd(person)"].to_numpy(), rel=1e-5)
    # The intercept is that of another origin.
    at_origin = got.params["Intercept"] + got.params["age"] * shift
    assert at_origin == pytest.approx(plain.params["Intercept"], abs=max(1e-6, 1e3 * lost))
    assert got.node_check.finer_sd == pytest.approx(plain.node_check.finer_sd, rel=1e-6)


def test_the_intercept_at_a_far_origin_has_its_interval(plain, data):
    far = fitted(plain, data, age=data["age"] + 1e5)
    row = np.array([1.0, 0.0, -1e5, 0.0])  # the far model's intercept, by the near one
    assert far.bse["Intercept"] == pytest.approx(np.sqrt(row @ plain.cov_params().to_numpy() @ row), rel=1e-6)
    ends, want = far.conf_int(method="profile"), plain.conf_int(method="profile")
    # So far away the intercept is -1e5 times the slope, but for a part in 1e5.
    assert ends.loc["Intercept"].to_numpy() == pytest.approx(-1e5 * want.loc["age"].to_numpy()[::-1], rel=1e-3)


def test_everything_beyond_the_table_knows_them_too(data):
    near = LogisticMixedModel.from_formula(FORMULA, data).fit()
    far_data = data.assign(age=data["age"] * 86400 + 1.7e9)
    far = LogisticMixedModel.from_formula(FORMULA, far_data).fit()
    assert influence(far)["cook"].to_numpy() == pytest.approx(influence(near)["cook"].to_numpy(), rel=1e-5)
    assert without_group(far, "p003")[2] * 86400 == pytest.approx(without_group(near, "p003")[2], rel=1e-5)
    assert far.predict(far_data).to_numpy() == pytest.approx(near.predict(data).to_numpy(), abs=1e-7)
    small = LogisticMixedModel.from_formula("help ~ signal + (1|person)", far_data).fit()
    assert far.compare_lr_test(small)[0] == pytest.approx(near.compare_lr_test(small)[0], rel=1e-7)
    assert node_table(far, (25,))["sd(person)"][25] == pytest.approx(near.sd, rel=1e-7)
    start = LogisticMixedModel.from_formula(FORMULA, far_data).fit(start_params=far.params)
    assert start.llf == pytest.approx(near.llf, rel=1e-10)


@pytest.mark.parametrize("shift", [0.0, 1e5])
def test_without_an_intercept(data, shift):
    """Dummies of all places hold a constant: origins are free. Without any, they are part of the model."""
    usual = LogisticMixedModel.from_formula("help ~ place + age + (1|person)", data).fit()
    dummies = LogisticMixedModel.from_formula(
        "help ~ 0 + place + age + (1|person)", data.assign(age=data["age"] + shift)
    ).fit()
    assert dummies.llf == pytest.approx(usual.llf, rel=1e-9)
    assert dummies.bse["age"] == pytest.approx(usual.bse["age"], rel=1e-6)
    through = [
        LogisticMixedModel.from_formula("help ~ 0 + age + signal + (1|person)", d).fit()
        for d in (data.assign(age=data["age"] + shift), data.assign(age=1e-7 * (data["age"] + shift)))
    ]
    assert through[0].converged
    assert through[1].llf == pytest.approx(through[0].llf, rel=1e-9)
    assert through[1].bse["age"] == pytest.approx(1e7 * through[0].bse["age"], rel=1e-6)


def test_nearly_dependent_columns_without_an_intercept(data):
    """Two clocks and no intercept: their difference is what tells."""
    clock = 1e4 + np.arange(len(data)) % 7
    by_clocks = data.assign(first=clock, second=clock + data["age"])
    by_parts = data.assign(first=clock, second=data["age"])
    got, want = (
        LogisticMixedModel.from_formula("help ~ 0 + first + second + (1|person)", d).fit()
        for d in (by_clocks, by_parts)
    )
    assert got.llf == pytest.approx(want.llf, rel=1e-9)
    assert got.params["second"] == pytest.approx(want.params["second"], rel=1e-6)
    assert got.bse["second"] == pytest.approx(want.bse["second"], rel=1e-5)
    assert got.conf_int(method="profile").loc["second"].to_numpy() == pytest.approx(
        want.conf_int(method="profile").loc["second"].to_numpy(), rel=1e-4
    )


def test_powers_of_a_year(data):
    year = data.assign(t=2000 + 10 * data["age"])
    centred = data.assign(t=data["age"])
    got, want = (
        LogisticMixedModel.from_formula("help ~ t + I(t**2) + I(t**3) + (1|person)", d).fit()
        for d in (year, centred)
    )
    assert got.converged
    assert got.llf == pytest.approx(want.llf, rel=1e-9)
    assert got.tvalues["I(t ** 3)"] == pytest.approx(want.tvalues["I(t ** 3)"], rel=1e-4)
    assert got.predict(year).to_numpy() == pytest.approx(want.predict(centred).to_numpy(), abs=1e-5)


@given(st.integers(0, 10**6))
def test_coordinates_go_forth_and_back(seed):
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.integers(-6, 7, 4)
    design = size * (rng.normal(size=(50, 4)) + rng.normal(size=4) * 10.0 ** rng.integers(-3, 7))
    if rng.random() < 0.6:
        design[:, 0] = 1.0
    found = Coordinates.of(design)
    gamma = rng.normal(size=5)
    beta = found.back(gamma)
    assert found.forward(beta) == pytest.approx(gamma, rel=1e-6, abs=1e-6)
    eta = design @ beta[:-1]
    assert found.apply(design) @ gamma[:-1] == pytest.approx(eta, abs=1e-9 * (1 + np.abs(design * beta[:-1]).max()))
    for index in range(5):
        held, turn, factor = found.holding(index)
        assert turn @ turn.T == pytest.approx(np.eye(5), abs=1e-12)
        assert held.matrix[index] == pytest.approx(factor * np.eye(5)[index], abs=1e-9 * abs(factor))
        assert held.matrix == pytest.approx(found.matrix @ turn, abs=1e-9 * np.abs(found.matrix).max())


def test_ordinary_columns_stay_as_they_are(data):
    model = LogisticMixedModel.from_formula(FORMULA, data)
    found = Coordinates.of(model.exog)
    assert found.trivial
    assert found.patterns(model.patterns) is model.patterns


def test_columns_that_say_nothing_new_are_still_found(data):
    x = data["age"].to_numpy()
    one = np.ones(len(x))
    for column, redundant in ((2 * x + 5, True), (x + 1e9, True), (one * 0.3, True), (x**2 + 1e9, False)):
        assert redundant_columns(np.column_stack([one, x, column])) == ([2] if redundant else [])
    assert redundant_columns(np.column_stack([x, one, 1e9 + 1e-9 * x])) == [2]
    with pytest.raises(InputError, match="'copy', which the other columns determine"):
        LogisticMixedModel.from_formula("help ~ age + copy + (1|person)", data.assign(copy=1.7e9 + 86400 * x))
