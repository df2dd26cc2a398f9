"""Event files read in parts: CSV and Parquet, each optionally gzipped, a bounded number of rows at a time.

The parts hold what `analysis.event_files` would have read at once, and what cannot be read is refused in the same
words, the same thing first.
"""

from __future__ import annotations

import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
from numpy.typing import NDArray

from analysis.csv_header import read_header
from analysis.csv_problems import explain
from analysis.event_files import check_names, csv_options, is_parquet, labels_of, typed
from analysis.file_source import FileSource
from models.errors import InputError, Phrase, located
from models.event_rules import COLUMNS, INTEGER_COLUMNS, TOKEN_COLUMNS, Coded

MOST_NAMES = 100_000
"""Distinct names that the condition column may hold; a file of more has something else in it."""

CSV_BLOCK = 4 << 20
PARQUET_ROWS = 1 << 16

Columns = dict[str, NDArray | Coded]
Watch = Callable[[float], None]
"""Called with the share of the file that was read."""


@dataclass(frozen=True)
class EventChunks:
    """The rows of an event file, part by part; can be read again and again.

    Attributes
    ----------
    source : FileSource
    names : tuple of str
        Columns that are read, in the order of their checks.
    unknown : tuple of str
        Columns that are not read.
    parquet : bool
    file : Path
        What is read: the file itself, or a gzipped Parquet file unpacked.
    rows : int or None
        Rows in a part; by default what is fast.
    """

    source: FileSource
    names: tuple[str, ...]
    unknown: tuple[str, ...]
    parquet: bool
    file: Path
    rows: int | None = None

    @classmethod
    @contextmanager
    def open(cls, source: FileSource, folder: Path, rows: int | None = None) -> Iterator[EventChunks]:
        """Look at a file; `folder` takes a gzipped Parquet file unpacked, which cannot be read in parts.

        Raises
        ------
        InputError
            If it is damaged, or not an event log.
        """
        place = str(source.path)
        if not is_parquet(source):
            header = read_header(source)
            yield cls(source, header.wanted, header.unknown, False, source.path, rows)
            return
        file = source.path
        with tempfile.TemporaryDirectory(dir=folder, ignore_cleanup_errors=True) as unpacked:
            if source.gzipped:
                file = Path(unpacked) / "events.parquet"
                try:
                    with source.open() as packed, file.open("wb") as out:
                        shutil.copyfileobj(packed, out, 1 << 20)
                except OSError as error:
                    raise InputError(f"{place}: cannot be unpacked into {folder}: {error.strerror}") from None
            with _readable(place), _parquet(file) as opened:
                found = opened.schema_arrow.names
            check_names(place, found)
            wanted = tuple(c for c in (*COLUMNS, *TOKEN_COLUMNS) if c in found)
            yield cls(source, wanted, tuple(n for n in found if n not in wanted), True, file, rows)

    def read(self, watch: Watch | None = None) -> Iterator[Columns]:
        """Columns of one part after the other, none of them empty.

        Text columns have codes of their own in every part, except the conditions, whose codes stay the same.

        Raises
        ------
        InputError
            Where a part cannot be read; names with line breaks are refused after the last part.
        """
        conditions: dict[str, int] = {}
        names: list[str] = []
        broken: dict[str, str] = {}
        for table in self._parquet_parts(watch) if self.parquet else self._csv_parts(watch):
            columns: Columns = {}
            for name in self.names:
                array = table.column(name)
                if not pa.types.is_dictionary(array.type):
                    columns[name] = array.to_numpy(zero_copy_only=False)
                    continue
                labels = labels_of(f"{self.source.path}, column {name}", array)
                for label in labels:
                    if label is not None and ("\n" in label or "\r" in label):
                        broken.setdefault(name, label)
                columns[name] = Coded(array.indices.fill_null(-1).to_numpy(), labels)
            columns["condition"] = self._same_codes(columns["condition"], conditions, names)  # type: ignore[arg-type]
            yield columns
        for name in self.names:
            if name in broken:
                raise located(f"{self.source.path}, column {name}", broken[name], "text without line breaks")

    def _same_codes(self, column: Coded, known: dict[str, int], names: list[str]) -> Coded:
        lookup = np.empty(len(column.labels) + 1, dtype=np.int32)
        lookup[-1] = -1
        used = np.zeros(len(lookup), dtype=bool)
        used[column.codes] = True
        for i, label in enumerate(column.labels):
            if label not in known and used[i]:
                known[label] = len(names)
                names.append(label)
            lookup[i] = known.get(label, -1)
        if len(names) > MOST_NAMES:
            found = Phrase(f"more than {MOST_NAMES:,} names")
            raise located(f"{self.source.path}, column condition", found, "conditions, which are few")
        return Coded(lookup[column.codes], names)

    def _csv_parts(self, watch: Watch | None) -> Iterator[Any]:
        header = read_header(self.source)
        read = pyarrow.csv.ReadOptions(block_size=CSV_BLOCK)
        size = max(1, self.source.path.stat().st_size)
        try:
            with self.source.open() as stream:
                file = pa.PythonFile(stream, mode="r")
                with pyarrow.csv.open_csv(file, read_options=read, convert_options=csv_options(header)) as parts:
                    for batch in parts:
                        if any(batch.column(c).null_count for c in INTEGER_COLUMNS):
                            raise explain(self.source, header, "an empty number")
                        if watch is not None:
                            watch(min(1.0, self.source.consumed(stream) / size))
                        yield from _portions(batch, self.rows)
        except pa.ArrowInvalid as error:
            raise explain(self.source, header, str(error)) from None

    def _parquet_parts(self, watch: Watch | None) -> Iterator[Any]:
        place = str(self.source.path)
        done = 0
        with _readable(place), _parquet(self.file, self.names) as opened:
            total = max(1, opened.metadata.num_rows)
            schema = opened.schema_arrow
            try:
                for name in self.names:
                    typed(place, name, pa.chunked_array([], schema.field(name).type))
                for batch in opened.iter_batches(self.rows or PARQUET_ROWS, columns=list(self.names)):
                    arrays = []
                    for name in self.names:
                        column = typed(place, name, pa.chunked_array([batch.column(name)])).combine_chunks()
                        arrays.append(column.chunk(0) if isinstance(column, pa.ChunkedArray) else column)
                    done += batch.num_rows
                    if watch is not None:
                        watch(done / total)
                    yield from _portions(pa.record_batch(arrays, names=list(self.names)), self.rows)
            except InputError:
                raise self._first_at_fault(opened) from None

    def _first_at_fault(self, opened: Any) -> InputError:
        """The error of the first column that has one, as reading whole columns one by one would meet it."""
        place = str(self.source.path)
        for name in self.names:
            done = 0
            try:
                typed(place, name, pa.chunked_array([], opened.schema_arrow.field(name).type))
                # Missing numbers of the whole column come before numbers out of range.
                for look in (False, True):
                    done = 0
                    for batch in opened.iter_batches(PARQUET_ROWS, columns=[name]):
                        column = pa.chunked_array([batch.column(0)])
                        if look or column.null_count:
                            typed(place, name, column, done)
                        done += batch.num_rows
            except InputError as error:
                return error
        return InputError(f"{place}: changed while it was read")


@contextmanager
def _parquet(file: Path, names: Sequence[str] = ()) -> Iterator[Any]:
    text = [c for c in names if c in COLUMNS and c not in INTEGER_COLUMNS]
    with pa.OSFile(str(file)) as content:
        # Buffered, column chunk by column chunk: a row group may be as large as the file.
        yield pyarrow.parquet.ParquetFile(content, read_dictionary=text, buffer_size=1 << 20, pre_buffer=False)


@contextmanager
def _readable(place: str) -> Iterator[None]:
    try:
        yield
    except (pa.ArrowException, OSError, UnicodeDecodeError, KeyError) as error:
        # KeyError: columns within a column, which have not its name.
        raise InputError(f"{place}: corrupt or not a Parquet file: {error}") from None


def _portions(batch: Any, rows: int | None) -> Iterator[Any]:
    for start in range(0, batch.num_rows, rows or max(1, batch.num_rows)):
        yield batch.slice(start, rows)
