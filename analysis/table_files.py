"""Plain tables from files: any CSV (gzipped or not) or Parquet file with one row an observation."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from analysis.file_source import FileSource
from models.errors import InputError, Phrase, located

PARQUET = b"PAR1"

LARGEST_TABLE = 1 << 30
"""Bytes that a gzipped or Parquet table may unpack to: it is held in memory, every value of a CSV file as text."""


def read_table(path: str | Path, columns: Sequence[str] | None = None) -> pd.DataFrame:
    """Read columns of a table.

    Parameters
    ----------
    path : str or Path
        CSV in UTF-8, optionally gzipped, or Parquet; told by content, not by name.
    columns : sequence of str, optional
        Different names; all columns by default.

    Returns
    -------
    DataFrame
        In this order. Of a CSV file every value is text and the index holds the line of each row, the header being
        line 1; of a Parquet file the index counts rows from 1.

    Raises
    ------
    InputError
        If the file cannot be read, holds no rows, or lacks a column.
    """
    source = FileSource.of(path, LARGEST_TABLE)
    parquet = source.head[:4] == PARQUET
    table = _parquet(source) if parquet else _csv(source)
    columns = list(dict.fromkeys(table.columns)) if columns is None else columns
    missing = [name for name in columns if name not in table.columns]
    if missing:
        shown = Phrase(", ".join(map(str, table.columns)))
        raise located(f"{path}, columns", shown, f"also {', '.join(map(repr, missing))}")
    twice = [name for name in columns if list(table.columns).count(name) > 1]
    if twice:
        raise located(f"{path}, column {twice[0]}", Phrase("several columns of that name"), "one")
    if not len(table):
        raise located(str(path), Phrase("no rows"), "at least one row below the header")
    first, unit = (1, "row") if parquet else (2, "line")
    return table[list(columns)].set_axis(pd.RangeIndex(first, first + len(table), name=unit))


def _parquet(source: FileSource) -> pd.DataFrame:
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        head = pq.ParquetFile(source.path)
        cells = head.metadata.num_rows * max(1, len(head.schema_arrow.names))
        if cells * 8 > LARGEST_TABLE:
            raise located(f"{source.path}, cells", cells, f"at most {LARGEST_TABLE // 8}")
        # Text that is none is found here; pandas would stumble over it much later.
        pq.read_table(source.path).validate(full=True)
        return pd.read_parquet(source.path).reset_index(drop=True)
    except (pa.ArrowException, ValueError, OSError, TypeError, KeyError, NotImplementedError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{source.path}: damaged Parquet file: {str(error).splitlines()[0]}") from None


def _csv(source: FileSource) -> pd.DataFrame:
    if b"\0" in source.head:
        raise located(str(source.path), Phrase("binary data"), "a CSV table in UTF-8, or Parquet")
    try:
        with source.open() as stream:
            # The header is an ordinary row here, so that pandas does not rename columns that occur twice.
            table = pd.read_csv(
                stream, header=None, dtype=str, keep_default_na=False, encoding="utf-8-sig", skip_blank_lines=False
            )
    except UnicodeDecodeError as error:
        raise located(str(source.path), Phrase(f"byte {error.object[error.start]:#x}"), "text in UTF-8") from None
    except (pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        raise InputError(f"{source.path}: no CSV table: {str(error).strip()}") from None
    names = [str(name).strip() for name in table.iloc[0]]
    table = table.iloc[1:].set_axis(names, axis=1)
    while len(table) and (table.iloc[-1].fillna("") == "").all():  # blank lines at the end are no rows
        table = table.iloc[:-1]
    return table
