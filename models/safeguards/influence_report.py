"""The influence report: what safeguards change, what that costs, and who is influenced most."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np

from models.notebook_view import NotebookView
from models.planning.baselines import ModePolicy
from models.planning.policies import Array, Policy
from models.planning.schedule import Schedule
from models.reward import UNIT
from models.robust.risk import weighted_quantiles
from models.safeguards.guarded import Guarded
from models.safeguards.guarded_run import GuardedRun, guarded_run
from models.safeguards.safeguard import Safeguard
from models.safeguards.worth import WorthSource

LEVEL = 0.9
"""Share of the draws between the ends of an interval (equal tails)."""

NONE, ALL = "none", "all together"


class Watched(NamedTuple):
    """A policy, and what its actions are worth."""

    policy: Policy
    worth: WorthSource | None = None


@dataclass(frozen=True)
class InfluenceReport(NotebookView):
    """What safeguards change, by policy.

    Attributes
    ----------
    runs : tuple of GuardedRun
        By policy: without safeguards, with each alone, with all together.
    states, responses : tuple of str
    cautions : tuple of str
        Those of the draws (`models.cautions`).
    unit : str
        What values are in: the word of the reward.
    """

    _units: ClassVar = {"cost": "unit of the charges", "influence": "moves a person"}

    runs: tuple[GuardedRun, ...]
    states: tuple[str, ...]
    responses: tuple[str, ...]
    cautions: tuple[str, ...] = ()
    unit: str = UNIT

    def run(self, policy: str, safeguards: str = NONE) -> GuardedRun:
        """One of the runs."""
        return next(r for r in self.runs if (r.policy, r.safeguards) == (policy, safeguards))

    @property
    def policies(self) -> tuple[str, ...]:
        """Names of the policies."""
        return tuple(dict.fromkeys(r.policy for r in self.runs))

    def rows(self) -> list[dict[str, Any]]:
        """One row a policy and set of safeguards.

        ``changed``: share of the decisions; ``withheld``: share of the proposals other than null actions that were
        not carried out as proposed; ``lost``: value lost to the policy without safeguards; ``influence``: how many
        times a person is moved, with the interval over the draws.
        """
        out = []
        for r in self.runs:
            low, high = interval(r.influences, r.weight)
            out.append(
                {
                    "policy": r.policy, "safeguards": r.safeguards, "changed": r.changed, "withheld": r.withheld,
                    "value": r.value, "lost": self.run(r.policy).value - r.value, "cost": r.cost,
                    "most_cost": r.most_cost, "help_rate": r.help_rate, "influence": r.influence,
                    "influence_low": low, "influence_high": high,
                }
            )  # fmt: skip
        return out

    @property
    def table(self) -> Any:
        """`rows` as a data frame."""
        import pandas as pd

        return pd.DataFrame(self.rows())

    def who_rows(self) -> list[dict[str, Any]]:
        """Who is influenced: one row a policy, set of safeguards and kind of person, with intervals over the draws.

        Kinds: by the state they start in, by their first response, and everybody, whose interval is that by draw.
        """
        out = []
        for r in self.runs:
            kinds: list[tuple[str, str, Array]] = [("everybody", "", r.influences)]
            kinds += [("starts as", name, r.by_state[:, i]) for i, name in enumerate(self.states)]
            kinds += [("first response", name, r.by_response[:, o]) for o, name in enumerate(self.responses)]
            for by, who, values in kinds:
                seen = ~np.isnan(values) & (r.weight > 0)
                if not seen.any():
                    continue
                weight = r.weight[seen] / r.weight[seen].sum()
                low, high = interval(values[seen], weight)
                out.append(
                    {
                        "policy": r.policy, "safeguards": r.safeguards, "by": by, "who": who,
                        "influence": float(weight @ values[seen]), "low": low, "high": high,
                    }
                )  # fmt: skip
        return out

    @property
    def who(self) -> Any:
        """`who_rows` as a data frame."""
        import pandas as pd

        return pd.DataFrame(self.who_rows())

    def most_influenced(self, policy: str, safeguards: str = NONE) -> dict[str, Any]:
        """The starting state whose people are influenced most."""
        own = [
            row
            for row in self.who_rows()
            if (row["policy"], row["safeguards"], row["by"]) == (policy, safeguards, "starts as")
        ]
        return max(own, key=lambda row: row["influence"])

    @property
    def sentence(self) -> str:
        """What the table says of the first policy."""
        name = self.policies[0]
        bare = self.run(name)
        text = (
            f"{name} moves a person {bare.influence:.2f} times over {bare.schedule}, at an expected cost of "
            f"{bare.cost:.3g} and at most {bare.most_cost:g}"
        )
        sets = [r for r in self.runs if r.policy == name and r.safeguards != NONE]
        if sets:
            r = sets[-1]
            lost = bare.value - r.value
            guards = "all safeguards together" if r.safeguards == ALL else f"the safeguard {r.safeguards}"
            text += (
                f"; {guards} change{'' if r.safeguards == ALL else 's'} {r.changed:.0%} of its decisions, which "
                f"takes {lost:.3g} of its value of {bare.value:.4g} and leaves {r.influence:.2f} moves"
            )
        most = self.most_influenced(name)
        return f"{text}; most influenced are people who start as {most['who']} ({most['influence']:.2f})."

    def to_dict(self) -> dict[str, Any]:
        """Plain content."""
        return {"runs": self.rows(), "who": self.who_rows(), "changed_by": [r.changed_by for r in self.runs]}


def influence_report(
    watched: Sequence[Watched], guards: Mapping[str, Sequence[Safeguard]], fallback: ModePolicy, truth: Schedule,
    charges: Array | None = None,
) -> InfluenceReport:  # fmt: skip
    """Follow policies without safeguards and with each set of them.

    Parameters
    ----------
    watched : sequence of Watched
        Policies with what their actions are worth.
    guards : mapping of str to sequence of Safeguard
        Sets of safeguards by name. Those that need to know what actions are worth pass over policies of which
        nobody can say.
    fallback : ModePolicy
    truth : Schedule
        What people are like.
    charges : float64[a], optional
        As in `guarded_run`.
    """
    runs = []
    for policy, worth in watched:
        runs.append(guarded_run(policy, truth, charges, NONE))
        for name, own in guards.items():
            guarded = Guarded(policy, own, fallback, worth)
            runs.append(guarded_run(guarded, truth, charges, name))
    states = truth.draws.model(0).state_names
    return InfluenceReport(tuple(runs), states, truth.protocol.response_names, truth.cautions, truth.unit)


def interval(values: Array, weight: Array) -> tuple[float, float]:
    """Ends of the interval over draws."""
    low, high = weighted_quantiles(values, weight, ((1 - LEVEL) / 2, (1 + LEVEL) / 2))
    return low, high
