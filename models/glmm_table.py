"""The tables that a mixed model is made from: their kind, columns and rows, brought to plain numbers."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd

from models.errors import Phrase, located
from models.glmm_formula import named_column, numeric_outcome, outcome_columns, select_rows, split_groups
from models.glmm_input import per_row
from models.glmm_offset import offset_values, split_offset


def read_table(
    formula: Any, data: Any, given: dict[str, Any], subset: Any, missing: str
) -> tuple[str, pd.DataFrame, dict[str, Any], int, str, str | None, dict[str, int]]:
    """What a formula and a table come to before any engine sees them.

    Parameters
    ----------
    given : dict
        ``groups``, and arrays beside the table: names, values, or one number for all rows.
    subset, missing
        As for `models.glmm.LogisticMixedModel.from_formula`.

    Returns
    -------
    formula : str
        Without the random intercept and the offset.
    data, arrays
        The rows to use, of the table and beside it.
    n_given : int
        Rows before any were left out for missing values.
    name : str
        Of the groups.
    offset : str or None
        The offset of the formula.
    lost : dict of str to int
        Rows left out in which the offset of the formula is no number though its columns have values.

    Raises
    ------
    InputError
    """
    if not isinstance(formula, str):
        raise located("formula", formula, "text: outcome ~ covariates + (1|group)")
    check_missing(missing, ("drop", "raise"))
    data = table_of(data)
    formula, groups = split_groups(formula, given["groups"])
    formula, offset = split_offset(outcome_columns(formula))
    check_columns_once(data, formula)
    data = plain_columns(data, formula)
    arrays: dict[str, Any] = {
        key: named_column(data, value, key) for key, value in (given | {"groups": groups}).items()
    }
    if offset is not None:
        if arrays["offset"] is not None:
            raise located("offset", Phrase(f"offset({offset}) in the formula as well"), "one of them")
        arrays["offset"] = offset_values(offset, data)
    for key, value in arrays.items():
        if key != "groups" and value is not None and np.ndim(value) == 0:
            arrays[key] = per_row(value, len(data), key)
    name = groups if isinstance(groups, str) else getattr(groups, "name", None) or "group"
    subset = check_subset(data, subset)
    lost = {} if offset is None else _lost(offset, arrays["offset"], data, subset)
    data, arrays, n_given = select_rows(numeric_outcome(formula, data), arrays, subset, missing == "drop")
    if n_given and not len(data):
        beside = " or ".join(key for key, value in arrays.items() if value is not None)
        raise located(
            "data", Phrase(f"a missing value in every one of {n_given} rows, of {beside}"), "rows without any"
        )
    return formula, data, arrays, n_given, str(name), offset, lost


def _lost(offset: str, values: Any, data: pd.DataFrame, subset: Any) -> dict[str, int]:
    """Rows in which an offset is no number though all its columns have values, by the offset."""
    used = [name for name in data.columns if is_used(name, offset)]
    gaps = pd.Series(np.isnan(values) & data[used].notna().all(axis=1).to_numpy(), index=data.index)
    number = int((gaps if subset is None else gaps.loc[subset]).sum())
    return {f"offset({offset})": number} if number else {}


def check_missing(missing: Any, allowed: Sequence[str]) -> None:
    """Refuse unknown ways to treat missing values.

    Raises
    ------
    InputError
    """
    if missing not in allowed:
        raise located("missing", missing, " or ".join(repr(name) for name in allowed))


def table_of(data: Any, place: str = "data") -> pd.DataFrame:
    """A table from a DataFrame, or from a dict of columns (of numbers, for one row).

    Raises
    ------
    InputError
        For anything else, and for columns of different lengths.
    """
    if isinstance(data, pd.DataFrame):
        return data
    if not isinstance(data, dict):
        raise located(place, Phrase(type(data).__name__), "a DataFrame, or a dict of columns")
    try:
        return pd.DataFrame(data if any(np.ndim(v) for v in data.values()) else {k: [v] for k, v in data.items()})
    except ValueError as error:
        raise located(place, Phrase(str(error)), "columns of one length") from None


def is_used(name: Any, formula: str) -> bool:
    """Whether a formula mentions a column."""
    return bool(re.search(rf"(?<!\w){re.escape(str(name))}(?!\w)", formula))


def check_columns_once(data: pd.DataFrame, formula: str) -> None:
    """Refuse columns of the formula that are there twice.

    Raises
    ------
    InputError
    """
    if data.columns.is_unique:
        return
    for name in data.columns[data.columns.duplicated()]:
        if is_used(name, formula):
            raise located(f"data, column {name!r}", Phrase(f"{(data.columns == name).sum()} columns"), "one")


def plain_columns(data: pd.DataFrame, formula: str) -> pd.DataFrame:
    """Columns of pandas' nullable types as plain numbers with NaN, which is all that formula engines know."""
    changed: dict[Any, Any] = {}
    for name, dtype in data.dtypes.items():
        if isinstance(dtype, (np.dtype, pd.CategoricalDtype)) or not is_used(name, formula):
            continue
        column = data[name]
        if pd.api.types.is_bool_dtype(dtype) and column.notna().all():
            changed[name] = column.to_numpy(bool)
        elif pd.api.types.is_numeric_dtype(dtype):
            changed[name] = column.to_numpy(float, na_value=np.nan)
    return data.assign(**changed) if changed else data


def check_subset(data: pd.DataFrame, subset: Any) -> Any:
    """Refuse subsets that ``data.loc`` cannot take.

    Raises
    ------
    InputError
    """
    if subset is None:
        return None
    try:
        chosen = pd.Series(np.arange(len(data)), index=data.index).loc[subset]
    except (KeyError, IndexError, TypeError, ValueError, pd.errors.IndexingError) as error:
        wanted = f"true or false for each of the {len(data)} rows, or labels of rows"
        raise located("subset", Phrase(str(error).splitlines()[0]), wanted) from None
    if np.ndim(chosen) == 0:
        raise located("subset", subset, "several rows")
    return subset


def check_rows_left(columns: Sequence[Any], n_given: int, table: pd.DataFrame | None = None) -> None:
    """Refuse data of which no row is complete, naming a column that is empty.

    Raises
    ------
    InputError
    """
    if n_given == 0:
        raise located("data", Phrase("no rows"), "rows")
    n_rows = n_given if table is None else len(table)
    whole = np.ones(n_rows, bool)
    for values in columns:
        if values is not None:
            gaps = np.asarray(pd.isna(np.asarray(values)), bool)
            whole &= ~(gaps if gaps.ndim == 1 else gaps.any(axis=1))
    if whole.any():
        return
    empty = []
    if table is not None:
        empty = [str(name) for name in table.columns if len(table) and table[name].isna().all()]
    why = f": nothing in {', '.join(empty)}" if empty else ""
    raise located("data", Phrase(f"a missing value in every one of {n_given} rows{why}"), "rows without any")


def numeric_table(table: Any, kind: str) -> Any:
    """Outcome or covariates with pandas' missing values turned into NaN, which numpy knows.

    Raises
    ------
    InputError
        For complex numbers, and more than two dimensions.
    """
    if isinstance(table, (pd.Series, pd.DataFrame)):
        dtypes = [table.dtype] if isinstance(table, pd.Series) else list(table.dtypes)
        if any(not isinstance(dtype, np.dtype) for dtype in dtypes):
            try:
                values = table.to_numpy(dtype=float, na_value=np.nan)
            except (TypeError, ValueError):
                raise located(kind, Phrase("values that are no numbers"), "numbers") from None
            if isinstance(table, pd.Series):
                return pd.Series(values, table.index, name=table.name)
            return pd.DataFrame(values, table.index, table.columns)
    if np.ndim(table) > 2:
        raise located(kind, Phrase(f"{np.ndim(table)} dimensions"), "one or two")
    if np.ndim(table) == 0:
        raise located(kind, table, "one value a row")
    if np.iscomplexobj(np.asarray(table)):
        raise located(kind, Phrase("complex numbers"), "real ones")
    return table
