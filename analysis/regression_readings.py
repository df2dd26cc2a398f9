"""The same regression under other readings of its formula, to see whether the answer hangs on the printed one."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from analysis.regression import LEVEL, Regression, fit_formula
from analysis.regression_data import PERSON
from models.errors import InputError
from models.notebook_view import NotebookView, View, table_rows

MAIN = "main model"


@dataclass(frozen=True)
class Readings(NotebookView):
    """Odds ratios under every reading.

    Attributes
    ----------
    table : DataFrame
        One row a reading and term: ``reading``, ``formula``, ``rows``, ``people``, ``term`` (as in the main model),
        ``estimate, low, high, z, p``, ``sd``, ``notes``.
    randomised : mapping of reading to bool
        Whether the term compares arms that chance made.
    failed : mapping of reading to str
        Readings that could not be fitted, and why.
    """

    table: pd.DataFrame
    randomised: dict[str, bool]
    failed: dict[str, str]

    def sentence_of(self, term: str) -> str:
        """How the odds ratio of a term changes between readings."""
        rows = self.table[self.table["term"] == term]
        first = rows[rows["reading"] == MAIN].iloc[0]
        others = rows[rows["reading"] != MAIN]
        if others.empty:
            return ""
        told = "; ".join(f"{r.reading} {r.estimate:.2f} ({r.low:.2f} to {r.high:.2f})" for r in others.itertuples())
        side = _side(first["low"], first["high"])
        changed = [r.reading for r in others.itertuples() if _side(r.low, r.high) != side]
        verdict = (
            f"what can be said of its sign changes: {', '.join(changed)}" if changed
            else "under every reading the same is said of its sign"
        )  # fmt: skip
        return (
            f"Odds ratio of {term}: {MAIN} {first['estimate']:.2f} ({first['low']:.2f} to "
            f"{first['high']:.2f}); {told}. {verdict[0].upper()}{verdict[1:]}."
        )

    def _view(self) -> View:
        warnings = tuple(f"{reading} could not be fitted: {why}." for reading, why in self.failed.items())
        return View("Odds ratios by reading", "", warnings, (), (), (table_rows(self.table, ".table"),))


def _side(low: float, high: float) -> int:
    """Above one, below one, or neither for sure."""
    return 1 if low > 1 else -1 if high < 1 else 0


def readings(regression: Regression, quadrature: int | str) -> Readings:
    """Fit the main model under other readings of what an assigned action is, and with the round beside it.

    `helped so far` compares a person before and after the first help and so mixes help with time; responses *after
    the first chance* compare the arms where they can differ.
    """
    table = regression.table
    frame = table.frame
    assigned = [term for term in table.terms if term.kind == "assigned"]
    everything = np.ones(len(frame), dtype=bool)
    wanted: list[tuple[str, dict[str, str], str, Any, bool]] = [
        (MAIN, {}, "", everything, table.randomised),
    ]
    if assigned:
        so_far = {term.name: term.so_far for term in assigned}
        after = (frame["had_chance"] == 1).to_numpy()
        wanted.append(("taken so far, not assigned", so_far, "", everything, False))
        wanted.append(("responses after the first chance only", {}, "", after, table.randomised))
    if len(np.unique(frame["round"])) > 1:
        wanted.append(("with the round as a covariate", {}, " + round", everything, table.randomised))
    parts, failed = [], {}
    for name, swap, more, rows, _ in wanted:
        right = " + ".join(swap.get(term, term) for term in regression.terms) + more
        try:
            fit = regression.main if name == MAIN else fit_formula(table, right, quadrature, rows)
        except InputError as error:
            failed[name] = str(error)
            continue
        ratios = fit.odds_ratios(1 - LEVEL)
        for term in regression.terms:
            row = ratios.loc[swap.get(term, term)]
            parts.append(
                {
                    "reading": name, "formula": table.formula(right), "rows": int(fit.nobs),
                    "people": int(frame.loc[rows, PERSON].nunique()), "term": term, "estimate": row["odds ratio"],
                    "low": row["lower"], "high": row["upper"], "z": row["z"], "p": row["p"], "sd": fit.sd,
                    "notes": "; ".join(note.text for note in fit.notes),
                }
            )  # fmt: skip
    return Readings(pd.DataFrame(parts), {name: ok for name, *_, ok in wanted if name not in failed}, failed)
