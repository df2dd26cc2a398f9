"""Rows and columns that a formula cannot use, said before or after an engine has read it.

Engines drop every row in which a term is no number, whether the value was missing or the term made it so, as a
logarithm does of negative numbers; the difference matters to whoever reads how many rows are left.
"""

from __future__ import annotations

import re
from importlib import import_module
from typing import Any

import numpy as np
import pandas as pd

from models.errors import InputError, Phrase, located
from models.glmm_table import is_used
from models.quiet import without_warnings

FEW = 0.5
"""Share of values that are no numbers from which a column counts as text."""

_LENGTHS = re.compile(r"Number of rows mismatch between data argument and (.+) \((\d+) versus (\d+)\)")


def check_columns(formula: str, data: pd.DataFrame, missing: str) -> None:
    """Refuse dates as numbers, text among numbers, and gaps where `missing` is "raise".

    One slip of the pen among numbers would make a category of them, with a coefficient for each of its values.

    Raises
    ------
    InputError
    """
    bare = _without_calls(formula)
    for name in data.columns:
        if not is_used(name, formula):
            continue
        column = data[name]
        if is_used(name, bare) and pd.api.types.is_datetime64_any_dtype(column.dtype):
            wanted = f"numbers, such as days since the first; C({name}) for a category of every date"
            raise located(f"data, column {name!r}", Phrase("dates"), wanted)
        if is_used(name, bare):
            _check_kind(name, column)
        if missing == "raise" and column.isna().any():
            row = int(np.argmax(column.isna().to_numpy()))
            wanted = "none; missing='drop' leaves such rows out"
            raise located(f"data, row {row + 1}, column {name!r}", Phrase("a missing value"), wanted)


def _check_kind(name: Any, column: pd.Series) -> None:
    """Refuse a column in which most values are numbers, and some text."""
    if isinstance(column.dtype, pd.CategoricalDtype) or not (
        column.dtype == object or pd.api.types.is_string_dtype(column.dtype)
    ):
        return
    known = column.notna().to_numpy()
    values = column.astype(object).to_numpy()
    text = np.array([isinstance(value, str) for value in values]) & known
    bad = text & pd.to_numeric(pd.Series(values), errors="coerce").isna().to_numpy()
    if bad.any() and bad.sum() < FEW * known.sum():
        row = int(np.argmax(bad))
        wanted = f"a number, as in {known.sum() - bad.sum()} of {known.sum()} rows; C({name}) for a category"
        raise located(f"data, row {row + 1}, column {name!r}", values[row], wanted)


def _without_calls(formula: str) -> str:
    """A formula without what stands in functions.

    Examples
    --------
    >>> _without_calls("y ~ C(d) + (e + np.log(f)):g")
    'y ~  + (e + ):g'
    """
    out, depth = "", 0
    for part in re.split(r"([\w.]*\w\s*\(|[()])", formula):
        if depth or re.fullmatch(r"[\w.]*\w\s*\(", part):
            depth += part.endswith("(") - (part == ")")
        else:
            out += part
    return out


def terms_without_numbers(model: Any, formula: str, data: pd.DataFrame) -> dict[str, int]:
    """Rows dropped though all their values were there, by the first column of the design that is no number."""
    dropped = getattr(model.data, "missing_row_idx", None)
    if dropped is None or not len(dropped):
        return {}
    rows = data.iloc[np.asarray(dropped)]
    used = [name for name in data.columns if is_used(name, formula)]
    rows = rows[rows[used].notna().all(axis=1)]
    if rows.empty:
        return {}
    design = design_with_gaps(model.data.model_spec, rows)
    if design is None:
        return {formula: len(rows)}
    return first_gaps(design, formula.split("~")[0].strip())


def design_with_gaps(spec: Any, rows: pd.DataFrame) -> pd.DataFrame | None:
    """Design of rows with NaN where it is no number; None from an engine that cannot say."""
    try:
        with without_warnings(), np.errstate(all="ignore"):
            if hasattr(spec, "factor_infos"):
                patsy = import_module("patsy")
                return patsy.dmatrix(spec, rows, NA_action=patsy.NAAction(NA_types=[]), return_type="dataframe")
            return pd.DataFrame(spec.get_model_matrix(rows, na_action="ignore"))
    except Exception:  # engines raise what they like
        return None


def first_gaps(design: pd.DataFrame, otherwise: str) -> dict[str, int]:
    """Number of rows by the first column that is no number in them; by `otherwise` where all are numbers."""
    gaps = np.column_stack([design.isna().to_numpy(), np.ones(len(design), bool)])
    names = [*map(str, design.columns), otherwise]
    first, counts = np.unique(gaps.argmax(axis=1), return_counts=True)
    return {names[i]: int(count) for i, count in zip(first, counts, strict=True)}


def engine_error(formula: str, data: pd.DataFrame, error: Exception) -> InputError | None:
    """What engines say of a term of another length than the table, said plainly; None for anything else."""
    if (found := _LENGTHS.search(str(error))) is None:
        return None
    term, first, second = found.groups()
    other = second if int(first) == len(data) else first
    wanted = f"one for each of the {len(data)} rows"
    return located(f"formula {formula!r}, term {term}", Phrase(f"{other} values"), wanted)
