"""Why the solver stops, what it says when asked for what cannot be, and problems at the edge."""

import os
import signal
import subprocess
import sys
import textwrap
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from models.errors import InputError
from models.planning import solver
from models.planning.problem import Branch, Choice, Problem, csr
from models.planning.problems import problem as standard_problem
from models.planning.solver import solve
from models.planning.textbook import textbook_problem
from tests.planning_cases import dense_problem, latent_case, modal_problem, sparse_problem
from tests.reference import planning_numpy as reference


def tiger():
    return standard_problem("tiger")


def bounded(solution):
    assert np.isfinite([solution.lower, solution.upper]).all()
    assert solution.lower <= solution.upper + 1e-9 * max(1, abs(solution.upper))
    assert solution.alpha_vectors > 0
    assert solution.trace
    return solution


# -- asked for what cannot be --------------------------------------------------------------------------
@pytest.mark.parametrize(("options", "words"), [
    ({"precision": -1e-3}, "precision: found -0.001, wanted a number from 0 on"),
    ({"precision": np.nan}, "precision: found nan"),
    ({"precision": np.inf}, "precision: found inf"),
    ({"time_limit": 0}, "time limit: found 0, wanted above 0 seconds"),
    ({"time_limit": -1.0}, "time limit: found -1"),
    ({"time_limit": np.nan}, "time limit: found nan"),
])  # fmt: skip
def test_settings_that_make_no_sense(options, words):
    with pytest.raises(InputError, match=words):
        solve(tiger(), **options)


def test_without_discount_there_is_no_optimum():
    with pytest.raises(InputError, match=r"tiger, discount: found 1\.0, wanted below 1"):
        solve(tiger().with_discount(1.0))


def test_warm_start_of_another_shape():
    other = solve(dense_problem(1, 3), 0.1)
    with pytest.raises(InputError, match="warm start, problem: found 'dense 1', wanted a problem of"):
        solve(tiger(), warm=other)


# -- why it stopped ------------------------------------------------------------------------------------
def test_time_limit():
    solution = bounded(solve(sparse_problem(0, 60, discount=0.97), 1e-9, time_limit=0.3))
    assert solution.status == "time limit"
    assert "Not solved to the relative gap of 1e-09: time limit" in solution.sentence
    assert solution.seconds < 5


@pytest.mark.parametrize("problem", [sparse_problem(0, 40, discount=0.97), dense_problem(3, 6, discount=0.95)])
def test_memory_limit(problem, monkeypatch):
    from models.planning import grid_search, trial_search

    for module, name in ((grid_search, "POINTS"), (trial_search, "NODES")):
        monkeypatch.setattr(module, name, 256)
    solution = bounded(solve(problem, 1e-12, memory_limit=1_000, time_limit=20))
    assert solution.status in ("memory limit", "stalled")
    assert solution.gap > 0


@pytest.mark.parametrize("after", [1, 3])
@pytest.mark.parametrize("make", [lambda: dense_problem(2, 4, 3, 3), lambda: sparse_problem(0, 40)])
def test_interrupted_from_the_progress_callback(make, after):
    seen = []

    def progress(point):
        seen.append(point)
        if len(seen) == after:
            raise KeyboardInterrupt

    solution = bounded(solve(make(), 1e-9, time_limit=20, progress=progress))
    assert solution.status == "interrupted"
    assert solution.trace == tuple(seen)
    assert len(seen) == after
    assert solution.policy.value(solution.problem.initial[0], "always") >= solution.lower - 1e-8
    assert "interrupted" in solution.sentence


def test_interrupted_while_blocks_are_looked_for(monkeypatch):
    def interrupted(problem):
        raise KeyboardInterrupt

    monkeypatch.setattr(solver, "observed_part", interrupted)
    solution = solve(sparse_problem(0, 40), 1e-3)
    assert solution.status == "interrupted"
    assert solution.lower <= solution.upper
    assert solution.alpha_vectors > 0


SIGNALLED = """
    import sys
    from models.planning.solver import solve
    from tests.planning_cases import sparse_problem

    solve(sparse_problem(0, 20), 0.5, time_limit=1)
    def progress(point):
        print("ready", flush=True)
    solution = solve(sparse_problem(0, 60, discount=.97), 1e-9, time_limit=60, progress=progress)
    print(solution.status, solution.lower, solution.upper, solution.alpha_vectors)
"""


@pytest.mark.skipif(os.name == "nt", reason="signals of a terminal")
def test_a_real_ctrl_c(checkout):
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(SIGNALLED)], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, cwd=checkout,
    ) as process:  # fmt: skip
        try:
            assert process.stdout.readline() == "ready\n"
            process.send_signal(signal.SIGINT)
            out, problems = process.communicate(timeout=60)
        finally:
            process.kill()
    assert problems == ""
    status, lower, upper, vectors = out.split("\n")[-2].split()
    assert status == "interrupted"
    assert float(lower) <= float(upper)
    assert int(vectors) > 0


def test_progress_sees_the_trace():
    seen = []
    solution = solve(tiger(), 1e-3, progress=seen.append)
    assert tuple(seen) == solution.trace
    assert {p.method for p in seen} <= {"grid", "trials"}
    assert all(a.seconds <= b.seconds for a, b in pairwise(seen))


# -- at the edge ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("n", [3, 20])
def test_zero_rewards(n):
    full = np.full((2, n, n), 1 / n)
    solution = bounded(solve(textbook_problem(full, full, np.zeros((2, n)), 0.95)))
    assert (solution.status, solution.lower, solution.upper, solution.relative_gap) == ("converged", 0, 0, 0)


@pytest.mark.parametrize("discount", [0.0, 0.5, 0.999])
@pytest.mark.parametrize("rewards", [[2.0], [-1.0, -3.0], [0.5, 0.0, 0.25]])
def test_a_single_state(discount, rewards):
    k = len(rewards)
    problem = textbook_problem(np.ones((k, 1, 1)), np.ones((k, 1, 1)), np.array(rewards)[:, None], discount)
    solution = bounded(solve(problem))
    assert solution.status == "converged"
    for bound in (solution.lower, solution.upper):
        assert bound == pytest.approx(max(rewards) / (1 - discount), rel=1e-3)


@pytest.mark.parametrize("n", [2, 5, 15])
def test_one_action(n):
    rng = np.random.default_rng(n)
    t, r, start = rng.dirichlet(np.ones(n), size=(1, n)), rng.normal(size=(1, n)), rng.dirichlet(np.ones(n))
    seen = rng.dirichlet(np.ones(3), size=(1, n))
    solution = bounded(solve(textbook_problem(t, seen, r, 0.9, start), 1e-4))
    exact = start @ np.linalg.solve(np.eye(n) - 0.9 * t[0], r[0])
    assert solution.status == "converged"
    assert solution.lower - 1e-8 <= exact <= solution.upper + 1e-8


@pytest.mark.parametrize("discount", [0.9, 0.99])
def test_absorbing_states(discount):
    """Cash in at once, or wait for a better price that comes with .3; either ends everything."""
    # States: low, high, over. Actions: wait, cash. The price is seen.
    wait = np.array([[0.7, 0.3, 0], [0, 1, 0], [0, 0, 1]])
    cash = np.array([[0, 0, 1.0]] * 3)
    reward = np.array([[0, 0, 0], [4.0, 10, 0]])
    solution = bounded(solve(textbook_problem([wait, cash], [np.eye(3)] * 2, reward, discount, [1, 0, 0]), 1e-6))
    exact = max(4, 10 * 0.3 * discount / (1 - 0.7 * discount))
    assert solution.status == "converged"
    assert solution.lower == pytest.approx(exact, rel=1e-5)
    assert solution.upper == pytest.approx(exact, rel=1e-5)


@pytest.mark.parametrize("n", [2, 14])
def test_optimum_of_zero(n):
    """The best is to do nothing."""
    rng = np.random.default_rng(n)
    t, o = rng.dirichlet(np.ones(n), size=(2, n)), rng.dirichlet(np.ones(2), size=(2, n))
    problem = textbook_problem(t, o, np.stack([np.zeros(n), -rng.random(n) - 0.1]), 0.9)
    solution = bounded(solve(problem, 1e-6, relative=False, time_limit=5))
    assert solution.status == "converged"
    assert solution.lower <= 0 <= solution.upper <= 1e-6


def test_limits_hold_where_no_relative_gap_is_small():
    """Next to an optimum of zero trials go deep: portions must stay short."""
    n, rng = 20, np.random.default_rng(0)
    t, o = rng.dirichlet(np.ones(n), size=(2, n)), rng.dirichlet(np.ones(2), size=(2, n))
    problem = textbook_problem(t, o, np.stack([np.zeros(n), -rng.random(n) - 0.1]), 0.9)
    solution = bounded(solve(problem, 1e-3, time_limit=0.5))
    assert solution.gap <= 1e-9 * problem.span
    assert solution.seconds < 5


def test_what_looks_alike_cannot_be_told_apart():
    """Two branches to one mode with one observation: nothing is seen, and guessing is worth nothing."""
    halves = [csr([[1.0, 0], [0, 0]]), csr([[0, 0], [0, 1.0]])]
    offered = [
        tuple(Choice(name, np.array([sign, -sign]), branches) for name, sign in (("left", 1.0), ("right", -1.0)))
        for branches in (
            tuple(Branch(0, half, (0,)) for half in halves),
            (Branch(0, csr(np.eye(2)), (0, 0), csr(np.eye(2))),),
        )
    ]
    for choices in offered:
        problem = Problem(("m",), (("a", "b"),), (choices,), ("none",), (np.array([0.5, 0.5]),), 0.9)
        solution = bounded(solve(problem, 1e-6, relative=False))
        assert solution.status == "converged"
        assert solution.lower == pytest.approx(0, abs=1e-6)
        assert problem.outcomes(0, 0, np.array([0.5, 0.5]))[0][2] == pytest.approx(1)


@pytest.mark.parametrize("search", ["grid", "trials"])
def test_a_mode_that_is_never_reached(search, monkeypatch):
    from models.planning import solver

    if search == "trials":
        monkeypatch.setattr(solver, "GRID_STATES", 0)
    problem = modal_problem(4, (2, 2))
    unreached = Choice("a", np.array([1000.0, -1000.0]), (Branch(2, csr(np.eye(2)), (0,)),))
    wider = Problem(
        (*problem.modes, "away"), (*problem.states, ("s0", "s1")), (*problem.choices, (unreached,)),
        problem.observations, (*problem.initial, np.zeros(2)), problem.discount,
    )  # fmt: skip
    one = bounded(solve(problem, 1e-3, time_limit=5))
    other = bounded(solve(wider, 1e-3, time_limit=5))
    assert other.status == "converged"
    assert {p.method for p in other.trace} == {search}
    assert one.lower <= other.upper + 1e-9
    assert other.lower <= one.upper + 1e-9
    assert other.policy.value(np.array([1.0, 0.0]), "away") <= 1000 / (1 - problem.discount) + 1e-6


@pytest.mark.parametrize("search", ["grid", "trials"])
def test_a_mode_that_first_looks_useless(search, monkeypatch):
    """Guessing a coin that is never seen looks best to who knows the coin; the tiger next door is worth more."""
    from models.planning import solver

    if search == "trials":
        monkeypatch.setattr(solver, "GRID_STATES", 0)
    even, stays = csr(np.full((2, 2), 0.5)), csr(np.eye(2))
    hint = csr([[0.05, 0, 0.95], [0, 0.05, 0.95]])
    room = tiger()
    guess = [
        Choice(f"guess{k}", np.array([11.0, -11.0])[[k, 1 - k]], (Branch(0, even, (1, 2, 0), hint),))
        for k in (0, 1)
    ]
    go = Choice("go", np.zeros(2), (Branch(1, stays, (0,)),))
    doors = tuple(
        Choice(c.action, c.reward, (Branch(1, c.branches[0].transition, (1, 2), c.branches[0].emission),))
        for c in room.choices[0]
    )
    problem = Problem(
        ("coin", "room"), (("l", "r"),) * 2, ((*guess, go), doors), ("none", "left", "right"),
        (np.array([0.5, 0.5]), np.zeros(2)), 0.95,
    )  # fmt: skip
    solution = bounded(solve(problem, 1e-3, time_limit=10))
    assert solution.status == "converged"
    assert solution.lower - 1e-6 <= 0.95 * 19.3714 <= solution.upper + 1e-4


def test_impossible_observations():
    """Columns of zeros, and outcomes that no state shows."""
    problem = dense_problem(2, 4, 3, 2)
    branches = [c.branches[0] for c in problem.choices[0]]
    reward = np.stack([c.reward for c in problem.choices[0]])
    never = [np.column_stack([np.zeros(4), b.emission.toarray(), np.zeros(4)]) for b in branches]
    wider = textbook_problem([b.transition for b in branches], never, reward, 0.9, problem.initial[0])
    one, other = solve(problem, 1e-4, time_limit=5), bounded(solve(wider, 1e-4, time_limit=5))
    assert other.status == "converged"
    assert one.lower <= other.upper + 1e-9
    assert other.lower <= one.upper + 1e-9


def test_beliefs_that_rule_states_out():
    """Starts at corners and on faces: outcomes there are impossible that are possible elsewhere."""
    base = modal_problem(3, (4, 1, 3, 2))
    for y in range(3):
        start = [np.zeros(len(s)) for s in base.states]
        start[2][y] = 1.0
        solution = bounded(solve(base.started(start), 1e-3, time_limit=5))
        low, high = reference.tree_interval(solution.problem, 4)
        assert solution.status == "converged"
        assert solution.lower <= high + 1e-9
        assert solution.upper >= low - 1e-9


@pytest.mark.parametrize("weight", [1e-3, 1e-8])
def test_a_start_that_is_hardly_ever_met(weight):
    """Its bounds count for little, but the policy must know what to do there."""
    base = modal_problem(2, (2, 2))
    start = [np.array([0.3, 0.7]) * (1 - weight), np.array([0.6, 0.4]) * weight]
    solution = bounded(solve(base.started(start), 1e-4, time_limit=5))
    assert solution.status == "converged"
    low, high = reference.line_interval(solution.problem)
    assert solution.lower <= high + 1e-9
    assert solution.upper >= low - 1e-9
    assert set(solution.mode) == {0, 1}


def machine():
    """It breaks down unseen: run it (1 if it works), or mend it (costs 2)."""
    run, mend = np.array([[0.9, 0.1], [0, 1]]), np.array([[1.0, 0], [1, 0]])
    seen = np.array([[0.8, 0.2], [0.2, 0.8]])
    return textbook_problem([run, mend], [seen, seen], [[1.0, 0.0], [-2.0, -2.0]], 0.999, [1, 0])


@cache
def worth_of_the_machine():
    return reference.line_interval(machine(), 51, 7000)


@pytest.mark.parametrize("search", ["grid", "trials"])
def test_high_discount(search, monkeypatch):
    from models.planning import solver

    if search == "trials":
        monkeypatch.setattr(solver, "GRID_STATES", 0)
    solution = bounded(solve(machine(), 1e-3, time_limit=2))
    low, high = worth_of_the_machine()
    assert solution.lower <= high
    assert solution.upper >= low
    assert solution.gap < 0.05 * solution.upper
    if search == "grid":
        assert solution.status == "converged"


def test_no_discount_at_all_looks_one_step_ahead():
    for problem in (
        dense_problem(4, 3, discount=0.0),
        latent_case(1, discount=0.0),
        sparse_problem(1, 20, discount=0.0),
    ):
        solution = bounded(solve(problem, 1e-6, time_limit=5))
        exact = sum(
            max(float(joint @ c.reward) for c in offered)
            for joint, offered in zip(problem.initial, problem.choices, strict=True)
        )
        assert solution.status == "converged"
        assert solution.lower == pytest.approx(exact, rel=1e-6)
        assert solution.upper == pytest.approx(exact, rel=1e-6)
