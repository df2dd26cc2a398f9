r"""Exact planning over a known schedule: the study as it is run.

The best plan is found over the tree of all histories, on unnormalised vectors (`models.planning.history_kernel`):
no belief grid, no tolerance. With several draws the plan is the best one for everything believed of them together:
the Bayes-adaptive optimum, with the draw a part of what is hidden.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.notebook_view import NotebookView
from models.planning.history_kernel import walk_tree
from models.planning.schedule import Array, Event, Schedule
from models.planning.schedule_tree import ScheduleTree, schedule_tree
from models.planning.summed_walk import pays, summed_walk

Decisions = tuple[NDArray[np.int8], ...]
"""A plan: the action of each event, counted within it, by the number of the responses so far."""


@dataclass(frozen=True)
class ExactPlan(NotebookView):
    """The best plan of a schedule.

    Attributes
    ----------
    schedule : Schedule
    value : float
        What it is worth, in the unit of the reward, seen from the first event.
    first_values : float64[a]
        The same for each action at the first event, followed by the best plan.
    decisions : tuple of int8[r]
        By event, an index from 0: its action (counted within its mode) by the responses so far: those are numbered
        :math:`r_{k+1} = r_k O_k + o_k`, with one number in events that show none.
    """

    schedule: Schedule
    value: float
    first_values: Array
    decisions: Decisions

    @property
    def first_action(self) -> str:
        """What to do at the first event."""
        return self.schedule.mode(0).actions[int(self.decisions[0][0])].name

    def rows(self) -> list[dict[str, Any]]:
        """The plan: event (from 1), mode, responses so far, action; one row a history that can be met."""
        out = []
        for k, level in enumerate(self.decisions):
            mode = self.schedule.mode(k)
            for r, a in enumerate(level):
                row = {"event": k + 1, "mode": mode.name, "responses": self.responses(k, r)}
                out.append({**row, "action": mode.actions[a].name})
        return out

    def responses(self, k: int, number: int) -> tuple[str, ...]:
        """Responses before event `k`, an index from 0, from their number."""
        return responses_before(self.schedule, k, number)

    @property
    def table(self) -> Any:
        """`rows` as a data frame."""
        import pandas as pd

        return pd.DataFrame(self.rows())

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        s = self.schedule
        fixed = all(len(set(level.tolist())) == 1 for level in self.decisions)
        waits = "never depends on the responses" if fixed else "depends on the responses"
        return (
            f"The best plan for {s.letters} is worth {self.value:.4g} {s.unit} (discount {s.discount:g}), "
            f"starts with {self.first_action} and {waits}."
        )


def responses_before(schedule: Schedule, k: int, number: int) -> tuple[str, ...]:
    """Responses before event `k` of a schedule, an index from 0, from their number."""
    seen: list[str] = []
    for j in range(k - 1, -1, -1):
        number, o = divmod(number, schedule.n_outcomes(j))
        if schedule.mode(j).shows_response:
            seen.append(schedule.protocol.response_names[o])
    return tuple(reversed(seen))


def solve_schedule(schedule: Schedule) -> ExactPlan:
    """Find the best plan of a schedule.

    Raises
    ------
    InputError
        If there are too many histories to visit.

    Examples
    --------
    >>> from models.lspomdp import LatentStatePOMDP
    >>> stays = LatentStatePOMDP([.5, .5], [[[1, 0], [0, 1]]] * 4, [[[.9, .1], [.2, .8]]] * 2)
    >>> plan = solve_schedule(Schedule.of(stays, "HRH"))
    >>> plan.first_action, round(plan.value, 3)
    ('no_signal', 61.232)
    """
    tree = schedule_tree(schedule)
    return walked(tree)


def walked(tree: ScheduleTree) -> ExactPlan:
    """Find the best plan over a tree that is laid out already; its start is what counts."""
    schedule = tree.schedule
    if pays(tree):
        found = summed_walk(tree)
        return ExactPlan(schedule, found.value, found.first_values, tree.decisions(found.decision, found.picks))
    decision = np.zeros(tree.histories, dtype=np.int8)
    picks = np.zeros((tree.leaves, schedule.n_outcomes(tree.leaf)), dtype=np.int16)
    first = np.zeros(len(schedule.mode(0).actions))
    value = walk_tree(tree.tables, tree.leaf, tree.leaf_vectors, tree.n_plans, tree.offset, decision, picks, first)
    return ExactPlan(schedule, float(value), first, tree.decisions(decision, picks))


def history_values(schedule: Schedule, history: Iterable[Event] = ()) -> dict[str, float]:
    """What each action is worth after any history, also one that no good plan leads to.

    Parameters
    ----------
    schedule : Schedule
    history : iterable of (str, str or None)
        Action and response of each event so far.

    Returns
    -------
    dict of str to float
        By action: expected reward from there on, under the best plan afterwards, discounted to that event.

    Raises
    ------
    InputError
        On a history that cannot be, or one that leaves nothing to decide.
    """
    joint, k = schedule.joint_after(history)
    if k == schedule.n_events:
        raise located("history, events", k, f"fewer than {schedule.n_events}: the schedule is over")
    plan = solve_schedule(schedule.rest(k, joint))
    return dict(zip([a.name for a in schedule.mode(k).actions], plan.first_values.tolist(), strict=True))
