"""Section: who took part, what was recorded, who left early."""

from __future__ import annotations

from functools import partial

from analysis import participant_flow
from analysis.figures.flow import still_going
from analysis.figures.style import spoken
from analysis.report.context import ReportContext
from analysis.report.section import Block, Figure, NotSupported, Table, Text, attempt
from analysis.wording import counted


def make(context: ReportContext) -> tuple[Block, ...]:
    """Counts by condition, selection and exclusions, run lengths, dropout."""
    return (
        Text(_selection(context)),
        _counts(context),
        *attempt("a figure of run lengths", partial(_lengths, context)),
        *attempt("a test whether leaving follows the response", partial(_dropout, context)),
    )


def _selection(context: ReportContext) -> str:
    log, whole = context.log, context.data.log
    if context.conditions:
        text = (
            f"Selected: condition {', '.join(context.conditions)}, which leaves {log.n_participants:,} of "
            f"{counted(whole.n_participants, 'person', 'people')} and {log.n_runs:,} of "
            f"{counted(whole.n_runs, 'run')}."
        )
    else:
        people, runs = counted(log.n_participants, "person", "people"), counted(log.n_runs, "run")
        text = f"The whole file is used: {people} and {runs}."
    return f"{text} The workbench excludes nobody: a file that breaks a rule is refused as a whole."


def _random_length(context: ReportContext) -> bool:
    return context.data.card.run_length == "random"


def _undecided(context: ReportContext) -> bool:
    """Whether run lengths differ by what may be design, and nobody said what it is."""
    return context.data.card.run_length == "unstated" and bool(participant_flow.lengths_by_design(context.log))


def _counts(context: ReportContext) -> Table:
    frame = participant_flow.flow_table(context.log)
    if len(context.log.conditions) == 1:
        frame = frame.iloc[:1]
    random, undecided = _random_length(context), _undecided(context)
    if random or undecided:
        frame = frame.drop(columns="short_runs")
    caption = "People, runs, events and responses by condition. "
    caption += (
        "Run lengths are random by design, so a short run is not a person who left."
        if random
        else "Run lengths differ by what may be design, so none is called cut short."
        if undecided
        else participant_flow.RULE
    )
    headings = {
        "recorded": "responses recorded", "missing": "responses missing", "shortest": "shortest run",
        "median": "median run", "longest": "longest run", "short_runs": "runs cut short",
    }  # fmt: skip
    formats = {c: ",g" if c == "median" else ",d" for c in frame.columns if c != "condition"}
    headings = {k: v for k, v in headings.items() if k in frame.columns}
    return Table("flow-counts", frame, caption, (context.origin,), headings=headings, formats=formats)


def _lengths(context: ReportContext) -> tuple[Block, ...]:
    table = participant_flow.still_going(context.log)
    if bool((table["share"] == 1).all()):
        same = {int(n) for n in table.groupby("condition")["k"].max() + 1}
        length = counted(same.pop(), "event") if len(same) == 1 else "the full number of events of its condition"
        raise NotSupported(f"every run has {length}, so the figure would be a flat line")
    half = table[table["share"] >= 0.5].groupby("condition")["k"].max()
    alt = (
        "Share of runs that have round k, falling from 1. The last round that half of the runs have is "
        + ", ".join(f"{k} in {name}" for name, k in half.items())
    )
    why = (
        "The fall is the design's random end of a run, not dropout."
        if _random_length(context)
        else "A fall before the last round is dropout, unless the design ended runs at random."
    )
    caption = f"Share of runs that have a round k, by condition. {why}"
    return (Figure("still-going", (partial(still_going, table),), caption, (f"{alt}.",), (context.origin,)),)


def _dropout(context: ReportContext) -> tuple[Block, ...]:
    if _random_length(context):
        raise NotSupported("run lengths are random by design, so ending early is not leaving")
    if _undecided(context):
        raise NotSupported(
            "run lengths differ by what may be design; say so on the data card or with --run-length random|fixed"
        )
    if not participant_flow.short_runs(context.log).any():
        raise NotSupported("no run was cut short")
    found = participant_flow.dropout_after_response(context.log)
    if found is None:
        raise NotSupported(
            "runs were cut short, but nowhere can two different responses in the same condition and round be "
            "compared"
        )
    frame = found.table.assign(response=[spoken(r) for r in found.table["response"]])
    table = Table(
        "dropout", frame, "Whether the run ended after a response, by that response", (context.origin,),
        headings={"stopped": "run ended next", "went_on": "went on", "share": "share that ended"},
        formats={"stopped": ",d", "went_on": ",d", "share": ".3f"},
    )  # fmt: skip
    return (Text(found.sentence), table)
