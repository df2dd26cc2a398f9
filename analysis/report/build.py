"""Build the report: fit, make every section, draw, write beside and rename."""

from __future__ import annotations

import datetime
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from analysis.datasets import DataSet
from analysis.design import published
from analysis.em_study import EmStudy, Progress, run_em
from analysis.report.context import ReportContext
from analysis.report.effort import Effort
from analysis.report.pdf import to_pdf
from analysis.report.registry import SECTIONS, Entry
from analysis.report.render import render
from analysis.report.section import Section
from models.bootstrap import parametric_bootstrap
from models.events import EventLog
from models.model_files import write_bytes, write_text
from models.parameters import Array

DEFAULT_STATES = (2, 3, 4, 5)
HTML_NAME, PDF_NAME = "report.html", "report.pdf"


@dataclass(frozen=True)
class ReportResult:
    """What was written.

    Attributes
    ----------
    html : Path
    pdf : Path or None
        None if it was not asked for.
    sections : tuple of Section
    study : EmStudy
        The fits behind it.
    seconds : float
        Wall time without compilation.
    """

    html: Path
    pdf: Path | None
    sections: tuple[Section, ...]
    study: EmStudy
    seconds: float


def build_report(
    dataset: DataSet,
    *,
    states: Sequence[int] | None = None,
    seed: int = 1,
    quick: bool = False,
    out: str | Path = "reports/build",
    condition: Sequence[str] | None = None,
    pins: Sequence[str] | None = None,
    pdf: bool = False,
    command: str = "",
    date: str | None = None,
    progress: Progress | None = None,
    sections: Sequence[Entry] = SECTIONS,
) -> ReportResult:
    """Fit the models of a data set and write the report on them.

    Parameters
    ----------
    dataset : DataSet
    states : sequence of int, optional
        Numbers of states; the card's, or 2 to 5.
    seed : int
    quick : bool
        Fewer restarts and replicates; the report is marked as not for citation.
    out : path
        Folder; made if it is not there.
    condition : sequence of str, optional
        Conditions to select; the card's by default, an empty sequence for all.
    pins : sequence of str, optional
        Actions whose transition table is fixed to the identity; the card's by default, an empty one for none.
    pdf : bool
        Also write a PDF (needs WeasyPrint).
    command : str
        Printed in the report.
    date : str, optional
        Printed in the report; today by default.
    progress : callable, optional
        Called with (what is running, done, total).
    sections : sequence of Entry
        The sections to show, in order.

    Raises
    ------
    InputError
        On an unknown condition or action, or if a PDF is wanted and WeasyPrint is missing.
    """
    started = time.perf_counter()
    defaults = _defaults(dataset)
    chosen = defaults["condition"] if condition is None else tuple(condition)
    held = defaults["pins"] if pins is None else tuple(pins)
    counts = defaults["states"] if states is None else tuple(states)
    log = dataset.log.select(conditions=chosen) if chosen else dataset.log
    effort = Effort.of(quick)
    study = fit_models(log, counts, effort, pins={a: None for a in held}, seed=seed, progress=progress)
    context = ReportContext(
        data=dataset, log=log, study=study, conditions=chosen, pins=held, seed=seed, effort=effort,
        published=published(), command=command, date=date or datetime.date.today().isoformat(),
    )  # fmt: skip
    made = tuple(entry.section(context) for entry in sections)
    if progress is not None:
        progress("drawing", 0, 1)
    page = render(made, context)
    folder = Path(out)
    # Both are complete before either is written, so a failure leaves the last good report alone.
    pages = to_pdf(page) if pdf else None
    write_text(folder / HTML_NAME, page)
    if pages is not None:
        write_bytes(folder / PDF_NAME, pages)
    if progress is not None:
        progress("drawing", 1, 1)
    seconds = time.perf_counter() - started - study.compile_seconds
    return ReportResult(folder / HTML_NAME, folder / PDF_NAME if pdf else None, made, study, seconds)


def fit_models(
    log: EventLog,
    states: Sequence[int],
    effort: Effort,
    *,
    pins: Mapping[str, Array | None],
    seed: int,
    progress: Progress | None = None,
) -> EmStudy:
    """Fit every number of states, the published procedure beside, and bootstrap what is shown in full."""
    study = run_em(
        log, states, settings=lambda k: effort.search(k, pins, seed), pins=pins, seed=seed, with_paper=True,
        progress=progress,
    )  # fmt: skip
    bootstraps = {}
    for k in study.states:
        if k not in (4, study.best_by_bic):
            continue

        def tell(done: int, total: int, k: int = k) -> None:
            if progress is not None:
                progress(f"bootstrap, {k} states", done, total)

        bootstraps[k] = parametric_bootstrap(
            effort.for_bootstrap(study.fits[k]), log, effort.replicates_for(log, k), seed=seed, progress=tell
        )
    return replace(study, bootstraps=bootstraps)


def _defaults(dataset: DataSet) -> dict[str, Any]:
    """The card's condition, pins and states, where it has any."""
    card = dataset.card.defaults
    condition = card.get("condition", ())
    return {
        "condition": (condition,) if isinstance(condition, str) else tuple(condition),
        "pins": tuple(card.get("pins", ())),
        "states": tuple(card.get("states", DEFAULT_STATES)),
    }
