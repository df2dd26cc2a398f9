"""What depends on kappa, the stickiness of the prior, and what does not.

``transition[a, s] ~ Dirichlet(1 + kappa e_s)``: kappa pseudo-counts more on staying. The default is 2; 0 treats all
moves alike and 5 expects states to last. Where the data speak, the answers agree; where they do not, the answer is
kappa's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from analysis.causal import causal_effects, silent_actions
from analysis.credible import LEVEL
from analysis.figures.style import spoken
from analysis.fits import stored_fit
from analysis.uncertainty import EVERYONE, contraction, contrasts
from models.errors import located
from models.events import EventLog
from models.notebook_view import NotebookView
from models.nuts import NutsSettings
from models.parameters import Array, DirichletPrior
from models.posterior import Posterior

KAPPAS = (0.0, 2.0, 5.0)


@dataclass(frozen=True)
class KappaSensitivity(NotebookView):
    """Answers by kappa.

    Attributes
    ----------
    table : DataFrame
        One row a quantity and kappa: ``quantity``, ``kappa``, ``mean, low, high, positive`` (percentage points or
        points of score), ``prior_low, prior_high``.
    fits : DataFrame
        One row a kappa: ``kappa``, ``contraction`` (median of the transition entries), ``gate`` (passed or not).
    n_states : int
    level : float
    """

    table: pd.DataFrame
    fits: pd.DataFrame
    n_states: int
    level: float

    @property
    def sentence(self) -> str:
        """How far the answers move, in units of their own uncertainty."""
        parts = []
        for name, rows in self.table.groupby("quantity", sort=False):
            shift = float(rows["mean"].max() - rows["mean"].min())
            width = float((rows["high"] - rows["low"]).mean())
            share = shift / width if width > 0 else 0.0
            verdict = "hardly depends" if share < 0.15 else "depends somewhat" if share < 0.4 else "depends"
            parts.append(f"{name} {verdict} on kappa ({_listed(rows)})")
        text = "; ".join(parts)
        failed = self.fits.loc[~self.fits["gate"], "kappa"].tolist()
        note = ""
        if failed:
            note = f" The convergence gate failed at kappa {', '.join(f'{k:g}' for k in failed)}."
        return f"{text[:1].upper()}{text[1:]}.{note}"


def _listed(rows: pd.DataFrame) -> str:
    return ", ".join(f"{m:+.1f} at {k:g}" for k, m in zip(rows["kappa"], rows["mean"], strict=True))


def refits(
    log: EventLog,
    data_digest: str,
    states: int,
    kappas: Sequence[float] = KAPPAS,
    *,
    pins: Mapping[str, Array | None] | None = None,
    sampler: NutsSettings | None = None,
) -> dict[float, Posterior]:
    """Posterior at every kappa, from the store where it is there (`analysis.fits`)."""
    return {
        kappa: stored_fit(
            log, data_digest, states, prior=DirichletPrior(stay=kappa), pins=pins, sampler=sampler
        ).posterior
        for kappa in kappas
    }


def kappa_sensitivity(fits: Mapping[float, Posterior], log: EventLog, level: float = LEVEL) -> KappaSensitivity:
    """Compare contrasts and causal effects of fits that differ in kappa alone.

    Raises
    ------
    InputError
        If the fits differ in their number of states, or have one state only.
    """
    states = {p.n_states for p in fits.values()}
    if len(states) != 1 or states == {1}:
        raise located("sensitivity, states of the fits", sorted(states), "one number of at least 2")
    silent = silent_actions(log)
    answers, quality = [], []
    for kappa, posterior in fits.items():
        once = contrasts(posterior, silent, level)
        effects = causal_effects(posterior, log, level=level)
        median = contraction(posterior, level).median_of_moves
        quality.append({"kappa": kappa, "contraction": median, "gate": posterior.gate.passed})
        for row in once.table[once.table["state"] == EVERYONE].to_dict("records"):
            if row["evidence"] == "learned":
                name = f"one act of '{spoken(row['action'])}' on the next response"
                answers.append({"quantity": name, "kappa": kappa, **_scaled(row, once.scale)})
        for action in effects.actions:
            row = effects.of(action).iloc[-1].to_dict()
            if action not in silent and np.ptp([row["low"], row["high"]]) > 0:
                name = f"always '{spoken(action)}' on all responses"
                answers.append({"quantity": name, "kappa": kappa, **_scaled(row, effects.scale)})
    table = pd.DataFrame(answers, columns=["quantity", "kappa", *_scaled(dict.fromkeys(_COLUMNS, 0.0), 1.0)])
    order = {name: i for i, name in enumerate(dict.fromkeys(table["quantity"]))}
    table = table.sort_values("quantity", key=lambda c: c.map(order), kind="stable").reset_index(drop=True)
    return KappaSensitivity(table, pd.DataFrame(quality), next(iter(states)), level)


_COLUMNS = ("mean", "low", "high", "positive", "prior_low", "prior_high")


def _scaled(row: Mapping[str, float], scale: float) -> dict[str, float]:
    return {c: row[c] * (1.0 if c == "positive" else scale) for c in _COLUMNS}
