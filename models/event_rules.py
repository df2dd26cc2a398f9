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

from models.errors import InputError, brief
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
        return f"line {self.line}, column {self.column}: found {brief(self.value)}, wanted {self.wanted}"


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
    condition = cast(Coded, columns["condition"])
    found = Problems(place)
    actions, responses = check_rows(columns, protocol, found)
    tokens = {c: np.asarray(columns[c], dtype=np.float64) for c in TOKEN_COLUMNS if c in columns}
    order = _run_order(participant, sequence, k)
    if order is not None:
        participant, sequence, k = participant[order], sequence[order], k[order]
        condition = Coded(condition.codes[order], condition.labels)
        actions, responses = actions[order], responses[order]
        tokens = {name: values[order] for name, values in tokens.items()}
    runs = RunCheck()
    starts = runs.check(participant, sequence, k, condition, np.arange(len(k)) if order is None else order)
    runs.report(found)
    found.raise_if_any()
    offsets = np.append(starts, len(k)).astype(np.int64)
    return CheckedColumns(offsets, participant, sequence, condition, actions, responses, tokens)


def check_rows(
    columns: Mapping[str, NDArray | Coded], protocol: Protocol, found: Problems,
    study_of_file: tuple[int, str] | None = None,
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:  # fmt: skip
    """Check the rules that a row keeps or breaks by itself.

    Parameters
    ----------
    columns : mapping
        All rows of a file, or some that follow each other.
    protocol : Protocol
    found : Problems
        Takes the broken rules; ``found.row`` is the row of the file that the first row here is.
    study_of_file : (int, str), optional
        Code (among the labels here) and name of the study of the file's first row; that of the first row here
        unless given.

    Returns
    -------
    action, response : int64[rows]
        As in `CheckedColumns`; -1 where the name is unknown.
    """
    participant, sequence, k = (np.asarray(columns[c], dtype=np.int64) for c in INTEGER_COLUMNS)
    study, condition, mode, action, response = (
        cast(Coded, columns[c]) for c in ("study", "condition", "mode", "action", "observation")
    )
    for name, values in zip(INTEGER_COLUMNS, (participant, sequence, k), strict=True):
        found.where(values < 0, name, values, "an integer of at least 0")
    code, own = (study.codes[0], label_at(study, 0)) if study_of_file is None else study_of_file
    found.where(study.codes != code, "study", study, f"one study a file, here {own!r}")
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
    for name in TOKEN_COLUMNS:
        if name in columns:
            counts = np.asarray(columns[name], dtype=np.float64)
            found.where(np.isinf(counts) | (counts < 0), name, counts, "a number of at least 0, or empty")
    return actions, responses


class RunCheck:
    """The rules that rows of a run keep or break together, on events that come sorted, in one part or in many.

    A run may go on from one part to the next. Only the first wrong number of a run is told; those after it follow.
    """

    def __init__(self) -> None:
        self._last: tuple[int, int, int] | None = None
        self._length = 0
        self._condition: tuple[int, str] = (-1, "")
        self._told = False
        self._kept: tuple[list[_RowProblem], list[_RowProblem]] = ([], [])
        self._total = [0, 0]

    def check(
        self, participant: NDArray[np.int64], sequence: NDArray[np.int64], k: NDArray[np.int64],
        condition: Coded, rows: NDArray[np.integer],
    ) -> NDArray[np.int64]:  # fmt: skip
        """Check the next events; returns where runs begin among them.

        Parameters
        ----------
        participant, sequence, k : int64[events]
            Sorted by all three; events of the file's order among equals.
        condition : Coded[events]
            Codes mean the same in every part.
        rows : integer[events]
            Row of the file that each event stands in.
        """
        n = len(k)
        new_run = np.ones(n, dtype=bool)
        np.not_equal(participant[1:], participant[:-1], out=new_run[1:])
        new_run[1:] |= sequence[1:] != sequence[:-1]
        if self._last is not None:
            new_run[0] = (participant[0], sequence[0]) != self._last[:2]
        starts = np.flatnonzero(new_run)
        # Run of each event: 0 is the one that goes on from the part before, if there is one.
        run = np.cumsum(new_run)
        begins = np.append(-self._length, starts)
        expected = np.arange(n) - begins[run]
        code = np.append(self._condition[0], condition.codes[starts])
        off = np.flatnonzero(k != expected)
        first = off[np.append(True, run[off[1:]] != run[off[:-1]])] if len(off) else off
        if len(first) and run[first[0]] == 0 and self._told:
            first = first[1:]
        for i in self._room(0, first):
            name = f"participant {participant[i]}, sequence {sequence[i]}"
            before = k[i - 1] if i else (self._last or (0, 0, 0))[2]
            if not new_run[i] and k[i] == before:
                wanted = f"each event once: {name} already has an event {k[i]}"
            else:
                wanted = f"{expected[i]}: events of a run ({name}) are numbered 0, 1, 2, ... without gaps"
            self._kept[0].append(_RowProblem(int(rows[i]), "k", str(k[i]), wanted))
        differs = np.flatnonzero(code[run] != condition.codes)
        for i in self._room(1, differs):
            own = self._condition[1] if run[i] == 0 else label_at(condition, int(begins[run[i]]))
            wanted = f"the condition of its run (participant {participant[i]}, sequence {sequence[i]}), {own!r}"
            self._kept[1].append(_RowProblem(int(rows[i]), "condition", repr(label_at(condition, int(i))), wanted))
        if len(starts):
            self._condition = (int(code[-1]), label_at(condition, int(starts[-1])))
        self._told = bool(len(off) and run[off[-1]] == run[-1]) or (self._told and not len(starts))
        self._length = int(expected[-1]) + 1
        self._last = (int(participant[-1]), int(sequence[-1]), int(k[-1]))
        return starts

    @property
    def total(self) -> int:
        """Problems so far."""
        return sum(self._total)

    def report(self, found: Problems) -> None:
        """Hand over what was found, once all events were checked."""
        for kept, total in zip(self._kept, self._total, strict=True):
            found.total += total - len(kept)
            for problem in kept:
                found.add(*problem)

    def _room(self, rule: int, at: NDArray[np.int64]) -> NDArray[np.int64]:
        self._total[rule] += len(at)
        return at[: max(0, Problems.KEEP - len(self._kept[rule]))]


class _RowProblem(NamedTuple):
    row: int
    column: str
    value: str
    wanted: str


class Problems:
    """Collects broken rules while a log is checked, in one part or in many; `place` names the file.

    Attributes
    ----------
    total : int
        Rows that broke a rule, kept or not.
    row : int
        Row of the file (from 0) that the first row of the part being checked is.
    """

    KEEP = 20_000
    """Rows of one rule that are kept; so many more are only counted."""

    def __init__(self, place: str) -> None:
        self.place = place
        self.total = 0
        self.row = 0
        self._rules: dict[tuple[str, str], list[Problem]] = {}
        self._added: list[Problem] = []

    @property
    def kept(self) -> list[Problem]:
        """All that are kept, rule by rule."""
        return [*(problem for rule in self._rules.values() for problem in rule), *self._added]

    def where(self, mask: NDArray[np.bool_], column: str, values: NDArray | Coded, wanted: str) -> None:
        """Add a problem for every row of `mask`, counted from `row` of the file."""
        rule = self._rules.setdefault((column, wanted), [])
        if not mask.any():
            return
        rows = np.flatnonzero(mask)
        self.total += len(rows)
        for row in rows[: max(0, self.KEEP - len(rule))]:
            found = repr(label_at(values, row)) if isinstance(values, Coded) else f"{values[row]}"
            rule.append(Problem(self.row + int(row) + 2, column, found, wanted))

    def add(self, row: int, column: str, value: str, wanted: str) -> None:
        """Add one problem of a row (from 0) of the file."""
        self.total += 1
        if len(self._added) < 2 * self.KEEP:
            self._added.append(Problem(row + 2, column, value, wanted))

    def raise_if_any(self) -> None:
        """Raise an `EventLogError` if anything was added."""
        kept = self.kept
        if kept:
            raise EventLogError(self.place, sorted(kept, key=lambda p: p.line), self.total)


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
