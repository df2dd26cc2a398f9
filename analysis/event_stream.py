"""Event logs of any length, read in parts, checked by every rule and compressed, in bounded memory.

A file that is sorted by participant, sequence and number, as nearly every file is, takes one pass: each part is
checked and goes into the tree, and nothing else stays. At the first row that is out of order or breaks a rule the
pass ends, and another one sorts the file outside of memory (`analysis.event_sorting`) and checks every row, so that
problems are told in the words and with the lines of `analysis.event_files.read_events`. Either way the result does
not depend on how large the parts are.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import cast

import numpy as np

from analysis.csv_problems import renumbered
from analysis.event_chunks import Columns, EventChunks
from analysis.event_files import reading_notes
from analysis.event_sorting import EventSorter, record_type
from analysis.file_source import DECOMPRESSED_LIMIT, FileSource
from analysis.log_spool import LogSpool
from analysis.progress import Progress
from analysis.selected_events import SelectedEvents
from models.compressed_log import CompressedLog, LogTally
from models.errors import InputError, Phrase, located
from models.event_flow import CodedEvents, EventFlow
from models.event_rules import (
    INTEGER_COLUMNS,
    TOKEN_COLUMNS,
    Coded,
    EventLogError,
    Problems,
    RunCheck,
    check_rows,
    label_at,
)
from models.growing_tree import BYTES_A_NODE
from models.histories import UNSEEN
from models.protocol import PUBLISHED, Protocol

MEMORY = 1 << 30
"""Bytes for the tree, and for sorting, unless the caller says otherwise; the libraries take some 200 MB beside."""

DISK = 64 << 30
"""Bytes of temporary files at the most, unless the caller says otherwise."""

SORTED, SORTING, MERGING = "reading (%)", "sorting (%)", "merging (%)"
"""Labels of progress."""


@dataclass(frozen=True)
class Sizes:
    """How much is worked on at a time; nothing in a result depends on it.

    Attributes
    ----------
    rows : int, optional
        Rows of a part.
    segment : int, optional
        Rows of a sorted segment.
    most_segments : int, optional
        Segments merged at a time.
    """

    rows: int | None = None
    segment: int | None = None
    most_segments: int | None = None


@dataclass(frozen=True)
class CompressedFile:
    """A compressed log and what a reader should know about its file.

    Attributes
    ----------
    log : CompressedLog
    notes : tuple of str
    resorted : bool
        Whether rows were out of order, so that they had to be sorted on disk.
    """

    log: CompressedLog
    notes: tuple[str, ...]
    resorted: bool


def compress_events(
    path: str | Path, protocol: Protocol = PUBLISHED, *, conditions: Sequence[str] | None = None,
    memory: int = MEMORY, disk: int = DISK, folder: str | Path | None = None, digest: bool = True,
    keep_runs: bool = False, by_condition: bool = False, of_part: bool = False, limit: int = DECOMPRESSED_LIMIT,
    sizes: Sizes | None = None, progress: Progress | None = None,
) -> CompressedFile:  # fmt: skip
    """Read, check and compress an event log without holding it.

    Parameters
    ----------
    path : path
        CSV or Parquet, each optionally gzipped.
    protocol : Protocol
    conditions : sequence of str, optional
        Compress only runs of these conditions; all rows are checked.
    memory : int
        Bytes for the tree, and (as far as `MEMORY`) for sorting. Parts, the libraries and the interpreter come on
        top.
    disk : int
        Bytes of temporary files that sorting may take.
    folder : path, optional
        For temporary files: the system's by default.
    digest : bool
        Work out the log's digest (a temporary file of two bytes an event and thirty a run).
    keep_runs : bool
        Keep the node at which every run ends (eight bytes a run), as in the tree of an `EventLog`.
    by_condition : bool
        Count histories by condition too, as the gate of a posterior wants it.
    of_part : bool
        The digest is that of the conditions that are compressed, as of the log that `EventLog.select` makes.
    limit : int
        Most bytes a gzipped file may unpack to.
    sizes : Sizes, optional
    progress : callable, optional
        Called with what is done, and percent of 100.

    Raises
    ------
    EventLogError
        If rows break the schema's rules: the same problems as `read_events` finds.
    InputError
        As `read_events`; also if the histories do not fit into `memory`, or the temporary files into `disk`.
    """
    source = FileSource.of(path, limit)
    place = str(path)
    if protocol.n_actions > 127 or protocol.n_responses > 127:
        raise located(f"{place}, protocol", protocol.n_actions, "at most 127 actions and 127 responses")
    most_nodes = max(4096, memory // BYTES_A_NODE)
    sizes = sizes or Sizes()
    with (
        _scratch(folder) as name,
        EventChunks.open(source, Path(name), sizes.rows) as chunks,
    ):
        work = _Work(chunks, protocol, Path(name), place, memory, disk, sizes, progress)
        for parts in (work.in_order, work.resorted):
            tally = LogTally(protocol, conditions, most_nodes, keep_runs, by_condition)
            part = SelectedEvents(conditions) if of_part and conditions is not None else None
            with LogSpool(Path(name), work.tokens, place) as spool:
                for events in parts():
                    if events is None:
                        break
                    tally.add(
                        events.starts, events.participant, events.condition, work.names, events.action,
                        events.response,
                    )  # fmt: skip
                    if digest:
                        spool.add(events if part is None else part.of(events, work.names))
                else:
                    names = work.names if part is None else part.names
                    own = spool.digest(work.study, names, protocol) if digest else ""
                    log = tally.finish(work.study, own)
                    return CompressedFile(log, reading_notes(source, chunks.unknown), parts == work.resorted)
    raise AssertionError("the second pass ends with a log or an error")


@contextmanager
def _scratch(folder: str | Path | None) -> Iterator[str]:
    """A folder for temporary files that is gone afterwards."""
    try:
        made = tempfile.TemporaryDirectory(prefix="prosocial-", dir=folder, ignore_cleanup_errors=True)
    except OSError as error:
        where = tempfile.gettempdir() if folder is None else str(folder)
        raise InputError(f"temporary files: no folder can be made in {where}: {error.strerror}") from None
    with made as name:
        yield name


class _Work:
    """Both passes over a file."""

    def __init__(
        self, chunks: EventChunks, protocol: Protocol, folder: Path, place: str, memory: int, disk: int,
        sizes: Sizes, progress: Progress | None,
    ) -> None:  # fmt: skip
        self.chunks, self.protocol, self.folder, self.place = chunks, protocol, folder, place
        self.memory, self.disk, self.sizes, self.progress = memory, disk, sizes, progress
        self.tokens = tuple(c for c in TOKEN_COLUMNS if c in chunks.names)
        self.names: Sequence[str] = ()
        self.study = ""

    def in_order(self) -> Iterator[CodedEvents | None]:
        """Events of a file that is sorted and valid; None, and no more, where it is not."""
        flow = EventFlow(self.protocol)
        rows = 0
        for columns in self._read(SORTED):
            events = flow.accept(columns)
            if events is None:
                yield None
                return
            rows += len(events.action)
            self.names = cast(Coded, columns["condition"]).labels
            yield events
        self._refuse_empty(rows)
        self.study = flow.study or ""

    def resorted(self) -> Iterator[CodedEvents]:
        """Events of any valid file.

        Raises
        ------
        EventLogError
            With every broken rule.
        """
        found, runs = Problems(self.place), RunCheck()
        sorter = EventSorter(
            self.folder, record_type(self.tokens), min(self.memory, MEMORY) // 2, self.disk, self.place,
            self.sizes.segment, self.sizes.most_segments,
        )  # fmt: skip
        study: str | None = None
        self.names = ()
        for columns in self._read(SORTING):
            own = cast(Coded, columns["study"])
            if found.row == 0:
                self.study = label_at(own, 0)
                study = None if own.codes[0] < 0 else self.study
            sorter.add(self._records(columns, found, study))
            found.row += len(own.codes)
            self.names = cast(Coded, columns["condition"]).labels
        self._refuse_empty(found.row)
        broken = found.total > 0
        # The first broken rule ends what is given out, not what is checked.
        for part in sorter.sorted(lambda done: self._watch(MERGING, done / found.row)):
            participant, sequence, k, condition = (
                np.ascontiguousarray(part[c]) for c in ("participant", "sequence", "k", "condition")
            )
            starts = runs.check(participant, sequence, k, Coded(condition, self.names), part["row"])
            broken = broken or runs.total > 0
            if not broken:
                response = np.maximum(part["response"] - 2, UNSEEN).astype(np.int8)
                yield CodedEvents(
                    starts, participant, sequence, condition, part["action"].astype(np.int8), response,
                    {name: np.ascontiguousarray(part[name]) for name in self.tokens},
                )  # fmt: skip
        runs.report(found)
        try:
            found.raise_if_any()
        except EventLogError as error:
            if self.chunks.parquet:
                raise
            raise renumbered(error, self.chunks.source) from None

    def _records(self, columns: Columns, found: Problems, study: str | None) -> np.ndarray:
        own = cast(Coded, columns["study"])
        code = -1 if study is None else (list(own.labels).index(study) if study in own.labels else -2)
        action, response = check_rows(columns, self.protocol, found, (code, self.study))
        records = np.empty(len(action), dtype=record_type(self.tokens))
        for name in (*INTEGER_COLUMNS, *self.tokens):
            records[name] = columns[name]
        records["row"] = np.arange(found.row, found.row + len(action))
        records["condition"] = cast(Coded, columns["condition"]).codes
        records["action"], records["response"] = action, response
        return records

    def _read(self, label: str) -> Iterator[Columns]:
        return self.chunks.read(lambda share: self._watch(label, share))

    def _watch(self, label: str, share: float) -> None:
        if self.progress is not None:
            self.progress(label, int(100 * share), 100)

    def _refuse_empty(self, rows: int) -> None:
        if rows == 0:
            raise located(self.place, Phrase("no events"), "at least one row below the header")
