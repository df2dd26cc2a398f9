"""The convergence gate: what a posterior sample must satisfy before its numbers are shown without a banner."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.notebook_view import NotebookView, View
from models.quiet import without_warnings

MAX_RHAT = 1.01
MIN_ESS = 400.0

FEWEST_DRAWS = 4
"""Draws a chain below which ArviZ computes neither r-hat nor effective sample sizes."""


@dataclass(frozen=True)
class Gate(NotebookView):
    """Diagnostics of a sample, on relabelled entries and on label-invariant quantities.

    Attributes
    ----------
    divergences : int or None
        None where nobody knows: a trace without statistics of its sampler.
    max_rhat : float
        Largest rank-normalised split r-hat; NaN if there is none.
    min_ess_bulk, min_ess_tail : float
        Smallest effective sample sizes; NaN if there are none.
    worst : str
        The quantity with the largest r-hat (the smallest effective sample size, without an r-hat).
    chains, draws : int, optional
        Chains, and draws in each of them.
    worst_bulk, worst_tail : str
        The quantities with the smallest effective sample sizes; empty if unknown.
    """

    divergences: int | None
    max_rhat: float
    min_ess_bulk: float
    min_ess_tail: float
    worst: str
    chains: int | None = None
    draws: int | None = None
    worst_bulk: str = ""
    worst_tail: str = ""

    @property
    def reasons(self) -> list[str]:
        """Why the gate is shut; empty if it is passed."""
        out = []
        if self.divergences is None:
            out.append("whether transitions diverged is unknown: the trace has no statistics of its sampler")
        elif self.divergences > 0:
            out.append(f"{self.divergences} divergent transition{'s' * (self.divergences > 1)}, none allowed")
        if self._impossible:
            return [*out, *self._impossible]
        if not self.max_rhat < MAX_RHAT:
            found = "not a number" if np.isnan(self.max_rhat) else f"{self.max_rhat:.4f}"
            out.append(f"largest r-hat {found} ({self.worst}), below {MAX_RHAT} wanted")
        return out + self._too_small

    @property
    def _impossible(self) -> list[str]:
        """What there cannot be for want of chains or draws."""
        if self.draws is not None and self.draws < FEWEST_DRAWS:
            return [
                f"r-hat and effective sample sizes need at least {FEWEST_DRAWS} draws a chain, found {self.draws}"
            ]
        if self.chains == 1:
            return ["r-hat needs at least two chains, found one", *self._too_small]
        return []

    @property
    def _too_small(self) -> list[str]:
        out = []
        for name, value, worst in (
            ("bulk", self.min_ess_bulk, self.worst_bulk), ("tail", self.min_ess_tail, self.worst_tail),
        ):  # fmt: skip
            if not value > MIN_ESS:
                found = ("not a number" if np.isnan(value) else f"{value:.0f}") + f" ({worst})" * bool(worst)
                out.append(f"smallest {name} effective sample size {found}, above {MIN_ESS:.0f} wanted")
        return out

    @property
    def passed(self) -> bool:
        """Whether every condition holds."""
        return not self.reasons

    @property
    def caution(self) -> str:
        """What everything made from the draws repeats (`models.cautions`); empty if the gate is passed."""
        return "" if self.passed else "the posterior failed its convergence gate"

    @property
    def sentence(self) -> str:
        """The gate in one sentence."""
        rhat = "no r-hat" if np.isnan(self.max_rhat) else f"largest r-hat {self.max_rhat:.4f}"
        sizes = [self.min_ess_bulk, self.min_ess_tail]
        ess = (
            "no effective sample sizes"
            if any(map(np.isnan, sizes))
            else f"smallest effective sample sizes {sizes[0]:.0f} (bulk) and {sizes[1]:.0f} (tail)"
        )
        n = "an unknown number of" if self.divergences is None else self.divergences
        numbers = f"{n} divergence{'s' * (n != 1)}, {rhat}, {ess}"
        if self.passed:
            return f"Convergence gate passed: {numbers}."
        return f"Convergence gate FAILED ({'; '.join(self.reasons)}): {numbers}. Do not rely on these numbers."

    def _view(self) -> View:
        return View("Convergence gate", "", tuple(f"{reason}." for reason in self.reasons), (), (self.sentence,))


def convergence_gate(draws: NDArray[np.float64], names: list[str], divergences: int | None) -> Gate:
    """Examine named quantities.

    Parameters
    ----------
    draws : float64[chain, draw, quantity]
        Quantities that never vary (held tables) are left out.
    names : list of str
    divergences : int or None
        None where nobody knows, which shuts the gate.
    """
    import arviz as az

    with np.errstate(invalid="ignore"):
        # A quantity that is not a number is kept, so that it shuts the gate.
        varies = ~(np.ptp(draws.reshape(-1, draws.shape[-1]), axis=0) <= 1e-14)
    divergences = None if divergences is None else int(divergences)
    kept = [n for n, ok in zip(names, varies, strict=True) if ok]
    chains, n = draws.shape[:2]
    none = float("nan")
    if not kept or n < FEWEST_DRAWS:
        worst = kept[0] if kept else "nothing varies"
        return Gate(divergences, none, none, none, worst, chains, n)
    with without_warnings():
        tree = az.from_dict({"posterior": {"q": draws[..., varies]}})
        bulk = np.atleast_1d(az.ess(tree, method="bulk")["q"].values)
        tail = np.atleast_1d(az.ess(tree, method="tail")["q"].values)
        rhat = np.atleast_1d(az.rhat(tree)["q"].values) if chains > 1 else np.full(len(kept), np.nan)
    # A quantity without a value is the worst.
    low_bulk, low_tail = (np.where(np.isnan(ess), -np.inf, ess) for ess in (bulk, tail))
    badness = np.where(np.isnan(rhat), np.inf, rhat) if chains > 1 else -low_bulk
    return Gate(
        divergences, float(np.max(rhat)), float(np.min(bulk)), float(np.min(tail)), kept[int(np.argmax(badness))],
        chains, n, kept[int(np.argmin(low_bulk))], kept[int(np.argmin(low_tail))],
    )  # fmt: skip
