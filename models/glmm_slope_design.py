"""Columns of random slopes: of the table, of new rows, and rows in which they are no numbers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from statsmodels.formula._manager import FormulaManager

from models.errors import InputError, Phrase, located
from models.glmm_data import Array
from models.glmm_formula import column_error
from models.glmm_gaps import check_columns, design_with_gaps, first_gaps
from models.glmm_new_rows import checked_rows, factors, level_error
from models.glmm_table import is_used
from models.quiet import without_warnings


@dataclass(frozen=True)
class RandomDesign:
    """Columns of one random term.

    Attributes
    ----------
    formula : str
        Its right side.
    spec
        The engine's description of it.
    columns : DataFrame [rows, effects]
        NaN where a value is missing, or the term is no number.
    blocks : tuple of int
        How many of the columns, one after the other, are correlated with each other: all, or with ``||`` those of
        one term of the formula, as in lme4.
    """

    formula: str
    spec: Any
    columns: pd.DataFrame
    blocks: tuple[int, ...]

    @classmethod
    def of(cls, formula: str, data: pd.DataFrame, missing: str, separate: bool) -> RandomDesign:
        """Read the right side of a random term.

        Raises
        ------
        InputError
            For text among numbers, dates, unknown columns, and a category with ``||``.
        """
        check_columns(formula, data, missing)
        design, spec = _engine(formula, data)
        if not separate:
            return cls(formula, spec, design, (design.shape[1],))
        for code, levels in factors(spec):
            if levels is not None:
                # lme4 gives a category a column for each level there, all correlated, beside the intercept.
                wanted = f"numbers, or ({formula}|...) in which they are correlated"
                raise located(f"random term ({formula}||...)", Phrase(f"the category {code}"), wanted)
        return cls(formula, spec, design, tuple(part.stop - part.start for part in _slices(spec)))


def new_columns(formula: str, data: pd.DataFrame, rows: pd.DataFrame) -> Array:
    """Columns of other rows, as the table was coded ``[rows, effects]``.

    Raises
    ------
    InputError
        For absent columns, unknown levels, and text where the table has numbers.
    """
    _, spec = _engine(formula, data)
    engine = "patsy" if hasattr(spec, "factor_infos") else "formulaic"
    checked = checked_rows(spec, rows, list(data.columns))
    try:
        with without_warnings():
            design = FormulaManager(engine=engine).get_matrices(spec, checked, pandas=True, prediction=True)
    except Exception as error:  # engines raise what they like
        raise level_error(spec, error) if "levels" in str(error) else column_error(formula, rows, error) from error
    return pd.DataFrame(design).reindex(checked.index).to_numpy(float)


def lost_rows(terms: Sequence[RandomDesign], data: pd.DataFrame, formula: str) -> dict[str, int]:
    """Rows in which every value that a formula uses is there, and a random effect no number, by the first such."""
    used = [name for name in data.columns if is_used(name, formula)]
    there = data[used].notna().all(axis=1)
    out: dict[str, int] = {}
    for term in terms:
        lost = there & term.columns.isna().any(axis=1)
        there &= ~lost
        if lost.any():
            design = design_with_gaps(term.spec, data[lost])
            found = {term.formula: int(lost.sum())} if design is None else first_gaps(design, term.formula)
            out |= {name: out.get(name, 0) + number for name, number in found.items()}
    return out


def _engine(formula: str, data: pd.DataFrame) -> tuple[pd.DataFrame, Any]:
    """Design of a table, NaN where a value is missing, and the engine's description of it."""
    manager = FormulaManager()
    try:
        with without_warnings(), np.errstate(all="ignore"):
            design = manager.get_matrices(formula, data, pandas=True)
    except InputError:
        raise
    except Exception as error:  # engines raise what they like
        raise column_error(formula, data, error) from error
    return pd.DataFrame(design).reindex(data.index), manager.spec


def _slices(spec: Any) -> list[slice]:
    """Columns of each term, whichever engine described them."""
    found = spec.term_name_slices if hasattr(spec, "factor_infos") else spec.term_slices
    return sorted(found.values(), key=lambda part: part.start)
