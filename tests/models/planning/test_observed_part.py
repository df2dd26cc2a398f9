"""An observed part found in problems that declare none: the same values, and policies for the problem as given."""

import time

import numpy as np
import pytest
from scipy import sparse

from models.planning import solver
from models.planning.arrays import arrays_of
from models.planning.controller import FiniteStateController, controller_of
from models.planning.formats.end_state import flat
from models.planning.observed_part import observed_part
from models.planning.problem import Problem
from models.planning.problems import problem as standard_problem
from models.planning.solver import solve
from models.planning.textbook import textbook_problem
from tests.planning_cases import CASES, dense_problem, latent_case, modal_problem
from tests.reference import planning_numpy as reference
from tests.reference.planning_blocks import block_problem


def from_one_mode(problem: Problem) -> Problem:
    x, _, belief = next(problem.starts())
    start = [np.zeros(len(s)) for s in problem.states]
    start[x] = belief
    return problem.started(start)


def test_tag_again():
    """Folded into one mode, the robot's cell is found again; the start alone is not told."""
    whole = flat(standard_problem("tag"), hide_start=True)
    part = observed_part(whole)
    assert block_problem(part).modes[part.start_mode] == "start"
    # Where both are in one cell it is seen too; the cell alone is 29 blocks.
    assert len(part.members) - 1 >= 29
    assert max(len(m) for m in part.members[:-1]) <= 30
    assert sorted(np.concatenate(part.members[:-1])) == list(range(whole.n_states))


@pytest.mark.parametrize("name", sorted(CASES))
def test_values_are_the_same_step_by_step(name):
    whole = flat(from_one_mode(CASES[name]))
    part = observed_part(whole)
    if part is None:
        assert CASES[name].n_modes == 1 or 2 * max(map(len, CASES[name].states)) > whole.n_states
        return

    def leaf(_, w):
        return w.sum(axis=1) * 3.0

    assert reference.tree_value(block_problem(part), 4, leaf) == pytest.approx(
        reference.tree_value(whole, 4, leaf), rel=1e-12
    )


def expanded(arrays):
    """Every branch with an emission of its own, as `arrays_of` has it; otherwise branches share them."""
    out, place = [], 0
    for b, seen in enumerate(arrays.branch_seen):
        rows = np.arange(seen, seen + arrays.mode_size[arrays.branch_mode[b]] + 1)
        start = arrays.seen_start[rows]
        kept = slice(start[0], start[-1])
        out.append((place, start - start[0], arrays.seen_outcome[kept], arrays.seen_value[kept]))
        place += len(rows)
    return out


@pytest.mark.parametrize("make", [
    *(lambda n=n: flat(from_one_mode(CASES[n])) for n in sorted(CASES)),
    lambda: flat(standard_problem("tag"), hide_start=True), lambda: flat(standard_problem("rock_sample_4_4")),
    lambda: grid_world(3), lambda: grid_world(4),
])  # fmt: skip
def test_arrays_are_those_of_the_problem_put_together_matrix_by_matrix(make):
    part = observed_part(make())
    if part is None:
        return
    other = arrays_of(block_problem(part))
    for name in part.arrays._fields:
        if name not in ("branch_seen", "seen_start", "seen_outcome", "seen_value", "span", "largest", "least"):
            ours, theirs = getattr(part.arrays, name), getattr(other, name)
            np.testing.assert_array_equal(ours, theirs, err_msg=name, strict=name != "discount")
    for ours, theirs in zip(expanded(part.arrays), expanded(other), strict=True):
        for one, two in zip(ours, theirs, strict=True):
            np.testing.assert_array_equal(one, two)
    for name in ("span", "largest"):
        assert getattr(part.arrays, name) == getattr(other, name)


def grid_world(seed, n=60):
    """A place that is seen, but for some noise within rows, and something hidden; the start is spread."""
    rng = np.random.default_rng(seed)
    t = np.where(rng.random((3, n, n)) < 0.1, rng.random((3, n, n)), 0) + np.eye(n)
    seen = np.zeros((3, n, 24))
    for s in range(n):
        seen[:, s, 2 * (s // 5) : 2 * (s // 5) + 2] = rng.dirichlet(np.ones(2))
    return textbook_problem(t / t.sum(axis=2, keepdims=True), seen, rng.normal(size=(3, n)), 0.9)


@pytest.mark.parametrize("make", [
    lambda: latent_case(1), lambda: modal_problem(1, (2, 3, 1)), lambda: modal_problem(3, (4, 1, 3, 2)),
], ids=["latent", "modal 1", "modal 3"])  # fmt: skip
def test_solved_with_and_without(make, monkeypatch):
    whole = flat(from_one_mode(make()))
    monkeypatch.setattr(solver, "GRID_STATES", 2)
    found = []
    plain = solver.observed_part
    monkeypatch.setattr(solver, "observed_part", lambda p: found.append(plain(p)) or found[-1])
    with_part = solve(whole, 1e-3, time_limit=4)
    monkeypatch.setattr(solver, "observed_part", lambda p: None)
    without = solve(whole, 1e-3, time_limit=4)
    assert any(part is not None for part in found)
    assert with_part.problem is whole
    assert with_part.lower <= without.upper + 1e-9
    assert without.lower <= with_part.upper + 1e-9
    values = reference.controller_values(whole, with_part.mode, with_part.choice, with_part.follow)
    worth = max(whole.initial[0] @ v for v in values)
    assert with_part.lower - 1e-8 <= worth <= with_part.upper + 1e-8
    for alpha, value in zip(with_part.alpha, values, strict=True):
        assert (alpha <= value + 1e-8).all()
    belief = whole.initial[0]
    assert with_part.policy.value(belief, whole.modes[0]) >= with_part.lower - 1e-8


def rooms(seed: int) -> Problem:
    """Rooms that are heard, 18 to 25 states; every action leads to some states only, and one state is beyond reach.

    What a state would show after an action that does not lead there is anything, other rooms' sounds included, and
    rewards punish whoever takes one room for another.
    """
    rng = np.random.default_rng(seed)
    room = np.repeat(np.arange(8), rng.integers(2, 4, size=8))
    n, actions = len(room), int(rng.integers(2, 4))
    beyond = int(rng.integers(n))
    t, shown = np.zeros((actions, n, n)), np.zeros((actions, n, 16))
    for a in range(actions):
        ends = np.setdiff1d(rng.choice(n, n // 2, replace=False), [beyond])
        for s in range(n):
            t[a, s, rng.choice(ends, 2, replace=False)] = rng.dirichlet(np.ones(2))
            shown[a, s, 2 * room[s] : 2 * room[s] + 2] = rng.dirichlet(np.ones(2))
        for s in np.setdiff1d(np.arange(n), ends):
            shown[a, s] = 0
            shown[a, s, rng.choice(16, 3, replace=False)] = 1 / 3
    good = rng.integers(actions, size=8)[room] == np.arange(actions)[:, None]
    reward = np.where(good, rng.random((actions, n)), -20.0)
    reward[:, beyond] = 300 * rng.choice([-1, 1])
    start = np.where(room == rng.integers(8) if rng.random() < 0.5 else True, rng.random(n), 0)
    start[beyond] = 0
    order = rng.permutation(n)  # rooms do not come one after the other
    return textbook_problem(
        t[:, order][:, :, order], shown[:, order], reward[:, order], 0.9, start[order] / start.sum()
    )  # fmt: skip


def worth(problem: Problem, controller: FiniteStateController) -> float:
    """Of a controller in a problem of one mode, from the start: node and state are a Markov chain."""
    n, nodes = problem.n_states, controller.n_nodes
    chain, reward = np.zeros((nodes, n, nodes, n)), np.zeros((nodes, n))
    for i, c in enumerate(controller.choice):
        branch = problem.choices[0][c].branches[0]
        reward[i] = problem.choices[0][c].reward
        for o, shown in zip(branch.observations, branch.emission.toarray().T, strict=True):
            chain[i, :, controller.follow[i, 0, o]] += branch.transition.toarray() * shown
    size = nodes * n
    system = np.eye(size) - problem.discount * chain.reshape(size, size)
    values = np.linalg.solve(system, reward.ravel()).reshape(nodes, n)
    return float(problem.initial[0] @ values[controller.start[0]])


@pytest.mark.parametrize("seed", range(16))
@pytest.mark.parametrize("limit", [1e-9, 5.0], ids=["in no time", "in time"])
def test_the_returned_policy_graph_is_worth_the_lower_bound(seed, limit):
    problem = rooms(seed)
    part = observed_part(problem)
    assert part is not None
    # Of two blocks that an action is said to show alike, one at least does not show it as it is not come to.
    blocks = part.members[: np.searchsorted(np.cumsum([len(m) for m in part.members]), problem.n_states) + 1]
    written = [
        np.stack([choice.branches[0].emission.toarray()[block].any(axis=0) for block in blocks])
        for choice in problem.choices[0]
    ]
    assert max(w.sum(axis=0).max() for w in written) > 1
    solution = solve(problem, 1e-2, time_limit=limit)
    values = reference.controller_values(problem, solution.mode, solution.choice, solution.follow)
    for alpha, value in zip(solution.alpha, values, strict=True):
        assert (alpha <= value + 1e-7).all()
    assert worth(problem, controller_of(solution.policy)) >= solution.lower - 1e-8


def test_thousands_of_states_take_no_time():
    """100 blocks of 50, 28,000 pairs of a block, an action and a block."""
    n, rng = 5000, np.random.default_rng(0)
    rows = np.repeat(np.arange(n), 3)
    tables, seen = [], []
    for a in range(6):
        to = (rows + rng.integers(1, 50, len(rows))) % n
        table = sparse.coo_array((rng.random(len(rows)), (rows, to)), shape=(n, n)).tocsr()
        tables.append(sparse.csr_array(sparse.diags_array(1 / np.asarray(table.sum(axis=1)).ravel()) @ table))
        shown = (np.ones(n), (np.arange(n), (np.arange(n) * 7 + a) % 100))
        seen.append(sparse.csr_array(sparse.coo_array(shown, shape=(n, 100))))
    problem = textbook_problem(tables, seen, rng.normal(size=(6, n)), 0.99, np.eye(n)[0])
    began = time.process_time()
    part = observed_part(problem)
    assert time.process_time() - began < 1.0
    assert part.arrays.mode_size.tolist() == [50] * 100
    assert len(part.arrays.branch_mode) > 20_000


def test_nothing_to_be_found():
    assert observed_part(dense_problem(1, 6)) is None
    assert observed_part(standard_problem("tiger")) is None
    # Everything observed: one state a block, and a start that is known needs no mode of its own.
    t = np.random.default_rng(0).dirichlet(np.ones(5), size=(2, 5))
    seen = observed_part(textbook_problem(t, [np.eye(5)] * 2, np.zeros((2, 5)), 0.9, [0, 0, 1.0, 0, 0]))
    assert seen.arrays.mode_size.tolist() == [1] * 5


def test_states_that_are_never_reached_join_nothing():
    """What they would show cannot be seen."""
    t = np.zeros((1, 6, 6))
    t[0, :, :4] = np.random.default_rng(1).dirichlet(np.ones(4), size=6)
    shown = np.array([[1.0, 0], [1, 0], [0, 1], [0, 1], [0.5, 0.5], [0.5, 0.5]])
    part = observed_part(textbook_problem(t, [shown], np.zeros((1, 6)), 0.9, [1.0, 0, 0, 0, 0, 0]))
    assert sorted(map(len, part.members)) == [1, 1, 2, 2]
