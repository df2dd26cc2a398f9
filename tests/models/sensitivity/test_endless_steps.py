"""Decisions without a horizon: against looking far ahead, against tight solves, and at ties."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import settings as effort
from hypothesis import strategies as st

from models.errors import InputError
from models.model_draws import ModelDraws
from models.planning.latent import latent_problem
from models.planning.mode_process import alternating
from models.planning.solver import solve
from models.reward import Reward
from models.sensitivity import endless_steps
from models.sensitivity.cases import OPEN, Cases
from models.sensitivity.endless_kernel import certain_choice
from models.sensitivity.endless_steps import EndlessSteps
from tests.analysis.report_cases import CORRIDOR
from tests.models.sensitivity.sensitivity_cases import cases_of, people, some_draws, some_rewards
from tests.reference.endless_decisions import action_bounds


def problem_of(draws, d, reward, discount):
    model = replace(draws, reward=reward).model(d)
    return latent_problem(model, alternating(draws.protocol), discount)


def tight(problem, mode, belief, precision=0.02):
    """Bounds of every action by solving from each belief that may follow."""
    out = []
    for c, choice in enumerate(problem.choices[mode]):
        worth = np.full(2, belief @ choice.reward)
        for x, _, p, after in problem.outcomes(mode, c, belief):
            start = [after if m == x else np.zeros_like(after) for m in range(problem.n_modes)]
            solved = solve(problem.started(start), precision, relative=False, time_limit=5.0)
            worth += problem.discount * p * np.array([solved.lower, solved.upper])
        out.append(worth)
    return np.array(out)


@given(st.integers(0, 10_000), st.integers(2, 4))
@effort(max_examples=8)
def test_bounds_hold_what_looking_ahead_finds(seed, states):
    draws = some_draws(seed, 1, states)
    rewards = some_rewards(seed, draws, 2)
    decider = EndlessSteps(draws)
    answers = decider.decide(cases_of(draws, rewards, 0.3))
    for g, reward in enumerate(rewards):
        problem = problem_of(draws, 0, reward, 0.3)
        belief = draws.initial[0]
        for k in range(2):
            ahead = np.array(action_bounds(problem, k, belief, 6))
            low, high = answers.lower[g, k], answers.upper[g, k]
            assert np.all(low <= ahead[:, 1] + 1e-7)
            assert np.all(high >= ahead[:, 0] - 1e-7)
            choice = answers.choice[g, k]
            assert choice == OPEN or ahead[choice, 1] >= ahead[:, 0].max()
            belief = belief @ draws.transition[0, max(choice, 0)]


@pytest.mark.parametrize("seed", range(4))
def test_decisions_are_those_of_tight_solves(seed):
    draws = people(seed, 2, 4)
    rewards = [Reward((45.0, 48.0, 56.0, 67.0), r, {"help": c, "signal": c}) for r, c in ((0.05, 5), (0.07, 15))]
    answers = EndlessSteps(draws).decide(cases_of(draws, rewards, 0.8))
    assert (answers.choice != OPEN).all()
    for case in range(4):
        g, d = divmod(case, 2)
        problem = problem_of(draws, d, rewards[g], 0.8)
        belief = draws.initial[d]
        for k in range(2):
            worth = tight(problem, k, belief)
            assert np.all(answers.lower[case, k] <= worth[:, 1] + 1e-6)
            assert np.all(answers.upper[case, k] >= worth[:, 0] - 1e-6)
            assert worth[answers.choice[case, k], 1] >= worth[:, 0].max()
            belief = belief @ draws.transition[d, 2 * k + answers.choice[case, k]]


def test_a_tie_stays_open_and_so_does_what_follows():
    draws = people(3, 1, 3)
    table = draws.transition.copy()
    table[:, 1] = table[:, 0]
    same = replace(draws, transition=table)
    free = Reward((45.0, 56.0, 67.0), 0.06, {"help": 0.0, "signal": 200.0})
    answers = EndlessSteps(same).decide(cases_of(same, [free], 0.9))
    assert answers.choice[0].tolist() == [OPEN, OPEN]
    assert answers.shares(1)[0].tolist() == [0, 0, 1]
    # The second step by itself is clear: only its belief was not known.
    assert answers.upper[0, 1, 1] < answers.lower[0, 1, 0]
    costly = replace(free, costs={"help": 1.0, "signal": 200.0})
    assert EndlessSteps(same).decide(cases_of(same, [costly], 0.9)).choice[0].tolist() == [0, 0]


def test_responses_before_a_step(monkeypatch):
    draws = some_draws(4, 2, 3, CORRIDOR)
    rewards = some_rewards(5, draws, 1)
    decider = EndlessSteps(draws)
    answers = decider.decide(cases_of(draws, rewards, 0.8))
    assert decider.nodes.counts == (1, 3, 3)
    for k in range(3):
        assert answers.chance[:, list(decider.nodes.of_step(k))].sum(axis=1) == pytest.approx(np.ones(2))
    assert answers.shares(2).sum(axis=1) == pytest.approx(np.ones(2))
    # Too many states for the grid: solved one by one, to the same decisions.
    monkeypatch.setattr(endless_steps, "GRID_STATES", 1)
    slow = EndlessSteps(draws, tolerance=1e-4).decide(cases_of(draws, rewards, 0.8))
    assert np.array_equal(slow.choice, answers.choice)
    seen = np.isfinite(slow.lower)
    assert np.all(slow.lower[seen] <= answers.upper[seen] + 1e-6)
    assert np.all(slow.upper[seen] >= answers.lower[seen] - 1e-6)


def test_steps_may_begin_anywhere():
    draws = people(6, 1, 3)
    (reward,) = some_rewards(2, draws, 1)
    answers = EndlessSteps(draws, (1,)).decide(cases_of(draws, [reward], 0.8))
    worth = tight(problem_of(draws, 0, reward, 0.8), 1, draws.initial[0])
    assert worth[answers.choice[0, 0], 1] >= worth[:, 0].max()


def test_who_solves_does_not_matter(monkeypatch):
    draws = people(9, 6, 3)
    cases = cases_of(draws, some_rewards(3, draws, 3), 0.9)
    one = EndlessSteps(draws).decide(cases)
    monkeypatch.setattr(endless_steps, "PORTION", 2)
    seen = []
    other = EndlessSteps(draws, progress=lambda done, total: seen.append((done, total))).decide(cases)
    assert np.array_equal(one.choice, other.choice)
    assert np.array_equal(one.lower, other.lower, equal_nan=True)
    assert seen[-1] == (9, 9)


def test_certain_choice():
    assert certain_choice(np.array([1.0, 3.0]), np.array([2.9, 4.0])) == 1
    assert certain_choice(np.array([1.0, 3.0]), np.array([3.0, 4.0])) == OPEN
    assert certain_choice.py_func(np.array([5.0, 3.0, 1.0]), np.array([6.0, 4.9, 2.0])) == 0
    assert certain_choice.py_func(np.array([5.0]), np.array([6.0])) == 0


def test_refused():
    draws = people(1, 1, 2)
    cases = cases_of(draws, some_rewards(1, draws, 1), 1.0)
    with pytest.raises(InputError, match="discount without a horizon: found 1"):
        EndlessSteps(draws).decide(cases)
    with pytest.raises(InputError, match="modes that take turns"):
        EndlessSteps(draws, (0, 0))
    assert isinstance(cases, Cases)
    assert isinstance(draws, ModelDraws)
