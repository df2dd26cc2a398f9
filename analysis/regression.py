"""Study 1's regression: the published mixed model with everything that should stand beside it.

``help ~ signal + robot_help + (1|participant)`` with a logit link, the models it is compared with (null, each term
alone, without each term, with interactions), likelihood-ratio tests, odds ratios with two kinds of intervals, and
what they amount to over people. All of it by adaptive Gauss--Hermite quadrature, and again by Laplace's
approximation, which is what the tool behind the published numbers does by default.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from analysis.regression_data import ResponseTable, response_table
from models.errors import InputError, Phrase, located
from models.events import EventLog
from models.glmm import DEFAULT_NODES, LogisticMixedModel
from models.glmm_comparison import aic_table
from models.glmm_marginal import MarginalContrast, marginal_contrast
from models.notebook_view import NotebookView, View, table_rows

LEVEL = 0.95
"""Level of every interval here, as in the paper."""

NULL = "1"
"""Right-hand side of the model without any term."""


@dataclass(frozen=True)
class Regression(NotebookView):
    """Fits of one quadrature rule, and what they say.

    Attributes
    ----------
    table : ResponseTable
    fits : mapping of str to results
        By right-hand side: `NULL`, each term alone, all but one, `ResponseTable.main`, and `interaction`.
    interaction : str
        Right-hand side of the model in which terms that meet interact; empty if there is none, or if
        the data cannot tell its coefficients apart.
    """

    table: ResponseTable
    fits: Mapping[str, Any]
    interaction: str

    @property
    def main(self) -> Any:
        """Fit of the main effects."""
        return self.fits[self.table.main]

    @property
    def terms(self) -> list[str]:
        """Names of the main effects."""
        return [term.name for term in self.table.terms]

    @cached_property
    def models(self) -> pd.DataFrame:
        """Models by AIC, best first (`models.glmm_comparison.aic_table`), with ``formula`` and ``sd``."""
        table = aic_table({self.table.formula(right): fit for right, fit in self.fits.items()})
        spread = {self.table.formula(right): fit.sd for right, fit in self.fits.items()}
        out = table.rename_axis("formula").reset_index()
        out["sd"] = out["formula"].map(spread)
        return out

    @cached_property
    def tests(self) -> pd.DataFrame:
        """Likelihood-ratio tests, one row a question.

        Columns ``question, full, restricted`` (right-hand sides), ``chi2, df, p``, ``dAIC`` (full less restricted:
        negative where the larger model is better). NaN where a search did not end; where data are
        separated, by what the likelihood rises to.
        """
        main = self.table.main
        rows = [(f"{name}, beside the others", main, self._without(name)) for name in self.terms]
        if len(self.terms) > 1:
            rows += [(f"{name}, alone against the null", name, NULL) for name in self.terms]
            rows.append(("all terms against the null", main, NULL))
        if self.interaction:
            rows.append(("interaction", self.interaction, main))
        return pd.DataFrame([self._test(*row) for row in rows])

    def _without(self, name: str) -> str:
        return " + ".join(term for term in self.terms if term != name) or NULL

    def _test(self, question: str, full: str, restricted: str) -> dict[str, Any]:
        big, small = self.fits[full], self.fits[restricted]
        row: dict[str, Any] = {"question": question, "full": full, "restricted": restricted}
        if not (big.comparable and small.comparable):
            return row | {"chi2": np.nan, "df": len(big.params) - len(small.params), "p": np.nan, "dAIC": np.nan}
        lr, p, df = big.compare_lr_test(small)
        return row | {"chi2": lr, "df": df, "p": p, "dAIC": big.aic - small.aic}

    @cached_property
    @np.errstate(over="ignore")  # separated data: infinite ends are what is meant
    def odds_ratios(self) -> pd.DataFrame:
        """Odds ratios of the main effects for one and the same person, indexed by term.

        Columns ``estimate``; ``low, high`` (Wald); ``profile_low, profile_high``; ``z``, ``p``.
        """
        wald = self.main.odds_ratios(1 - LEVEL)
        profile = np.exp(np.asarray(self.main.conf_int(1 - LEVEL, "profile", which=self.terms))[:-1])
        out = pd.DataFrame(
            {
                "estimate": wald["odds ratio"], "low": wald["lower"], "high": wald["upper"],
                "profile_low": profile[:, 0], "profile_high": profile[:, 1], "z": wald["z"], "p": wald["p"],
            }
        )  # fmt: skip
        return out.loc[self.terms]

    @cached_property
    def marginal(self) -> dict[str, MarginalContrast]:
        """Each term at 1 against 0, averaged over the people and rows of the study."""
        return {name: marginal_contrast(self.main, {name: 1}, {name: 0}, 1 - LEVEL) for name in self.terms}

    def _view(self) -> View:
        notes = tuple(note.text for note in self.main.notes)
        tables = (
            table_rows(self.odds_ratios, ".odds_ratios", "odds ratios for one person"),
            table_rows(self.tests, ".tests", "likelihood-ratio tests"),
        )
        return View("Regression of responses", "", notes, (), (f"Main model: {self.table.main}.",), tables)


def regress(data: EventLog | ResponseTable, quadrature: int | str = DEFAULT_NODES) -> Regression:
    """Fit the main model and all it is compared with.

    Parameters
    ----------
    data : EventLog or ResponseTable
    quadrature : int or "laplace"

    Raises
    ------
    InputError
        With more than two responses, no factor that varies, or responses that cannot be regressed: all alike, one a
        person, one person, or factors that determine each other.
    """
    table = data if isinstance(data, ResponseTable) else response_table(data)
    if not table.terms:
        held = Phrase(f"none ({', '.join(term.name for term in table.constant) or 'the robot has no choice'})")
        raise located("regression, factors that vary", held, "at least one: the robot did the same in every row")
    names = [term.name for term in table.terms]
    rights = dict.fromkeys([NULL, *names])
    if len(names) > 1:
        rights |= dict.fromkeys(" + ".join(n for n in names if n != out) for out in names)
    rights |= {table.main: None}
    fits = {right: fit_formula(table, right, quadrature) for right in rights}
    interaction = _interaction(table)
    if interaction:
        try:
            fits[interaction] = fit_formula(table, interaction, quadrature)
        except InputError:  # a cell of the design is empty: the coefficients determine each other
            interaction = ""
    return Regression(table, fits, interaction)


def fit_formula(table: ResponseTable, right: str, quadrature: int | str, rows: Any = None) -> Any:
    """Fit one right-hand side; notes are in the results, not raised as warnings."""
    frame = table.frame if rows is None else table.frame[rows]
    return LogisticMixedModel.from_formula(table.formula(right), frame, quadrature=quadrature).fit(warn=False)


def _interaction(table: ResponseTable) -> str:
    """Main effects, and products of the terms that meet in some row: two actions of one round never do."""
    frame = table.frame
    pairs = [(a.name, b.name) for a, b in combinations(table.terms, 2)]
    products = [f"{a}:{b}" for a, b in pairs if ((frame[a] == 1) & (frame[b] == 1)).any()]
    return " + ".join([table.main, *products]) if products else ""
