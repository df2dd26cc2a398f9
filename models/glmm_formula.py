"""Formulas of the mixed model: lme4's spellings brought to what both formula engines read.

``y ~ x + (1|g)`` names the groups inside the formula; ``cbind(y, n - y) ~ x`` gives successes and failures; a name
that is no word of Python stands in backticks, ``y ~ `dose (mg)` + (1|`clinic.id`)``.
"""

from __future__ import annotations

import re
import warnings
from difflib import get_close_matches
from keyword import iskeyword
from typing import Any

import numpy as np
import pandas as pd
from formulaic.errors import DataMismatchWarning
from numpy.typing import NDArray
from statsmodels.formula._manager import FormulaManager

from models.errors import InputError, Phrase, located
from models.glmm_new_rows import checked_rows, column_of, level_error
from models.quiet import without_warnings

_BAR = re.compile(r"\+?\s*\(([^()|]*)\|([^()|]*)\)")
_NAME = re.compile(r"[^\W\d]\w*")
_TICKS = re.compile(r"`([^`]*)`")
_STAND_IN = "backticked_{}_"
_UNKNOWN = (
    re.compile(r"name '([^']+)' is not defined"),
    re.compile(r"`([^`]+)` is not present in the dataset"),
    re.compile(r"no data named '([^']+)' found"),
    re.compile(r"KeyError: '([^']+)'"),
)
"""What patsy, formulaic and ``Q`` say of a name that they do not know."""


def split_groups(formula: str, groups: object) -> tuple[str, object]:
    """Take ``(1|g)`` out of a formula, and spell names in backticks as the engines do, ``Q('the name')``.

    Returns
    -------
    formula : str
        Without the random intercept and without backticks.
    groups
        The name inside the brackets, or `groups` as given.

    Raises
    ------
    InputError
        Without ``~``; with random slopes, several random terms, or groups named twice or not at all; for a backtick
        that is never closed.

    Examples
    --------
    >>> split_groups("help ~ signal + (1|person)", None)
    ('help ~ signal', 'person')
    >>> split_groups("help ~ (1 | person)", None)
    ('help ~ 1', 'person')
    >>> split_groups("help ~ `dose (mg)` + (1|`clinic.id`)", None)
    ("help ~ Q('dose (mg)')", 'clinic.id')
    """
    place = f"formula {formula!r}"
    formula, names = _without_ticks(formula, place)
    if formula.count("~") != 1:
        raise located(place, Phrase(f"{formula.count('~')} times '~'"), "outcome ~ covariates")
    if "||" in formula:
        raise located(place, Phrase("a random slope, '||'"), "one random intercept, (1|group)")
    found = list(_BAR.finditer(formula))
    if "|" in _BAR.sub("", formula) or len(found) > 1:
        raise located(place, Phrase("more than one random term"), "one random intercept, (1|group)")
    if not found:
        if groups is None:
            raise located(place, Phrase("no groups"), "groups=..., or (1|group) in the formula")
        return _quoted(formula, names), groups
    inside, name = (part.strip() for part in found[0].groups())
    if inside != "1":
        raise located(place, Phrase(f"({inside}|{name})"), f"a random intercept: (1|{name})")
    if not _NAME.fullmatch(name):
        hint = f": in backticks, (1|`{name}`), unless it is a word" if name else ""
        raise located(place, name, f"the name of one column after the bar{hint}")
    name = names.get(name, name)
    if groups is not None and not (isinstance(groups, str) and groups == name):
        raise located(place, Phrase(f"groups both in the formula ({name}) and as an argument"), "one of them")
    rest = _BAR.sub("", formula)
    left, right = (part.strip() for part in rest.split("~"))
    right = right.removeprefix("+").strip()
    return _quoted(f"{left} ~ {right or '1'}", names), name


def _without_ticks(formula: str, place: str) -> tuple[str, dict[str, str]]:
    """Words in place of names in backticks, which may hold brackets and bars; and the names by word."""
    names: dict[str, str] = {}

    def word(found: re.Match[str]) -> str:
        stand_in = _STAND_IN.format(len(names))
        names[stand_in] = found[1]
        return stand_in

    without = _TICKS.sub(word, formula)
    if "`" in without or "" in names.values():
        raise located(place, Phrase("a backtick without its pair"), "names of columns as in `clinic.id`")
    if tilde := [name for name in names.values() if "~" in name]:
        raise located(place, tilde[0], "a column's name without ~, which divides the formula")
    return without, names


def _quoted(formula: str, names: dict[str, str]) -> str:
    """The names again, those that are no words as ``Q('the name')``."""
    for stand_in, name in names.items():
        formula = formula.replace(
            stand_in, name if _NAME.fullmatch(name) and not iskeyword(name) else f"Q({name!r})"
        )
    return formula


def quoted_names(formula: str) -> str:
    """A formula with names in backticks as the engines spell them.

    Raises
    ------
    InputError
    """
    return _quoted(*_without_ticks(formula, f"formula {formula!r}"))


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
    name = column_of(formula.split("~")[0])
    if name is None or name not in data.columns:
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
    """What the engines say when they cannot read a formula or do not know a name, said plainly."""
    names = [str(column) for column in data.columns]
    reason = str(error).strip()
    # The engines take the part of a name before a dot or a blank for a word of its own.
    bare = [n for n in names if not _NAME.fullmatch(n) and n in formula.replace(f"Q({n!r})", "")]
    ticks = f" (names that are no words stand in backticks: `{bare[0]}`)" if bare else ""
    unknown = next((found[1] for pattern in _UNKNOWN if (found := pattern.search(reason))), None)
    if unknown is None:
        return InputError(
            f"formula {formula!r}: {reason.splitlines()[0] if reason else type(error).__name__}{ticks}"
        )
    close = get_close_matches(unknown, names, n=1)
    hint = f" (did you mean {close[0]!r}?)" if close else ""
    return located(f"formula {formula!r}", unknown, f"one of the columns {', '.join(names)}{ticks or hint}")


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
    table = getattr(model.data, "frame", None)
    rows = checked_rows(spec, exog, () if table is None else list(table.columns))
    try:
        with without_warnings():
            # Of an unknown level this engine makes the reference level, and only warns.
            warnings.simplefilter("error", DataMismatchWarning)
            design = FormulaManager(engine=engine).get_matrices(spec, rows, pandas=True, prediction=True)
    except Exception as error:
        # Engines raise what they like here; the message is theirs, or names the column.
        if isinstance(error, DataMismatchWarning) or "expected levels" in str(error):
            raise level_error(spec, error) from error
        raise column_error(str(model.formula), exog, error) from error
    return design.reindex(rows.index).to_numpy(float), exog.index
