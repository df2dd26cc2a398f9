"""Draws solved from more beliefs: sound everywhere, as good as a solution started there."""

from dataclasses import replace

import numpy as np
import pytest

from models.errors import InputError
from models.planning.batch import solve_draws
from models.planning.latent import LatentBatch
from models.robust.belief_stability import draw_action_values
from models.robust.controller_values import value_matrix
from models.robust.controllers import of_graph, own_controllers
from models.robust.wider_solution import widened
from tests.models.robust.endless_cases import solved


@pytest.fixture(scope="module")
def wide():
    return widened(solved())


def test_bounds_of_the_start_remain(wide):
    s = solved()
    np.testing.assert_array_equal(wide.lower, s.lower)
    np.testing.assert_array_equal(wide.upper, s.upper)
    own = own_controllers(wide)
    values = value_matrix(s.batch, own.controllers).values[own.which, np.arange(24)]
    assert np.all(values >= s.lower - 1e-9)
    assert np.all(values <= s.upper + 1e-6)


def test_nowhere_worse_and_certified_in_the_corners(wide):
    s = solved()
    corners = np.eye(3)
    for mode in (0, 1):
        before, after = draw_action_values(s, corners, mode), draw_action_values(wide, corners, mode)
        assert np.all(after >= before - 1e-9)
    for y in range(3):
        start = replace(s.batch.draws, initial=np.tile(corners[y], (24, 1)))
        there = solve_draws(LatentBatch(start, s.batch.process, 0.9), 1e-4)
        best = draw_action_values(wide, corners[[y]], 0)[:, 0].max(axis=1)
        assert np.all(best <= there.upper + 1e-9 * np.abs(there.upper))
        # The gap of the two modes' mean, asked for in the corner, is at most twice as large in one mode.
        assert np.all(best >= there.lower - 2e-3 * np.maximum(np.abs(there.upper), 60.0))


def test_every_vector_is_a_lower_bound_of_its_node(wide):
    """The joined graph is one: from any of its nodes the controller is worth what the vector says."""
    batch = wide.batch
    for d in range(0, 24, 9):
        one = wide.solutions[d]
        for node in range(len(one.alpha)):
            start = np.full(2, -1)
            start[one.mode[node]] = node
            process = replace(batch.process, start=np.eye(2)[one.mode[node]])
            graph = of_graph(batch.template, one.mode, one.choice, one.follow, start)
            for y in range(3):
                draws = replace(batch.draws, initial=np.tile(np.eye(3)[y], (24, 1)))
                value = value_matrix(LatentBatch(draws, process, batch.discount), [graph]).values[0, d]
                assert value >= one.alpha[node, y] - 1e-9 * max(1, abs(value))


def test_chosen_beliefs_and_progress():
    s = solved(3)
    seen = []
    wide = widened(s, np.array([[0.2, 0.3, 0.5]]), progress=lambda done, total: seen.append((done, total)))
    assert seen[-1] == (3, 3)
    assert all(len(w.alpha) > len(o.alpha) for w, o in zip(wide.solutions, s.solutions, strict=True))
    with pytest.raises(InputError, match="belief 0"):
        widened(s, np.array([[0.2, 0.3, 0.6]]))
