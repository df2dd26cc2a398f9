"""Offsets in formulas, as lme4 spells them: ``y ~ x + offset(log(exposure)) + (1|g)``.

The formula engines know no offsets, so that they are taken out of the formula and computed from the columns.
Because they can be computed for new rows too, predictions of such a model need no offset beside them.
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
import pandas as pd

from models.errors import InputError, Phrase, located
from models.glmm_data import Array

_OFFSET = re.compile(r"(?<![\w.])offset\s*\(")

FUNCTIONS = {
    "np": np,
    "numpy": np,
    "log": np.log,
    "log2": np.log2,
    "log10": np.log10,
    "exp": np.exp,
    "sqrt": np.sqrt,
}
"""What an offset may use beside columns: numpy, and R's names of the functions of which offsets are made."""


def split_offset(formula: str) -> tuple[str, str | None]:
    """Take the offsets out of a formula; several are added up.

    Returns
    -------
    formula : str
    offset : str or None
        Of columns.

    Raises
    ------
    InputError
        For an offset that is not a term of its own, or has no end.

    Examples
    --------
    >>> split_offset("y ~ x + offset(log(n))")
    ('y ~ x', 'log(n)')
    >>> split_offset("y ~ offset(a) + x + offset(b)")
    ('y ~ x', '(a) + (b)')
    >>> split_offset("y ~ offset(a)")
    ('y ~ 1', 'a')
    """
    left, _, right = formula.partition("~")
    found: list[str] = []
    while (start := _OFFSET.search(right)) is not None:
        depth, end = 1, start.end()
        while end < len(right) and depth:
            depth += (right[end] == "(") - (right[end] == ")")
            end += 1
        before, after = right[: start.start()].rstrip(), right[end:].lstrip()
        if depth or (before and before[-1] not in "+") or (after and after[0] not in "+-"):
            raise located(f"formula {formula!r}", Phrase("an offset within another term"), "+ offset(...)")
        found.append(right[start.end() : end - 1].strip())
        right = f"{before.removesuffix('+').rstrip()} {after}".strip().removeprefix("+").strip()
    if not found:
        return formula, None
    offset = found[0] if len(found) == 1 else " + ".join(f"({part})" for part in found)
    return f"{left.strip()} ~ {right or '1'}", offset


def offset_values(offset: str, data: pd.DataFrame) -> Array:
    """The offset of every row, NaN where a column has a gap.

    Raises
    ------
    InputError
        For what is no column, or gives no numbers.
    """
    place = f"offset({offset})"
    names = {str(column): data[column] for column in data.columns if data[column].ndim == 1}
    try:
        with np.errstate(all="ignore"):
            values = eval(offset, {**FUNCTIONS, "Q": data.__getitem__}, names)
            if isinstance(values, pd.Series):
                if pd.api.types.is_datetime64_any_dtype(values.dtype):
                    raise TypeError("dates are no numbers")
                values = values.to_numpy(float, na_value=np.nan)
            values = np.asarray(values, float)
    except NameError as error:
        if error.name == "I" and "I" not in names:
            raise located(place, "I", "the expression itself: an offset needs no I()") from None
        raise located(place, error.name, f"one of the columns {', '.join(names)}") from None
    except Exception as error:  # whatever the columns' values do to the expression
        if isinstance(error, TypeError) and "^" in offset:
            raise located(place, "^", "**, for a power") from None
        raise located(place, Phrase(f"{type(error).__name__}: {error}"), "numbers, one a row") from None
    if values.ndim == 0:
        values = np.full(len(data), float(values))
    if values.shape != (len(data),):
        raise located(place, Phrase(f"shape {values.shape}"), f"one number for each of the {len(data)} rows")
    return values


def offset_of_rows(model: Any, rows: pd.DataFrame | None, has_offset: bool) -> Array | None:
    """The offset of new rows where none is given: that of the formula; None for a model without.

    Raises
    ------
    InputError
        Where the model has an offset that is not in its formula: 0 would be a guess.
    """
    if model.offset_term is not None and rows is not None:
        try:
            return offset_values(model.offset_term, rows)
        except InputError as error:
            raise InputError(f"exog, {error} (or offset=...)") from None
    if has_offset:
        raise located("offset", Phrase("none"), "that of the new rows (0 for none): the model has an offset")
    return None
