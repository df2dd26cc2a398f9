"""The grid on the simplex: every interpolation is a mixture of grid points that gives the belief back."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from models.planning.simplex_grid import FINEST, cell, find, interpolation, new_scratch, point_belief, rehash
from tests.reference.planning_numpy import freudenthal


def vertices_of(belief, level):
    """Coordinates at the finest level and weights, through `cell`."""
    n = len(belief)
    base, order, part = np.zeros(n, np.int64), np.zeros(n, np.int64), np.zeros(n)
    more = cell(np.asarray(belief, float), n, level, base, part, order)
    heights = [1.0, *part[:more], 0.0]
    out, vertex = [], base.copy()
    for k in range(more + 1):
        if k:
            vertex[order[k - 1]] += 1
        out.append((vertex << (FINEST - level), heights[k] - heights[k + 1]))
    return out


def belief_of(coordinates):
    out = np.zeros(len(coordinates))
    point_belief(np.asarray(coordinates, np.int64), len(coordinates), out)
    return out


@st.composite
def beliefs(draw):
    """Beliefs inside, on faces and corners, and with coordinates that tie."""
    n = draw(st.integers(1, 6))
    kind = draw(st.sampled_from(["whole", "real", "tiny"]))
    if kind == "whole":
        parts = np.array(draw(st.lists(st.integers(0, 4), min_size=n, max_size=n).filter(any)), float)
    elif kind == "real":
        parts = np.array(draw(st.lists(st.floats(0.0, 1.0), min_size=n, max_size=n).filter(lambda v: sum(v) > 0.1)))
    else:
        parts = 10.0 ** -np.array(draw(st.lists(st.integers(0, 14), min_size=n, max_size=n)), float)
    return parts / parts.sum()


@given(beliefs(), st.integers(0, 12))
@example(np.array([0.25, 0.25, 0.25, 0.25]), 1)
@example(np.array([1e-13, 1 - 2e-13, 1e-13]), 10)
@example(np.array([1 / 3, 1 / 3, 1 / 3]), 0)
def test_mixture_of_grid_points_gives_the_belief_back(belief, level):
    found = vertices_of(belief, level)
    weights = np.array([w for _, w in found])
    assert (weights >= 0).all()
    assert weights.sum() == pytest.approx(1, abs=1e-14)
    points = np.array([belief_of(v) for v, _ in found])
    assert (points >= 0).all()
    np.testing.assert_array_equal(points.sum(axis=1), 1)
    np.testing.assert_array_equal(points * 2**level, np.round(points * 2**level))
    np.testing.assert_allclose(weights @ points, belief, atol=3e-11)
    # All vertices lie in one cell: no coordinate differs by more than one cell.
    spread = np.ptp(np.array([v for v, _ in found]), axis=0)
    assert spread.max(initial=0) <= 1 << (FINEST - level)
    # No weight on states the belief rules out.
    assert points[weights > 0][:, belief == 0].max(initial=0) == 0


@given(beliefs(), st.integers(0, 6))
def test_is_freudenthals_triangulation(belief, level):
    theirs = sorted((tuple(v.round(12)), w) for v, w in freudenthal(belief, 2**level) if w > 1e-7)
    ours = sorted((tuple(belief_of(v).round(12)), w) for v, w in vertices_of(belief, level) if w > 1e-7)
    assert [v for v, _ in ours] == [v for v, _ in theirs]
    np.testing.assert_allclose([w for _, w in ours], [w for _, w in theirs], atol=2e-6)


@given(st.integers(2, 5), st.integers(0, 5), st.integers(0, 2**32 - 1))
def test_levels_are_nested(n, level, seed):
    """A finer cell lies within one coarser cell: its vertices share the coarser cell's vertices."""
    belief = np.random.default_rng(seed).dirichlet(np.ones(n))
    coarse = {tuple(v) for v, _ in vertices_of(belief, level)}
    for vertex, _ in vertices_of(belief, level + 1):
        assert {tuple(v) for v, w in vertices_of(belief_of(vertex), level) if w > 0} <= coarse


def test_a_grid_point_is_its_own_vertex():
    for level in range(5):
        for parts in np.ndindex(3, 3, 3):
            if sum(parts) == 4:
                belief = np.array([*parts]) / 4
                found = vertices_of(belief, level + 2)
                assert len(found) == 1
                np.testing.assert_array_equal(belief_of(found[0][0]), belief)


def test_interpolation_needs_every_vertex_and_tells_modes_apart():
    belief, level, n = np.array([0.5, 0.3, 0.2]), 2, 3
    cells = [v for v, _ in vertices_of(belief, level)]
    points = np.array([*cells, *cells])
    mode = np.repeat([0, 1], len(cells))
    sizes = np.array([3, 3])
    scratch = new_scratch(n)
    for missing in range(len(cells)):
        table = np.full(32, -1, dtype=np.int32)
        held = points.copy()
        held[missing, 0] = 0  # as roots are: in no table
        rehash(table, held, mode, sizes, len(held))
        assert interpolation(table, held, mode, belief, n, 0, level, scratch) == 0
        count = interpolation(table, held, mode, belief, n, 1, level, scratch)
        assert (mode[scratch.vertices[:count]] == 1).all()
        mixture = scratch.weights[:count] @ [belief_of(points[i]) for i in scratch.vertices[:count]]
        np.testing.assert_allclose(mixture, belief, atol=1e-12)
        assert find(table, held, mode, cells[missing], n, 0) < 0


@pytest.mark.parametrize("n", [2, 3, 5])
def test_no_convex_function_exceeds_its_interpolation(n):
    rng = np.random.default_rng(n)
    planes = rng.normal(size=(6, n))
    for _ in range(200):
        belief = rng.dirichlet(np.full(n, 0.5))
        finer = np.inf
        for level in range(6):
            value = sum(w * (planes @ belief_of(v)).max() for v, w in vertices_of(belief, level))
            assert value >= (planes @ belief).max() - 1e-10
            finer = min(finer, value)
        assert finer - (planes @ belief).max() < 0.2
