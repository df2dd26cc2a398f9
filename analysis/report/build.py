"""Build the report: fit, make every section, draw, write beside and rename."""

from __future__ import annotations

import datetime
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from analysis.datasets import DataSet
from analysis.design import published
from analysis.em_study import EmStudy, Progress
from analysis.report.ahead import Ahead
from analysis.report.analysis_plan import AnalysisPlan
from analysis.report.appendix import KEY as APPENDIX
from analysis.report.appendix import appendix
from analysis.report.context import ReportContext
from analysis.report.drawings import Drawings
from analysis.report.effort import Effort
from analysis.report.fitting import fit_models
from analysis.report.methods import methods_paragraph
from analysis.report.output_map import output_map
from analysis.report.parts import Written, check_parts_folder, write_parts
from analysis.report.pdf import to_pdf
from analysis.report.registry import SECTIONS, Entry
from analysis.report.render import PageHead, page_keys, render
from analysis.report.section import Section
from analysis.report.summary import summarised
from analysis.stated_reward import Asked, StatedReward, stated_reward
from analysis.stored_results import StoredResult, found_or_made
from analysis.study_selection import Selection, select
from models.errors import located
from models.model_files import write_bytes, write_text
from models.reward import UNIT

HTML_NAME, PDF_NAME, PARTS_NAME = "report.html", "report.pdf", "parts"


@dataclass(frozen=True)
class ReportResult:
    """What was written.

    Attributes
    ----------
    html : Path
    pdf : Path or None
        None if it was not asked for.
    parts : Written or None
        Every table and figure as files; None if they were not asked for.
    sections : tuple of Section
    selection : Selection
        What the report is about.
    study : EmStudy
        The fits behind it.
    seconds : float
        Wall time without compilation.
    reward : StatedReward, optional
        What a round is worth, where it was said for this report.
    found, drawn_before : dict of str to bool
        Of every result that costs more than a second, in words, and of every figure, by key: whether it was found
        in the store (`analysis.stored_results`) rather than computed. The page is the same either way.
    made_beside : tuple of str
        Sections that other processes made first.
    """

    html: Path
    pdf: Path | None
    parts: Written | None
    sections: tuple[Section, ...]
    selection: Selection
    study: EmStudy
    seconds: float
    reward: StatedReward | None = None
    found: dict[str, bool] = field(default_factory=dict)
    drawn_before: dict[str, bool] = field(default_factory=dict)
    made_beside: tuple[str, ...] = ()


def build_report(
    dataset: DataSet,
    *,
    states: Sequence[int] | str | None = None,
    seed: int = 1,
    quick: bool = False,
    out: str | Path = "reports/build",
    condition: Sequence[str] | None = None,
    pins: Sequence[str] | None = None,
    pdf: bool = False,
    parts: bool = False,
    plan: AnalysisPlan | None = None,
    reward: Asked | None = None,
    schedule: str | None = None,
    command: str = "",
    date: str | None = None,
    progress: Progress | None = None,
    sections: Sequence[Entry] = SECTIONS,
    workers: int = 0,
) -> ReportResult:
    """Fit the models of a data set and write the report on them.

    Parameters
    ----------
    dataset : DataSet
    states : sequence of int or str, optional
        Numbers of states, as text such as ``2-5``; the card's by default, else 2 to 5.
    seed : int
    quick : bool
        Fewer restarts and replicates; the report is marked as not for citation.
    out : path
        Folder; made if it is not there.
    condition : sequence of str, optional
        Conditions to select; the card's by default, ``["all"]`` for all.
    pins : sequence of str, optional
        Actions whose transition table is fixed to the identity; the card's by default,
        ``["none"]`` for none.
    pdf : bool
        Also write a PDF (needs WeasyPrint).
    parts : bool
        Also write every table as CSV and LaTeX and every figure as SVG and PNG.
    plan : AnalysisPlan, optional
        Marks every figure and table as planned or exploratory.
    reward : Reward, mapping of int to Reward, Measured, or ``measured``, optional
        What a round is worth, for one number of states or several; ``measured``: the mean team tokens by state
        (`analysis.stated_reward`). Without it only reports on the paper's protocol plan, with the printed reward.
    schedule : str, optional
        With a reward: letters of the rounds that are planned for; the most common ones of the data by default.
    command : str
        Printed in the report.
    date : str, optional
        Printed in the report; today by default.
    progress : callable, optional
        Called with (what is running, done, total).
    sections : sequence of Entry
        The sections to show, in order.
    workers : int
        Other processes that make sections meanwhile (`analysis.report.ahead`); the report is the same.

    Raises
    ------
    InputError
        On an unknown condition or action, a reward for other numbers of states than those fitted, a planned result
        that the report does not have, a folder of other files where the parts belong, or if a PDF is wanted and
        WeasyPrint is missing.
    """
    started = time.perf_counter()
    wanted = states if states is None or isinstance(states, str) else ",".join(map(str, states))
    chosen = select(dataset, condition, wanted, pins)
    effort = Effort.of(quick)
    if schedule is not None:
        if reward is None:
            raise located("schedule", schedule, "none: rounds are planned for where a reward is given")
        chosen.log.protocol.modes_from_letters(schedule)
    folder = Path(out)
    if parts:
        check_parts_folder(folder / PARTS_NAME)
    drawings = Drawings(pictures=parts)
    with Ahead(workers, parts) as ahead:
        fitted = _fitted(ahead, chosen, effort, seed, progress)
        study = replace(fitted.value, compile_seconds=0.0) if fitted.reused else fitted.value
        stated = None if reward is None else stated_reward(reward, study, schedule)
        context = ReportContext(
            selection=chosen, study=study, seed=seed, effort=effort, published=published(), command=command,
            date=date or datetime.date.today().isoformat(), progress=progress, stated=stated,
        )  # fmt: skip
        made = tuple(ahead.sections(context, sections, UNIT if stated is None else stated.unit, drawings))
    if plan is not None:
        plan.check(page_keys(made))
    modules = {entry.key: entry.make.__module__ for entry in sections} | {APPENDIX: appendix.__module__}
    outputs = output_map(made, modules, None if plan is None else plan.status)
    made = (*made, appendix(context, outputs, plan))
    if progress is not None:
        progress("drawing", 0, 1)
    page = render(made, PageHead.of(context), drawings, {o.block.key: o.status for o in outputs if o.status})
    # Both are complete before either is written, so a failure leaves the last good report alone.
    pages = to_pdf(page) if pdf else None
    write_text(folder / HTML_NAME, page)
    if pages is not None:
        write_bytes(folder / PDF_NAME, pages)
    written = None
    if parts:
        told = methods_paragraph(context, {o.block.key for o in outputs})
        status = None if plan is None else plan.status
        summary = [answer.line for answer in summarised(made)]
        marked = output_map(made, modules, status)
        written = write_parts(marked, drawings, folder / PARTS_NAME, told, summary, quick=quick)
    if progress is not None:
        progress("drawing", 1, 1)
    seconds = time.perf_counter() - started - study.compile_seconds
    results = {fitted.what: fitted.reused, **context.found}
    return ReportResult(
        folder / HTML_NAME, folder / PDF_NAME if pdf else None, written, made, chosen, study, seconds, stated,
        {what: found and what not in ahead.computed for what, found in results.items()},
        {key: found and key not in ahead.drawn for key, found in drawings.found.items()}, tuple(ahead.done),
    )  # fmt: skip


def _fitted(
    ahead: Ahead, chosen: Selection, effort: Effort, seed: int, progress: Progress | None
) -> StoredResult[EmStudy]:
    """The fits of the report; if they have to be made, so has most of the rest: other processes begin too."""
    given = (chosen.log, tuple(chosen.states), effort)
    held = dict.fromkeys(chosen.pins)

    def make() -> EmStudy:
        ahead.start(chosen, effort, seed)
        return fit_models(*given, pins=held, seed=seed, progress=progress)

    return found_or_made(
        f"Baum-Welch, states {', '.join(map(str, chosen.states))}, and bootstraps", make, fit_models,
        {"args": given, "pins": held, "seed": seed},
    )  # fmt: skip
