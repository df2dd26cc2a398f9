"""Charges of actions, whole units, and the amounts left that matter."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.budget_levels import budget_levels
from models.planning.charges import charges_of, checked_charges, in_units
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.reward import Reward
from tests.models.planning.policy_cases import person


def test_kinds():
    assert charges_of(person()).tolist() == [0, 15, 0, 15]
    assert charges_of(person(), "count").tolist() == [0, 1, 0, 1]
    assert charges_of(person(), {"help": 2.5}).tolist() == [0, 2.5, 0, 0]


def test_costs_of_the_reward_come_first():
    from dataclasses import replace

    model = replace(person(), reward=Reward(person().reward.x, 0.06, {"help": 4.0}))
    s = Schedule.of(model, "HR")
    assert charges_of(model).tolist() == charges_of(s).tolist() == charges_of(s.draws).tolist() == [0, 4, 0, 15]


@pytest.mark.parametrize(
    ("kind", "words"),
    [
        ("price", "charges: found 'price', wanted cost, count"),
        ({"wave": 1.0}, "wave"),
        ({"help": -1.0}, "charge of help: found -1.0, wanted a number from 0 on"),
        ({"help": float("nan")}, "charge of help: found nan"),
        ({"help": "1"}, "charge of help: found '1'"),
        ({"help": True}, "charge of help: found True"),
        ({"no_help": 1.0}, "charge of no_help: found 1.0, wanted 0: the null action"),
    ],
)
def test_charges_that_are_none(kind, words):
    with pytest.raises(InputError) as caught:
        charges_of(person(), kind)
    assert words in str(caught.value)


def test_costs_that_cannot_be_charged():
    from dataclasses import replace

    model = replace(person(), reward=Reward(person().reward.x, 0.06, {"no_help": 1.0}))
    with pytest.raises(InputError, match=r"charge of no_help: found 1\.0, wanted 0"):
        charges_of(model)


@pytest.mark.parametrize("charges", [[0, 1, 0], [0, -1, 0, 1], [0, np.inf, 0, 1], [1, 1, 0, 1]])
def test_arrays_that_are_none(charges):
    with pytest.raises(InputError, match="charge"):
        checked_charges(PUBLISHED, charges)


@given(st.lists(st.integers(0, 10**6), min_size=1, max_size=5), st.integers(0, 6), st.integers(0, 10**7))
def test_decimals_add_up_as_written(numbers, places, budget):
    charges = [float(f"{n}e-{places}") for n in numbers]
    units = in_units(charges, float(f"{budget}e-{places}"))
    for n, u in zip(numbers, units.charge.tolist(), strict=True):
        assert u * units.size == Fraction(n, 10**places)
    # The budget covers as many units as it is worth, to the last of them.
    assert units.budget * units.size <= Fraction(budget, 10**places) < (units.budget + 1) * units.size


def test_three_tenths():
    units = in_units([0.0, 0.1], 0.3)
    assert units.budget == 3
    assert 0.1 + 0.1 + 0.1 > 0.3
    assert units.amount(3) == 0.3


@pytest.mark.parametrize("budget", [-1.0, float("nan"), "15", True, None])
def test_budgets_that_are_none(budget):
    with pytest.raises(InputError, match="budget: found"):
        in_units([0.0, 1.0], budget)


def test_charges_without_a_common_unit():
    with pytest.raises(InputError, match="within a factor of"):
        in_units([1e-300, 1e300], 1.0)


@given(st.lists(st.lists(st.integers(0, 7), min_size=0, max_size=2), min_size=1, max_size=4), st.integers(0, 30))
def test_levels_are_all_sums(extra, budget):
    charges = [np.array([0, *own]) for own in extra]
    levels = budget_levels(charges, budget)
    for k in range(len(charges) + 1):
        sums = {int(sum(own)) for own in product(*charges[k:])}
        assert levels.left[k].tolist() == sorted(s for s in sums if s <= budget)
    for k, own in enumerate(charges):
        for i, left in enumerate(levels.left[k].tolist()):
            for c, charge in enumerate(own.tolist()):
                after = levels.after[k, i, c]
                assert (after < 0) == (charge > left)
                if after >= 0:
                    assert levels.level(k + 1, left - charge) == after
                    assert levels.left[k + 1][after] <= left - charge
    assert levels.level(0, -5) == 0


def test_too_many_levels(monkeypatch):
    monkeypatch.setattr("models.planning.budget_levels.MOST_LEVELS", 3)
    with pytest.raises(InputError, match="4 different sums, wanted at most 3"):
        budget_levels([np.array([0, 1])] * 3, 10)


def test_charges_of_many_digits_never_pay_for_more_than_the_budget():
    charges = [0.0, 14.738928371234567, 15.29837412345678]
    units = in_units(charges, 30.0)
    assert units.amount(units.budget) == 30.0
    assert [units.amount(int(u)) for u in units.charge] == charges
    assert units.charge[1] + units.charge[2] > units.budget  # 30.04
    assert 2 * units.charge[1] <= units.budget  # 29.48
    assert units.charge.dtype == object


@given(
    st.lists(st.floats(1e-6, 1e6), min_size=1, max_size=3), st.lists(st.integers(0, 3), min_size=3, max_size=3),
    st.integers(-2, 2),
)  # fmt: skip
def test_a_budget_pays_for_what_is_rounded_to_it(charges, times, steps):
    """By fractions: the largest sum that is not above the budget as the nearest floating-point number."""
    units = in_units(charges)
    total = sum((n * Fraction(repr(c)) for n, c in zip(times, charges, strict=False)), Fraction(0))
    budget = float(total)
    for _ in range(abs(steps)):
        budget = max(0.0, float(np.nextafter(budget, np.inf if steps > 0 else 0.0)))
    covered = units.within(budget)
    assert float(covered * units.size) <= budget < float((covered + 1) * units.size)
    assert (total / units.size <= covered) == (float(total) <= budget)


def test_no_limit_is_infinite():
    units = in_units([0.0, 1 / 3], np.inf)
    assert units.budget == units.within(np.inf) == np.inf
    levels = budget_levels([np.array([0, 10**25], dtype=object)] * 3, np.inf)
    assert levels.left[0].tolist() == [0, 10**25, 2 * 10**25, 3 * 10**25]
    assert levels.level(0, np.inf) == 3
    assert levels.level(0, 2 * 10**25 - 1) == 1
