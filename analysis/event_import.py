"""Import a raw export (one row a round) with a column map: the way to data this project does not carry.

Personal ids never reach the log: people are numbered 1..n in order of first appearance, and the key is written
only where it is asked for.
"""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from analysis.column_map import ColumnMap, read_map
from analysis.csv_header import column_names, first_line
from analysis.csv_problems import EMPTY_NUMBERS, renumbered, text_lines, wrong_width
from analysis.file_source import FileSource
from models.errors import Phrase, located
from models.event_rules import Problems
from models.events import TOKEN_COLUMNS, Coded, EventLog, EventLogError
from models.protocol import MISSING, NO_RESPONSE, PUBLISHED, Protocol

EXACT = 1 << 53
"""Largest number of a round or a sequence: beyond, not every integer has a floating-point number of its own."""

_INTEGER = re.compile(r"[+-]?[0-9]{1,400}")


@dataclass(frozen=True)
class Imported:
    """An imported log.

    Attributes
    ----------
    log : EventLog
    key : tuple of str
        The raw id of participant i + 1: personal data, to be kept apart from the log.
    notes : tuple of str
    """

    log: EventLog
    key: tuple[str, ...]
    notes: tuple[str, ...]


def import_events(path: str | Path, map_path: str | Path, protocol: Protocol = PUBLISHED) -> Imported:
    """Turn a raw CSV export into a checked event log.

    Parameters
    ----------
    path : path
        One row a round, a header, UTF-8, optionally gzipped.
    map_path : path
        See `analysis.column_map`.
    protocol : Protocol

    Raises
    ------
    EventLogError
        With the line, raw column and value of everything that has no meaning under the map, or that breaks a
        rule of the event log.
    InputError
        If a file cannot be read or a mapped column is not there.
    """
    column_map = read_map(map_path, protocol)
    source = FileSource.of(path)
    export = _Export.read(source, column_map, str(map_path))
    modes = export.modes(protocol)
    ids = export.participants()
    number = {name: i for i, name in enumerate(dict.fromkeys(ids), start=1)}
    columns: dict[str, NDArray | Coded] = {
        "study": _coded([column_map.study] * len(modes)),
        "participant": np.array([number[name] for name in ids], dtype=np.int64),
        "condition": _coded(export.conditions()),
        "sequence": np.full(len(modes), column_map.sequence, dtype=np.int64),
        "k": export.numbers("k").astype(np.int64) - column_map.first_round,
        "mode": _coded(modes),
        "action": _coded(export.actions(modes, protocol)),
        "observation": _coded(export.observations(modes, protocol)),
    }
    if "sequence" in column_map.columns:
        columns["sequence"] = export.numbers("sequence").astype(np.int64)
    for name in TOKEN_COLUMNS:
        if name in column_map.columns:
            columns[name] = export.numbers(name)
    export.found.raise_if_any()
    try:
        log = EventLog.from_columns(columns, protocol, f"{path} (as mapped by {map_path})")
    except EventLogError as error:
        raise renumbered(error, source) from None
    notes = []
    if export.unused:
        notes.append(f"{path}: columns the map does not use: {', '.join(export.unused)}")
    return Imported(log, tuple(number), tuple(notes))


def key_text(key: Sequence[str]) -> str:
    """CSV text of the key from participant numbers to raw ids."""
    sink = io.StringIO()
    writer = csv.writer(sink, lineterminator="\n")
    writer.writerow(["participant", "raw_id"])
    writer.writerows(enumerate(key, start=1))
    return sink.getvalue()


@dataclass(frozen=True)
class _Export:
    """Raw columns under a map; what has no meaning under it is collected in `found`, with its line."""

    column_map: ColumnMap
    map_place: str
    fields: dict[str, list[str]]
    lines: list[int]
    unused: tuple[str, ...]
    found: Problems

    @classmethod
    def read(cls, source: FileSource, column_map: ColumnMap, map_place: str) -> _Export:
        place, separator = str(source.path), column_map.separator
        header = column_names(place, first_line(source, "a CSV export"), separator)
        wanted = column_map.raw_columns()
        for name in wanted:
            if name not in header:
                also = f"also {name}, which {map_place} names"
                raise located(f"{place}, line 1, columns", ", ".join(header), also)
        index = [header.index(name) for name in wanted]
        values: list[list[str]] = [[] for _ in wanted]
        lines: list[int] = []
        for number, fields in text_lines(source, separator):
            if number == 1:
                continue
            if len(fields) != len(header):
                raise EventLogError(place, [wrong_width(number, len(fields), len(header))], 1)
            lines.append(number)
            for column, i in zip(values, index, strict=True):
                column.append(fields[i].strip())
        if not lines:
            raise located(place, Phrase("no rows"), "at least one row below the header")
        unused = tuple(name for name in header if name not in wanted)
        return cls(column_map, map_place, dict(zip(wanted, values, strict=True)), lines, unused, Problems(place))

    def column(self, name: str) -> str:
        """Raw column behind a schema column."""
        return self.column_map.columns[name][0]

    def participants(self) -> list[str]:
        column = self.column("participant")
        for row, name in enumerate(self.fields[column]):
            if not name:
                self._add(row, column, "", "an id of the person")
        return self.fields[column]

    def conditions(self) -> list[str]:
        columns = self.column_map.columns["condition"]
        parts = [self.fields[c] for c in columns]
        joined = [self.column_map.join.join(several) for several in zip(*parts, strict=True)]
        return self._mapped(dict(enumerate(joined)), self.column_map.join.join(columns), "condition")

    def modes(self, protocol: Protocol) -> list[str]:
        column = self.column("mode")
        if not self.column_map.letters:
            return self._mapped(dict(enumerate(self.fields[column])), column, "mode")
        known = {m.letter for m in protocol.modes}
        modes = []
        for row, letter in enumerate(self.fields[column]):
            if letter not in known:
                self._add(row, column, letter, f"one of the letters {', '.join(sorted(known))}")
            modes.append(protocol.modes_from_letters(letter)[0].name if letter in known else "")
        return modes

    def actions(self, modes: list[str], protocol: Protocol) -> list[str]:
        actions = [""] * len(modes)
        for mode in protocol.mode_names:
            column = self.column_map.action_columns.get(mode) or self.column("action")
            table = f"action.{mode}" if f"action.{mode}" in self.column_map.values else "action"
            raw = {row: self.fields[column][row] for row, name in enumerate(modes) if name == mode}
            for row, action in zip(raw, self._mapped(raw, column, table), strict=True):
                actions[row] = action
        return actions

    def observations(self, modes: list[str], protocol: Protocol) -> list[str]:
        """Responses where the mode shows one; elsewhere the raw field means nothing and is not read."""
        shows = {m.name for m in protocol.modes if m.shows_response}
        column = self.column("observation")
        observation = [MISSING if mode in shows else NO_RESPONSE for mode in modes]
        raw = {
            row: self.fields[column][row]
            for row, mode in enumerate(modes)
            if mode in shows and self.fields[column][row] not in self.column_map.missing
        }
        for row, response in zip(raw, self._mapped(raw, column, "observation"), strict=True):
            observation[row] = response
        return observation

    def numbers(self, name: str) -> NDArray[np.float64]:
        """Numbers of a column: integers, or for tokens any number or none."""
        column = self.column(name)
        tokens = name in TOKEN_COLUMNS
        numbers = np.zeros(len(self.lines))
        for row, value in enumerate(self.fields[column]):
            try:
                if tokens:
                    numbers[row] = np.nan if value in EMPTY_NUMBERS else float(value)
                elif not _INTEGER.fullmatch(value) or abs(int(value)) > EXACT:
                    raise ValueError
                else:
                    numbers[row] = int(value)
            except (ValueError, OverflowError):
                wanted = "a number, or empty" if tokens else f"an integer between -{EXACT} and {EXACT}"
                self._add(row, column, value, wanted)
        return numbers

    def _mapped(self, raw: dict[int, str], column: str, table: str) -> list[str]:
        """Look the values of some rows up in a table of the map; without one they stay as they are."""
        entries = self.column_map.values.get(table)
        if entries is None:
            return list(raw.values())
        for row, value in raw.items():
            if value not in entries:
                wanted = f"a value mapped in {self.map_place}, [values.{table}]: {', '.join(entries)}"
                self._add(row, column, value, wanted)
        return [entries.get(value, value) for value in raw.values()]

    def _add(self, row: int, column: str, value: str, wanted: str) -> None:
        # `Problems` counts rows of a file without empty lines; these are lines of the file itself.
        self.found.add(self.lines[row] - 2, column, repr(value), wanted)


def _coded(values: Sequence[str]) -> Coded:
    labels = list(dict.fromkeys(values))
    index = {label: i for i, label in enumerate(labels)}
    return Coded(np.array([index[v] for v in values], dtype=np.int32), labels)
