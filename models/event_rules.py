"""The rules of the event log, checked on coded columns.

A broken rule becomes a `Problem` with line, column, value found and what was wanted; all of them are collected,
so that a file can be mended in one go. Valid logs that are sorted already never come here: one compiled pass
(`models.event_scan`) accepts them, and anything it does not accept is explained here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from models.errors import InputError
from models.protocol import MISSING, NO_RESPONSE, Protocol

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


class CheckedColumns(NamedTuple):
    """Columns that keep every rule, in run order.

    Attributes
    ----------
    offsets : int64[runs + 1]
    participant, sequence : int64[events]
    condition : Coded[events]
    action, response : integer[events]
        Protocol indices; response counts ``none, missing`` first, as `response_labels` does.
    tokens : mapping of str to float64[events]
    """

    offsets: NDArray[np.int64]
    participant: NDArray[np.int64]
    sequence: NDArray[np.int64]
    condition: Coded
    action: NDArray[np.integer]
    response: NDArray[np.integer]
    tokens: dict[str, NDArray[np.float64]]


def response_labels(protocol: Protocol) -> tuple[str, ...]:
    """What the observation column may hold."""
    return (NO_RESPONSE, MISSING, *protocol.response_names)


def check_columns(columns: Mapping[str, NDArray | Coded], protocol: Protocol, place: str) -> CheckedColumns:
    """Check every rule and sort the events by run.

    Raises
    ------
    EventLogError
        With every broken rule.
    """
    participant, sequence, k = (np.asarray(columns[c], dtype=np.int64) for c in INTEGER_COLUMNS)
    n = len(k)
    study, condition, mode, action, response = (
        cast(Coded, columns[c]) for c in ("study", "condition", "mode", "action", "observation")
    )
    found = Problems(place)
    for name, values in zip(INTEGER_COLUMNS, (participant, sequence, k), strict=True):
        found.where(values < 0, name, values, "an integer of at least 0")
    found.where(study.codes != study.codes[0], "study", study, f"one study a file, here {label_at(study, 0)!r}")
    found.where(_blank(condition), "condition", condition, "a condition name")
    found.where(_blank(study), "study", study, "a study name")
    modes = recode(mode.labels, protocol.mode_names)[mode.codes]
    actions = recode(action.labels, protocol.action_names)[action.codes]
    responses = recode(response.labels, response_labels(protocol))[response.codes]
    found.where(modes < 0, "mode", mode, one_of(protocol.mode_names))
    found.where(actions < 0, "action", action, one_of(protocol.action_names))
    found.where(
        responses < 0, "observation", response,
        one_of((*protocol.response_names, NO_RESPONSE, MISSING)),
    )  # fmt: skip
    mode_of_action = np.array([*protocol.mode_of_action, -1])
    shows = np.array([*(m.shows_response for m in protocol.modes), False])
    known = (modes >= 0) & (actions >= 0)
    for i, m in enumerate(protocol.modes):
        wrong = known & (modes == i) & (mode_of_action[actions] != i)
        allowed = one_of([a.name for a in m.actions])
        found.where(wrong, "action", action, f"an action of mode {m.name}: {allowed}")
    known = (modes >= 0) & (responses >= 0)
    silent = known & ~shows[modes] & (responses != 0)
    found.where(silent, "observation", response, f"{NO_RESPONSE!r}, since this mode shows no response")
    empty = known & shows[modes] & (responses == 0)
    wanted = f"{one_of(protocol.response_names)}, or {MISSING!r} where it was not recorded"
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
        found.total += max(0, len(first) - Problems.KEEP)
        for i in off[first[: Problems.KEEP]]:
            row = i if order is None else order[i]
            run = f"participant {participant[i]}, sequence {sequence[i]}"
            if not new_run[i] and k[i] == k[i - 1]:
                wanted = f"each event once: {run} already has an event {k[i]}"
            else:
                wanted = f"{expected[i]}: events of a run ({run}) are numbered 0, 1, 2, ... without gaps"
            found.add(int(row), "k", str(k[i]), wanted)
    differs = np.flatnonzero(np.repeat(condition.codes[offsets[:-1]], np.diff(offsets)) != condition.codes)
    found.total += max(0, len(differs) - Problems.KEEP)
    for i in differs[: Problems.KEEP]:
        row = i if order is None else order[i]
        wanted = (
            f"the condition of its run (participant {participant[i]}, sequence {sequence[i]}), "
            f"{label_at(condition, int(i - k[i]) if 0 <= i - k[i] < n else 0)!r}"
        )
        found.add(int(row), "condition", repr(label_at(condition, int(i))), wanted)
    found.raise_if_any()
    return CheckedColumns(offsets, participant, sequence, condition, actions, responses, tokens)


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
            found = repr(label_at(values, row)) if isinstance(values, Coded) else f"{values[row]}"
            self.kept.append(Problem(int(row) + 2, column, found, wanted))

    def add(self, row: int, column: str, value: str, wanted: str) -> None:
        """Add one problem of a row (from 0)."""
        self.total += 1
        if len(self.kept) < 10 * self.KEEP:
            self.kept.append(Problem(row + 2, column, value, wanted))

    def raise_if_any(self) -> None:
        """Raise an `EventLogError` if anything was added."""
        if self.kept:
            raise EventLogError(self.place, sorted(self.kept, key=lambda p: p.line), self.total)


def label_at(column: Coded, row: int) -> str:
    """Text of one row, empty where there is none."""
    code = int(column.codes[row])
    return "" if code < 0 else str(column.labels[code])


def _blank(column: Coded) -> NDArray[np.bool_]:
    blank = [i for i, name in enumerate(column.labels) if not str(name).strip()]
    return (column.codes < 0) | np.isin(column.codes, blank)


def one_of(names: Sequence[str]) -> str:
    """Join the permitted names for an error message."""
    return "one of " + ", ".join(names)


def recode(labels: Sequence[str], names: Sequence[str]) -> NDArray[np.int64]:
    """Index in `names` of each label, -1 where it is none of them; the last entry stands for a code of -1."""
    return np.array([*(names.index(v) if v in names else -1 for v in labels), -1], dtype=np.int64)


def _run_order(
    participant: NDArray[np.int64], sequence: NDArray[np.int64], k: NDArray[np.int64]
) -> NDArray[np.int64] | None:
    """Sorting permutation by (participant, sequence, k), None where the rows are sorted already."""
    d_participant, d_sequence = np.diff(participant), np.diff(sequence)
    same = d_participant == 0
    ordered = (d_participant > 0) | (same & ((d_sequence > 0) | ((d_sequence == 0) & (np.diff(k) >= 0))))
    return None if bool(ordered.all()) else np.lexsort((k, sequence, participant))
