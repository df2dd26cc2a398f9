"""What single blocks of the tables would be worth, in a table and in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from models.notebook_view import NotebookView
from models.reward import UNIT
from models.robust.block_smoother import block_words

FEWEST_DRAWS = 100
"""Draws below which rules fitted on some of them say little about the others."""

NO_RULE = "no rule was found by which it would change the plan"
"""Said of a block that the draws were not divided by."""

MOST_EQUAL = 3
"""Blocks that are named beside the one most worth knowing because they may be worth as much."""

ROUNDING = 1e-9
"""Worths that differ by less than this share are the same."""


@dataclass(frozen=True)
class BlockWorth(NotebookView):
    """What it would be worth to know one block.

    Attributes
    ----------
    block : str
    worth, se : float
        Cross-fitted, with the standard error of the paired differences between the rule's plan and today's; may be
        negative by chance. NaN where there are too few draws to say.
    in_sample : float
        Optimistic; never negative and never more than the pool's EVPI.
    regression : float
        Mean of the largest smoothed worth less the largest mean, by the regression alone.
    cells : int
        Different plans that knowing the block leads to.
    probabilities : int
        Free probabilities in the block; 0: it is known already.
    exact : bool
        Whether the draws are all that is believed and each block was compared with the others: `worth` and
        `in_sample` are then the same number, without an error.
    unit : str
        What worths are in: the word of the reward.
    cautions : tuple of str
        Those of the draws (`models.cautions`).
    """

    block: str
    worth: float
    se: float
    in_sample: float
    regression: float
    cells: int
    probabilities: int
    exact: bool = False
    unit: str = UNIT
    cautions: tuple[str, ...] = ()

    @property
    def fixed(self) -> str:
        """Why a block without free probabilities is worth nothing."""
        return "the same in all of these models" if self.exact else "held fixed in these draws"

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        words = block_words(self.block)
        if self.probabilities == 0:
            return f"Knowing {words} would be worth nothing: it is {self.fixed}."
        if self.exact and self.worth == 0:
            return f"Knowing {words} would be worth nothing: whatever it is, today's plan is the best one."
        if self.exact:
            return f"Knowing {words} would be worth {self.worth:.2g} {self.unit} a person."
        if np.isnan(self.worth):
            found = (
                f"{self.in_sample:.2g} {self.unit} a person if scored on the draws that the plans were chosen "
                "with, which is too much"
            )
            return (
                f"There are too few draws to say what knowing {words} would be worth "
                f"({found if self.in_sample > 0 else NO_RULE})."
            )
        if self.in_sample == 0:
            # A regression that finds no pattern proves nothing about what there is to find.
            return f"Knowing {words} would be worth nothing as far as these draws tell: {NO_RULE}."
        sure = "" if np.isnan(self.se) else f" (cross-fitted, standard error {self.se:.1g})"
        told = "" if not self.worth < 2 * self.se else "; that may be nothing at all"
        return (
            f"Knowing {words} would be worth {max(self.worth, 0.0):.2g} {self.unit} a person{sure}, and "
            f"{self.in_sample:.2g} if scored on the draws that the plans were chosen with{told}."
        )


@dataclass(frozen=True)
class PartialInformation(NotebookView):
    """What each block of the tables would be worth.

    Attributes
    ----------
    rows : tuple of BlockWorth
    perfect : float
        EVPI.
    pool : float
        EVPI of the pool: among its plans only.
    plans : int
        Plans in the pool.
    folds : int
    chains : int or None
        Chains that the standard errors allow for; None: draws count as independent.
    draws : int
        Draws that rules were fitted on and scored with.
    exact : bool
        Whether the draws are all that is believed, so that nothing was fitted.
    unit : str
        What worths are in: the word of the reward.
    cautions : tuple of str
        Those of the draws (`models.cautions`).
    """

    rows: tuple[BlockWorth, ...]
    perfect: float
    pool: float
    plans: int
    folds: int
    chains: int | None
    draws: int = FEWEST_DRAWS
    exact: bool = False
    unit: str = UNIT
    cautions: tuple[str, ...] = ()

    @property
    def enough(self) -> bool:
        """Whether there are enough draws to fit rules on some and score them on others, or no need to."""
        return self.exact or self.draws >= FEWEST_DRAWS

    @property
    def table(self) -> Any:
        """One row a block, as a data frame."""
        import pandas as pd

        columns = ("block", "worth", "se", "in_sample", "regression", "cells", "probabilities")
        return pd.DataFrame([{c: getattr(r, c) for c in columns} for r in self.rows])

    @property
    def sentences(self) -> list[str]:
        """One sentence a block."""
        return [r.sentence for r in self.rows]

    @property
    def sentence(self) -> str:
        """Which block matters most, in one sentence."""
        if not self.enough:
            some = "1 draw is" if self.draws == 1 else f"{self.draws} draws are"
            return f"{some} too few to say what single blocks of the tables would be worth ({FEWEST_DRAWS} wanted)."
        best = max(self.rows, key=lambda r: r.worth)
        whole = [r for r in self.rows if r.worth >= self.perfect * (1 - ROUNDING)]
        if self.exact and best.worth > 0 and whole:
            said = "; ".join(block_words(r.block) for r in whole)
            some = f"any of {len(whole)} blocks ({said})" if len(whole) > 1 else said
            every = len(whole) == len(self.rows) > 1
            which = "any single block of the tables, whichever," if every else some
            return (
                f"Knowing {which} would by itself be worth as much as perfect knowledge of all tables: "
                f"{self.perfect:.2g} {self.unit} a person."
            )
        if best.worth <= 0:
            told = "" if self.exact else ", as far as these draws tell"
            return (
                f"No single block of the tables is worth knowing by itself{told} "
                f"(perfect knowledge of all of them: {self.perfect:.2g} {self.unit} a person)."
            )
        sure = "" if np.isnan(best.se) else f" (standard error {best.se:.1g})"
        return (
            f"Most worth knowing is {block_words(best.block)}: {best.worth:.2g} {self.unit} a person{sure}, of "
            f"{self.perfect:.2g} that perfect knowledge of all tables would be worth{self._as_much(best)}."
        )

    def _as_much(self, best: BlockWorth) -> str:
        """Which blocks may be worth as much as the best one, for all their errors tell."""
        near = [
            r for r in sorted(self.rows, key=lambda r: -r.worth)
            if r is not best and r.worth > best.worth - 2 * np.hypot(r.se, best.se)
        ]  # fmt: skip
        if not near:
            return ""
        named = [f"{block_words(r.block)} ({r.worth:.2g})" for r in near[:MOST_EQUAL]]
        named += [f"{len(near) - MOST_EQUAL} more"] if len(near) > MOST_EQUAL else []
        said = " and ".join([", ".join(named[:-1]), named[-1]] if len(named) > 1 else named)
        return f"; as far as the errors tell {said} may be worth as much"
