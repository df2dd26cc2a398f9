r"""How sure is each decision of a plan: what the draws would do at the same place, and what the robot has learned.

At every history that the plan leads to, each draw says what it would do and what every action is worth to it, all
later decisions being its own best. Its opinion depends on the belief about the person. By default every draw holds
its own belief there, the one its own tables give after this history; with a `tracker` all hold the belief of that
one model, as a robot does that filters with fixed tables.
"""

from __future__ import annotations

from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.errors import located
from models.lspomdp import LatentStatePOMDP
from models.notebook_view import NotebookView
from models.planning.exact import Decisions, ExactPlan
from models.planning.schedule import Array, Schedule
from models.robust.draw_groups import DrawGroups
from models.robust.information import beyond_rounding
from models.robust.many_weights import ManyWeights
from models.robust.own_plans import own_plans

LIKELY = 0.01
"""Histories less probable than that are not looked at for the least sure decision."""

ROUNDING = 1e-12
"""Bits below this are rounding."""


@dataclass(frozen=True)
class Standing:
    r"""One decision of a plan.

    Attributes
    ----------
    event : int
        An index, from 0; tables and sentences count from 1.
    mode : str
    responses : tuple of str
        Those before the event.
    probability : float
        Of this history under the plan, by what is believed.
    action : str
        What the plan does.
    share : dict of str to float
        Share of the draws, weighted by what is believed of them after this history, that prefer each action.
    loss : dict of str to float
        Expected loss of each action against the best of each draw, in the reward's unit, of that event.
    effective_draws : float
        Effective number of draws after this history, :math:`1 / \sum_i w_i^2`.
    information : float
        What the history has told of the draws, in bits (relative entropy from before the first event).
    weight : float64[u]
        What is believed of the draws after this history.
    """

    event: int
    mode: str
    responses: tuple[str, ...]
    probability: float
    action: str
    share: dict[str, float]
    loss: dict[str, float]
    effective_draws: float
    information: float
    weight: Array

    @property
    def regret(self) -> float:
        """What the plan's action costs on average in the draws that prefer another one; 0 if none does."""
        wrong = 1 - self.share[self.action]
        return self.loss[self.action] / wrong if wrong > 1e-12 else 0.0

    @property
    def words(self) -> str:
        """How sure the decision is."""
        agree = self.share[self.action]
        if agree > 1 - 1e-12:
            return f"{self.action} first is right in every draw."
        return (
            f"{self.action} first is right in {agree:.0%} of the draws; being wrong costs {self.regret:.2g} on "
            "average."
        )


@dataclass(frozen=True)
class Stability(NotebookView):
    """All decisions of a plan.

    Attributes
    ----------
    schedule : Schedule
    beliefs : str
        Whose beliefs the draws act on.
    standings : tuple of Standing
    """

    schedule: Schedule
    beliefs: str
    standings: tuple[Standing, ...]

    @property
    def table(self) -> Any:
        """One row a decision, as a data frame."""
        import pandas as pd

        return pd.DataFrame(
            [
                {
                    "event": x.event + 1, "mode": x.mode, "responses": ", ".join(x.responses) or "-",
                    "probability": x.probability, "action": x.action, "agree": x.share[x.action],
                    "loss": x.loss[x.action], "effective_draws": x.effective_draws, "information": x.information,
                }
                for x in self.standings
            ]
        )  # fmt: skip

    @property
    def by_event(self) -> Any:
        """One row an event, as a data frame.

        How many of the draws agree with the plan on average over its histories; the decision that fewest agree with
        of those likely to come up; and what the responses have told of the draws, in bits and effective draws.
        """
        import pandas as pd

        rows = []
        for k in range(self.schedule.n_events):
            own = [x for x in self.standings if x.event == k]
            chance = np.array([x.probability for x in own])
            chance /= chance.sum()
            least = min(
                (x for x in own if x.probability >= LIKELY), key=lambda x: x.share[x.action], default=own[0]
            )
            rows.append(
                {
                    "event": k + 1, "mode": self.schedule.mode(k).name,
                    "agree": float(sum(p * x.share[x.action] for p, x in zip(chance, own, strict=True))),
                    "least_sure": least.action, "after": ", ".join(least.responses) or "-",
                    "least_agree": least.share[least.action], "wrong_costs": least.regret,
                    "bits": float(sum(p * x.information for p, x in zip(chance, own, strict=True))),
                    "effective_draws": float(sum(p * x.effective_draws for p, x in zip(chance, own, strict=True))),
                }
            )  # fmt: skip
        return pd.DataFrame(rows)

    def rows(self) -> list[dict[str, Any]]:
        """One row a decision, with the share of the draws that prefer each action and what each loses."""
        return [
            {
                "event": x.event + 1, "mode": x.mode, "responses": list(x.responses), "probability": x.probability,
                "action": x.action, "shares": x.share, "losses": x.loss, "effective_draws": x.effective_draws,
                "bits": x.information,
            }
            for x in self.standings
        ]  # fmt: skip

    @property
    def agreement(self) -> float:
        """Mean share of the draws that agree with the plan, over its events and histories."""
        chance = np.array([x.probability for x in self.standings])
        agree = np.array([x.share[x.action] for x in self.standings])
        return float(chance @ agree / chance.sum())

    @property
    def least_sure(self) -> Standing:
        """The decision that fewest draws agree with, of those that are likely to come up."""
        return min((x for x in self.standings if x.probability >= LIKELY), key=lambda x: x.share[x.action])

    @property
    def headline(self) -> str:
        """How sure the first decision is; where every draw agrees with it, the least sure one as well."""
        first, least = self.standings[0], self.least_sure
        words = first.words[:-1]
        if first.share[first.action] <= 1 - 1e-12 or least.share[least.action] > 1 - 1e-12:
            return words
        after = f" after {', '.join(least.responses)}" if least.responses else ""
        return (
            f"{words}, {least.action} at event {least.event + 1}{after} in {least.share[least.action]:.0%}; being "
            f"wrong there costs {least.regret:.2g} on average"
        )

    @property
    def sentence(self) -> str:
        """The first decision, the least sure one, and what is learned on the way."""
        return f"{self.standings[0].words} {self.weakest}"

    @property
    def weakest(self) -> str:
        """The least sure decision of those that are likely to come up, and what is learned on the way."""
        least = self.least_sure
        end = [x for x in self.standings if x.event == self.schedule.n_events - 1]
        bits = sum(x.probability * x.information for x in end) / sum(x.probability for x in end)
        after = f" after {', '.join(least.responses)}" if least.responses else ""
        return (
            f"The least sure decision is {least.action} at event {least.event + 1}{after}: "
            f"{least.share[least.action]:.0%} agree, and where it is wrong it costs {least.regret:.2g} on average. "
            f"By the last event the responses have told {bits:.2g} bits of the draws."
        )


def decision_stability(
    schedule: Schedule,
    plan: ExactPlan | Decisions,
    tracker: LatentStatePOMDP | None = None,
    executor: Executor | None = None,
    *,
    kinds: int = 1,
) -> Stability:
    """What the draws say to every decision of a plan.

    Parameters
    ----------
    schedule : Schedule
    plan : ExactPlan or Decisions
    tracker : LatentStatePOMDP, optional
        Model whose belief all draws act on; each draw's own by default.
    executor : concurrent.futures.Executor, optional
    kinds : int
        Where people differ: kinds of people in each draw (`models.robust.people_draws`). Draws then judge by their
        belief about the kind of person too.

    Raises
    ------
    InputError
        If the tracker has other states or another protocol than the draws, or takes a history for impossible.
    """
    decisions = plan.decisions if isinstance(plan, ExactPlan) else plan
    follower = None
    if tracker is not None:
        if tracker.n_states != schedule.n_states or tracker.protocol != schedule.protocol:
            found = f"{tracker.n_states} states, protocol {tracker.protocol.name}"
            raise located("stability, tracker", found, f"{schedule.n_states} states, the protocol of the draws")
        follower = replace(Schedule.of(tracker, "".join(m.letter for m in schedule.protocol.modes)),
                           modes=schedule.modes)  # fmt: skip
    prior = DrawGroups.of(schedule.draws, kinds).weight
    out: list[Standing] = []
    level: list[tuple[tuple[str, ...], Array, Array | None]] = [
        ((), schedule.start(), None if follower is None else follower.start())
    ]
    names = schedule.protocol.response_names
    for k in range(schedule.n_events):
        mode, after = schedule.mode(k), []
        for number, (responses, joint, belief) in enumerate(level):
            choice = int(decisions[k][number])
            action = schedule.first_action(k) + choice
            total = float(joint.sum())
            if total > 0:
                out.append(
                    _standing(
                        schedule, k, responses, joint, belief, mode.actions[choice].name, prior, executor, kinds
                    )
                )
            for o in range(schedule.n_outcomes(k)):
                seen = o if mode.shows_response else None
                next_belief = None
                if follower is not None and belief is not None:
                    next_belief = follower.after(belief, action, seen)
                told = (*responses, names[o]) if mode.shows_response else responses
                after.append((told, schedule.after(joint, action, seen), next_belief))
        level = after
    whose = "each draw's own" if tracker is None else "those of one fixed model"
    return Stability(schedule, whose, tuple(out))


def _standing(
    schedule: Schedule, k: int, responses: tuple[str, ...], joint: Array, belief: Array | None, action: str,
    prior: Array, executor: Executor | None, kinds: int,
) -> Standing:  # fmt: skip
    rest = schedule.rest(k, joint)
    if belief is not None:
        mass = belief.sum()
        if mass <= 0:
            raise located(
                "stability, tracker", f"probability zero for {', '.join(responses)}", "a possible history"
            )
        same = np.broadcast_to(belief[0] / mass, rest.draws.initial.shape)
        rest = replace(rest, draws=replace(rest.draws, initial=np.ascontiguousarray(same)))
    groups = DrawGroups.of(rest.draws, kinds)
    if kinds == 1:
        first = own_plans(rest, executor).first_values
    else:
        first = ManyWeights(rest).group_optima(groups.share).first_values
    weight, best = groups.weight, first.max(axis=1)
    names = [a.name for a in schedule.mode(k).actions]
    # Draws to which two actions are worth the same, up to rounding, do not disagree with either.
    lost = beyond_rounding(best[:, None] - first, max(1.0, float(np.abs(first).max())))
    planned = names.index(action)
    chosen = np.where(lost[:, planned] == 0, planned, np.argmin(lost, axis=1))
    share = {name: float(weight[chosen == a].sum()) for a, name in enumerate(names)}
    loss = {name: float(weight @ lost[:, a]) for a, name in enumerate(names)}
    positive = weight > 0
    bits = float(np.sum(weight[positive] * np.log2(weight[positive] / prior[positive])))
    bits = bits if bits > ROUNDING else 0.0
    return Standing(
        k, schedule.mode(k).name, responses, float(joint.sum()), action, share, loss,
        float(1 / np.sum(weight**2)), bits, weight,
    )  # fmt: skip
