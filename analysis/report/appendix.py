"""The appendix: methods ready to quote, settings of every fit, the analysis plan, and what makes what."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from analysis.report.analysis_plan import AnalysisPlan
from analysis.report.compared_models import scope
from analysis.report.context import ReportContext, versions
from analysis.report.methods import methods_paragraph
from analysis.report.output_map import Output
from analysis.report.search_words import search_words
from analysis.report.section import Block, Origin, Part, Section, Table, Text
from analysis.wording import counted
from models.baum_welch import BaumWelch

KEY, TITLE = "appendix", "Appendix: methods, settings, and what makes what"


def appendix(context: ReportContext, outputs: Sequence[Output], plan: AnalysisPlan | None = None) -> Section:
    """The last section of a report.

    Parameters
    ----------
    context : ReportContext
    outputs : sequence of Output
        Every figure and table of the sections before it.
    plan : AnalysisPlan, optional
    """
    methods = (
        Text("Free to copy. It says what this report did; what it found is in the sections above.", "note"),
        Text(methods_paragraph(context, {output.block.key for output in outputs}), "quote"),
    )
    blocks: list[Block] = [Part("Methods, ready to quote", "methods", methods)]
    if plan is not None:
        blocks.append(Part("The analysis plan", "analysis-plan", (_plan_text(plan, outputs), _plan(plan))))
    software = pd.DataFrame(list(versions().items()), columns=["software", "version"])
    settings = (
        *_searches(context), _settings(context, outputs),
        Table("versions", software, "Software", (Origin.DEFINITION,), facts=True),
    )  # fmt: skip
    blocks.append(Part("Settings and software", "settings-and-software", settings))
    blocks.append(Part("What makes which figure and table", "what-makes-what", (_map(outputs),), folded=True))
    return Section(TITLE, KEY, tuple(blocks))


def _plan_text(plan: AnalysisPlan, outputs: Sequence[Output]) -> Text:
    planned = sum(o.status == "planned" for o in outputs)
    where = f" ({plan.where})" if plan.where else ""
    return Text(
        f"{plan.title}, {plan.date}{where}: {counted(planned, 'result')} of {len(outputs)} planned; all others are "
        "exploratory, and say so. Whether the plan was written before anybody saw the data is not checked here."
    )


def _plan(plan: AnalysisPlan) -> Table:
    headings = {"planned": "planned results (keys)", "why": "why"}
    return Table(
        "planned-results", pd.DataFrame(plan.rows()), "What was planned", (Origin.DEFINITION,), headings
    )  # fmt: skip


def _map(outputs: Sequence[Output]) -> Table:
    rows = [
        {"output": o.name, "key": o.block.key, "section": o.section, "made by": o.maker.replace("analysis.", "")}
        for o in outputs
    ]
    caption = (
        "Plot function of every figure, and module of every table, below analysis/. The files of each are in the "
        "folder parts beside the report."
    )
    return Table("output-map", pd.DataFrame(rows), caption, (Origin.DEFINITION,))


def _searches(context: ReportContext) -> tuple[Block, ...]:
    """How many random starts there were, and how many runs behind what is said of final runs above."""
    study = context.study
    told = f"Longer search: {search_words(study.fits.values())}"
    if study.paper_fits:
        told += f" Published procedure: {search_words(study.paper_fits.values())}"
    return (Text(f"Restarts are random starts; final runs are those that were followed to the end. {told}"),)


def _settings(context: ReportContext, outputs: Sequence[Output]) -> Table:
    study = context.study
    rows = [_fit_row("longer search", list(study.fits), [f.settings for f in study.fits.values()])]
    if study.paper_fits:
        paper = [f.settings for f in study.paper_fits.values()]
        rows.append(_fit_row("published procedure", list(study.paper_fits), paper))
    for k, bootstrap in study.bootstraps.items():
        settings = context.effort.for_bootstrap(study.fits[k]).settings
        row = _fit_row(f"bootstrap, {bootstrap.replicates} replicates", [k], [settings])
        rows.append(row | {"restarts": "3 a replicate", "finalists": "all", "screening": "–"})
    samples = [("posterior", True, context.shown_states), ("posterior, other kappa", False, context.shown_states)]
    if any(output.block.key == "comparison-loo" for output in outputs):
        samples.insert(1, ("posterior, models compared", True, scope(context).sizes))
    for name, main, sizes in samples:
        sampler = context.effort.sampler(context.seed, main)
        row = dict.fromkeys(rows[0], "–")
        row |= {"fit": name, "states": ", ".join(map(str, sizes)), "seed": str(sampler.seed)}
        row |= {"restarts": f"{sampler.chains} chains", "screening": f"{sampler.tune:,} tuning"}
        rows.append(row | {"cap": f"{sampler.draws:,} draws", "estimate": "NUTS sample"})
    caption = (
        "Settings of every fit. Maps are EM iterations; a run ends when the gain stays below the tolerance. The "
        "paper prints the 30 restarts and the Dirichlet(1) draws of its procedure, but neither tolerance nor cap: "
        "the ones here are conventional."
    )
    return Table("settings", pd.DataFrame(rows), caption, (Origin.DEFINITION,))


def _fit_row(name: str, states: list[int], settings: list[BaumWelch]) -> dict[str, str]:
    own = settings[0]
    prior = own.prior
    flat = prior.initial == prior.transition == prior.emission == 1.0 and prior.stay == 0
    return {
        "fit": name,
        "states": ", ".join(map(str, states)),
        "restarts": str(own.restarts),
        "finalists": "all" if own.finalists is None else str(min(own.finalists, own.restarts)),
        "screening": f"{own.screening_maps} maps" if own.finalists is not None else "–",
        "cap": f"{own.max_maps:,} maps",
        "tolerance": f"{own.tolerance:g}",
        "patience": str(own.patience),
        "acceleration": "SQUAREM" if own.accelerate else "none",
        "estimate": "maximum likelihood" if flat else "posterior mode",
        "seed": str(own.seed),
    }
