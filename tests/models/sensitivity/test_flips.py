"""Critical values: against closed forms and root finding, several flips, third decisions, open zones."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.optimize import brentq

from models.errors import InputError
from models.model_draws import ModelDraws
from models.protocol import PUBLISHED
from models.reward import PUBLISHED_X, Reward
from models.sensitivity.cases import OPEN, Answers, Cases, Nodes
from models.sensitivity.endless_steps import EndlessSteps
from models.sensitivity.few_steps import FewSteps
from models.sensitivity.flips import find_flips
from models.sensitivity.moving import costs_of, moving, ranges, reward_cases
from models.sensitivity.reward_grid import cost_axes, reward_at
from tests.models.sensitivity.sensitivity_cases import people

HELP, SIGNAL = cost_axes(PUBLISHED)
BASE = Reward(PUBLISHED_X, 0.06)


@dataclass
class Ruled:
    """A decider whose decision at step 0 is a rule of the discount, for what bisection does."""

    rule: object
    draws: ModelDraws
    reading: str = "ruled"
    nodes: Nodes = Nodes(PUBLISHED, (0, 1))  # noqa: RUF009

    def decide(self, cases: Cases) -> Answers:
        choice = np.zeros((len(cases), 2), dtype=np.int8)
        choice[:, 0] = self.rule(cases.discount, cases.draw)
        nothing = np.zeros((len(cases), 2, 2))
        return Answers(self.nodes, choice, np.ones((len(cases), 2)), nothing, nothing)


def by_rule(rule, draws=1, scan=None, tolerance=1e-9):
    decider = Ruled(rule, people(0, draws, 2))
    setting = moving(PUBLISHED, Reward((45.0, 67.0)), 0.5, gamma=True)
    return find_flips(decider, "discount", setting, np.linspace(0, 1, 11) if scan is None else scan, tolerance)[0]


def gained(model, reward, discount=1.0, terminal=False):
    """What helping brings more than not helping, before its cost, in two steps without a signal."""
    p = reward.prosocial()
    gain = model.initial @ (model.transition[1] - model.transition[0])
    return discount * gain @ p + (discount**2 * gain @ model.transition[2] @ p if terminal else 0.0)


@pytest.mark.parametrize("terminal", [False, True])
def test_the_critical_cost_is_what_helping_brings(terminal):
    draws = people(2, 20, 4)
    base = reward_at(BASE, None, {SIGNAL: 1e3})
    setting = moving(PUBLISHED, base, 0.9, cost=HELP)
    first, second = find_flips(FewSteps(draws, terminal), "cost", setting, np.linspace(0, 60, 25), 1e-9)
    wanted = np.array([gained(draws.model(d), base, 0.9, terminal) for d in range(20)])
    has = (wanted > 0) & (wanted < 60)
    assert np.array_equal(first.per_draw == 1, has)
    assert first.first[has] == pytest.approx(wanted[has], abs=1e-6)
    assert np.isnan(first.first[~has]).all()
    assert not len(second.draw)
    assert first.share_without == pytest.approx(1 - has.mean())
    assert set(first.always) <= {"help", "no_help"}
    assert sum(first.always.values()) == pytest.approx(first.share_without)
    assert first.closed.all()


def test_the_critical_steepness_is_a_root():
    draws = people(11, 6, 4)
    found = find_flips(FewSteps(draws, False), "r", moving(PUBLISHED, BASE, 1.0, r=True), np.linspace(0, 0.12, 61))[
        0
    ]
    assert len(found.draw)
    for d, low, high in zip(found.draw, found.low, found.high, strict=True):
        root = brentq(lambda r, d=d: gained(draws.model(int(d)), replace(BASE, r=r)) - 15, low - 1e-3, high + 1e-3)
        assert low - 1e-9 <= root <= high + 1e-9


def test_brackets_without_a_horizon_are_proven():
    draws = people(4, 1, 3)
    base = Reward((45.0, 56.0, 67.0), 0.06)
    found = find_flips(
        EndlessSteps(draws, tolerance=1e-7), "cost", moving(PUBLISHED, base, 0.8, cost=HELP), np.linspace(0, 80, 17)
    )[0]
    assert len(found.draw) == 1
    low, high = float(found.low[0]), float(found.high[0])
    assert high - low < 0.01
    cases = moving(PUBLISHED, base, 0.8, cost=HELP)(np.array([low, high]), np.zeros(2, dtype=np.int64))
    ends = EndlessSteps(draws, tolerance=1e-9, rounds=200).decide(cases)
    assert ends.choice[:, 0].tolist() == [1, 0]
    assert ends.lower[0, 0, 1] > ends.upper[0, 0, 0]
    assert ends.lower[1, 0, 0] > ends.upper[1, 0, 1]
    assert "help up to" in found.sentence


def test_several_flips_are_all_found():
    found = by_rule(lambda g, _: ((g > 0.13) & (g < 0.42)) | (g > 0.77))
    assert found.middle == pytest.approx([0.13, 0.42, 0.77], abs=1e-8)
    assert [(int(a), int(b)) for a, b in zip(found.before, found.after, strict=True)] == [(0, 1), (1, 0), (0, 1)]
    assert found.share_several == 1
    assert found.first == pytest.approx([0.13], abs=1e-8)
    # Two that undo each other between neighbouring points are missed, as the words say.
    assert not len(by_rule(lambda g, _: (g > 0.12) & (g < 0.18)).draw)
    assert found.spacing == pytest.approx(0.1)


def test_a_third_decision_between_two_others():
    found = by_rule(lambda g, _: np.select([g < 0.31, g < 0.345], [0, 2], 1), scan=[0.0, 0.3, 0.4, 1.0])
    assert np.sort(found.middle) == pytest.approx([0.31, 0.345], abs=1e-8)
    order = np.argsort(found.low)
    assert found.before[order].tolist() == [0, 2]
    assert found.after[order].tolist() == [2, 1]


def test_open_zones():
    rule = lambda g, _: np.select([g < 0.5, g < 0.53], [0, OPEN], 1)  # noqa: E731
    found = by_rule(rule)
    assert found.low <= 0.5
    assert found.high >= 0.53
    assert not found.closed.any()
    assert found.undecided == 1
    throughout = by_rule(lambda g, _: np.full(len(g), OPEN))
    assert throughout.always == {"undecided": 1.0}
    assert np.isnan(throughout.quantiles()).all()


def test_quantiles_over_draws():
    at = np.array([0.2, 0.4, 0.6, 2.0])
    found = by_rule(lambda g, d: g > at[d], draws=4)
    assert found.quantiles((0.1, 0.5, 0.9)) == pytest.approx([0.2, 0.4, 0.6], abs=1e-8)
    assert found.share_without == pytest.approx(0.25)
    assert found.always == {"no_help": pytest.approx(0.25)}
    assert found.sentence.endswith(
        "3 of 4 draws flip, first at 0.2, 0.4, 0.6; the others never (no_help 1 of 4 throughout)"
    )


def test_few_draws_are_counted_and_never_have_quantiles():
    one = by_rule(lambda g, d: g > np.where(d == 1, 0.25, 2.0), draws=3)
    assert "1 of 3 draws flip, at 0.25; the others never" in one.sentence
    some = by_rule(lambda g, d: g > 0.1 + 0.05 * d, draws=12, scan=np.linspace(0, 1, 101))
    assert "12 of 12 draws flip, first from 0.1 to 0.65, in the median of these at 0.35" in some.sentence
    many = by_rule(lambda g, d: g > np.where(d < 25, 0.1 + 0.01 * d, 2.0), draws=40, scan=np.linspace(0, 1, 101))
    assert "62% of 40 draws flip, among these first at 0.22 in the median" in many.sentence
    assert "the others never (no_help 38% throughout)" in many.sentence
    for few in (one, some):
        assert "90%" not in few.sentence
    assert by_rule(lambda g, d: 0 * g, draws=3).sentence.endswith("none of 3 draws changes its mind")


def test_few_weighted_draws_come_with_their_weights():
    found = by_rule(lambda g, d: g > 0.25 + 0.25 * d, draws=2)
    weighted = replace(found, weight=np.array([0.75, 0.25]))
    assert "100% of the weight of 2 draws flip, first at 0.25 (weight 0.75), 0.5 (weight 0.25)" in weighted.sentence


def test_both_ends_of_a_bracket_are_told_apart():
    found = by_rule(lambda g, _: g > 0.123456789, tolerance=1e-9)
    low, high = re.search(r"no_help up to (\S+), help from (\S+) on", found.sentence).groups()
    assert low != high
    assert float(low) <= 0.123456789 <= float(high)


def test_cases_are_those_of_the_reward():
    reward = reward_at(BASE, 0.07, {HELP: 3.0, SIGNAL: 8.0})
    draw = np.array([0, 2])
    for cases in (
        Cases.of(1, [reward], PUBLISHED, 0.9),
        reward_cases(PUBLISHED, draw, x=np.array(BASE.x), r=0.07, costs=costs_of(PUBLISHED, reward), discount=0.9),
        moving(PUBLISHED, reward_at(reward, 0.01), 0.9, r=True)(np.full(2, 0.07), draw),
        moving(PUBLISHED, reward_at(reward, None, {HELP: 0.0}), 0.9, cost=HELP)(np.full(2, 3.0), draw),
        moving(PUBLISHED, reward, 0.1, gamma=True)(np.full(2, 0.9), draw),
        moving(PUBLISHED, replace(reward, x=(45.0, 48.0, 50.0, 67.0)), 0.9, state=2)(np.full(2, 56.0), draw),
    ):
        assert cases.reward[-1] == pytest.approx(reward.table(PUBLISHED))
        assert cases.prosocial[-1] == pytest.approx(reward.prosocial())
        assert cases.discount[-1] == 0.9


def test_ranges():
    found = ranges(BASE, (0.01, 0.08), {HELP: (30.0, 0.0)})
    assert found["r"] == (0.0, pytest.approx(0.12))
    assert found["cost_help"] == (0.0, 60.0)
    assert found["x_0"] == (42.0, 48.0)
    assert found["x_3"] == (56.0, 78.0)


def test_refused():
    with pytest.raises(InputError, match="at least two values that rise"):
        by_rule(lambda g, _: g > 0.5, scan=[0.3, 0.3])
    with pytest.raises(InputError, match="above 0"):
        by_rule(lambda g, _: g > 0.5, tolerance=0.0)
    with pytest.raises(InputError, match="exactly one of"):
        moving(PUBLISHED, BASE, 0.9)
    with pytest.raises(InputError, match="exactly one of"):
        moving(PUBLISHED, BASE, 0.9, r=True, gamma=True)
