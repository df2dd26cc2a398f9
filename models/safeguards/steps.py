"""A safeguard made stricter step by step: value and influence at every setting that matters, not on a grid.

What a safeguard does changes only where its setting passes a number that some decision compares with it. So all
settings between two such numbers do the same, and the next one is read off while histories are followed.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.notebook_view import NotebookView
from models.planning.baselines import ModePolicy
from models.planning.policies import Array
from models.planning.schedule import Schedule
from models.reward import UNIT
from models.safeguards.confidence import Confidence
from models.safeguards.guarded import Guarded
from models.safeguards.guarded_run import GuardedRun, guarded_run
from models.safeguards.influence import SAME, MinimumInfluence
from models.safeguards.influence_report import Watched
from models.safeguards.safeguard import Proposal, Safeguard, Verdict

MOST_STEPS = 150
"""Steps that are followed, from the laxest on."""

APART = 1e-9
"""A tolerance is put that far above the loss that it is to allow, relatively: differences of values are rounded."""


@dataclass(frozen=True)
class Steps(NotebookView):
    """What a policy is worth by the setting of one safeguard: each row holds from its setting up to the next.

    Attributes
    ----------
    policy, safeguard, setting : str
    levels : float64[i]
        Settings, increasing.
    values, influences, costs, changed : float64[i]
        Value, influence, expected cost, share of the decisions changed.
    complete : bool
        Whether the last row holds for all settings above.
    cautions : tuple of str
        Those of the draws (`models.cautions`).
    unit : str
        What values are in: the word of the reward.
    """

    policy: str
    safeguard: str
    setting: str
    levels: Array
    values: Array
    influences: Array
    costs: Array
    changed: Array
    complete: bool
    cautions: tuple[str, ...] = ()
    unit: str = UNIT

    def rows(self) -> list[dict[str, Any]]:
        """One row a step."""
        first = float(self.values[0])
        return [
            {self.setting: x, "value": v, "lost": first - v, "influence": i, "cost": c, "changed": s}
            for x, v, i, c, s in zip(
                *(a.tolist() for a in (self.levels, self.values, self.influences, self.costs, self.changed)),
                strict=True,
            )
        ]  # fmt: skip

    @property
    def table(self) -> Any:
        """`rows` as a data frame."""
        import pandas as pd

        return pd.DataFrame(self.rows())

    @property
    def sentence(self) -> str:
        """How far it goes, and what half of the influence costs."""
        lost = self.values[0] - self.values
        half = np.flatnonzero(self.influences <= 0.5 * self.influences[0])
        settings = "1 setting" if len(self.levels) == 1 else f"{len(self.levels)} different settings"
        text = f"{self.policy} under the safeguard {self.safeguard}: {settings}"
        if self.influences[0] > 0 and half.size:
            i = int(half[0])
            text += (
                f"; a {self.setting} of {self.levels[i]:.3g} halves its influence ({self.influences[0]:.2f} to "
                f"{self.influences[i]:.2f}) and takes {lost[i]:.3g} of its value of {self.values[0]:.4g}"
            )
        return text + "."


class _Lenient(MinimumInfluence):
    """Notes the next larger tolerance at which some decision changes."""

    following = float("inf")

    def review(self, state: None, proposal: Proposal) -> Verdict:
        verdict = super().review(state, proposal)
        if proposal.worth is not None:
            mean = proposal.worth.mean
            influence = self.expected(proposal.mode, proposal.worth)
            for c in np.flatnonzero(influence < influence[verdict.choice] - SAME):
                gap = float(np.nanmax(mean) - mean[c])
                if gap > self.tolerance:
                    self.following = min(self.following, gap * (1 + APART))
        return verdict


class _Doubtful(Confidence):
    """Notes the next higher threshold at which some decision changes."""

    following = float("inf")

    def review(self, state: None, proposal: Proposal) -> Verdict:
        verdict = super().review(state, proposal)
        sure = verdict.numbers.get("probability", 0.0)
        if sure > self.threshold:
            self.following = min(self.following, sure)
        return verdict


def tolerance_steps(watched: Watched, fallback: ModePolicy, truth: Schedule) -> Steps:
    """Minimum influence by its tolerance, from 0.

    Parameters
    ----------
    watched : Watched
        A policy and what its actions are worth, in the draws of `truth`.
    fallback : ModePolicy
    truth : Schedule
    """
    return _steps(
        watched, fallback, truth, "influence", "tolerance", lambda x: _Lenient.of(truth.draws, x), float("inf")
    )


def threshold_steps(watched: Watched, fallback: ModePolicy, truth: Schedule, tolerance: float = 0.0) -> Steps:
    """Confidence by its threshold, from 0.

    Parameters
    ----------
    watched, fallback, truth
        As in `tolerance_steps`.
    tolerance : float
        That of the safeguard.
    """
    return _steps(
        watched, fallback, truth, "confidence", "threshold",
        lambda x: _Doubtful.of(truth.protocol, x, tolerance), 1 - 1e-9,
    )  # fmt: skip


def _steps(
    watched: Watched, fallback: ModePolicy, truth: Schedule, safeguard: str, setting: str,
    made: Callable[[float], Safeguard], top: float,
) -> Steps:  # fmt: skip
    level, levels, runs = 0.0, list[float](), list[GuardedRun]()
    while level < top and len(levels) < MOST_STEPS:
        guard: Any = made(level)
        run = guarded_run(Guarded(watched.policy, [guard], fallback, watched.worth), truth)
        # A setting at which histories change that are never met changes nothing that can be told.
        if not runs or (run.value, run.influence) != (runs[-1].value, runs[-1].influence):
            levels.append(level)
            runs.append(run)
        level = guard.following

    def of(key: str) -> Array:
        return np.array([getattr(r, key) for r in runs])

    return Steps(
        watched.policy.name, safeguard, setting, np.array(levels), of("value"), of("influence"), of("cost"),
        of("changed"), bool(level >= top), truth.cautions, truth.unit,
    )  # fmt: skip
