"""What single blocks of the tables would be worth, in a table and in words."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from models.robust.block_smoother import block_words

FEWEST_DRAWS = 100
"""Draws below which rules fitted on some of them say little about the others."""


@dataclass(frozen=True)
class BlockWorth:
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
    """

    block: str
    worth: float
    se: float
    in_sample: float
    regression: float
    cells: int
    probabilities: int

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        words = block_words(self.block)
        if self.probabilities == 0:
            return f"Knowing {words} would be worth nothing: it is held fixed in these draws."
        if self.in_sample == 0:
            return f"Knowing {words} would be worth nothing: whatever it is, today's plan is the best one."
        if np.isnan(self.worth):
            return (
                f"There are too few draws to say what knowing {words} would be worth ({self.in_sample:.2g} reward "
                "units a person if scored on the draws that the plans were chosen with, which is too much)."
            )
        sure = "" if np.isnan(self.se) else f" (cross-fitted, standard error {self.se:.1g})"
        told = "" if not self.worth < 2 * self.se else "; that may be nothing at all"
        return (
            f"Knowing {words} would be worth {max(self.worth, 0.0):.2g} reward units a person{sure}, and "
            f"{self.in_sample:.2g} if scored on the draws that the plans were chosen with{told}."
        )


@dataclass(frozen=True)
class PartialInformation:
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
    """

    rows: tuple[BlockWorth, ...]
    perfect: float
    pool: float
    plans: int
    folds: int
    chains: int | None
    draws: int = FEWEST_DRAWS

    @property
    def enough(self) -> bool:
        """Whether there are enough draws to fit rules on some and score them on others."""
        return self.draws >= FEWEST_DRAWS

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
        if best.worth <= 0:
            return (
                "No single block of the tables is worth knowing by itself, as far as these draws tell "
                f"(perfect knowledge of all of them: {self.perfect:.2g} reward units a person)."
            )
        sure = "" if np.isnan(best.se) else f" (standard error {best.se:.1g})"
        return (
            f"Most worth knowing is {block_words(best.block)}: {best.worth:.2g} reward units a person{sure}, of "
            f"{self.perfect:.2g} that perfect knowledge of all tables would be worth."
        )
