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
from typing import NamedTuple, cast

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from models.errors import InputError, located
from models.histories import UNSEEN, HistoryTree
from models.protocol import MISSING, NO_RESPONSE, PUBLISHED, Protocol

COLUMNS = ("study", "participant", "condition", "sequence", "k", "mode", "action", "observation")
TOKEN_COLUMNS = ("team_tokens", "human_tokens", "robot_tokens")
INTEGER_COLUMNS = ("participant", "sequence", "k")


class Problem(NamedTuple):
    """One broken rule: line of the file (the header is line 1), column, value found, what was wanted."""

    line: int
    column: str
    value: str
    wanted: str

    def __str__(self) -> str:
        return f"line {self.line}, column {self.column}: found {self.value}, wanted {self.wanted}"


class EventLogError(InputError):
    """A log that breaks the schema's rules.

    Attributes
    ----------
    problems : list of Problem
        The broken rules, first lines first (at most `Problems.KEEP` a rule).
    total : int
        How many rows broke a rule.
    """

    def __init__(self, place: str, problems: Sequence[Problem], total: int) -> None:
        self.problems, self.total, self.place = list(problems), total, place
        more = "" if total <= 1 else f" ({total} problems in all; `prosocial data check` lists them)"
        super().__init__(f"{place}, {problems[0]}{more}")


class Coded(NamedTuple):
    """A text column as integer codes into `labels`."""

    codes: NDArray[np.integer]
    labels: Sequence[str]


@dataclass(frozen=True)
class EventLog:
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
        found = Problems(place)
        participant, sequence, k = (np.asarray(columns[c], dtype=np.int64) for c in INTEGER_COLUMNS)
        n = len(k)
        if n == 0:
            raise located(place, "no events", "at least one row below the header")
        study, condition, mode, action, response = (
            cast(Coded, columns[c]) for c in ("study", "condition", "mode", "action", "observation")
        )

        for name, values in zip(INTEGER_COLUMNS, (participant, sequence, k), strict=True):
            found.where(values < 0, name, values, "an integer of at least 0")
        found.where(study.codes != study.codes[0], "study", study, f"one study a file, here {_label(study, 0)!r}")
        found.where(_blank(condition), "condition", condition, "a condition name")
        found.where(_blank(study), "study", study, "a study name")
        modes = _recode(mode, protocol.mode_names)
        actions = _recode(action, protocol.action_names)
        responses = _recode(response, (NO_RESPONSE, MISSING, *protocol.response_names))
        found.where(modes < 0, "mode", mode, _one_of(protocol.mode_names))
        found.where(actions < 0, "action", action, _one_of(protocol.action_names))
        found.where(
            responses < 0, "observation", response,
            _one_of((*protocol.response_names, NO_RESPONSE, MISSING)),
        )  # fmt: skip
        mode_of_action = np.array([*protocol.mode_of_action, -1])
        shows = np.array([*(m.shows_response for m in protocol.modes), False])
        known = (modes >= 0) & (actions >= 0)
        for i, m in enumerate(protocol.modes):
            wrong = known & (modes == i) & (mode_of_action[actions] != i)
            allowed = _one_of([a.name for a in m.actions])
            found.where(wrong, "action", action, f"an action of mode {m.name}: {allowed}")
        known = (modes >= 0) & (responses >= 0)
        silent = known & ~shows[modes] & (responses != 0)
        found.where(silent, "observation", response, f"{NO_RESPONSE!r}, since this mode shows no response")
        empty = known & shows[modes] & (responses == 0)
        wanted = f"{_one_of(protocol.response_names)}, or {MISSING!r} where it was not recorded"
        found.where(empty, "observation", response, f"{wanted}: this mode shows the response")
        tokens = {c: np.asarray(columns[c], dtype=np.float64) for c in TOKEN_COLUMNS if c in columns}
        for name, counts in tokens.items():
            found.where(np.isinf(counts) | (counts < 0), name, counts, "a number of at least 0, or empty")

        order = _run_order(participant, sequence, k)
        if order is not None:
            participant, sequence, k = participant[order], sequence[order], k[order]
            condition = Coded(condition.codes[order], condition.labels)
            actions, responses = actions[order], responses[order]
            tokens = {name: values[order] for name, values in tokens.items()}
        new_run = np.empty(n, dtype=bool)
        new_run[0] = True
        np.not_equal(participant[1:], participant[:-1], out=new_run[1:])
        new_run[1:] |= sequence[1:] != sequence[:-1]
        offsets = np.append(np.flatnonzero(new_run), n).astype(np.int64)
        expected = np.arange(n) - np.repeat(offsets[:-1], np.diff(offsets))
        off = np.flatnonzero(k != expected)
        if len(off):
            first = np.flatnonzero(np.append(True, np.searchsorted(offsets, off[1:], "right")
                                             != np.searchsorted(offsets, off[:-1], "right")))  # fmt: skip
            for i in off[first]:
                row = i if order is None else order[i]
                run = f"participant {participant[i]}, sequence {sequence[i]}"
                if not new_run[i] and k[i] == k[i - 1]:
                    wanted = f"each event once: {run} already has an event {k[i]}"
                else:
                    wanted = f"{expected[i]}: events of a run ({run}) are numbered 0, 1, 2, ... without gaps"
                found.add(int(row), "k", str(k[i]), wanted)
        same = np.repeat(condition.codes[offsets[:-1]], np.diff(offsets)) == condition.codes
        for i in np.flatnonzero(~same)[: Problems.KEEP]:
            row = i if order is None else order[i]
            wanted = (
                f"the condition of its run (participant {participant[i]}, sequence {sequence[i]}), "
                f"{_label(condition, int(i - k[i]) if 0 <= i - k[i] < n else 0)!r}"
            )
            found.add(int(row), "condition", repr(_label(condition, int(i))), wanted)
        found.raise_if_any()

        if protocol.n_actions > 127 or protocol.n_responses > 127:
            raise located(f"{place}, protocol", protocol.n_actions, "at most 127 actions and 127 responses")
        run_condition = condition.codes[offsets[:-1]]
        used = np.unique(run_condition)
        labels = [str(condition.labels[c]) for c in used]
        rank = np.argsort(np.argsort(np.array(labels, dtype=object)))
        lookup = np.full(int(used.max()) + 1, -1, dtype=np.int32)
        lookup[used] = rank
        return cls(
            protocol,
            str(_label(study, 0)),
            offsets,
            participant[offsets[:-1]],
            sequence[offsets[:-1]],
            lookup[run_condition],
            tuple(sorted(labels)),
            actions.astype(np.int8),
            np.maximum(responses - 2, UNSEEN).astype(np.int8),
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
                columns[name] = frame[name].to_numpy(dtype=np.float64)
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

    # -- views -------------------------------------------------------------------------------------
    @cached_property
    def run_of_event(self) -> NDArray[np.int64]:
        """Run of each event."""
        return np.repeat(np.arange(self.n_runs), np.diff(self.offsets))

    @cached_property
    def k(self) -> NDArray[np.int64]:
        """Position of each event in its run, from 0."""
        return np.arange(self.n_events) - np.repeat(self.offsets[:-1], np.diff(self.offsets))

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
                    raise located("condition", name, _one_of(self.conditions))
            keep &= np.isin(self.condition, [self.conditions.index(c) for c in conditions])
        if participants is not None:
            keep &= np.isin(self.participant, participants)
        if runs is not None:
            chosen = np.zeros(self.n_runs, dtype=bool)
            chosen[runs] = True
            keep &= chosen
        if not keep.any():
            raise located("selection", "no runs", "at least one run of the log")
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
        names = (NO_RESPONSE, MISSING, *p.response_names)
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


class Problems:
    """Collects broken rules while a log is checked; `place` names the file."""

    KEEP = 200

    def __init__(self, place: str) -> None:
        self.place = place
        self.kept: list[Problem] = []
        self.total = 0

    def where(self, mask: NDArray[np.bool_], column: str, values: NDArray | Coded, wanted: str) -> None:
        """Add a problem for every row of `mask`."""
        if not mask.any():
            return
        rows = np.flatnonzero(mask)
        self.total += len(rows)
        for row in rows[: self.KEEP]:
            found = repr(_label(values, row)) if isinstance(values, Coded) else f"{values[row]}"
            self.kept.append(Problem(int(row) + 2, column, found, wanted))

    def add(self, row: int, column: str, value: str, wanted: str) -> None:
        """Add one problem of a row (from 0)."""
        self.total += 1
        self.kept.append(Problem(row + 2, column, value, wanted))

    def raise_if_any(self) -> None:
        """Raise an `EventLogError` if anything was added."""
        if self.kept:
            raise EventLogError(self.place, sorted(self.kept, key=lambda p: p.line), self.total)


def _label(column: Coded, row: int) -> str:
    code = int(column.codes[row])
    return "" if code < 0 else str(column.labels[code])


def _blank(column: Coded) -> NDArray[np.bool_]:
    blank = [i for i, name in enumerate(column.labels) if not str(name).strip()]
    return (column.codes < 0) | np.isin(column.codes, blank)


def _one_of(names: Sequence[str]) -> str:
    return "one of " + ", ".join(names)


def _recode(column: Coded, names: Sequence[str]) -> NDArray[np.int64]:
    """Codes into `names`, -1 where the label is not among them."""
    lookup = np.array([*(names.index(v) if v in names else -1 for v in column.labels), -1], dtype=np.int64)
    return lookup[column.codes]


def _integers(values: pd.Series, name: str, place: str) -> NDArray[np.int64]:
    if pd.api.types.is_integer_dtype(values.dtype) and not values.hasnans:
        return values.to_numpy(dtype=np.int64)
    try:
        numbers = pd.to_numeric(values, errors="raise").to_numpy(dtype=np.float64)
        wrong = ~(numbers == np.floor(numbers))
    except (ValueError, TypeError):
        as_number = pd.to_numeric(values, errors="coerce")
        numbers = as_number.to_numpy(dtype=np.float64, na_value=np.nan)
        wrong = ~(numbers == np.floor(numbers))
    if wrong.any():
        rows = np.flatnonzero(wrong)
        problems = [Problem(int(r) + 2, name, repr(values.iloc[r]), "an integer") for r in rows[:200]]
        raise EventLogError(place, problems, len(rows))
    return numbers.astype(np.int64)


def _run_order(
    participant: NDArray[np.int64], sequence: NDArray[np.int64], k: NDArray[np.int64]
) -> NDArray[np.int64] | None:
    """Sorting permutation by (participant, sequence, k), None where the rows are sorted already."""
    d_participant, d_sequence = np.diff(participant), np.diff(sequence)
    same = d_participant == 0
    ordered = (d_participant > 0) | (same & ((d_sequence > 0) | ((d_sequence == 0) & (np.diff(k) >= 0))))
    return None if bool(ordered.all()) else np.lexsort((k, sequence, participant))
