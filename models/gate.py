"""The convergence gate: what a posterior sample must satisfy before its numbers are shown without a banner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.quiet import without_warnings

MAX_RHAT = 1.01
MIN_ESS = 400.0


@dataclass(frozen=True)
class Gate:
    """Diagnostics of a sample, on relabelled entries and on label-invariant quantities.

    Attributes
    ----------
    divergences : int
    max_rhat : float
        Largest rank-normalised split r-hat.
    min_ess_bulk, min_ess_tail : float
        Smallest effective sample sizes.
    worst : str
        The quantity with the largest r-hat.
    """

    divergences: int
    max_rhat: float
    min_ess_bulk: float
    min_ess_tail: float
    worst: str

    @property
    def reasons(self) -> list[str]:
        """Why the gate is shut; empty if it is passed."""
        out = []
        if self.divergences > 0:
            out.append(f"{self.divergences} divergent transitions, none allowed")
        if not self.max_rhat < MAX_RHAT:
            out.append(f"largest r-hat {self.max_rhat:.4f} ({self.worst}), below {MAX_RHAT} wanted")
        for name, value in (("bulk", self.min_ess_bulk), ("tail", self.min_ess_tail)):
            if not value > MIN_ESS:
                out.append(f"smallest {name} effective sample size {value:.0f}, above {MIN_ESS:.0f} wanted")
        return out

    @property
    def passed(self) -> bool:
        """Whether every condition holds."""
        return not self.reasons

    @property
    def sentence(self) -> str:
        """The gate in one sentence."""
        numbers = (
            f"{self.divergences} divergences, largest r-hat {self.max_rhat:.4f}, smallest effective sample sizes "
            f"{self.min_ess_bulk:.0f} (bulk) and {self.min_ess_tail:.0f} (tail)"
        )
        if self.passed:
            return f"Convergence gate passed: {numbers}."
        return f"Convergence gate FAILED ({'; '.join(self.reasons)}): {numbers}. Do not rely on these numbers."


def convergence_gate(draws: NDArray[np.float64], names: list[str], divergences: int) -> Gate:
    """Examine named quantities.

    Parameters
    ----------
    draws : float64[chain, draw, quantity]
        Quantities that never vary (held tables) are left out.
    names : list of str
    divergences : int
    """
    import arviz as az

    with np.errstate(invalid="ignore"):
        # A quantity that is not a number is kept, so that it shuts the gate.
        varies = ~(np.ptp(draws.reshape(-1, draws.shape[-1]), axis=0) <= 1e-14)
    kept = [n for n, ok in zip(names, varies, strict=True) if ok]
    if not kept:
        return Gate(int(divergences), float("nan"), float("nan"), float("nan"), "nothing varies")
    with without_warnings():
        tree = az.from_dict({"posterior": {"q": draws[..., varies]}})
        rhat = np.atleast_1d(az.rhat(tree)["q"].values)
        bulk = np.atleast_1d(az.ess(tree, method="bulk")["q"].values)
        tail = np.atleast_1d(az.ess(tree, method="tail")["q"].values)
    worst = int(np.nanargmax(np.where(np.isnan(rhat), np.inf, rhat)))
    return Gate(int(divergences), float(np.max(rhat)), float(np.min(bulk)), float(np.min(tail)), kept[worst])
