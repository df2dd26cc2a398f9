"""What cannot be come to says nothing, and may hold any number."""

from dataclasses import replace

import numpy as np
import pytest

from models.planning import solver
from models.planning import within_reach as reach
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


def walled_off(n: int) -> Problem:
    """A sparse problem, and a state worth a million that nothing leads to: solved in blocks, or as it is."""
    return with_a_place_beyond(sparse_problem(3, n), 1e6, True)


@pytest.mark.parametrize("make", [
    lambda: walled_off(20),
    lambda: with_a_place_beyond(flat(modal_problem(3, (6, 5, 7, 6)), hide_start=True), 1e6, True),
], ids=["as it is", "in blocks"])  # fmt: skip
@pytest.mark.parametrize("when", ["before", "after"])
def test_interrupted_while_the_policy_is_put_in_order(make, when, monkeypatch):
    """The second time nothing is done that is not needed; what the search found is not lost."""
    problem, plain, given = make(), solver.beyond_reach, []

    def interrupted(problem, arrays, vectors, work):
        given.append(work)
        if when == "after" or len(given) > 1:
            plain(problem, arrays, vectors, work)
        if len(given) == 1:
            raise KeyboardInterrupt

    monkeypatch.setattr(solver, "beyond_reach", interrupted)
    solution = solve(problem, 0.05, time_limit=2)
    assert solution.status == "interrupted"
    assert given[0] > 0 == given[1]
    graph = solution.mode, solution.choice, solution.follow
    values = reference.controller_values(problem, *graph)
    for alpha, value in zip(solution.alpha, values, strict=True):
        assert (alpha <= value + 1e-6).all()
    assert max(problem.initial[0] @ alpha for alpha in solution.alpha) >= solution.lower - 1e-6
    assert max(problem.initial[0] @ value for value in values) >= solution.lower - 1e-6


def test_what_lies_beyond_is_worth_some_work_only(monkeypatch):
    """Nobody looks at the clock any longer; what is too much is left at the least there can be."""
    problem = walled_off(20)
    arrays, spent = arrays_of(problem), []
    plain = reach.evaluate_closed

    def counted(arrays, vectors, first, tolerance, most):
        spent.append(most * len(vectors.alpha) * (len(arrays.value) + len(arrays.seen_value)) / len(arrays.reward))
        plain(arrays, vectors, first, tolerance, most)

    monkeypatch.setattr(reach, "evaluate_closed", counted)
    found = solve(problem, 0.05, time_limit=2)
    assert found.alpha_vectors > 1
    for work in (0.0, 1.0, 1e4, 1e5, 1e9):
        spent.clear()
        vectors = solver.warm_vectors(arrays, found)
        vectors.alpha[: found.alpha_vectors] = found.alpha
        reach.beyond_reach(problem, arrays, vectors, work)
        assert sum(spent) <= work
        alpha = vectors.alpha[: found.alpha_vectors]
        np.testing.assert_array_equal(alpha[:, :-1], found.alpha[:, :-1])
        if not spent:
            assert (alpha[:, -1] == arrays.reward.min() / (1 - 0.9)).all()
        values = reference.controller_values(problem, found.mode, found.choice, found.follow)
        assert (alpha <= np.stack(values) + 1e-6).all()
    np.testing.assert_allclose(alpha[:, -1], [v[-1] for v in values], rtol=1e-6)


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
