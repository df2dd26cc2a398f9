"""Section: what data, which part of them, and how to read the badges."""

from __future__ import annotations

import pandas as pd

from analysis.report.context import ReportContext
from analysis.report.section import Block, Origin, Points, Table, Text
from analysis.wording import counted

PLAIN_WORDS = {
    Origin.SIMULATED: "These data are SIMULATED. They were drawn from a model on a computer; nobody took part. "
    "Nothing in this report is evidence about people.",
    Origin.REAL: "These data are REAL: recorded behaviour of people. What the study can and cannot carry is said "
    "in the last section.",
    Origin.UNSTATED: "This is a supplied file, and nothing states whether its people are real or simulated. Read "
    "it accordingly.",
}


def make(context: ReportContext) -> tuple[Block, ...]:
    """Data card, selection, badges."""
    blocks: list[Block] = [Text(PLAIN_WORDS[context.origin], "warning"), _data(context)]
    if context.data.card.references:
        blocks.append(Points(context.data.card.references, "References of the data set"))
    origins = tuple(
        f"{o.label}: {o.meaning}" for o in Origin if o in (context.origin, Origin.PRINTED, Origin.DEFINITION)
    )
    blocks.append(Points(origins, "Badges at every table and figure say where its numbers come from"))
    return tuple(blocks)


def _reward(context: ReportContext) -> str:
    if context.stated is not None:
        return context.stated.sentence
    return (
        "the paper's (section The reward)"
        if context.is_published_protocol
        else "none: nobody said what a round is worth"
    )


def _data(context: ReportContext) -> Table:
    card, log, whole = context.data.card, context.log, context.data.log
    selection = "all conditions"
    if context.conditions:
        selection = (
            f"condition {', '.join(context.conditions)}: {log.n_participants:,} of "
            f"{counted(whole.n_participants, 'person', 'people')}, {log.n_runs:,} of {counted(whole.n_runs, 'run')}"
        )
    pins = ", ".join(context.pins) or "none"
    if context.pins:
        pins += " (transition table fixed to the identity: the action leaves the state where it is)"
    rows = [
        ("title", card.title),
        ("real or simulated", context.origin.label),
        ("what it is", card.what or "not stated"),
        ("source", card.source),
        ("licence", card.licence),
        ("study, as written in the log", log.study),
        ("content (SHA-256)", context.data.digest),
        ("selection", selection),
        (
            "size of the selection",
            f"{counted(log.n_participants, 'person', 'people')}, {counted(log.n_runs, 'run')}, "
            f"{counted(log.n_events, 'event')}, {counted(log.n_responses_recorded, 'response')}",
        ),
        ("protocol", context.protocol.name),
        ("actions held fixed", pins),
        ("reward that plans are made for", _reward(context)),
        ("taken from the data card", ", ".join(context.selection.from_card) or "nothing"),
        ("seed", str(context.seed)),
        ("report made", context.date),
        ("command", context.command or "not given"),
        *(("note on reading", note) for note in context.data.notes),
    ]
    frame = pd.DataFrame(rows, columns=["item", "value"])
    return Table("data", frame, "The data and what was asked of them", (context.origin,), facts=True)
