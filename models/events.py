"""The event log: every source of data in one coded form, checked rule by rule.

An event is one round: who is in need (mode), what the robot did (action), how the human responded. A *run* is
one unbroken sequence of events of one participant and starts from the initial belief; a participant may have
several. Checked logs are stored per run (participant, sequence, condition) and per event (action, response):
the mode follows from the action, and `k` from the position.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from models.design_facts import DesignFacts, facts_of_events
from models.errors import Phrase, located
from models.event_rules import (
    COLUMNS,
    INTEGER_COLUMNS,
    TOKEN_COLUMNS,
    Coded,
    EventLogError,
    Problem,
    Problems,
    check_columns,
    label_at,
    one_of,
    response_labels,
)
from models.event_scan import scan_sorted
from models.histories import UNSEEN, HistoryTree
from models.notebook_view import MOST_ROWS, NotebookView, Rows, View
from models.protocol import PUBLISHED, Protocol

__all__ = ["COLUMNS", "INTEGER_COLUMNS", "TOKEN_COLUMNS", "Coded", "EventLog", "EventLogError", "Problem"]


@dataclass(frozen=True)
class EventLog(NotebookView):
    """A checked event log.

    Attributes
    ----------
    protocol : Protocol
    study : str
    offsets : int64[runs + 1]
        Events of run i are ``offsets[i] : offsets[i + 1]``; runs are sorted by participant, then sequence.
    participant, sequence : int64[runs]
    condition : int32[runs]
        Codes into `conditions`.
    conditions : tuple of str
        Sorted.
    action, response : int8[events]
        Response is `UNSEEN` in silent modes and where the record is missing.
    tokens : mapping of str to float64[events]
        Token counts where the file has them.
    """

    protocol: Protocol
    study: str
    offsets: NDArray[np.int64]
    participant: NDArray[np.int64]
    sequence: NDArray[np.int64]
    condition: NDArray[np.int32]
    conditions: tuple[str, ...]
    action: NDArray[np.int8]
    response: NDArray[np.int8]
    tokens: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)

    # -- construction ------------------------------------------------------------------------------
    @classmethod
    def from_columns(
        cls,
        columns: Mapping[str, NDArray | Coded],
        protocol: Protocol = PUBLISHED,
        place: str = "event log",
    ) -> EventLog:
        """Check coded columns and store them by run.

        Parameters
        ----------
        columns : mapping
            The schema's columns: integers for participant, sequence and k, `Coded` for the text columns,
            floats for tokens (NaN where empty).
        protocol : Protocol
        place : str
            Named in errors, usually the file.

        Raises
        ------
        EventLogError
            With every broken rule (see `Problem`).
        """
        if len(cast(NDArray, columns["k"])) == 0:
            raise located(place, Phrase("no events"), "at least one row below the header")
        if protocol.n_actions > 127 or protocol.n_responses > 127:
            raise located(f"{place}, protocol", protocol.n_actions, "at most 127 actions and 127 responses")
        study, condition = cast(Coded, columns["study"]), cast(Coded, columns["condition"])
        scanned = scan_sorted(columns, protocol)
        if scanned is not None:
            offsets, actions, responses = scanned
            first = offsets[:-1]
            participant, sequence = (np.asarray(columns[c])[first] for c in ("participant", "sequence"))
            run_condition = condition.codes[first]
            tokens = {c: np.asarray(columns[c], dtype=np.float64) for c in TOKEN_COLUMNS if c in columns}
        else:
            checked = check_columns(columns, protocol, place)
            offsets, tokens = checked.offsets, checked.tokens
            first = offsets[:-1]
            participant, sequence = checked.participant[first], checked.sequence[first]
            run_condition = checked.condition.codes[first]
            actions = checked.action.astype(np.int8)
            responses = np.maximum(checked.response - 2, UNSEEN).astype(np.int8)
        used = np.unique(run_condition)
        labels = [str(condition.labels[c]) for c in used]
        rank = np.argsort(np.argsort(np.array(labels, dtype=object)))
        lookup = np.full(int(used.max()) + 1, -1, dtype=np.int32)
        lookup[used] = rank
        return cls(
            protocol,
            label_at(study, 0),
            offsets,
            participant.astype(np.int64),
            sequence.astype(np.int64),
            lookup[run_condition],
            tuple(sorted(labels)),
            actions,
            responses,
            tokens,
        )

    @classmethod
    def from_frame(cls, frame: pd.DataFrame, protocol: Protocol = PUBLISHED, place: str = "event log") -> EventLog:
        """Check a data frame with the schema's columns; errors count its first row as line 2."""
        missing = [c for c in COLUMNS if c not in frame.columns]
        if missing:
            raise located(f"{place}, columns", list(map(str, frame.columns)), f"also {', '.join(missing)}")
        columns: dict[str, NDArray | Coded] = {}
        for name in COLUMNS:
            if name in INTEGER_COLUMNS:
                columns[name] = _integers(frame[name], name, place)
            else:
                codes, labels = pd.factorize(frame[name].astype(object), use_na_sentinel=True)
                columns[name] = Coded(codes.astype(np.int64), [str(v) for v in labels])
        for name in TOKEN_COLUMNS:
            if name in frame.columns:
                columns[name] = _numbers(frame[name], name, place)
        return cls.from_columns(columns, protocol, place)

    # -- sizes -------------------------------------------------------------------------------------
    @property
    def n_events(self) -> int:
        """Number of events."""
        return len(self.action)

    @property
    def n_runs(self) -> int:
        """Number of runs."""
        return len(self.participant)

    @cached_property
    def n_participants(self) -> int:
        """Number of people."""
        return int(np.count_nonzero(np.diff(self.participant))) + 1

    @cached_property
    def shows(self) -> NDArray[np.bool_]:
        """Whether a response could be seen, by event."""
        return np.asarray(self.protocol.emission_index)[self.action] >= 0

    @cached_property
    def n_responses_recorded(self) -> int:
        """Number of recorded responses: the sample size of every information criterion here."""
        return int(np.count_nonzero(self.response != UNSEEN))

    @cached_property
    def n_missing(self) -> int:
        """Responses that could have been seen but were not recorded."""
        return int(np.count_nonzero(self.shows & (self.response == UNSEEN)))

    @cached_property
    def emission_weights(self) -> NDArray[np.float64]:
        """Recorded responses under each response-showing action: the weights of the canonical state order."""
        index = np.asarray(self.protocol.emission_index)[self.action[self.response != UNSEEN]]
        return np.bincount(index, minlength=len(self.protocol.emission_actions)).astype(np.float64)

    @cached_property
    def design(self) -> DesignFacts:
        """What the design can say about the tables."""
        return facts_of_events(self.protocol, self.offsets, self.participant, self.action, self.response)

    # -- views -------------------------------------------------------------------------------------
    @cached_property
    def run_of_event(self) -> NDArray[np.int64]:
        """Run of each event."""
        return np.repeat(np.arange(self.n_runs), np.diff(self.offsets))

    @cached_property
    def k(self) -> NDArray[np.int64]:
        """Position of each event in its run, from 0."""
        return np.arange(self.n_events) - np.repeat(self.offsets[:-1], np.diff(self.offsets))

    @property
    def condition_of_event(self) -> NDArray[np.object_]:
        """Condition name of each event."""
        return np.array(self.conditions, dtype=object)[self.condition][self.run_of_event]

    def tree(self) -> HistoryTree:
        """Distinct histories with counts (`models.histories`)."""
        return HistoryTree.build(
            self.offsets, self.action, self.response, self.protocol.n_actions, self.protocol.n_responses
        )

    def schedules(self) -> NDArray[np.object_]:
        """Schedule letters of each run, such as ``HRHRH``."""
        letters = np.array([m.letter for m in self.protocol.modes])[np.asarray(self.protocol.mode_of_action)]
        text = "".join(letters[self.action])
        out = np.empty(self.n_runs, dtype=object)
        for i in range(self.n_runs):
            out[i] = text[self.offsets[i] : self.offsets[i + 1]]
        return out

    def select(
        self,
        *,
        conditions: Sequence[str] | None = None,
        participants: NDArray[np.int64] | None = None,
        runs: NDArray[np.integer] | NDArray[np.bool_] | None = None,
    ) -> EventLog:
        """Part of the log: by condition names, participant ids or run index (all that are given must hold).

        Raises
        ------
        InputError
            On an unknown condition, or if nothing is left.
        """
        keep = np.ones(self.n_runs, dtype=bool)
        if conditions is not None:
            for name in conditions:
                if name not in self.conditions:
                    raise located("condition", name, one_of(self.conditions))
            keep &= np.isin(self.condition, [self.conditions.index(c) for c in conditions])
        if participants is not None:
            keep &= np.isin(self.participant, participants)
        if runs is not None:
            chosen = np.zeros(self.n_runs, dtype=bool)
            chosen[runs] = True
            keep &= chosen
        if not keep.any():
            raise located("selection", Phrase("no runs"), "at least one run of the log")
        events = np.repeat(keep, np.diff(self.offsets))
        lengths = np.diff(self.offsets)[keep]
        used = np.unique(self.condition[keep])
        lookup = np.full(len(self.conditions), -1, dtype=np.int32)
        lookup[used] = np.arange(len(used))
        return EventLog(
            self.protocol, self.study, np.append(0, np.cumsum(lengths)).astype(np.int64),
            self.participant[keep], self.sequence[keep], lookup[self.condition[keep]],
            tuple(self.conditions[i] for i in used), self.action[events], self.response[events],
            {name: values[events] for name, values in self.tokens.items()},
        )  # fmt: skip

    def with_responses(self, response: NDArray[np.int8]) -> EventLog:
        """Same design, other responses (a simulation); tokens are dropped since they belong to the old ones."""
        return EventLog(
            self.protocol, self.study, self.offsets, self.participant, self.sequence, self.condition,
            self.conditions, self.action, np.ascontiguousarray(response, dtype=np.int8),
        )  # fmt: skip

    def to_frame(self) -> pd.DataFrame:
        """The log as a tidy frame with the schema's columns, sorted by participant, sequence and k."""
        p = self.protocol
        run = self.run_of_event
        response = np.where(self.response >= 0, self.response + 2, np.where(self.shows, 1, 0))
        mode = np.asarray(p.mode_of_action)[self.action]
        names = response_labels(p)
        frame = pd.DataFrame(
            {
                "study": pd.Categorical.from_codes(np.zeros(self.n_events, np.int8), [self.study]),
                "participant": self.participant[run],
                "condition": pd.Categorical.from_codes(self.condition[run], list(self.conditions)),
                "sequence": self.sequence[run],
                "k": self.k,
                "mode": pd.Categorical.from_codes(mode, list(p.mode_names)),
                "action": pd.Categorical.from_codes(self.action, list(p.action_names)),
                "observation": pd.Categorical.from_codes(response, list(names)),
            }
        )
        for name, values in self.tokens.items():
            frame[name] = values
        return frame

    def __repr__(self) -> str:
        return (
            f"EventLog({self.study!r}: {self.n_participants} people, {self.n_runs} runs, {self.n_events} events, "
            f"{self.n_responses_recorded} responses, {len(self.conditions)} conditions)"
        )

    def _view(self) -> View:
        told = (
            f"Study {self.study}: {self.n_participants:,} people, {self.n_runs:,} runs, {self.n_events:,} events, "
            f"{self.n_responses_recorded:,} responses; conditions {', '.join(self.conditions)}."
        )
        notes = (f"{self.n_missing:,} responses are missing.",) if self.n_missing else ()
        # As many runs as fill a screen: a frame of the whole log may be large.
        runs = int(np.searchsorted(self.offsets, MOST_ROWS))
        first = self.select(runs=np.arange(min(max(runs, 1), self.n_runs))).to_frame()
        return View("Event log", "", (), notes, (told,), (Rows(first, self.n_events, ".to_frame()"),))


def _integers(values: pd.Series, name: str, place: str) -> NDArray[np.int64]:
    as_number = pd.to_numeric(values, errors="coerce")
    if pd.api.types.is_signed_integer_dtype(as_number.dtype) and not as_number.hasnans:
        return as_number.to_numpy(dtype=np.int64)
    numbers = as_number.to_numpy(dtype=np.float64, na_value=np.nan)
    # From 2**53 on, a float no longer tells neighbouring ids apart.
    _refuse(~((np.abs(numbers) < 2.0**53) & (numbers == np.floor(numbers))), values, name, place, "an integer")
    return numbers.astype(np.int64)


def _numbers(values: pd.Series, name: str, place: str) -> NDArray[np.float64]:
    """Token counts, NaN where empty."""
    numbers = pd.to_numeric(values, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    text = np.isnan(numbers) & values.notna().to_numpy(dtype=bool)
    _refuse(text, values, name, place, "a number of at least 0, or empty")
    return numbers


def _refuse(wrong: NDArray[np.bool_], values: pd.Series, name: str, place: str, wanted: str) -> None:
    if wrong.any():
        rows = np.flatnonzero(wrong)
        found = [(int(row), values.iloc[row]) for row in rows[: Problems.KEEP]]
        problems = [Problem(r + 2, name, repr(v) if isinstance(v, str) else str(v), wanted) for r, v in found]
        raise EventLogError(place, problems, len(rows))
