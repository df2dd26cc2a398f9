"""Formulas of the mixed model: lme4's spellings brought to what both formula engines read.

``y ~ x + (1|g)`` names the groups inside the formula; ``cbind(y, n - y) ~ x`` gives successes and failures.
"""

from __future__ import annotations

import re
from difflib import get_close_matches
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from statsmodels.formula._manager import FormulaManager

from models.errors import InputError, Phrase, located

_BAR = re.compile(r"\+?\s*\(([^()|]*)\|([^()|]*)\)")
_NAME = re.compile(r"[^\W\d]\w*")


def split_groups(formula: str, groups: object) -> tuple[str, object]:
    """Take ``(1|g)`` out of a formula.

    Returns
    -------
    formula : str
        Without the random intercept.
    groups
        The name inside the brackets, or `groups` as given.

    Raises
    ------
    InputError
        Without ``~``; with random slopes, several random terms, or groups named twice or not at all.

    Examples
    --------
    >>> split_groups("help ~ signal + (1|person)", None)
    ('help ~ signal', 'person')
    >>> split_groups("help ~ (1 | person)", None)
    ('help ~ 1', 'person')
    """
    place = f"formula {formula!r}"
    if formula.count("~") != 1:
        raise located(place, Phrase(f"{formula.count('~')} times '~'"), "outcome ~ covariates")
    found = list(_BAR.finditer(formula))
    if "|" in _BAR.sub("", formula) or len(found) > 1:
        raise located(place, Phrase("more than one random term"), "one random intercept, (1|group)")
    if not found:
        if groups is None:
            raise located(place, Phrase("no groups"), "groups=..., or (1|group) in the formula")
        return formula, groups
    inside, name = (part.strip() for part in found[0].groups())
    if inside != "1":
        raise located(place, Phrase(f"({inside}|{name})"), f"a random intercept: (1|{name})")
    if not _NAME.fullmatch(name):
        raise located(place, name, "the name of one column after the bar")
    if groups is not None and not (isinstance(groups, str) and groups == name):
        raise located(place, Phrase(f"groups both in the formula ({name}) and as an argument"), "one of them")
    rest = _BAR.sub("", formula)
    left, right = (part.strip() for part in rest.split("~"))
    right = right.removeprefix("+").strip()
    return f"{left} ~ {right or '1'}", name


def outcome_columns(formula: str) -> str:
    """Spell ``cbind(a, b)`` as the two-column outcome of the formula engines.

    Examples
    --------
    >>> outcome_columns("cbind(ill, size - ill) ~ period")
    'I(ill) + I(size - ill) ~ period'
    """
    left, right = (part.strip() for part in formula.split("~"))
    if not left.startswith("cbind("):
        return f"{left} ~ {right}"
    parts, depth = [""], 0
    for character in left.removeprefix("cbind(").removesuffix(")"):
        depth += (character == "(") - (character == ")")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    if len(parts) != 2:
        raise located(
            f"formula {formula!r}", Phrase(f"{len(parts)} columns in cbind"), "cbind(successes, failures)"
        )
    return " + ".join(f"I({part.strip()})" for part in parts) + f" ~ {right}"


def numeric_outcome(formula: str, data: pd.DataFrame) -> pd.DataFrame:
    """Turn a true/false outcome into 1/0: formula engines would make two columns of it, failures first.

    Raises
    ------
    InputError
        If the outcome is a column of text or categories.
    """
    name = formula.split("~")[0].strip()
    if name not in data.columns:
        return data
    column = data[name]
    if isinstance(column.dtype, pd.BooleanDtype) or column.dtype == bool:
        return data.assign(**{name: column.astype("Float64").astype(float)})
    if not pd.api.types.is_numeric_dtype(column.dtype):
        known = column.dropna()
        values = sorted(map(str, known.unique()))[:4]
        if len(known) and known.map(lambda value: isinstance(value, bool)).all():
            return data.assign(**{name: column.astype("boolean").astype("Float64").astype(float)})
        raise located(f"outcome {name!r}", Phrase("the values " + ", ".join(values)), "0 and 1, or counts")
    return data


def column_error(formula: str, data: pd.DataFrame, error: Exception) -> InputError:
    """What the engines say when a name is unknown, said plainly."""
    names = [str(column) for column in data.columns]
    unknown = re.search(r"name '(\w+)' is not defined", str(error))
    if not unknown:
        return InputError(f"formula {formula!r}: {str(error).splitlines()[0]}")
    close = get_close_matches(unknown[1], names, n=1)
    hint = f" (did you mean {close[0]!r}?)" if close else ""
    return located(f"formula {formula!r}", unknown[1], f"one of the columns {', '.join(names)}{hint}")


def named_column(data: pd.DataFrame, value: object, place: str) -> object:
    """The column of that name, or the value itself if it is no name."""
    if not isinstance(value, str):
        return value
    if value not in data.columns:
        names = [str(column) for column in data.columns]
        raise located(place, value, f"one of the columns {', '.join(names)}")
    return data[value]


def select_rows(
    data: pd.DataFrame, arrays: dict[str, Any], subset: Any, drop: bool
) -> tuple[pd.DataFrame, dict[str, Any], int]:
    """Take a subset, then leave out rows without a group, weight, number of trials or offset.

    Returns
    -------
    data, arrays
        The rows left, of the table and of the arrays beside it.
    n_given : int
        Rows before any were left out for missing values.

    Raises
    ------
    InputError
        For an array of another length than the table.
    """
    for key, value in arrays.items():
        if value is not None and len(value) != len(data):
            raise located(key, Phrase(f"{len(value)} values"), f"one for each of the {len(data)} rows")

    def keep(rows: Any) -> dict[str, Any]:
        return {
            key: None if value is None else pd.Series(value).reset_index(drop=True).iloc[rows]
            for key, value in arrays.items()
        }

    if subset is not None:
        rows = pd.Series(np.arange(len(data)), index=data.index).loc[subset].to_numpy()
        data, arrays = data.iloc[rows], keep(rows)
    n_given = len(data)
    if drop:
        whole = np.ones(n_given, bool)
        for value in arrays.values():
            if value is not None:
                whole &= ~np.asarray(pd.isna(value), bool)
        if not whole.all():
            data, arrays = data.iloc[whole], keep(whole)
    return data, arrays, n_given


def new_design(model: Any, exog: Any) -> tuple[NDArray[np.float64], pd.Index]:
    """Design matrix of new rows, by the engine that made the model's, whichever is in use now.

    Returns
    -------
    design : array [rows, p]
        NaN in rows with a missing value.
    index : Index
        Of the table.

    Raises
    ------
    InputError
        For anything but a table, and for missing columns or unknown levels.
    """
    if not isinstance(exog, pd.DataFrame):
        raise located("exog", Phrase(type(exog).__name__), "a DataFrame with the variables of the formula")
    spec = model.data.model_spec
    engine = "patsy" if type(spec).__module__.startswith("patsy") else "formulaic"
    numbered = exog.reset_index(drop=True)
    try:
        design = FormulaManager(engine=engine).get_matrices(spec, numbered, pandas=True, prediction=True)
    except Exception as error:
        # Engines raise what they like here; the message is theirs, or names the column.
        raise column_error(str(model.formula), exog, error) from error
    return design.reindex(numbered.index).to_numpy(float), exog.index
