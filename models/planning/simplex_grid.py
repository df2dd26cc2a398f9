r"""A grid on the belief simplex that is fine only where it has to be.

A belief over `n` states has the coordinates :math:`x_i = M \sum_{j \ge i} b_j` (Lovejoy 1991). Freudenthal's
triangulation of the points with integer coordinates cuts the simplex into cells of `n` vertices; with `d` the
fractions of `x` in descending order, :math:`b` is the mixture of the vertices :math:`v, v + e_{p_1}, \dots` with
weights :math:`1 - d_{p_1}, d_{p_1} - d_{p_2}, \dots`. The levels :math:`M = 2^\ell` are nested, so cells can be
refined one by one: a belief is interpolated in the finest cell whose vertices are all there. A convex function
never exceeds such an interpolation, whatever the cell: every set of vertices gives a sound upper bound.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel

Array = NDArray[np.float64]
Index = NDArray[np.int64]

FINEST = 20
"""Coordinates are whole numbers at the level :math:`M = 2^{20}`, finer than any cell that matters."""

SNAP = 2e-15
"""Sums of probabilities nearer than this to a coordinate of the grid are taken for it: no more than rounding, as
every bit of it moves the belief that is bounded."""


class Scratch(NamedTuple):
    """Room to work out one interpolation in; every array has the width of a belief."""

    base: Index
    corner: Index
    order: Index
    fraction: Array
    vertices: NDArray[np.int32]
    weights: Array
    reached: Array


@kernel
def new_scratch(width: int) -> Scratch:
    """Scratch for beliefs of that width."""
    return Scratch(
        np.empty(width, dtype=np.int64), np.empty(width, dtype=np.int64), np.empty(width, dtype=np.int64),
        np.empty(width), np.empty(width, dtype=np.int32), np.empty(width), np.empty(width),
    )  # fmt: skip


@kernel
def cell(belief: Array, n: int, level: int, base: Index, fraction: Array, order: Index) -> int:
    """Cell of a belief: its base vertex, and the coordinates in the order in which the other vertices add them.

    Parameters
    ----------
    belief : float64[n]
    n, level : int
    base : int64[n]
        Filled: whole part of the coordinates, ``base[0]`` being `M`.
    fraction : float64[n]
        Filled: fractions in descending order, ``fraction[0]`` belonging to ``order[0]``.
    order : int64[n]
        Filled.

    Returns
    -------
    int
        How many fractions are above zero: the cell has that many vertices beside the base.
    """
    scale = float(1 << level)
    base[0] = 1 << level
    rest = 0.0
    found = 0
    for i in range(n - 1, 0, -1):
        rest += belief[i]
        x = min(rest, 1.0) * scale
        whole = int(np.floor(x))
        part = x - whole
        tolerance = SNAP * scale
        if part > 1.0 - tolerance:
            whole += 1
            part = 0.0
        elif part < tolerance:
            part = 0.0
        base[i] = whole
        if part > 0.0:
            place = found
            # Ties: lowest index first, or a vertex would not be descending. Indices come in falling order.
            while place > 0 and fraction[place - 1] <= part:
                fraction[place] = fraction[place - 1]
                order[place] = order[place - 1]
                place -= 1
            fraction[place] = part
            order[place] = i
            found += 1
    return found


@kernel
def point_belief(coordinates: Index, n: int, belief: Array) -> None:
    """Belief of a grid point from its coordinates at the finest level."""
    scale = 1.0 / float(1 << FINEST)
    for i in range(n):
        below = coordinates[i + 1] if i + 1 < n else 0
        belief[i] = (coordinates[i] - below) * scale


@kernel
def _slot(coordinates: Index, n: int, mode: int, size: int) -> int:
    """First place of a point in a hash table whose size is a power of two (FNV-1a over the coordinates)."""
    code = np.uint64(14695981039346656037)
    prime = np.uint64(1099511628211)
    code = (code ^ np.uint64(mode)) * prime
    for i in range(1, n):
        code = (code ^ np.uint64(coordinates[i])) * prime
        code ^= code >> np.uint64(29)
    return np.int64(code & np.uint64(size - 1))  # type: ignore[return-value]


@kernel
def find(table: NDArray[np.int32], points: Index, point_mode: Index, coordinates: Index, n: int, mode: int) -> int:
    """Number of a grid point, or ``-1 - slot`` of the free place where it would go.

    Parameters
    ----------
    table : int32[h]
        Hash table of point numbers, -1 where free; `h` a power of two.
    points : int64[i, w]
        Coordinates of every point at the finest level.
    point_mode : int64[i]
    coordinates : int64[n]
    n, mode : int
    """
    size = len(table)
    slot = _slot(coordinates, n, mode, size)
    while True:
        i = table[slot]
        if i < 0:
            return -1 - slot
        if point_mode[i] == mode:
            same = True
            for j in range(1, n):
                if points[i, j] != coordinates[j]:
                    same = False
                    break
            if same:
                return i
        slot = (slot + 1) & (size - 1)


@kernel
def interpolation(
    table: NDArray[np.int32], points: Index, point_mode: Index, belief: Array, n: int, mode: int, level: int,
    scratch: Scratch,
) -> int:  # fmt: skip
    """Vertices and weights of a belief at one level, if the grid has all of them.

    Parameters
    ----------
    table, points, point_mode
        The grid, as for `find`.
    belief : float64[n]
    n, mode, level : int
    scratch : Scratch
        `vertices` and `weights` are filled.

    Returns
    -------
    int
        Number of vertices with a weight, 0 if one of them is missing.
    """
    corner, fraction = scratch.corner, scratch.fraction
    more = cell(belief, n, level, scratch.base, fraction, scratch.order)
    shift = FINEST - level
    for i in range(n):
        corner[i] = scratch.base[i] << shift
    count = 0
    last = 1.0
    for k in range(more + 1):
        if k > 0:
            corner[scratch.order[k - 1]] += 1 << shift
            last = fraction[k - 1]
        weight = last - (fraction[k] if k < more else 0.0)
        if weight > 0.0:
            i = find(table, points, point_mode, corner, n, mode)
            if i < 0:
                return 0
            scratch.vertices[count] = i
            scratch.weights[count] = weight
            count += 1
    return count


@kernel
def rehash(table: NDArray[np.int32], points: Index, point_mode: Index, mode_size: Index, count: int) -> None:
    """Fill an empty hash table with the points there are."""
    for i in range(count):
        if points[i, 0] > 0:
            mode = point_mode[i]
            free = find(table, points, point_mode, points[i], mode_size[mode], mode)
            table[-1 - free] = i
