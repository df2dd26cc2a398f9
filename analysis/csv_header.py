"""The first line of a CSV event log: is it text, is it separated by commas, does it name the columns."""

from __future__ import annotations

import csv
from typing import NamedTuple

from analysis.file_source import FileSource
from models.errors import InputError, located
from models.events import COLUMNS, TOKEN_COLUMNS

_MARKS = {b"\xff\xfe\x00\x00": "UTF-32", b"\xff\xfe": "UTF-16", b"\xfe\xff": "UTF-16"}
_CONTAINERS = {
    b"PK\x03\x04": "a zip archive or spreadsheet (.zip, .xlsx)",
    b"RDX": "an R data file",
    b"\x89HDF": "an HDF5 file",
}
_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}


class Header(NamedTuple):
    """All column names in file order, the schema's columns that are to be read, and the names of the rest."""

    names: tuple[str, ...]
    wanted: tuple[str, ...]
    unknown: tuple[str, ...]


def first_line(source: FileSource, kind: str = "a CSV event log") -> str:
    """First line of a text file.

    Raises
    ------
    InputError
        If the file is another kind of file, binary, in another encoding, or begins with an empty line.
    """
    place, head = str(source.path), source.head
    packed = "gzip that is not CSV: inside is " if source.gzipped else ""
    for mark, name in _CONTAINERS.items():
        if head.startswith(mark):
            raise InputError(f"{place}: {packed}{name}, {kind} was wanted")
    for mark, name in _MARKS.items():
        if head.startswith(mark):
            raise InputError(f"{place}: the text is encoded as {name}, UTF-8 was wanted; save it as UTF-8")
    if b"\0" in head:
        position = head.index(b"\0")
        raise InputError(f"{place}: {packed or 'not a text file: '}binary data (a null byte at {position}), "
                         f"{kind} was wanted")  # fmt: skip
    line = head.removeprefix(b"\xef\xbb\xbf").split(b"\n", 1)[0].split(b"\r", 1)[0]
    try:
        text = line.decode()
    except UnicodeDecodeError as error:
        raise InputError(
            f"{place}, line 1: {packed}not UTF-8 text (byte 0x{line[error.start]:02x} at position "
            f"{error.start + 1}), {kind} in UTF-8 was wanted"
        ) from None
    if not text.strip():
        raise located(f"{place}, line 1", text, "a header with the names of the columns")
    return text


def column_names(place: str, line: str, separator: str = ",") -> tuple[str, ...]:
    """Names in a header line; each may stand there once."""
    names = tuple(next(csv.reader([line], delimiter=separator)))
    for name in names:
        if names.count(name) > 1:
            count = f"{names.count(name)} columns of that name"
            raise located(f"{place}, line 1, column {name}", count, "one")
    return names


def read_header(source: FileSource) -> Header:
    """Check the header of a CSV event log.

    Raises
    ------
    InputError
        On a wrong separator, a missing column or one that is there twice.
    """
    place = str(source.path)
    line = first_line(source)
    for separator, word in _SEPARATORS.items():
        fields = [field.strip('" ') for field in line.split(separator)]
        if len(fields) > 1 and sum(name in COLUMNS for name in fields) > 1:
            raise located(f"{place}, line 1, separator", word, "commas")
    names = column_names(place, line)
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise located(f"{place}, line 1, columns", ", ".join(names), f"also {', '.join(missing)}")
    wanted = tuple(name for name in (*COLUMNS, *TOKEN_COLUMNS) if name in names)
    return Header(names, wanted, tuple(name for name in names if name not in wanted))
