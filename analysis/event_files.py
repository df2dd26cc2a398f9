"""Event logs in files: CSV or Parquet, each optionally gzipped, read through pyarrow and checked.

A valid file costs one multi-threaded parse and one compiled pass. A file that fails is read once more, slowly,
to say which line, column and value were at fault (`analysis.csv_problems`).
"""

from __future__ import annotations

import gzip
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from analysis.csv_header import Header, read_header
from analysis.csv_problems import EMPTY_NUMBERS, explain, renumbered
from analysis.file_source import DECOMPRESSED_LIMIT, FileSource
from models.errors import InputError, Phrase, located
from models.event_rules import response_labels
from models.events import COLUMNS, INTEGER_COLUMNS, TOKEN_COLUMNS, Coded, EventLog, EventLogError
from models.model_files import write_bytes
from models.protocol import PUBLISHED, Protocol

_PARQUET_MAGIC = b"PAR1"

PACKED_PARQUET = 1 << 30
"""Bytes that a gzipped Parquet file, which is compressed already, may unpack to: it is held in memory."""

_BLOCK = 4 << 20
_TEXT = pa.dictionary(pa.int32(), pa.string())


@dataclass(frozen=True)
class EventFile:
    """A checked log and what a reader should know about its file.

    Attributes
    ----------
    log : EventLog
    notes : tuple of str
        Sentences: columns that were not read, a name that does not fit the content.
    """

    log: EventLog
    notes: tuple[str, ...]


def read_events(path: str | Path, protocol: Protocol = PUBLISHED, *, limit: int = DECOMPRESSED_LIMIT) -> EventFile:
    """Read and check an event log; format and compression are told by the content.

    Parameters
    ----------
    path : path
    protocol : Protocol
    limit : int
        Most bytes a gzipped file may unpack to.

    Raises
    ------
    EventLogError
        If rows break the schema's rules, with line, column and value of each.
    InputError
        If the file is missing, unreadable, damaged, or not an event log.
    """
    source = FileSource.of(path, limit)
    if is_parquet(source):
        columns, unknown = _read_parquet(source)
        log = EventLog.from_columns(columns, protocol, str(path))
    else:
        columns, unknown = _read_csv(source)
        try:
            log = EventLog.from_columns(columns, protocol, str(path))
        except EventLogError as error:
            raise renumbered(error, source) from None
    return EventFile(log, reading_notes(source, unknown))


def is_parquet(source: FileSource) -> bool:
    """Whether a file is to be read as Parquet: by its first bytes, or by its name."""
    return source.head.startswith(_PARQUET_MAGIC) or source.path.suffix == ".parquet"


def reading_notes(source: FileSource, unknown: Sequence[str]) -> tuple[str, ...]:
    """What a reader should know: columns that were not read, a name that does not fit the content."""
    path, notes = source.path, []
    if unknown:
        notes.append(f"{path}: columns not read, since the schema has none of that name: {', '.join(unknown)}")
    if path.suffix == ".gz" and not source.gzipped:
        notes.append(f"{path}: named .gz but not compressed; read as it is")
    return tuple(notes)


def csv_options(header: Header) -> Any:
    """How the schema's columns of a CSV file are converted."""
    types = {c: pa.int64() if c in INTEGER_COLUMNS else _TEXT for c in COLUMNS}
    types |= {c: pa.float64() for c in TOKEN_COLUMNS if c in header.wanted}
    return pyarrow.csv.ConvertOptions(
        include_columns=list(header.wanted), column_types=types, null_values=list(EMPTY_NUMBERS)
    )


def _read_csv(source: FileSource) -> tuple[dict[str, NDArray | Coded], tuple[str, ...]]:
    place = str(source.path)
    header = read_header(source)
    options = csv_options(header)
    try:
        with (
            source.open() as stream,
            pa.PythonFile(stream, mode="r") if source.gzipped else pa.OSFile(str(source.path)) as file,
        ):
            read = pyarrow.csv.ReadOptions(block_size=_BLOCK)
            table = pyarrow.csv.read_csv(file, read_options=read, convert_options=options)
    except pa.ArrowInvalid as error:
        raise explain(source, header, str(error)) from None
    if any(table[c].null_count for c in INTEGER_COLUMNS):
        raise explain(source, header, "an empty number")
    return _columns(place, table), header.unknown


def _read_parquet(source: FileSource) -> tuple[dict[str, NDArray | Coded], tuple[str, ...]]:
    place = str(source.path)
    try:
        if source.gzipped:
            with replace(source, limit=min(source.limit, PACKED_PARQUET)).open() as stream:
                content: Any = pa.BufferReader(stream.read())
        else:
            # Not mapped into memory: where a mapped file is cut short meanwhile, the process is killed.
            content = pa.OSFile(place)
        with content:
            opened = pyarrow.parquet.ParquetFile(content)
            names = opened.schema_arrow.names
            check_names(place, names)
            check_rows(place, opened.metadata.num_rows, len(COLUMNS), source.limit)
            wanted = [c for c in (*COLUMNS, *TOKEN_COLUMNS) if c in names]
            content.seek(0)
            text = [c for c in COLUMNS if c not in INTEGER_COLUMNS]
            table = pyarrow.parquet.read_table(content, columns=wanted, read_dictionary=text)
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise InputError(f"{place}: corrupt or not a Parquet file: {error}") from None
    for name in wanted:
        table = table.set_column(table.column_names.index(name), name, typed(place, name, table[name]))
    return _columns(place, table), tuple(name for name in names if name not in wanted)


def check_rows(place: str, rows: int, columns: int, limit: int) -> None:
    """Refuse a Parquet file that would fill more than `limit` bytes: equal values are a few bytes in the file."""
    if rows * columns * 8 > limit:
        most = limit // (8 * columns)
        wanted = f"at most {most}, which fill {limit} bytes; raise the limit if you trust the file"
        raise located(f"{place}, rows", rows, wanted)


def check_names(place: str, names: list[str]) -> None:
    """Refuse a Parquet file in which a column of the schema is missing, or any is there twice."""
    for name in names:
        if names.count(name) > 1:
            raise located(f"{place}, column {name}", f"{names.count(name)} columns of that name", "one")
    missing = [c for c in COLUMNS if c not in names]
    if missing:
        raise located(f"{place}, columns", ", ".join(names), f"also {', '.join(missing)}")


def typed(place: str, name: str, column: Any, first_row: int = 0) -> Any:
    """Column in the schema's type; a type that could only be converted with loss is refused.

    `first_row` is the row of the file (from 0) that the column begins with.
    """
    found, where = column.type, f"{place}, column {name}, type"
    if name in INTEGER_COLUMNS:
        if not pa.types.is_integer(found):
            raise located(where, str(found), "an integer type")
        if column.null_count:
            row = int(np.flatnonzero(column.is_null().to_numpy())[0])
            raise located(f"{place}, row {first_row + row + 1}, column {name}", "nothing", "an integer")
        try:
            return column.cast(pa.int64())
        except pa.ArrowInvalid as error:
            raise InputError(f"{place}, column {name}: {error}; wanted integers below 2^63") from None
    if name in TOKEN_COLUMNS:
        if not (pa.types.is_integer(found) or pa.types.is_floating(found) or pa.types.is_null(found)):
            raise located(where, str(found), "a number type")
        return column.cast(pa.float64())
    value = found.value_type if pa.types.is_dictionary(found) else found
    if not (pa.types.is_string(value) or pa.types.is_large_string(value) or pa.types.is_string_view(value)):
        raise located(where, str(found), "text")
    if found == _TEXT:
        return column
    return column.cast(pa.string()).dictionary_encode()


def _columns(place: str, table: Any) -> dict[str, NDArray | Coded]:
    columns: dict[str, NDArray | Coded] = {}
    table = table.unify_dictionaries().combine_chunks()
    for name in table.column_names:
        column = table[name]
        array = column.chunk(0) if column.num_chunks else pa.array([], type=column.type)
        if pa.types.is_dictionary(array.type):
            codes = array.indices.fill_null(-1).to_numpy()
            labels = labels_of(f"{place}, column {name}", array)
            for label in labels:
                if label is not None and ("\n" in label or "\r" in label):
                    raise located(f"{place}, column {name}", label, "text without line breaks")
            columns[name] = Coded(codes, labels)
        else:
            columns[name] = array.to_numpy(zero_copy_only=False)
    return columns


def labels_of(place: str, array: Any) -> list[Any]:
    """Labels of a text column, once it is sure that every code has one: compiled code looks them up unasked.

    Raises
    ------
    InputError
        If a damaged file has codes without a label, or labels that are no text.
    """
    try:
        array.validate(full=True)
        return array.dictionary.to_pylist()
    except (pa.ArrowException, UnicodeDecodeError):
        raise located(place, Phrase("codes or bytes that stand for no text"), "text in UTF-8") from None


def log_table(log: EventLog) -> Any:
    """The log as an Arrow table with the schema's columns, text dictionary-encoded."""
    p, run = log.protocol, log.run_of_event
    response = np.where(log.response >= 0, log.response + 2, np.where(log.shows, 1, 0))
    coded: dict[str, tuple[NDArray, Sequence[str]]] = {
        "study": (np.zeros(log.n_events), [log.study]),
        "condition": (log.condition[run], log.conditions),
        "mode": (np.asarray(p.mode_of_action)[log.action], p.mode_names),
        "action": (log.action, p.action_names),
        "observation": (response, response_labels(p)),
    }
    numbers = {"participant": log.participant[run], "sequence": log.sequence[run], "k": log.k}
    table: Mapping[str, Any] = {
        name: pa.DictionaryArray.from_arrays(pa.array(coded[name][0].astype(np.int32)), list(coded[name][1]))
        if name in coded
        else numbers[name]
        for name in COLUMNS
    } | {name: pa.array(values, from_pandas=True) for name, values in log.tokens.items()}
    return pa.table(table)


def write_events(log: EventLog, path: str | Path) -> None:
    """Write a log as ``.csv``, ``.csv.gz`` or ``.parquet`` (by the name), never half-written.

    The same log gives the same bytes: the gzip header carries neither time nor name.

    Raises
    ------
    InputError
        On another ending, or where the file cannot be written.
    """
    path = Path(path)
    if path.name.endswith((".csv", ".csv.gz")):
        content = csv_bytes(log)
        if path.suffix == ".gz":
            content = gzip.compress(content, compresslevel=9, mtime=0)
    elif path.suffix == ".parquet":
        sink = pa.BufferOutputStream()
        pyarrow.parquet.write_table(log_table(log), sink, compression="zstd")
        content = sink.getvalue().to_pybytes()
    else:
        raise located("output file", str(path), "a name that ends in .csv, .csv.gz or .parquet")
    try:
        write_bytes(path, content)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror}") from None


def csv_bytes(log: EventLog) -> bytes:
    """CSV text of a log: schema's columns first, quotes only where a name needs them."""
    table = log_table(log)
    special = any(mark in name for name in (log.study, *log.conditions) for mark in ',"\r\n')
    options = pyarrow.csv.WriteOptions(include_header=False, quoting_style="needed" if special else "none")
    columns = {
        name: table[name].cast(pa.string()) if pa.types.is_dictionary(table[name].type) else table[name]
        for name in table.column_names
    }
    sink = io.BytesIO()
    sink.write((",".join(columns) + "\n").encode())
    pyarrow.csv.write_csv(pa.table(columns), sink, options)
    return sink.getvalue()
