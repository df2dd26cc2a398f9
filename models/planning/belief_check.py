"""What a belief is: a probability vector over the hidden states of a mode."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import located

TOLERANCE = 1e-9
"""How far a belief's sum may be from one."""


def checked_belief(belief: Any, mode: str, n: int) -> NDArray[np.float64]:
    """Return a belief over the `n` hidden states of a mode as an array.

    Raises
    ------
    InputError
        If its length does not fit, or it is no probability vector (sum within `TOLERANCE`).
    """
    value = np.asarray(belief, dtype=np.float64)
    place = f"belief in mode {mode}"
    if value.shape != (n,):
        raise located(f"{place}, shape", value.shape, f"({n},)")
    if not (np.isfinite(value).all() and (value >= 0).all()):
        raise located(place, [float(v) for v in value], "probabilities between 0 and 1")
    if abs(value.sum() - 1) > TOLERANCE:
        raise located(f"{place}, sum", f"{value.sum():.10g}", "1 within 1e-9")
    return value
