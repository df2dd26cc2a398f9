"""Canonical state order for many draws at once, and when relabelling is allowed.

Free labels, then sorting each draw, is exact while the prior does not tell states apart. The sorting key's
marginals are then those of order statistics, and all other entries go along with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from models.labels import canonical_order
from models.parameters import Array


def relabel_draws(
    initial: Array, transition: Array, emission: Array, scores: Sequence[float], weights: Array
) -> tuple[Array, Array, Array]:
    """Put every draw into canonical order.

    Parameters
    ----------
    initial : float64[..., s]
    transition : float64[..., a, s, s']
    emission : float64[..., e, s, o]
    scores, weights
        As in `models.labels.canonical_order`.
    """
    order = canonical_order(emission, scores, weights)
    rows = order[..., None, :, None]
    transition = np.take_along_axis(transition, rows, axis=-2)
    return (
        np.take_along_axis(initial, order, axis=-1),
        np.take_along_axis(transition, order[..., None, None, :], axis=-1),
        np.take_along_axis(emission, rows, axis=-2),
    )


def exchangeable(pins: Mapping[str, Array]) -> bool:
    """Whether held tables treat all states alike: every permutation of states leaves them as they are."""
    for table in pins.values():
        off = table[~np.eye(len(table), dtype=bool)]
        if np.ptp(np.diag(table)) > 0 or (len(off) and np.ptp(off) > 0):
            return False
    return True


def exchangeable_prior(initial: Array, transition: Array, emission: Array) -> bool:
    """Whether the Dirichlet parameters of a prior treat all states alike.

    Parameters
    ----------
    initial : float64[s]
    transition : float64[a, s, s']
    emission : float64[e, s, o]
    """
    rows_alike = np.ptp(initial) == 0 and np.all(np.ptp(emission, axis=1) == 0)
    return bool(rows_alike) and exchangeable({str(a): table for a, table in enumerate(transition)})
