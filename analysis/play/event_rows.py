"""The event log while a study runs: rows appended and forced to disk as rounds finish, rows of a person removed.

Files are the truth: who has played what is read from them when the server starts, so that a killed server loses no
finished round.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable
from pathlib import Path
from typing import NamedTuple

from analysis.event_files import read_events
from models.errors import Phrase, located
from models.event_rules import COLUMNS, TOKEN_COLUMNS
from models.model_files import write_bytes

HEADER = (*COLUMNS, *TOKEN_COLUMNS)


class Row(NamedTuple):
    """One finished round, with the schema's columns (`data/README.md`)."""

    study: str
    participant: int
    condition: str
    sequence: int
    k: int
    mode: str
    action: str
    observation: str
    team_tokens: int
    human_tokens: int
    robot_tokens: int


class EventRows:
    """The log's file. Not safe from several threads at once: its owner serialises.

    Parameters
    ----------
    path : path
        Made with the first row; a log of the same study is gone on with.
    study : str

    Attributes
    ----------
    rows : dict of int to list of Row
        Finished rounds by person, in order.
    mended : str
        What a power cut had left at the end of the file and was cut off; empty if nothing.

    Raises
    ------
    InputError
        If the file is no event log with these columns, breaks a rule, or belongs to another study.
    """

    def __init__(self, path: str | Path, study: str) -> None:
        self.path, self.study = Path(path), study
        if not self.path.name.endswith(".csv"):
            raise located("--out", str(path), "a name that ends in .csv: rows are appended as rounds finish")
        self.rows: dict[int, list[Row]] = {}
        self.mended = ""
        if self.path.exists():
            self._take_over()

    def _take_over(self) -> None:
        content = self.path.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if whole != content:
            self.mended = content[len(whole) :].decode(errors="replace")
        lines = whole.decode("utf-8", errors="replace").splitlines()
        if lines and tuple(lines[0].split(",")) != HEADER:
            raise located(f"{self.path}, line 1", lines[0], ",".join(HEADER))
        if self.mended and not lines and not ",".join(HEADER).startswith(self.mended):
            raise located(f"{self.path}, line 1", self.mended, ",".join(HEADER))
        if self.mended:
            write_bytes(self.path, whole)
        if len(lines) < 2:
            return
        read_events(self.path)
        for number, cells in enumerate(csv.reader(io.StringIO(whole.decode(), newline="")), start=1):
            if number == 1:
                continue
            if len(cells) != len(HEADER):
                raise located(f"{self.path}, line {number}", Phrase(f"{len(cells)} fields"), f"{len(HEADER)}")
            row = _row(self.path, number, cells)
            if row.study != self.study:
                raise located(
                    f"{self.path}, line {number}, column study", row.study, f"{self.study}, the study played"
                )
            self.rows.setdefault(row.participant, []).append(row)
        for own in self.rows.values():
            own.sort(key=lambda r: (r.sequence, r.k))

    def append(self, row: Row) -> None:
        """Write a row and wait until it is on the disk.

        Raises
        ------
        OSError
            If it could not be written; then nothing of it stays.
        """
        new = not self.path.exists() or self.path.stat().st_size == 0
        content = (_text([HEADER]) if new else "") + _text([row])
        handle = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            before = os.fstat(handle).st_size
            data = content.encode()
            try:
                if os.write(handle, data) != len(data):
                    raise OSError("the disk is full")
                os.fsync(handle)
            except OSError:
                os.ftruncate(handle, before)
                raise
        finally:
            os.close(handle)
        if new:
            flush(self.path.parent)
        self.rows.setdefault(row.participant, []).append(row)

    def delete(self, participant: int) -> int:
        """Remove all rows of a person (the file is written beside and renamed); returns how many there were."""
        gone = self.rows.pop(participant, [])
        if gone:
            with self.path.open(newline="", encoding="utf-8") as stream:
                cells = list(csv.reader(stream))
            place = HEADER.index("participant")
            left = [cells[0], *(row for row in cells[1:] if int(row[place]) != participant)]
            write_bytes(self.path, _text(left).encode())
            flush(self.path)
            flush(self.path.parent)
        return len(gone)


def _text(rows: Iterable[Iterable[object]]) -> str:
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(rows)
    return out.getvalue()


def _row(path: Path, number: int, cells: list[str]) -> Row:
    place = f"{path}, line {number}"
    values: dict[str, object] = {}
    for name, cell in zip(HEADER, cells, strict=True):
        if name in ("participant", "sequence", "k", *TOKEN_COLUMNS):
            try:
                values[name] = int(cell)
            except ValueError:
                found = cell or Phrase("nothing")
                raise located(f"{place}, column {name}", found, "a whole number, as the page writes it") from None
        else:
            values[name] = cell
    return Row(**values)  # type: ignore[arg-type]


def flush(path: Path) -> None:
    """Force a file, or the names of new and renamed files in a folder, to disk, where the system can."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(handle)
    except OSError:
        pass
    finally:
        os.close(handle)
