"""An observed part found in problems that declare none: the same values, and policies for the problem as given."""

import numpy as np
import pytest

from models.planning import solver
from models.planning.formats.end_state import flat
from models.planning.observed_part import observed_part
from models.planning.problem import Problem
from models.planning.problems import problem as standard_problem
from models.planning.solver import solve
from models.planning.textbook import textbook_problem
from tests.planning_cases import CASES, dense_problem, latent_case, modal_problem
from tests.reference import planning_numpy as reference


def from_one_mode(problem: Problem) -> Problem:
    x, _, belief = next(problem.starts())
    start = [np.zeros(len(s)) for s in problem.states]
    start[x] = belief
    return problem.started(start)


def test_tag_again():
    """Folded into one mode, the robot's cell is found again; the start alone is not told."""
    whole = flat(standard_problem("tag"), hide_start=True)
    part = observed_part(whole)
    assert part.problem.modes[-1] == "start"
    # Where both are in one cell it is seen too; the cell alone is 29 blocks.
    assert part.problem.n_modes - 1 >= 29
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

    assert reference.tree_value(part.problem, 4, leaf) == pytest.approx(
        reference.tree_value(whole, 4, leaf), rel=1e-12
    )


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


def test_nothing_to_be_found():
    assert observed_part(dense_problem(1, 6)) is None
    assert observed_part(standard_problem("tiger")) is None
    # Everything observed: one state a block, and a start that is known needs no mode of its own.
    t = np.random.default_rng(0).dirichlet(np.ones(5), size=(2, 5))
    seen = observed_part(textbook_problem(t, [np.eye(5)] * 2, np.zeros((2, 5)), 0.9, [0, 0, 1.0, 0, 0]))
    assert seen.problem.n_modes == 5
    assert seen.problem.n_states == 1


def test_states_that_are_never_reached_join_nothing():
    """What they would show cannot be seen."""
    t = np.zeros((1, 6, 6))
    t[0, :, :4] = np.random.default_rng(1).dirichlet(np.ones(4), size=6)
    shown = np.array([[1.0, 0], [1, 0], [0, 1], [0, 1], [0.5, 0.5], [0.5, 0.5]])
    part = observed_part(textbook_problem(t, [shown], np.zeros((1, 6)), 0.9, [1.0, 0, 0, 0, 0, 0]))
    assert sorted(map(len, part.members)) == [1, 1, 2, 2]
