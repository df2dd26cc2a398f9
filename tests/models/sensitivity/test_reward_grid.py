"""The grid of rewards, and what draws answer in its cells."""

from dataclasses import replace

import numpy as np
import pytest

from models.errors import InputError
from models.protocol import PUBLISHED
from models.sensitivity.cases import OPEN
from models.sensitivity.endless_steps import EndlessSteps
from models.sensitivity.few_steps import FewSteps
from models.sensitivity.reward_grid import (
    ENOUGH_TO_BE_SURE,
    PRINTED_COSTS,
    PRINTED_R,
    SURE,
    RewardGrid,
    chosen,
    cost_axes,
    decide_grid,
    decisions_when_certain,
    reward_of,
    verdict,
)
from models.unseen import without_actions
from tests.analysis.report_cases import CORRIDOR
from tests.models.sensitivity.sensitivity_cases import people, some_draws


def test_the_printed_grid():
    grid = RewardGrid.of(people(1, 1, 4))
    assert grid.shape == (5, 4, 4)
    assert len(grid.cells) == 80
    assert grid.r == PRINTED_R
    assert grid.costs == (PRINTED_COSTS, PRINTED_COSTS)
    for (r, (helping, signal)), reward in zip(grid.cells, grid.rewards, strict=True):
        assert reward.r == r
        assert reward.table(PUBLISHED)[:, 0] == pytest.approx([0, -helping, 0, -signal])


def test_axes_follow_the_protocol():
    assert [a.name for a in cost_axes(CORRIDOR)] == ["ask", "assist", "open"]
    fewer = without_actions(people(1, 1, 3), ["signal"])
    assert [a.name for a in cost_axes(fewer.protocol)] == ["help"]
    grid = RewardGrid.of(fewer, r=[0.05], costs=[1.0, 2.0])
    found = decide_grid(FewSteps(fewer, True), grid, 1.0)
    assert {row["action"] for row in found.rows() if row["k"] == 1} == {"no_signal"}


def test_shares_are_weighted_means_of_single_draws():
    draws = people(3, 3, 3)
    draws = replace(draws, weight=np.array([0.5, 0.3, 0.2]))
    grid = RewardGrid.of(draws, costs=[15.0, 0.0])
    together = decide_grid(FewSteps(draws, True), grid, 1.0)
    alone = [decide_grid(FewSteps(draws.some(np.array([d])), True), grid, 1.0) for d in range(3)]
    for k in range(2):
        wanted = sum(w * a.shares(k) for w, a in zip(draws.weight, alone, strict=True))
        assert together.shares(k) == pytest.approx(wanted)
        assert together.shares(k).sum(axis=1) == pytest.approx(np.ones(len(grid.cells)))
        assert together.acting(k).shape == (len(grid.cells), 3)
    rows = together.rows()
    assert len(rows) == 2 * len(grid.cells)
    for row in rows:
        assert row["share"] == max(v for name, v in row["shares"].items() if name != "undecided")
    with pytest.raises(InputError, match="bounds of action values"):
        together.bounds(0)
    bounds = alone[0].bounds(0)[0]
    assert bounds["help"][0] == bounds["help"][1]


def test_open_decisions_count_half_and_are_named():
    draws = people(5, 1, 2)
    grid = RewardGrid.of(draws, r=[0.06], costs=[15.0])
    found = decide_grid(FewSteps(draws, True), grid, 1.0)
    answers = replace(found.answers, choice=np.full_like(found.answers.choice, OPEN))
    open_ = replace(found, answers=answers)
    assert open_.acting(0).tolist() == [[0.5]]
    row = open_.rows()[0]
    assert (row["action"], row["share"], row["verdict"]) == ("undecided", 1.0, "undecided")
    assert chosen({"a": 0.2, "b": 0.3, "undecided": 0.5}) == ("b", 0.3)


def test_what_is_done_when_certain():
    draws = people(6, 2, 3)
    rewards = [reward_of(draws)]
    deciders = [FewSteps(replace(draws, initial=np.tile(np.eye(3)[s], (2, 1))), False) for s in range(3)]
    found = decisions_when_certain(deciders, rewards, 1.0)
    assert found.shape == (3, 1, 2)
    p = rewards[0].prosocial()
    for s in range(3):
        for d in range(2):
            gain = (draws.transition[d, 1, s] - draws.transition[d, 0, s]) @ p
            assert found[s, 0, d] == (gain > 15)


def test_three_modes_have_steps_and_shares():
    draws = some_draws(2, 2, 3, CORRIDOR)
    grid = RewardGrid.of(draws, r=[0.03], costs=[5.0])
    for decider, discount in ((FewSteps(draws, True), 1.0), (EndlessSteps(draws), 0.7)):
        found = decide_grid(decider, grid, discount)
        assert [row["k"] for row in found.rows()] == [0, 1, 2]
        assert {"cost_ask", "cost_assist", "cost_open"} <= set(found.rows()[0])


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"r": []}, "grid, r: found 0"), ({"r": [0.1, 0.1]}, "every value once"),
        ({"costs": [float("nan")]}, "finite numbers"), ({"costs": [1.0, 1.0]}, "every value once"),
    ],
)  # fmt: skip
def test_refused(asked, words):
    with pytest.raises(InputError, match=words):
        RewardGrid.of(people(1, 1, 2), **asked)


def test_discounts_are_checked():
    draws = people(1, 1, 2)
    with pytest.raises(InputError, match="discount"):
        decide_grid(FewSteps(draws, True), RewardGrid.of(draws), 1.5)


def test_few_draws_are_never_sure_and_never_a_toss():
    for n in (2, 10, 19):
        assert {verdict("help", share, n) for share in (0.4, 0.8, 1.0)} == {"too few draws"}
    assert verdict("help", 0.5, 20) == "coin toss"
    # The least number of draws that, all agreeing, leave no share below SURE with 95% confidence.
    assert SURE**ENOUGH_TO_BE_SURE < 0.05 < SURE ** (ENOUGH_TO_BE_SURE - 1)
    assert verdict("help", 1.0, ENOUGH_TO_BE_SURE - 1) == "leaning"
    assert verdict("help", 1.0, ENOUGH_TO_BE_SURE) == "sure"
    assert verdict("undecided", 1.0, 5) == "undecided"
    # One model knows no doubt: a share below one is the chance of the responses that it acts upon.
    assert verdict("help", 0.55, 1) == "depends on responses"


def test_rows_name_their_draws():
    draws = people(3, 3, 4)
    grid = RewardGrid.of(draws)
    rows = decide_grid(FewSteps(draws, True), grid, 1.0).rows()
    assert {row["verdict"] for row in rows} == {"too few draws"}
    assert {row["agree"] for row in rows} <= {"2 of 3 draws", "3 of 3 draws"}
    weighted = decide_grid(FewSteps(replace(draws, weight=np.array([0.5, 0.3, 0.2])), True), grid, 1.0).rows()
    assert all("of the weight of 3 draws" in row["agree"] for row in weighted)
    assert {row["verdict"] for row in decide_grid(FewSteps(draws.thin(1), True), grid, 1.0).rows()} == {"one model"}


def test_shares_never_pass_one():
    draws = people(3, 7, 2)
    weight = np.full(7, 1 / 7) * (1 + 1e-13)
    found = decide_grid(FewSteps(replace(draws, weight=weight), True), RewardGrid.of(draws), 1.0)
    assert all(found.shares(k).max() <= 1 for k in range(2))
