"""New rows for a fitted formula: what no formula engine may be trusted to refuse.

One engine takes an unknown level for the reference level and goes on with a warning, the other raises in words of
its own; a column that is absent may be found in the surroundings of whoever fitted the model. So columns, levels
and kinds of values are looked at before an engine sees them.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
import pandas as pd

from models.errors import InputError, Phrase, located

SHOWN_LEVELS = 12
"""Levels of a variable listed in a message; more are counted."""


def column_of(code: str) -> str | None:
    """The column that a factor shows as it is: ``x``, ``Q('x')``, or either within ``C(...)``; None for others.

    Examples
    --------
    >>> [column_of(code) for code in ("arm", "Q('the arm')", "C(arm, Treatment('b'))", "C(x > 0)", "np.log(x)")]
    ['arm', 'the arm', 'arm', None, None]
    """
    node = _parsed(code)
    if _calls(node, "C"):
        node = node.args[0]
    if isinstance(node, ast.Name):
        return node.id
    return _named_by_q(node)


def factors(spec: Any) -> Iterator[tuple[str, tuple[Any, ...] | None]]:
    """Factors of a design as written, and their levels, None where numeric; whichever engine described it."""
    if hasattr(spec, "factor_infos"):
        for factor, info in spec.factor_infos.items():
            yield str(factor.code), None if info.categories is None else tuple(info.categories)
        return
    for code, (_, state) in spec.encoder_state.items():
        yield str(code), tuple(state["categories"]) if "categories" in state else None


def checked_rows(spec: Any, exog: pd.DataFrame, known_columns: Sequence[Any]) -> pd.DataFrame:
    """Rows as the engines read them: numbered from 0, without categories of their own, gaps all alike.

    Parameters
    ----------
    spec
        The engine's description of the design.
    exog : DataFrame
    known_columns : sequence
        Columns of the table that was fitted.

    Raises
    ------
    InputError
        For an absent column, an unknown level, or text where the fit had numbers; naming row, column and value.
    """
    rows = exog.reset_index(drop=True)
    for code, levels in factors(spec):
        for name in _columns_in(code):
            if name not in rows.columns and name in known_columns:
                found = Phrase(", ".join(map(str, rows.columns)) or "none")
                raise located("exog, columns", found, f"also {name!r}, as in the data of the fit")
        shown = column_of(code)
        if shown is None or shown not in rows.columns:
            continue
        column, present = rows[shown], rows[shown].notna().to_numpy()
        plain = isinstance(column.dtype, np.dtype) and column.dtype.kind in "iufb"
        values = column.to_numpy(dtype=object, copy=True)
        if levels is None and plain:
            continue
        wanted = "a number, as in the data of the fit" if levels is None else f"one of the levels {listed(levels)}"
        for i in np.flatnonzero(present):
            if not (_is_number(values[i]) if levels is None else values[i] in levels):
                raise located(f"exog, row {exog.index[i]}, column {shown!r}", values[i], wanted)
        if not plain:
            values[~present] = np.nan
            rows[shown] = pd.Series(values, dtype=object if levels is not None else np.float64)
    return rows


def level_error(spec: Any, error: Exception) -> InputError:
    """An unknown level of a factor that is computed from columns, such as ``C(x > 0)``."""
    text = str(error)
    found = re.search(r"observation with value (.+) does not match|original dataset\): \{(.+?)\}\.", text)
    value = Phrase((found[1] or found[2]) if found else "a value that the fit did not have")
    computed = [(code, levels) for code, levels in factors(spec) if levels is not None and column_of(code) is None]
    wanted = "; ".join(f"one of the levels {listed(levels)} of {code}" for code, levels in computed)
    return located("exog", value, wanted or "levels of the fit")


def listed(levels: tuple[Any, ...]) -> str:
    """Levels in a message.

    Examples
    --------
    >>> listed(("a", "b")), listed(tuple(range(14)))
    ("'a', 'b'", '0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11 and 2 more')
    """
    shown = ", ".join(repr(v) if isinstance(v, str) else str(v) for v in levels[:SHOWN_LEVELS])
    return shown + (f" and {len(levels) - SHOWN_LEVELS} more" if len(levels) > SHOWN_LEVELS else "")


def _parsed(code: str) -> Any:
    try:
        return ast.parse(code.strip(), mode="eval").body
    except SyntaxError:
        return None


def _calls(node: Any, name: str) -> bool:
    return (
        isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == name and bool(node.args)
    )


def _named_by_q(node: Any) -> str | None:
    if not _calls(node, "Q") or not isinstance(node.args[0], ast.Constant):
        return None
    value = node.args[0].value
    return value if isinstance(value, str) else None


def _columns_in(code: str) -> list[str]:
    """Names that a factor may look up in the table."""
    tree = _parsed(code)
    if tree is None:
        return []
    nodes = list(ast.walk(tree))
    plain = [node.id for node in nodes if isinstance(node, ast.Name)]
    return plain + [name for node in nodes if (name := _named_by_q(node)) is not None]


def _is_number(value: Any) -> bool:
    return isinstance(value, (bool, int, float, np.bool_, np.number))
