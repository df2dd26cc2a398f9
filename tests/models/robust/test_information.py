"""The value of perfect information: against its definition, and what holds of it."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.model_draws import ModelDraws
from models.planning.schedule import Schedule
from models.robust.draw_error import controlled_mean, draw_mean, effective_draws
from models.robust.draw_groups import DrawGroups
from models.robust.information import perfect_information
from tests.models.planning.schedule_cases import schedules
from tests.models.robust.information_cases import cloud, contested, doubts
from tests.reference.information import perfect_value

CLOSE = {"rel": 1e-9, "abs": 1e-9}


@given(st.one_of(doubts(), schedules()))
def test_equals_its_definition(schedule):
    found = perfect_information(schedule)
    assert found.value == pytest.approx(perfect_value(schedule), **CLOSE)
    assert found.value >= 0
    assert np.all(found.losses >= 0)


@given(doubts(max_draws=6))
def test_knowing_the_draw_but_not_the_person(schedule):
    n = schedule.draws.n_draws
    for kinds in [k for k in (1, 2, 3) if n % k == 0]:
        found = perfect_information(schedule, kinds=kinds)
        assert found.value == pytest.approx(perfect_value(schedule, kinds), **CLOSE)
    assert perfect_information(schedule, kinds=n).value == 0
    assert perfect_information(schedule).value >= perfect_information(schedule, kinds=n).value


def test_one_draw_and_equal_draws_are_worth_nothing():
    one = contested(3, 1)
    found = perfect_information(Schedule.of(one, "HRHRH"))
    assert found.value == 0
    assert found.right == 1
    assert "worth nothing" in found.sentence
    twice = ModelDraws.from_models([one.model(0)] * 3, np.array([0.2, 0.3, 0.5]))
    assert perfect_information(Schedule.of(twice, "HRHRH")).value == 0


def test_duplicates_of_draws_change_nothing():
    draws = contested(5, 4)
    keep = np.array([0, 0, 1, 2, 3, 3])
    share = np.array([0.25, 0.75, 1, 1, 0.5, 0.5])
    more = replace(
        draws, initial=draws.initial[keep], transition=draws.transition[keep], emission=draws.emission[keep],
        weight=draws.weight[keep] * share,
    )  # fmt: skip
    a, b = (perfect_information(Schedule.of(d, "HRHRH")) for d in (draws, more))
    assert a.value > 0.01
    assert b.value == pytest.approx(a.value, **CLOSE)
    assert b.right == pytest.approx(a.right, **CLOSE)


def test_says_what_it_is_worth():
    found = perfect_information(Schedule.of(cloud(4, 200), "HRHRH"), chains=4)
    row = found.table.iloc[0]
    assert row["known"] - row["today"] == pytest.approx(found.value, **CLOSE)
    assert f"{found.value:.3g} reward units a person (standard error {found.error.se:.2g})" in found.sentence
    assert found.value == pytest.approx(found.error.mean, **CLOSE)
    with ThreadPoolExecutor(2) as threads:
        assert perfect_information(found.schedule, executor=threads).value == found.value


def test_bad_groups_and_chains():
    schedule = Schedule.of(contested(1, 4), "HR")
    with pytest.raises(InputError, match="kinds of people: found 3, wanted an integer that divides the 4 draws"):
        perfect_information(schedule, kinds=3)
    with pytest.raises(InputError, match="chains: found 3, wanted a number that divides the 4 draws"):
        perfect_information(schedule, chains=3)


def test_groups():
    draws = replace(contested(1, 4), weight=np.array([0.1, 0.3, 0.0, 0.6]))
    groups = DrawGroups.of(draws, 2)
    assert groups.weight == pytest.approx([0.4, 0.6])
    assert groups.share == pytest.approx(np.array([[0.25, 0.75], [0, 1]]))
    assert groups.mean(np.array([[1.0, 2, 3, 4]])) == pytest.approx(np.array([[1.75, 4]]))
    assert groups.expand(groups.weight) == pytest.approx(draws.weight)


# -- errors of means over draws ------------------------------------------------------------------
def test_plain_standard_error():
    x = np.random.default_rng(1).normal(size=500)
    found = draw_mean(x, np.full(500, 1 / 500))
    assert found.se == pytest.approx(x.std(ddof=1) / np.sqrt(500))
    assert found.ess == pytest.approx(500, rel=0.01)
    assert np.isnan(draw_mean(x[:1], np.ones(1)).se)
    assert draw_mean(np.ones(8), np.full(8, 1 / 8), 2).se == 0


def test_error_of_correlated_draws():
    """First-order autoregression: the variance of the mean is (1 + r) / (1 - r) times that of independent draws."""
    rng, r, n = np.random.default_rng(2), 0.8, 20_000
    x = np.empty((4, n // 4))
    x[:, 0] = rng.normal(size=4)
    for t in range(1, n // 4):
        x[:, t] = r * x[:, t - 1] + np.sqrt(1 - r**2) * rng.normal(size=4)
    found = draw_mean(x.ravel(), np.full(n, 1 / n), chains=4)
    assert found.se == pytest.approx(np.sqrt((1 + r) / (1 - r) / n), rel=0.15)
    assert found.ess == pytest.approx(n * (1 - r) / (1 + r), rel=0.3)


def test_error_of_weighted_draws():
    """Importance weights: simulated means scatter as the standard error says."""
    rng = np.random.default_rng(3)
    means, errors = [], []
    for _ in range(400):
        x = rng.normal(size=300)
        w = np.exp(0.7 * x)
        found = draw_mean(x, w / w.sum())
        means.append(found.mean)
        errors.append(found.se)
    assert np.std(means) == pytest.approx(np.mean(errors), rel=0.15)
    assert effective_draws(np.array([[1.0, 1, 0, 0], [1, 1, 1, 1]])) == pytest.approx([2, 4])


def test_controlled_mean():
    """Freed of what shows in the control, without bias, and the error is the scatter."""
    rng = np.random.default_rng(4)
    found, errors = [], []
    for _ in range(500):
        luck = rng.normal(size=60)
        mean, se = controlled_mean(1.0 + 2.0 * luck + 0.3 * rng.normal(size=60), luck[:, None])
        found.append(mean)
        errors.append(se)
    assert np.mean(found) == pytest.approx(1.0, abs=4 * np.std(found) / np.sqrt(500))
    assert np.std(found) == pytest.approx(np.mean(errors), rel=0.15)
    assert np.mean(errors) < 0.06
    x = rng.normal(size=10)
    assert controlled_mean(x, x[:, None]) == pytest.approx((x.mean(), x.std(ddof=1) / np.sqrt(10)))
    assert controlled_mean(np.zeros(50), np.zeros((50, 1))) == (0.0, 0.0)
