"""A sparse table filled statement by statement, where the last word on an entry counts.

Problem files say things like "everything is zero; this row is uniform; but this entry is one half". Entries are
kept in a log, with a mark for each row where it was last written as a whole, and sorted out once at the end: a
statement about everything costs nothing if what it says is zero, and no table is ever held densely.
"""

from __future__ import annotations

from array import array
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from models.errors import Phrase, located

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_ROWS = 10_000_000
"""Rows a table may have; names and counts in a file are refused before they ask for more."""

MOST_ENTRIES = 30_000_000
"""Entries a table may hold that are not zero."""

FILE_TOLERANCE = 1e-5
"""How far from one a row of a file may sum: files are often written with six digits."""

EXACT = 1e-12
"""Rows closer to one than that are left as they are, so that what was written is read back bit by bit."""


class WrittenTable:
    """Entries by row and column, zero where nothing was said.

    Parameters
    ----------
    n_rows, n_columns : int
    place : str
        File and table, for error messages.
    """

    def __init__(self, n_rows: int, n_columns: int, place: str) -> None:
        if n_rows > MOST_ROWS:
            raise located(f"{place}, size", Phrase(f"{n_rows} rows"), f"at most {MOST_ROWS}")
        self.n_rows = n_rows
        self.n_columns = n_columns
        self.place = place
        self._row = array("q")
        self._column = array("q")
        self._value = array("d")
        self._whole = np.zeros(n_rows, dtype=np.int64)
        self._line = np.zeros(n_rows, dtype=np.int32)

    def put(self, row: int, column: int, value: float, line: int) -> None:
        """Write one entry."""
        self._row.append(row)
        self._column.append(column)
        self._value.append(value)
        self._line[row] = line

    def put_cells(self, rows: Index, columns: Index, values: Array, line: int) -> None:
        """Write entries, given as arrays of one shape."""
        self._room(rows.size, line)
        self._row.frombytes(np.ascontiguousarray(rows, dtype=np.int64).tobytes())
        self._column.frombytes(np.ascontiguousarray(columns, dtype=np.int64).tobytes())
        self._value.frombytes(np.ascontiguousarray(values, dtype=np.float64).tobytes())
        self._line[rows] = line

    def put_rows(self, rows: Index, values: float | Array, line: int) -> None:
        """Write whole rows: one number for all, one row for all (``[column]``), or a block ``[row, column]``."""
        block = np.asarray(values, dtype=np.float64)
        self._whole[rows] = len(self._row)
        self._line[rows] = line
        if block.ndim < 2:
            block = np.broadcast_to(block, self.n_columns) if block.any() else np.zeros(0)
            columns = np.flatnonzero(block)
            self._room(len(rows) * len(columns), line)
            self.put_cells(
                np.repeat(rows, len(columns)), np.tile(columns, len(rows)), np.tile(block[columns], len(rows)), line
            )
        else:
            at, columns = np.nonzero(block)
            self.put_cells(rows[at], columns, block[at, columns], line)

    def _room(self, more: int, line: int) -> None:
        if len(self._row) + more <= MOST_ENTRIES:
            return
        kept = self.matrix().tocoo()
        if kept.nnz + more > MOST_ENTRIES:
            found = Phrase(f"{kept.nnz + more} entries that are not zero")
            raise located(f"{self.place}, line {line}", found, f"at most {MOST_ENTRIES}")
        # What is left of rows that were written over is gone already: no mark is needed any more.
        self._row = array("q", kept.row.astype(np.int64).tobytes())
        self._column = array("q", kept.col.astype(np.int64).tobytes())
        self._value = array("d", kept.data.tobytes())
        self._whole[:] = 0

    def line(self, row: int) -> int:
        """Line of the last statement on a row, 0 if there was none."""
        return int(self._line[row])

    def matrix(self) -> sparse.csr_array:
        """The table as it stands."""
        row = np.frombuffer(self._row, dtype=np.int64) if self._row else np.zeros(0, dtype=np.int64)
        column = np.frombuffer(self._column, dtype=np.int64) if self._row else np.zeros(0, dtype=np.int64)
        value = np.frombuffer(self._value, dtype=np.float64) if self._row else np.zeros(0)
        valid = np.arange(len(row)) >= self._whole[row]
        row, column, value = row[valid], column[valid], value[valid]
        key = row * self.n_columns + column
        if np.any(key[1:] <= key[:-1]):
            order = np.argsort(key, kind="stable")
            last = np.append(np.diff(key[order]) > 0, True)
            order = order[last]
            row, column, value = row[order], column[order], value[order]
        keep = value != 0
        row, column, value = row[keep], column[keep], value[keep]
        start = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=self.n_rows))])
        return sparse.csr_array((value, column, start), shape=(self.n_rows, self.n_columns))

    def probabilities(self, describe: Callable[[int], str], end: int) -> sparse.csr_array:
        """The table with rows that sum to one.

        Parameters
        ----------
        describe : callable
            Words for a row, ``row -> str``, for the message.
        end : int
            Last line of the table, named where nothing was said about a row.

        Raises
        ------
        InputError
            If a row is further than 1e-5 from one: with file, line and row.
        """
        table = self.matrix()
        total = np.asarray(table.sum(axis=1)).ravel()
        wrong = np.flatnonzero(~(np.abs(total - 1) <= FILE_TOLERANCE))
        if wrong.size:
            row = int(wrong[0])
            line = self.line(row)
            place = f"{self.place}, line {line or end}, {describe(row)}"
            found = Phrase(f"a sum of {total[row]:.10g}" if line else "no entry up to here")
            raise located(place, found, "probabilities that sum to 1 within 1e-5")
        scale = np.where(np.abs(total - 1) > EXACT, total, 1.0)
        table.data /= np.repeat(scale, np.diff(table.indptr))
        return table
