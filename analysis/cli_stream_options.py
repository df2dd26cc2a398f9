"""The option ``--stream``: when commands read a file in parts, and what they then learn from."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from models.errors import InputError, Phrase, located

if TYPE_CHECKING:
    from analysis.progress import Progress
    from models.compressed_log import CompressedLog
    from models.protocol import Protocol

LARGE = 5_000_000
"""Events from which commands read a file in parts, unless told otherwise."""

CSV_BYTES, PACKED = 64, 10
"""Bytes an event takes in a CSV file, and how many times smaller gzip makes it: rough, the choice is not a matter
of results."""

MANY, HELD = 1_000_000, 130
"""Events from which commands that hold a file say so, and bytes that an event takes while it is read at once."""

StreamOption = Annotated[
    bool | None,
    typer.Option(
        "--stream/--no-stream",
        help="Read the file in parts, in bounded memory; by default from some five million events on.",
    ),
]


@dataclass(frozen=True)
class SelectionInParts:
    """What a command learns from, where the file was read in parts (`analysis.study_selection.Selection`).

    Attributes
    ----------
    log : CompressedLog
        The selected conditions.
    pins : tuple of str
    states : tuple of int
    notes : tuple of str
    """

    log: CompressedLog
    pins: tuple[str, ...]
    states: tuple[int, ...]
    notes: tuple[str, ...]

    kind = "unstated"

    @property
    def conditions(self) -> tuple[str, ...]:
        """Names of the selected conditions."""
        return self.log.conditions

    @property
    def digest(self) -> str:
        """Digest of the whole log, or of the selected conditions (`select_in_parts`)."""
        return self.log.digest

    @property
    def sentence(self) -> str:
        """The selection in words."""
        some = len(self.conditions) < len(self.log.counts)
        parts = [f"condition {', '.join(self.conditions)}" if some else "all conditions"]
        if self.pins:
            parts.append(f"transition table of {', '.join(self.pins)} held at the identity")
        return "; ".join([*parts, f"states {', '.join(map(str, self.states))}"])


def in_parts(file: str, asked: bool | None, needs_all: str = "") -> bool:
    """Whether to read a file in parts.

    Parameters
    ----------
    file : str
        As given to the command.
    asked : bool, optional
        What ``--stream`` or ``--no-stream`` said.
    needs_all : str
        An option given that needs the whole log; empty if there is none.

    Raises
    ------
    InputError
        If ``--stream`` was given for a registered data set or beside such an option.
    """
    from analysis import datasets

    registered = file in datasets.names()
    if asked and registered:
        raise located("--stream", Phrase(f"the registered data set {file}"), "a file: its data set is read at once")
    if asked and needs_all:
        raise InputError(f"--stream: found {needs_all} beside it, which needs every run of the log; leave one out")
    if asked is not None:
        return asked
    return not registered and not needs_all and Path(file).is_file() and _events(file) >= LARGE


def reading_sentence(file: str, resorted: bool, asked: bool | None) -> str:
    """How a file was read, in words."""
    why = "as asked" if asked else "since it is large; --no-stream reads it at once"
    order = "; its rows were out of order and were sorted on disk" if resorted else ""
    return f"{file}: read in parts, in bounded memory ({why}){order}."


def held_sentence(file: str, command: str) -> str:
    """What a command that cannot read in parts says of a large file; empty if the file is not large.

    Raises
    ------
    InputError
        If the machine has not enough memory to hold the events alone.
    """
    from analysis import datasets

    if file in datasets.names() or not Path(file).is_file() or (events := _events(file)) < MANY:
        return ""
    parts = "em, bayes and data check read files in parts"
    memory = machine_memory()
    if events * HELD > memory:
        found = Phrase(f"some {events:,} events, which take about {events * HELD / 1e9:.1f} GB")
        wanted = f"a file that fits into {memory / 1e9:.1f} GB of memory: {command} reads it at once; {parts}"
        raise located(file, found, wanted)
    return (
        f"{file}: some {events:,} events, read at once and held; besides, {command} keeps log-likelihoods of every "
        f"person under every draw of every model, 32 KB a person at 4,000 draws. Only {parts}."
    )


def machine_memory() -> float:
    """Bytes of memory that the machine has; infinite where the system does not say."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):
        return float("inf")


def memory_allowed() -> int:
    """Bytes that the tree of a file read in parts may take: half of what is free, where the system says so.

    Histories that hardly repeat make a tree as large as the file; results do not depend on this number.
    """
    from analysis.event_stream import MEMORY

    try:
        free = os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):
        return MEMORY
    return max(MEMORY, free // 2)


def select_in_parts(
    file: str, protocol: Protocol, condition: Sequence[str] | None, states: str | None, pins: Sequence[str] | None,
    progress: Progress | None = None, default_states: str = "2-5", *, for_posterior: bool = False,
) -> tuple[SelectionInParts, bool]:  # fmt: skip
    """Read a file in parts for learning; the options are those of `analysis.study_selection.select`.

    Parameters
    ----------
    file, protocol, condition, states, pins, progress, default_states
    for_posterior : bool
        Histories are counted by condition too, and the digest is that of the selected conditions.

    Returns
    -------
    SelectionInParts
    bool
        Whether rows had to be sorted.

    Raises
    ------
    InputError
        As `compress_events` and `select`.
    """
    from analysis.em_study import parse_states
    from analysis.event_stream import compress_events
    from analysis.study_selection import ALL_CONDITIONS, checked_pins

    held = checked_pins(protocol, pins)
    wanted = parse_states(default_states if states is None else states)
    chosen = None if not condition or list(condition) == [ALL_CONDITIONS] else condition
    found = compress_events(
        file, protocol, conditions=chosen, memory=memory_allowed(), by_condition=for_posterior,
        of_part=for_posterior, progress=progress,
    )  # fmt: skip
    return SelectionInParts(found.log, held, wanted, found.notes), found.resorted


def _events(file: str) -> int:
    """About how many events a file holds: exactly for Parquet, by its size otherwise."""
    import pyarrow as pa
    import pyarrow.parquet

    from analysis.event_files import is_parquet
    from analysis.file_source import FileSource

    source = FileSource.of(file)
    if is_parquet(source) and not source.gzipped:
        try:
            return int(pyarrow.parquet.read_metadata(source.path).num_rows)
        except (pa.ArrowException, OSError):
            return 0
    size = source.path.stat().st_size
    return size * (PACKED if source.gzipped else 1) // CSV_BYTES
