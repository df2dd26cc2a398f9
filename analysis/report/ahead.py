"""Processes beside this one that make sections before it gets to them.

Much of a report keeps one processor busy: compilation, drawing, the exact parts of plans. So another process
makes some sections meanwhile, the longest first, and draws their figures. Nothing is handed over but through the
store (`analysis.stored_results`, `analysis.fits`): this process makes every section itself, and finds there what
the other one computed, or waits for what it is computing. A report is the same with as many of them as one likes,
with none, and when they die.
"""

from __future__ import annotations

import threading
import warnings
from collections.abc import Sequence
from concurrent.futures import Future
from concurrent.futures import wait as wait_for
from dataclasses import dataclass, replace
from functools import partial
from types import TracebackType
from typing import Self

from analysis.report.context import ReportContext, posterior_of
from analysis.report.drawings import Drawings
from analysis.report.effort import Effort
from analysis.report.registry import Entry
from analysis.report.section import Section
from analysis.report.units import in_unit
from analysis.study_selection import Selection
from models.parameters import STICKY
from models.posterior import Posterior
from models.worker_processes import WorkerProcesses

LONGEST_FIRST = ("held-out", "plan", "study2", "robust", "sensitivity", "safeguards", "comparison", "uncertainty")
"""Sections that take more than seconds, in the order in which other processes take them."""

USUAL_STATES = 4
"""Its posterior is in every report that fits as many states, whatever the criteria say."""


@dataclass(frozen=True)
class Told:
    """What another process has to say of its work.

    Attributes
    ----------
    found, drawn_before : dict of str to bool
        As in `analysis.report.context.ReportContext` and `analysis.report.drawings.Drawings`.
    warned : tuple of (category, text)
        Warnings that whoever finds a result does not get to see.
    """

    found: dict[str, bool]
    drawn_before: dict[str, bool]
    warned: tuple[tuple[type[Warning], str], ...] = ()


class Ahead:
    """Sections of one report, made here and in other processes.

    Parameters
    ----------
    workers : int
        Other processes; 0 for none.
    pictures : bool
        Whether figures are wanted as PNG too (`Drawings`).

    Attributes
    ----------
    done : list of str
        What other processes made, in the order they did.
    computed, drawn : set of str
        Results and figures that they computed, rather than found.
    """

    def __init__(self, workers: int, pictures: bool) -> None:
        self._workers, self._pictures = workers, pictures
        self._pool: WorkerProcesses | None = None
        self._lock = threading.Lock()
        self._context: ReportContext | None = None
        self._unit = ""
        self._entries: dict[str, Entry] = {}
        self._to_make: list[str] = []
        self._to_draw: list[str] = []
        self._idle = 0
        self._under_way: dict[str, Future[Told]] = {}
        self._warned: list[tuple[type[Warning], str]] = []
        self.done: list[str] = []
        self.computed: set[str] = set()
        self.drawn: set[str] = set()

    def start(self, chosen: Selection, effort: Effort, seed: int) -> None:
        """Start the processes, with what needs no search for models first; for a report that has to be computed."""
        if self._workers and self._pool is None:
            self._pool = WorkerProcesses(self._workers)
            if USUAL_STATES in chosen.states:
                first = self._pool.submit(sample_ahead, chosen, effort, seed)
                first.add_done_callback(self._noted)

    def sections(
        self, context: ReportContext, entries: Sequence[Entry], unit: str, drawings: Drawings
    ) -> list[Section]:
        """Make all sections, in order, and draw here what nobody else draws.

        Parameters
        ----------
        context : ReportContext
        entries : sequence of Entry
        unit : str
            Of the reward (`analysis.report.units.in_unit`).
        drawings : Drawings
            Of this process.
        """
        made: dict[str, Section] = {}

        def make(key: str) -> None:
            made[key] = in_unit([self._entries[key].section(context)], unit)[0]

        self._entries = {entry.key: entry for entry in entries}
        self._context, self._unit = replace(context, progress=None, found={}, _posteriors={}), unit
        with self._lock:
            self._to_make = list(self._entries)
        for _ in range(self._workers if self._pool is not None else 0):
            self._next()
        while (key := self._mine(self._to_make)) is not None:
            make(key)
            if self._pool is not None and made[key].figures:
                with self._lock:
                    self._to_draw.append(key)
                    idle, self._idle = self._idle, 0
                for _ in range(idle):
                    self._next()
        while (key := self._mine(self._to_draw)) is not None:
            for figure in made[key].figures:
                drawings.of(figure)
        with self._lock:
            waited = [future for future in self._under_way.values() if not future.done()]
        if waited and context.progress is not None:
            context.progress("waiting for what another process makes", 0, 1)
        wait_for(waited)
        for key in self._entries.keys() - made.keys():
            make(key)
        for category, text in self._warned:
            warnings.warn(text, category, stacklevel=2)
        return [made[entry.key] for entry in entries]

    def __enter__(self) -> Self:
        """Itself."""
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End the processes at once: nobody wants more of them."""
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def _mine(self, tasks: list[str]) -> str | None:
        with self._lock:
            return tasks.pop(0) if tasks else None

    def _next(self) -> None:
        """Give a process its next section, or one whose figures are to be drawn."""
        with self._lock:
            longest = [key for key in LONGEST_FIRST if key in self._to_make]
            if longest:
                self._to_make.remove(key := longest[0])
            elif self._to_draw:
                key = self._to_draw.pop()
            else:
                self._idle += 1
                return
            if self._pool is None or self._context is None:
                return
            future = self._pool.submit(make_ahead, self._context, self._entries[key], self._unit, self._pictures)
            self._under_way[key] = future
        future.add_done_callback(partial(self._answered, key))

    def _answered(self, key: str, future: Future[Told]) -> None:
        if future.cancelled():
            return
        # An error there is no error of the report: the section is made here then, and fails here if it must.
        if future.exception() is None:
            self.done.append(key)
            self._noted(future)
        self._next()

    def _noted(self, future: Future[Told]) -> None:
        if future.cancelled() or future.exception() is not None:
            return
        told = future.result()
        with self._lock:
            self.computed |= {what for what, found in told.found.items() if not found}
            self.drawn |= {what for what, found in told.drawn_before.items() if not found}
            self._warned += told.warned


def sample_ahead(chosen: Selection, effort: Effort, seed: int) -> Told:
    """In another process: sample the posterior that every report shows.

    Parameters
    ----------
    chosen : Selection
    effort : Effort
    seed : int
    """
    label, stored = posterior_of(chosen, USUAL_STATES, STICKY.stay, effort, seed)
    return Told({label: stored.reused}, {})


def make_ahead(context: ReportContext, entry: Entry, unit: str, pictures: bool) -> Told:
    """In another process: make a section and draw its figures, all of which the store keeps.

    Parameters
    ----------
    context : ReportContext
    entry : Entry
    unit : str
        Of the reward (`analysis.report.units.in_unit`).
    pictures : bool
        As in `Drawings`.
    """
    # A process makes sections of one report, and posteriors that it has read before serve it again.
    context = replace(context, _posteriors=_read_before)
    drawings = Drawings(pictures)
    with warnings.catch_warnings(record=True) as warned:
        section = in_unit([entry.section(context)], unit)[0]
        for figure in section.figures:
            drawings.of(figure)
    told = tuple((w.category, str(w.message)) for w in warned)
    return Told(dict(context.found), drawings.found, told)


_read_before: dict[tuple[int, float], Posterior] = {}
