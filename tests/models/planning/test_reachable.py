"""What cannot be come to says nothing, and may hold any number."""

from dataclasses import replace

import numpy as np
import pytest

from models.planning import solver
from models.planning.arrays import arrays_of
from models.planning.formats.end_state import flat
from models.planning.problem import Problem
from models.planning.problems import problem as standard_problem
from models.planning.reachable import reachable_states
from models.planning.solver import solve
from models.planning.textbook import textbook_problem
from models.planning.within_reach import within_reach
from tests.planning_cases import CASES, modal_problem, sparse_problem
from tests.reference import planning_numpy as reference


def by_walking(problem: Problem) -> list[set[int]]:
    """States met by following every entry of every table."""
    found = [set(np.flatnonzero(start > 0).tolist()) for start in problem.initial]
    left = [(x, y) for x, states in enumerate(found) for y in states]
    while left:
        x, y = left.pop()
        for choice in problem.choices[x]:
            for branch in choice.branches:
                for after in np.flatnonzero(branch.transition.toarray()[y]):
                    if int(after) not in found[branch.mode]:
                        found[branch.mode].add(int(after))
                        left.append((branch.mode, int(after)))
    return found


def thinned(seed: int) -> Problem:
    """A sparse problem from one state, so that some are out of reach."""
    rng = np.random.default_rng(seed)
    n = 24
    t = np.zeros((2, n, n))
    for a in range(2):
        for s in range(n):
            t[a, s, rng.choice(n, 1 + int(rng.integers(2)), replace=False)] = 1
    t[0] = t[0, :, rng.permutation(n)].T
    start = np.zeros(n)
    start[int(rng.integers(n))] = 1.0
    seen = rng.dirichlet(np.ones(3), size=(2, n))
    return textbook_problem(t / t.sum(axis=2, keepdims=True), seen, rng.normal(size=(2, n)), 0.9, start)


@pytest.mark.parametrize("make", [
    *(lambda n=n: CASES[n] for n in sorted(CASES)), *(lambda s=s: thinned(s) for s in range(12)),
    *(lambda s=s: modal_problem(s, (3, 4, 2, 2)) for s in range(8)),
    lambda: standard_problem("rock_sample_4_4"), lambda: flat(standard_problem("tag"), hide_start=True),
])  # fmt: skip
def test_states_that_can_be_come_to(make):
    problem = make()
    walked = by_walking(problem)
    for x, met in enumerate(reachable_states(problem)):
        assert set(np.flatnonzero(met).tolist()) == walked[x]
    paid = [c.reward[sorted(walked[x])] for x, o in enumerate(problem.choices) for c in o if walked[x]]
    assert problem.stakes.lowest == min(r.min() for r in paid)
    assert problem.stakes.highest == max(r.max() for r in paid)
    sure = [max(c.reward[sorted(walked[x])].min() for c in o) for x, o in enumerate(problem.choices) if walked[x]]
    assert problem.stakes.sure == min(sure)


def with_a_place_beyond(problem: Problem, worth: float, leads_back: bool) -> Problem:
    """Another state, of some worth whatever is done, that nothing leads to."""
    tables, seen, reward = [], [], []
    n = problem.n_states
    for choice in problem.choices[0]:
        branch = choice.branches[0]
        t = np.zeros((n + 1, n + 1))
        t[:n, :n] = branch.transition.toarray()
        t[n, 0 if leads_back else n] = 1.0
        tables.append(t)
        seen.append(np.vstack([branch.emission.toarray(), np.eye(len(branch.observations))[0]]))
        reward.append([*choice.reward, worth])
    start = np.append(problem.initial[0], 0.0)
    return textbook_problem(tables, seen, reward, problem.discount, start)


@pytest.mark.parametrize("search", ["grid", "trials"])
@pytest.mark.parametrize("worth", [1e10, -1e10, 1e14, -1e14, 3.0])
@pytest.mark.parametrize("leads_back", [True, False])
def test_a_place_beyond_changes_nothing(search, worth, leads_back, monkeypatch):
    if search == "trials":
        monkeypatch.setattr(solver, "GRID_STATES", 0)
    plain = standard_problem("tiger")
    problem, tame = (with_a_place_beyond(plain, w, leads_back) for w in (worth, 0.0))
    assert (problem.span, problem.largest_value, problem.least_size) == (
        plain.span, plain.largest_value, plain.least_size
    )  # fmt: skip
    solution = solve(problem, 1e-4, time_limit=20)
    assert solution.status == "converged"
    assert solution.gap <= 1e-4 * solution.upper
    assert solution.lower <= 19.37136838
    assert solution.upper >= 19.37136837
    graph = solution.mode, solution.choice, solution.follow
    # What lies beyond would spoil the digits of the linear system; within reach it makes no difference.
    for alpha, value in zip(solution.alpha, reference.controller_values(tame, *graph), strict=True):
        assert (alpha[:2] <= value[:2] + 1e-7).all()
    # There too a vector is worth what its policy is, or it says less.
    for alpha, value in zip(solution.alpha, reference.controller_values(problem, *graph), strict=True):
        assert alpha[2] <= value[2] + 1e-9 * abs(worth) + 1e-7


def test_blocks_with_a_place_beyond():
    """Where an observed part is found as well."""
    whole = flat(modal_problem(3, (6, 5, 7, 6)).started([np.full(6, 1 / 6), np.zeros(5), np.zeros(7), np.zeros(6)]))
    problem = with_a_place_beyond(whole, -1e12, True)
    one, other = solve(whole, 0.05, time_limit=20), solve(problem, 0.05, time_limit=20)
    assert one.lower <= other.upper + 1e-9
    assert other.lower <= one.upper + 1e-9
    assert one.status == other.status == "converged"
    assert other.gap <= 0.05 * max(abs(other.lower), abs(other.upper))
    graph = other.mode, other.choice, other.follow
    for alpha, value in zip(
        other.alpha, reference.controller_values(with_a_place_beyond(whole, 0.0, True), *graph), strict=True
    ):
        assert (alpha[:-1] <= value[:-1] + 1e-7).all()
    for alpha, value in zip(other.alpha, reference.controller_values(problem, *graph), strict=True):
        assert alpha[-1] <= value[-1] + 1e-9 * 1e12


def test_rewards_within_reach_are_left_alone():
    for problem in (CASES["modal 3"], sparse_problem(0, 20), standard_problem("tag")):
        arrays = arrays_of(problem)
        same, tamed = within_reach(arrays, problem)
        if not tamed:
            assert same is arrays
    problem = with_a_place_beyond(standard_problem("tiger"), 1e10, True)
    tamed, changed = within_reach(arrays_of(problem), problem)
    assert changed
    np.testing.assert_array_equal(tamed.reward[:, :2], arrays_of(problem).reward[:, :2])
    assert (tamed.reward[:, 2] == 10).all()


def test_with_everything_in_reach_stakes_are_those_of_all_rewards():
    problem = CASES["dense 3"]
    start = replace(problem, initial=(np.eye(6)[0],))
    assert problem.stakes == start.stakes
