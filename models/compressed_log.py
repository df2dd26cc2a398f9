"""A log too large to be held, as what learning needs of it: the tree of its histories, totals, facts of its design.

`LogTally` counts while checked events come in, sorted by participant and sequence, in parts of any size;
`CompressedLog` is the result. People and runs are counted and not kept, so memory does not grow with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from models.compiled import kernel
from models.condition_trees import ConditionTrees
from models.design_facts import DesignFacts, facts_of_tree
from models.errors import located
from models.event_rules import one_of
from models.growing_tree import GrowingTree
from models.histories import UNSEEN, HistoryTree
from models.notebook_view import NotebookView, Rows, View
from models.protocol import Protocol

COUNTS = ("events", "runs", "people", "responses", "missing")
"""What is counted for each condition; somebody in two conditions counts in both."""


@dataclass(frozen=True)
class CompressedLog(NotebookView):
    """What learning takes from an event log.

    Attributes
    ----------
    protocol : Protocol
    study : str
    conditions : tuple of str
        Those that are compressed here, sorted.
    histories : HistoryTree
        Of the runs in these conditions.
    counts : pandas.DataFrame
        `COUNTS` of every condition of the log, in rows by name; those not compressed included.
    n_participants : int
        People with a run in these conditions.
    emission_weights : float64[e]
        Recorded responses under each action that shows one.
    design : DesignFacts
    whole : tuple of int
        Events, people and runs of the whole log.
    digest : str
        That of the whole log, or of these conditions where that was asked for (`analysis.datasets.log_digest`);
        empty if none was.
    counts_by_condition : float64[condition, history] or None
        How many runs of each of `conditions` have each history; None if it was not counted.
    """

    protocol: Protocol
    study: str
    conditions: tuple[str, ...]
    histories: HistoryTree
    counts: pd.DataFrame
    n_participants: int
    emission_weights: NDArray[np.float64]
    design: DesignFacts
    whole: tuple[int, int, int]
    digest: str = ""
    counts_by_condition: NDArray[np.float64] | None = None

    def tree(self) -> HistoryTree:
        """Distinct histories with counts (`models.histories`)."""
        return self.histories

    @property
    def n_events(self) -> int:
        """Number of events."""
        return self._total("events")

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return self._total("runs")

    @property
    def n_responses_recorded(self) -> int:
        """Number of recorded responses: the sample size of every information criterion here."""
        return self._total("responses")

    @property
    def n_missing(self) -> int:
        """Responses that could have been seen but were not recorded."""
        return self._total("missing")

    def _total(self, what: str) -> int:
        return int(self.counts.loc[list(self.conditions), what].sum())

    def __repr__(self) -> str:
        return (
            f"CompressedLog({self.study!r}: {self.n_participants} people, {self.n_runs} runs, {self.n_events} "
            f"events as {self.histories.n_histories} histories, {len(self.conditions)} conditions)"
        )

    def _view(self) -> View:
        told = (
            f"Study {self.study}: {self.n_participants:,} people, {self.n_runs:,} runs and {self.n_events:,} "
            f"events as {self.histories.n_histories:,} distinct histories; {self.n_responses_recorded:,} responses."
        )
        notes = (f"{self.n_missing:,} responses are missing.",) if self.n_missing else ()
        shown = self.counts.rename_axis("condition").reset_index()
        return View("Compressed log", "", (), notes, (told,), (Rows(shown, len(shown), ".counts"),))


class LogTally:
    """Takes checked events in order and becomes a `CompressedLog`.

    Parameters
    ----------
    protocol : Protocol
    conditions : sequence of str, optional
        Those whose runs are compressed; all unless given. The others are counted.
    most_nodes, keep_runs
        As in `GrowingTree`.
    by_condition : bool
        Count histories by condition, as the gate of a posterior wants it. Runs cannot be kept beside.
    """

    def __init__(
        self, protocol: Protocol, conditions: Sequence[str] | None = None, most_nodes: int | None = None,
        keep_runs: bool = False, by_condition: bool = False,
    ) -> None:  # fmt: skip
        if by_condition and keep_runs:
            raise located("keep_runs", keep_runs, "False where histories are counted by condition")
        self.protocol = protocol
        self._chosen = None if conditions is None else frozenset(conditions)
        sizes = protocol.n_actions, protocol.n_responses
        self._tree: GrowingTree | ConditionTrees
        if by_condition:
            self._tree = ConditionTrees(*sizes, most_nodes)
        else:
            self._tree = GrowingTree(*sizes, most_nodes, keep_runs)
        self._names: list[str] = []
        self._wanted = np.zeros(0, dtype=bool)
        self._counts = np.zeros((0, len(COUNTS)), np.int64)
        self._last_person = np.zeros(0, np.int64)
        n = protocol.n_actions
        self._pairs = np.zeros((3, n, n), dtype=bool)
        self._person = np.zeros((2, n), dtype=bool)
        self._recorded = np.zeros(n, np.int64)
        # Participant, how many people came so far, condition of the open run, whether the person counts, and how
        # many people counted.
        self._state = np.array([-1, 0, -1, 0, 0], dtype=np.int64)
        self._shows = np.asarray(protocol.emission_index) >= 0

    def add(
        self, starts: NDArray[np.int64], participant: NDArray[np.int64], condition: NDArray[np.int32],
        names: Sequence[str], action: NDArray[np.int8], response: NDArray[np.int8],
    ) -> None:  # fmt: skip
        """Take the next events.

        Parameters
        ----------
        starts : int64[runs]
            Where runs begin among these events; those before go on with the run that is open.
        participant : int64[events]
        condition : int32[events]
            Codes into `names`.
        names : sequence of str
            May have become longer since the last call, and is otherwise the same.
        action, response : int8[events]
            Codes; `UNSEEN` where no response was seen.
        """
        self._extend_to(names)
        wanted = self._wanted[condition[starts]]
        _tally(
            starts, participant, condition, action, response, self._wanted, self._shows, self._counts,
            self._last_person, self._pairs, self._person, self._recorded, self._state,
        )  # fmt: skip
        if isinstance(self._tree, ConditionTrees):
            self._tree.add(starts, condition[starts], wanted, action, response)
        else:
            self._tree.add(starts, wanted, action, response)

    def finish(self, study: str, digest: str = "") -> CompressedLog:
        """The result.

        Raises
        ------
        InputError
            If a condition was asked for that the log does not have.
        """
        _end_person(self._person, self._pairs, self._state)
        used = [i for i in range(len(self._names)) if self._counts[i, 1]]
        names = sorted(self._names[i] for i in used)
        chosen = names if self._chosen is None else sorted(self._chosen)
        for name in chosen:
            if name not in names:
                raise located("condition", name, one_of(names))
        rows = np.array([self._counts[self._names.index(name)] for name in names])
        by_condition = None
        if isinstance(self._tree, ConditionTrees):
            tree, of_code = self._tree.finish()
            by_condition = np.stack([of_code[self._names.index(name)] for name in chosen])
        else:
            tree = self._tree.finish()
        weights = np.zeros(len(self.protocol.emission_actions))
        weights[np.asarray(self.protocol.emission_index)[self._shows]] = self._recorded[self._shows]
        followed, alternating = facts_of_tree(tree, self.protocol)
        return CompressedLog(
            self.protocol, study, tuple(chosen), tree, pd.DataFrame(rows, names, COUNTS), int(self._state[4]),
            weights, DesignFacts(followed, alternating, *self._pairs),
            (int(rows[:, 0].sum()), int(self._state[1]), int(rows[:, 1].sum())), digest,
            by_condition,
        )  # fmt: skip

    def _extend_to(self, names: Sequence[str]) -> None:
        more = len(names) - len(self._names)
        if more <= 0:
            return
        new = list(names[len(self._names) :])
        self._names += new
        self._wanted = np.append(self._wanted, [self._chosen is None or name in self._chosen for name in new])
        self._counts = np.concatenate([self._counts, np.zeros((more, len(COUNTS)), np.int64)])
        self._last_person = np.append(self._last_person, np.zeros(more, np.int64))


@kernel
def _tally(  # type: ignore[no-untyped-def]
    starts, participant, condition, action, response, wanted, shows, counts, last_person, pairs, person, recorded,
    state,
):  # fmt: skip
    """Count by condition, and note which actions each person met."""
    run = 0
    group = state[2]
    for i in range(len(action)):
        if run < len(starts) and starts[run] == i:
            run += 1
            if participant[i] != state[0]:
                _end_person(person, pairs, state)
                state[0] = participant[i]
                state[1] += 1
            group = np.int64(condition[i])
            counts[group, 1] += 1
            if last_person[group] != state[1]:
                last_person[group] = state[1]
                counts[group, 2] += 1
        a = action[i]
        counts[group, 0] += 1
        if shows[a]:
            if response[i] == UNSEEN:
                counts[group, 4] += 1
            else:
                counts[group, 3] += 1
                if wanted[group]:
                    recorded[a] += 1
                    person[1, a] = True
        if wanted[group]:
            state[3] = 1
            person[0, a] = True
    state[2] = group


@kernel
def _end_person(person, pairs, state):  # type: ignore[no-untyped-def]
    """Note what the person met together, and forget it."""
    if state[3] == 0:
        return
    state[3] = 0
    state[4] += 1
    n = person.shape[1]
    for a in range(n):
        if person[0, a]:
            for b in range(n):
                if person[0, b]:
                    pairs[0, a, b] = True
                    if person[1, a]:
                        pairs[2, a, b] = True
                        if person[1, b]:
                            pairs[1, a, b] = True
    for a in range(n):
        person[0, a] = False
        person[1, a] = False
