"""Why a CSV event log could not be read: the slow scan, line by line, that follows a failed fast read."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from analysis.csv_header import Header
from analysis.file_source import FileSource
from analysis.wording import counted
from models.errors import InputError
from models.events import INTEGER_COLUMNS, TOKEN_COLUMNS, EventLogError, Problem

KEEP = 200
"""Problems kept with their lines; all are counted."""

_INTEGER = re.compile(r"-?[0-9]+")
_INT64 = 1 << 63
EMPTY_NUMBERS = ("", "NA", "NaN", "nan")
"""What stands for "no count" in the token columns."""


class LineProblem(Problem):
    """A problem of a whole line, such as too few fields: its column is empty and not named."""

    __slots__ = ()

    def __str__(self) -> str:
        return f"line {self.line}: found {self.value}, wanted {self.wanted}"


def wrong_width(number: int, found: int, wanted: int) -> LineProblem:
    """Problem of a line that has not as many fields as the header."""
    return LineProblem(number, "", counted(found, "field"), f"{wanted}, as many as the header has")


class Line(NamedTuple):
    """A line of the file that is not empty: its number (the header is line 1) and its fields."""

    number: int
    fields: list[str]


def text_lines(source: FileSource, separator: str = ",") -> Iterator[Line]:
    """Fields of every line that is not empty, the header included.

    Raises
    ------
    InputError
        At a line that is not UTF-8, or whose quotes are broken.
    """
    with source.open() as stream:
        for number, raw in enumerate(stream, start=1):
            raw = raw.rstrip(b"\r\n")
            if number == 1:
                raw = raw.removeprefix(b"\xef\xbb\xbf")
            if not raw:
                continue
            try:
                text = raw.decode()
            except UnicodeDecodeError as error:
                raise InputError(
                    f"{source.path}, line {number}: not UTF-8 text (byte 0x{raw[error.start]:02x} at position "
                    f"{error.start + 1}); save the file as UTF-8"
                ) from None
            if "\0" in text:
                raise InputError(f"{source.path}, line {number}: binary data (a null byte), text was wanted")
            if '"' not in text:
                yield Line(number, text.split(separator))
                continue
            try:
                yield Line(number, next(csv.reader([text], delimiter=separator, strict=True)))
            except csv.Error as error:
                more = "; a line break inside a field, perhaps?" if "end of data" in str(error) else ""
                raise InputError(f"{source.path}, line {number}: broken quotes: {error}{more}") from None


def explain(source: FileSource, header: Header, reported: str) -> InputError:
    """Error with every line at fault; `reported` is passed on if the scan finds nothing.

    Parameters
    ----------
    source : FileSource
    header : Header
    reported : str
        What the fast reader said.
    """
    integers = [(header.names.index(c), c) for c in INTEGER_COLUMNS]
    counts = [(header.names.index(c), c) for c in TOKEN_COLUMNS if c in header.names]
    width = len(header.names)
    kept: list[Problem] = []
    total = 0
    for number, fields in text_lines(source):
        if number == 1:
            continue
        if len(fields) != width:
            found: list[Problem] = [wrong_width(number, len(fields), width)]
        else:
            found = [
                Problem(number, column, repr(fields[i]), _wanted_integer(fields[i]))
                for i, column in integers
                if not _is_integer(fields[i])
            ]
            found += [
                Problem(number, column, repr(fields[i]), "a number of at least 0, or empty")
                for i, column in counts
                if not _is_count(fields[i])
            ]
        total += len(found)
        if len(kept) < KEEP:
            kept += found
    if kept:
        return EventLogError(str(source.path), kept[:KEEP], total)
    return InputError(f"{source.path}: cannot be read as CSV: {reported}")


def renumbered(error: EventLogError, source: FileSource) -> EventLogError:
    """Same problems with the lines of the file: the fast reader does not count empty lines."""
    lines: dict[int, int] = {}
    last = max(problem.line for problem in error.problems)
    wanted = {problem.line for problem in error.problems}
    with source.open() as stream:
        row = 0
        quoted = False  # inside a field that has a line break in it
        for number, raw in enumerate(stream, start=1):
            row += not quoted and bool(raw.strip(b"\r\n"))
            quoted ^= raw.count(b'"') % 2 == 1
            if row in wanted:
                lines.setdefault(row, number)
            if row >= last:
                break
    problems: Sequence[Problem] = [p._replace(line=lines.get(p.line, p.line)) for p in error.problems]
    return EventLogError(error.place, problems, error.total)


def _is_integer(text: str) -> bool:
    if text.isascii() and text.isdigit() and len(text) < 19:
        return True
    text = text.strip(" \t")
    return len(text) <= 20 and _INTEGER.fullmatch(text) is not None and -_INT64 <= int(text) < _INT64


def _wanted_integer(text: str) -> str:
    return "an integer below 2^63" if _INTEGER.fullmatch(text.strip(" \t")) else "an integer"


def _is_count(text: str) -> bool:
    if text in EMPTY_NUMBERS:
        return True
    try:
        return math.isfinite(float(text)) and float(text) >= 0
    except ValueError:
        return False
