r"""Small systems :math:`(I - \gamma P)\, v = r` solved at once, where sweeping would take hundreds of rounds.

With alternating modes the chain under a policy has the eigenvalue :math:`-\gamma` beside :math:`\gamma`, so sweeps
close in by a twentieth each at best, whatever is done about the common part.
"""

from __future__ import annotations

from models.compiled import kernel
from models.planning.arrays import Array

LARGEST = 48
"""Unknowns up to which elimination beats sweeps."""

PATIENT = 400
"""Unknowns up to which elimination beats sweeps where the discount is near one."""


@kernel
def dense_limit(discount: float) -> int:
    """Unknowns up to which a system is solved at once; sweeps take in proportion to the horizon."""
    return PATIENT if discount > 0.99 else LARGEST


@kernel
def eliminate(matrix: Array, right: Array, n: int) -> None:
    r"""Solve the first `n` equations in place: `right` becomes the solution.

    No pivots are looked for: rows of :math:`I - \gamma P` are strictly dominated by their diagonal, for which
    elimination in order is stable (Higham 2002, theorem 9.9).
    """
    for k in range(n):
        inverse = 1.0 / matrix[k, k]
        for i in range(k + 1, n):
            factor = matrix[i, k] * inverse
            if factor != 0.0:
                for j in range(k + 1, n):
                    matrix[i, j] -= factor * matrix[k, j]
                right[i] -= factor * right[k]
    for k in range(n - 1, -1, -1):
        total = right[k]
        for j in range(k + 1, n):
            total -= matrix[k, j] * right[j]
        right[k] = total / matrix[k, k]
