"""What a belief is: a probability vector over the hidden states of a mode; and what counts as impossible."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import located

TOLERANCE = 1e-9
"""How far from one the sum of a belief, or of a row of probabilities, may be."""

IMPOSSIBLE = 1e-12
"""An observation less probable than that cannot be told from one that is impossible."""


def checked_belief(belief: Any, mode: str, n: int) -> NDArray[np.float64]:
    """Return a belief over the `n` hidden states of a mode as an array.

    Raises
    ------
    InputError
        If it holds anything but numbers, its length does not fit, or it is no probability vector (sum within
        `TOLERANCE`).
    """
    place = f"belief in mode {mode}"
    value = real_array(place, belief, f"{n} probabilities")
    if value.shape != (n,):
        raise located(f"{place}, shape", value.shape, f"({n},)")
    if not (np.isfinite(value).all() and (value >= 0).all()):
        raise located(place, [float(v) for v in value], "probabilities between 0 and 1")
    if abs(value.sum() - 1) > TOLERANCE:
        raise located(f"{place}, sum", f"{value.sum():.10g}", "1 within 1e-9")
    return value


def real_array(place: str, values: Any, wanted: str) -> NDArray[np.float64]:
    """Return what somebody passed as numbers as an array of float64.

    Raises
    ------
    InputError
        If it holds text, complex numbers, objects, or lists of different lengths.
    """
    try:
        raw = np.asarray(values)
        if raw.dtype.kind in "biuf":
            return raw.astype(np.float64, copy=False)
    except (TypeError, ValueError, OverflowError):
        pass
    raise located(place, values, wanted)
