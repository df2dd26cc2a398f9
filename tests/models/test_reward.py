"""The paper's reward, number by number."""

import math

import numpy as np
import pytest

from models.errors import InputError
from models.protocol import PUBLISHED
from models.reward import PUBLISHED_X, Reward, default_x
from tests.models.test_protocol import THREE


def test_published_table():
    """R(s, a) = -C + exp(r x_s) - exp(r x_0) with r = .06 and x = (45, 48, 56, 67)."""
    table = Reward(PUBLISHED_X).table(PUBLISHED)
    gain = [math.exp(0.06 * x) - math.exp(0.06 * 45) for x in (45, 48, 56, 67)]
    np.testing.assert_allclose(table[0], gain, rtol=1e-14)
    np.testing.assert_allclose(table[1], np.array(gain) - 15, rtol=1e-14)
    np.testing.assert_allclose(table[2:], table[:2], rtol=1e-14)
    np.testing.assert_allclose(table[0], [0, 2.93, 13.91, 40.82], atol=0.01)


def test_costs_come_from_the_protocol_unless_given():
    table = Reward((1.0, 1.0), costs={"hint": 7.0}).table(THREE)
    assert table[:, 0].tolist() == [0.0, -2.5, 0.0, -7.0, -4.0, 0.0]


def test_a_cost_of_an_unknown_action_is_refused():
    with pytest.raises(InputError, match="action: found 'hint', wanted one of no_help, help, no_signal, signal"):
        Reward((1.0, 2.0), costs={"hint": 7.0}).table(PUBLISHED)


def test_default_x():
    assert default_x(4) == (45.0, 48.0, 56.0, 67.0)
    assert default_x(2) == (45.0, 67.0)
    assert default_x(3) == (45.0, 56.0, 67.0)
    assert default_x(1) == (45.0,)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (((),), r"reward, x: found \(\), wanted finite numbers, one a state"),
        (((1.0, math.nan),), r"reward, x: found \(1\.0, nan\), wanted finite numbers"),
        (((1.0,), math.inf), "reward, r: found inf, wanted a finite number"),
    ],
)
def test_unusable_numbers_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        Reward(*arguments)


@pytest.mark.parametrize("values", [[0.0, 12.0], [30.0, 18.0, 25.0], [-4.0, 1e6], [7.0]])
def test_any_values_are_a_reward(values):
    """The table is the values less the first, less the cost of the action."""
    table = Reward.of_values(values, {"help": 3.0}).table(PUBLISHED)
    wanted = np.array(values) - values[0]
    np.testing.assert_allclose(table[0], wanted, rtol=1e-12, atol=1e-9)
    np.testing.assert_allclose(table[1], wanted - 3.0, rtol=1e-12, atol=1e-9)


@pytest.mark.parametrize("values", [[], [[1.0, 2.0]], [1.0, np.nan], [np.inf, 0.0]])
def test_values_that_are_none_are_refused(values):
    with pytest.raises(InputError, match="reward, values: found"):
        Reward.of_values(values)
