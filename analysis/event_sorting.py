"""Events sorted outside of memory: sorted segments in temporary files, merged into one sorted stream.

Segments are merged by portions. What every segment that still has rows on disk vouches for, up to the smallest of
the last rows held of each, is taken from all of them, sorted and given out; so that memory holds one portion a
segment, whatever the order of the file and however many rows one person or one run has.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import InputError, Phrase, located

KEYS = ("participant", "sequence", "k", "row")
"""What events are sorted by; rows of the file are distinct, so the order is one and the same."""

Records = NDArray[np.void]


def record_type(tokens: Sequence[str]) -> np.dtype[np.void]:
    """One event as it is kept on disk: coded as `models.event_rules.CheckedColumns`, with its row in the file."""
    fields: list[tuple[str, str]] = [(name, "<i8") for name in KEYS]
    fields += [("condition", "<i4"), ("action", "<i2"), ("response", "<i2")]
    return np.dtype([*fields, *((name, "<f8") for name in tokens)])


class EventSorter:
    """Takes events in any order and gives them back sorted by participant, sequence, number and row.

    Parameters
    ----------
    folder : Path
        For the temporary files.
    kind : dtype
        `record_type`.
    memory : int
        Bytes that may be held.
    disk : int
        Bytes that the files may take, all of them together.
    place : str
        Named in errors, usually the file.
    rows, most_segments : int, optional
        Rows of a segment, and segments merged at a time; from `memory` unless given.
    """

    def __init__(
        self, folder: Path, kind: np.dtype[np.void], memory: int, disk: int, place: str,
        rows: int | None = None, most_segments: int | None = None,
    ) -> None:  # fmt: skip
        self._folder, self._kind, self._disk, self._place = folder, kind, disk, place
        # Sorting holds the rows, their sorted copy and three keys with their order.
        self._rows = rows or max(1024, memory // (2 * kind.itemsize + 40))
        self._most = most_segments or 64
        self._portion = max(1, self._rows // (2 * self._most))
        self._held: list[Records] = []
        self._n_held = 0
        self._files: list[Path] = []
        self._number = 0
        self._written = 0

    @property
    def written(self) -> int:
        """Bytes on disk."""
        return self._written

    def add(self, records: Records) -> None:
        """Take some events.

        Raises
        ------
        InputError
            If the disk is full, or `disk` bytes are not enough.
        """
        start = 0
        while start < len(records):
            part = records[start : start + self._rows - self._n_held]
            self._held.append(part)
            self._n_held += len(part)
            start += len(part)
            if self._n_held == self._rows:
                self._write_segment()

    def sorted(self, watch: Callable[[int], None] | None = None) -> Iterator[Records]:
        """All events in order, in parts; `watch` is called with the events given out so far."""
        if not self._files:
            parts: Iterator[Records] = iter([_in_order(np.concatenate(self._held))]) if self._held else iter([])
            self._held = []
        else:
            if self._held:
                self._write_segment()
            while len(self._files) > self._most:
                now, self._files = self._files[: self._most], self._files[self._most :]
                self._write(self._merged(now))
            parts = self._merged(self._files)
        done = 0
        for part in parts:
            done += len(part)
            yield part
            if watch is not None:
                watch(done)

    def _write_segment(self) -> None:
        records = _in_order(np.concatenate(self._held))
        self._held, self._n_held = [], 0
        self._write(iter([records]))

    def _write(self, parts: Iterator[Records]) -> None:
        path = self._folder / f"segment{self._number}"
        self._number += 1
        try:
            with path.open("wb") as out:
                for part in parts:
                    self._written += part.nbytes
                    if self._written > self._disk:
                        raise located(
                            f"{self._place}, rows out of order, bytes of temporary files",
                            Phrase(f"more than {self._disk:,}"),
                            f"at most {self._disk:,}; allow more, or sort the file",
                        )  # fmt: skip
                    out.write(part.tobytes())
        except OSError as error:
            free = shutil.disk_usage(self._folder).free
            raise InputError(
                f"{self._place}, rows out of order: a temporary file in {self._folder} cannot be written "
                f"({error.strerror}; {free:,} bytes are free)"
            ) from None
        self._files.append(path)

    def _merged(self, paths: Sequence[Path]) -> Iterator[Records]:
        segments = [_Segment(path, self._kind, self._portion) for path in paths]
        try:
            while True:
                open_ones = [s for s in segments if s.more]
                if not open_ones:
                    rest = [s.held for s in segments if len(s.held)]
                    if rest:
                        yield _in_order(np.concatenate(rest))
                    return
                bound = min(tuple(s.held[name][-1].item() for name in KEYS) for s in open_ones)
                yield _in_order(np.concatenate([s.up_to(bound) for s in segments]))
        finally:
            for segment in segments:
                self._written -= segment.close()


class _Segment:
    """A sorted file of records, of which one portion is held."""

    def __init__(self, path: Path, kind: np.dtype[np.void], portion: int) -> None:
        self._path, self._stream, self._kind, self._portion = path, path.open("rb"), kind, portion
        self._left = path.stat().st_size // kind.itemsize
        self._size = path.stat().st_size
        self.held: Records = self._next()

    @property
    def more(self) -> bool:
        """Whether there are rows that are not held."""
        return self._left > 0

    def _next(self) -> Records:
        count = min(self._portion, self._left)
        self._left -= count
        return np.frombuffer(self._stream.read(count * self._kind.itemsize), dtype=self._kind)

    def up_to(self, bound: tuple[int, ...]) -> Records:
        """Take the rows up to `bound` that are held; hold the next portion where none is left."""
        last = np.zeros(len(self.held), dtype=bool)
        equal = ~last
        for name, value in zip(KEYS, bound, strict=True):
            column = self.held[name]
            last |= equal & (column < value)
            equal &= column == value
        n = int(np.count_nonzero(last | equal))
        out, self.held = self.held[:n], self.held[n:]
        if not len(self.held) and self.more:
            self.held = self._next()
        return out

    def close(self) -> int:
        """Remove the file; returns its size."""
        self._stream.close()
        self._path.unlink(missing_ok=True)
        return self._size


def _in_order(records: Records) -> Records:
    keys: list[Any] = [records[name] for name in reversed(KEYS)]
    order = np.lexsort(keys)
    return records[order]
