"""Bounds and a policy without any compiled code, for who does not wait for it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.planning.arrays import Array, Index, ProblemArrays


def at_once(arrays: ProblemArrays) -> tuple[float, float, tuple[Array, Index, Index, NDArray[np.int32]]]:
    r"""Bounds of the value of any belief, and a policy graph that is worth the lower one.

    The policy takes in every mode the choice whose worst reward is best, so it earns at least the least of these,
    for ever: :math:`\min_x \max_c \min_y R_c(y) / (1 - \gamma)`. Nothing is worth more than the highest reward.

    Returns
    -------
    lower, upper : float
    alpha, mode, choice, follow : float64[x, w], int64[x], int64[x], int32[x, z]
        One vector a mode, as in `models.planning.solution.Solution`.
    """
    n_modes = len(arrays.mode_size)
    alpha = np.zeros((n_modes, arrays.reward.shape[1]))
    choice = np.zeros(n_modes, dtype=np.int64)
    follow = np.zeros((n_modes, int(np.diff(arrays.choice_outcome).max())), dtype=np.int32)
    sure, highest = np.inf, -np.inf
    for x, size in enumerate(arrays.mode_size):
        begin, end = arrays.mode_choice[x : x + 2]
        paid = arrays.reward[begin:end, :size]
        choice[x] = np.argmax(paid.min(axis=1))
        sure, highest = min(sure, paid[choice[x]].min()), max(highest, paid.max())
        c = begin + choice[x]
        after = arrays.outcome_mode[arrays.choice_outcome[c] : arrays.choice_outcome[c + 1]]
        follow[x, : len(after)] = after
    lower = float(sure) / (1 - arrays.discount)
    for x, size in enumerate(arrays.mode_size):
        alpha[x, :size] = lower
    return lower, float(highest) / (1 - arrays.discount), (alpha, np.arange(n_modes), choice, follow)
