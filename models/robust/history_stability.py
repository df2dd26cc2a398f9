r"""Decision stability along a study: after every history, which action each draw would take next.

The same responses move the belief differently in every draw, and they say how believable the draw itself is:
:math:`w_i(h) \propto w_i P_i(h)`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.errors import Phrase, located
from models.lspomdp import LatentStatePOMDP
from models.notebook_view import NotebookView
from models.planning.arrays import Array
from models.planning.batch import BatchSolution
from models.planning.mode_process import schedule_modes
from models.planning.policies import Policy
from models.robust.belief_stability import UNDECIDED, BeliefStability, belief_stability

POSSIBLE = 1e-12
"""Histories less probable than that are left out."""

ROUNDING = 1e-9
"""A share of percents below this is rounding."""

LIKELY = 0.01
"""Histories less probable than that are not looked at for the most divided one."""


@dataclass(frozen=True)
class EventStability:
    """Decisions at one event, history by history.

    Attributes
    ----------
    event : int
        From 0.
    histories : tuple of tuple of str
        Actions and responses so far, ``action`` or ``action: response``.
    probability : float64[g]
        Of each history, by what is believed of the draws.
    stability : BeliefStability
    """

    event: int
    histories: tuple[tuple[str, ...], ...]
    probability: Array
    stability: BeliefStability

    def rows(self) -> list[dict[str, Any]]:
        """One row a history: shares of the actions, undecided, losses."""
        s = self.stability
        return [
            {
                "event": self.event + 1, "mode": s.mode, "history": ", ".join(h) or "nothing yet",
                "probability": float(p), **s.shares(g), **{f"loss of {a}": v for a, v in s.losses(g).items()},
            }
            for g, (h, p) in enumerate(zip(self.histories, self.probability, strict=True))
        ]  # fmt: skip

    @property
    def mean_shares(self) -> dict[str, float]:
        """Shares by action, histories weighted by how probable they are."""
        p = self.probability / self.probability.sum()
        names = [*self.stability.actions, UNDECIDED]
        return dict(zip(names, [*(p @ self.stability.share).tolist(), float(p @ self.stability.undecided)],
                        strict=True))  # fmt: skip


@dataclass(frozen=True)
class HistoryStability(NotebookView):
    """Decisions of all draws along a study.

    Attributes
    ----------
    letters : str
        The study's schedule.
    policy : str
        Name of what the robot does until then.
    events : tuple of EventStability
    null_actions : mapping of str to str
        Of every mode.
    cautions : tuple of str
        Those of the draws (`models.cautions`).
    """

    letters: str
    policy: str
    events: tuple[EventStability, ...]
    null_actions: Mapping[str, str]
    cautions: tuple[str, ...] = ()

    def rows(self) -> list[dict[str, Any]]:
        """One row a history."""
        return [row for event in self.events for row in event.rows()]

    @property
    def table(self) -> Any:
        """One row an event, histories weighted by how probable they are, as a data frame."""
        import pandas as pd

        rows = []
        for e in self.events:
            p = e.probability / e.probability.sum()
            losses = dict(zip(e.stability.actions, (p @ e.stability.loss).tolist(), strict=True))
            rows.append(
                {
                    "event": e.event + 1, "mode": e.stability.mode,
                    "prefer": _in_percent(e.mean_shares),
                    "lose": ", ".join(f"{a} {v:.2g}" for a, v in losses.items()),
                    "histories": len(e.histories),
                }
            )  # fmt: skip
        return pd.DataFrame(rows)

    @property
    def most_divided(self) -> tuple[EventStability, int]:
        """Event, and number of the history there, of those likely to come up at which draws agree least.

        Undecided draws go with any other; of equals it is the one where the best action for all loses most.
        """
        found = [
            (float(e.stability.share[g].max() + e.stability.undecided[g]), -float(e.stability.loss[g].min()), k, g)
            for k, e in enumerate(self.events)
            for g in range(len(e.histories))
            if e.probability[g] >= LIKELY
        ]
        *_, k, g = min(found)
        return self.events[k], g

    @property
    def sentence(self) -> str:
        """Where the draws disagree most, and what that costs."""
        event, g = self.most_divided
        s = event.stability
        after = f" after {', '.join(event.histories[g])}" if event.histories[g] else ""
        shares = _in_percent(s.shares(g))
        losses = ", ".join(f"{a} {v:.2g}" for a, v in s.losses(g).items())
        return (
            f"Without an end, along {self.letters} with {self.policy}, at {s.whose}: the draws are most divided at "
            f"event {event.event + 1} ({s.mode}){after}: {shares}; what each loses on average: {losses}."
        )


def _in_percent(shares: Mapping[str, float]) -> str:
    """Shares in whole percents that sum to a hundred: the largest remainders are rounded up."""
    values = 100 * np.array(list(shares.values()))
    whole = np.floor(values + ROUNDING)
    up = np.argsort(whole - values, kind="stable")[: round(float(values.sum() - whole.sum()))]
    whole[up] += 1
    return ", ".join(f"{name} {v:.0f}%" for name, v in zip(shares, whole, strict=True))


def history_stability(
    solution: BatchSolution, schedule: str | Sequence[str], policy: Policy, *,
    tracker: LatentStatePOMDP | None = None, executor: Executor | None = None,
) -> HistoryStability:  # fmt: skip
    """What each draw would do next, after every history that a policy may meet over a schedule.

    The schedule says which histories there are. What an action is worth is counted without horizon, with modes as
    the solution has them.

    Parameters
    ----------
    solution : BatchSolution
    schedule : str or sequence of str
        Letters or names of modes.
    policy : Policy
        What the robot does until then; it may not leave actions to chance.
    tracker : LatentStatePOMDP, optional
        The model that the robot's belief is made with, one belief for all draws. By default every draw has its own
        belief, from its own filter.
    executor : concurrent.futures.Executor, optional

    Raises
    ------
    InputError
        On a schedule that is none, a policy that randomises, a tracker of another size.
    """
    draws = solution.batch.draws
    p, n = draws.protocol, draws.n_states
    modes = schedule_modes(p, schedule)
    if tracker is not None and (tracker.n_states != n or tracker.protocol != p):
        raise located("tracker, states and protocol", tracker.n_states, f"{n} and the protocol of the draws")
    level: list[tuple[tuple[str, ...], Any, Array, Array | None]] = [
        ((), policy.begin(modes[0]), draws.initial, None if tracker is None else tracker.initial)
    ]
    out = []
    for k, x in enumerate(modes):
        reached = np.stack([w.sum(axis=1) for _, _, w, _ in level], axis=1)
        if tracker is None:
            own = np.stack([w for _, _, w, _ in level], axis=1)
            # A draw in which the history is impossible has no weight there, and any belief will do.
            safe = np.where(reached[:, :, None] > 0, own, 1.0)
            beliefs = safe / safe.sum(axis=2, keepdims=True)
        else:
            beliefs = np.stack([b / b.sum() for *_, b in level if b is not None])
        joint = draws.weight[:, None] * reached
        found = belief_stability(solution, beliefs, x, weight=joint, executor=executor)
        out.append(EventStability(k, tuple(h for h, *_ in level), joint.sum(axis=0), found))
        if k + 1 < len(modes):
            level = [new for old in level for new in _after(draws, old, policy, tracker, modes[k + 1])]
    nulls = {m.name: m.null_action for m in p.modes}
    letters = "".join(p.modes[x].letter for x in modes)
    return HistoryStability(letters, policy.name, tuple(out), nulls, draws.cautions)


def _after(
    draws: Any, old: tuple[tuple[str, ...], Any, Array, Array | None], policy: Policy,
    tracker: LatentStatePOMDP | None, next_mode: int,
) -> list[tuple[tuple[str, ...], Any, Array, Array | None]]:  # fmt: skip
    """The histories that follow one of them."""
    history, memory, w, belief = old
    p = draws.protocol
    x = policy.mode_of(memory)
    share = policy.probabilities(memory)
    if np.count_nonzero(share) != 1:
        raise located(f"policy {policy.name}", Phrase("actions left to chance"), "one action after each history")
    choice = int(np.argmax(share))
    name = p.modes[x].actions[choice].name
    a = p.action(name)
    row = p.emission_index[a]
    out = []
    for o in [None] if row < 0 else range(p.n_responses):
        seen = w if o is None else w * draws.emission[:, row, :, o]
        after = np.einsum("ds,dst->dt", seen, draws.transition[:, a])
        if draws.weight @ after.sum(axis=1) <= POSSIBLE:
            continue
        own = None
        if belief is not None and tracker is not None:
            own = (belief if o is None else belief * tracker.emission[row, :, o]) @ tracker.transition[a]
            if own.sum() <= 0:
                words = ", ".join([*history, f"{name}: {p.response_names[o or 0]}"])
                raise located("tracker, probability of a history", Phrase(f"zero for {words}"), "above zero")
        words = name if o is None else f"{name}: {p.response_names[o]}"
        observed = 0 if o is None else o + 1
        out.append(((*history, words), policy.observe(memory, choice, observed, next_mode), after, own))
    return out
