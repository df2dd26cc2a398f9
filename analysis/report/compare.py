"""The comparison report: two data sets or two fits, what differs between them and what that changes."""

from __future__ import annotations

import datetime
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from analysis.datasets import DataSet
from analysis.em_study import EmStudy, Progress, run_em
from analysis.report import (
    compared_limits,
    compared_people,
    compared_plans,
    compared_responses,
    compared_sides,
    compared_tables,
)
from analysis.report.compared_context import Comparison
from analysis.report.drawings import Drawings
from analysis.report.effort import Effort
from analysis.report.output_map import output_map
from analysis.report.parts import Written, check_parts_folder, write_parts
from analysis.report.render import PageHead, render
from analysis.report.section import Block, NotSupported, Section
from analysis.report.summary import summarised
from analysis.side_by_side import (
    Side,
    data_side,
    fit_side,
    is_fit,
    name_of,
    shared_states,
    stated_kinds,
    states_for,
)
from analysis.wording import counted
from models.bootstrap import bootstrap_fit
from models.errors import InputError
from models.model_files import write_text
from models.protocol import Protocol

HTML_NAME, PARTS_NAME = "comparison.html", "comparison_parts"


@dataclass(frozen=True)
class CompareResult:
    """What was written.

    Attributes
    ----------
    html : Path
    parts : Written or None
    sides : (Side, Side)
    sections : tuple of Section
    states : tuple of int
        Numbers of states that both sides have.
    seconds : float
    """

    html: Path
    parts: Written | None
    sides: tuple[Side, Side]
    sections: tuple[Section, ...]
    states: tuple[int, ...]
    seconds: float


def compare_report(
    a: str | DataSet, b: str | DataSet, *, states: str | None = None, condition: Sequence[str] | None = None,
    pins: Sequence[str] | None = None, schedule: str | None = None, seed: int = 1, quick: bool = False,
    out: str | Path = "reports/build", parts: bool = False, protocol: Protocol | None = None,
    kind: Sequence[str] = (), command: str = "", date: str | None = None, progress: Progress | None = None,
) -> CompareResult:  # fmt: skip
    """Compare two data sets, two stored posteriors, or one of each, and write the page.

    Parameters
    ----------
    a, b : str or DataSet
        A registered data set, an event file, a fit (netCDF), or a data set as it is, with its card.
    states : str, optional
        Numbers of states to fit data sets with; those of a fit on the other side, else the cards'.
    condition, pins : sequence of str, optional
        Of data sets; their cards' by default.
    schedule : str, optional
        Letters of the rounds that plans are made for; the published ones by default, where there are such modes.
    seed : int
    quick : bool
        Fewer restarts and replicates; marked as not for citation.
    out : path
    parts : bool
    protocol : Protocol, optional
    kind : sequence of str
        ``real`` or ``simulated``, for sides whose people no card speaks of: one for both, or A's and B's.
    command, date : str
    progress : callable, optional

    Raises
    ------
    InputError
        On sides that cannot be read or compared.
    """
    started = time.perf_counter()
    folder = Path(out)
    if parts:
        check_parts_folder(folder / PARTS_NAME)
    # Event logs do not compare with ==: two data sets are the same if they are one object.
    if a is b or (isinstance(a, str) and isinstance(b, str) and a == b):
        raise InputError(f"--compare: found {name_of(a)!r} twice, two different ones were wanted")
    effort = Effort.of(quick)
    wanted = states_for(a, b, states)
    kinds = stated_kinds(a, b, kind)

    def fit(log, numbers, held) -> EmStudy:  # type: ignore[no-untyped-def]
        study = run_em(log, numbers, settings=lambda k: effort.search(k, held, seed), pins=held, seed=seed,
                       progress=progress)  # fmt: skip
        boots = {}
        for k in study.states:
            tell = None if progress is None else partial(progress, f"bootstrap, {counted(k, 'state')}")
            again = effort.for_bootstrap(study.fits[k])
            boots[k] = bootstrap_fit(again, log, effort.replicates_for(log, k), seed=seed, progress=tell)
        return EmStudy(log, study.fits, {}, study.identifications, boots, study.seconds, study.compile_seconds)

    sides = tuple(
        fit_side(label, source, protocol, own) if isinstance(source, str) and is_fit(source)
        else data_side(
            label, source, fit, states=wanted, condition=condition, pins=pins, protocol=protocol, kind=own
        )
        for label, source, own in zip("AB", (a, b), kinds, strict=True)
    )  # fmt: skip
    both = shared_states(*sides)
    comparison = Comparison((sides[0], sides[1]), both, effort, seed, schedule, progress)
    made = tuple(compared_section(comparison, key) for key, _, _ in SECTIONS)
    modules = {key: make.__module__ for key, _, make in SECTIONS}
    head = PageHead(
        f"{sides[0].title} and {sides[1].title}", comparison.origins,
        tuple(s.digest for s in sides if s.digest), seed, date or datetime.date.today().isoformat(), command, quick,
    )  # fmt: skip
    if progress is not None:
        progress("drawing", 0, 1)
    drawings = Drawings(pictures=parts)
    page = render(made, head, drawings)
    write_text(folder / HTML_NAME, page)
    outputs = output_map(made, modules)
    there = folder / PARTS_NAME
    summary = [answer.line for answer in summarised(made)]
    written = (
        write_parts(outputs, drawings, there, comparison.methods, summary, quick=quick) if parts else None
    )  # fmt: skip
    if progress is not None:
        progress("drawing", 1, 1)
    seconds = time.perf_counter() - started
    return CompareResult(folder / HTML_NAME, written, (sides[0], sides[1]), made, both, seconds)


type Make = Callable[[Comparison], tuple[Block, ...]]

SECTIONS: tuple[tuple[str, str, Make], ...] = (
    ("what", "What is compared", compared_sides.make),
    ("responses", "Who responded how", compared_responses.make),
    ("tables", "The learned models", compared_tables.make),
    ("one-model", "One model for both?", compared_people.one_model),
    ("prediction", "Does one predict the people of the other?", compared_people.prediction),
    ("plans", "What it changes for plans", compared_plans.make),
    ("limits", "What this does not show", compared_limits.make),
)
"""Key, title and maker of every section, in order."""


def compared_section(comparison: Comparison, key: str) -> Section:
    """One section of a comparison, made or left out with its reason.

    Parameters
    ----------
    comparison : Comparison
    key : str
        As in `SECTIONS`.
    """
    title, make = next((title, make) for own, title, make in SECTIONS if own == key)
    try:
        return Section(title, key, make(comparison))
    except NotSupported as error:
        return Section(title, key, omitted=error.reason)
