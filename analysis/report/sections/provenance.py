"""Section: what data, which part of them, which settings and versions."""

from __future__ import annotations

import pandas as pd

from analysis.report.context import ReportContext, versions
from analysis.report.section import Block, Origin, Points, Table, Text
from analysis.wording import counted
from models.baum_welch import BaumWelch

PLAIN_WORDS = {
    Origin.SIMULATED: "These data are SIMULATED. They were drawn from a model on a computer; nobody took part. "
    "Nothing in this report is evidence about people.",
    Origin.REAL: "These data are REAL: recorded behaviour of people. What the study can and cannot carry is said "
    "in the last section.",
    Origin.UNSTATED: "This is a supplied file, and nothing states whether its people are real or simulated. Read "
    "it accordingly.",
}


def make(context: ReportContext) -> tuple[Block, ...]:
    """Data card, selection, settings, versions."""
    blocks: list[Block] = [Text(PLAIN_WORDS[context.origin], "warning"), _data(context), _settings(context)]
    software = pd.DataFrame(list(versions().items()), columns=["software", "version"])
    blocks.append(Table("versions", software, "Software", (Origin.DEFINITION,), facts=True))
    if context.data.card.references:
        blocks.append(Points(context.data.card.references, "References of the data set"))
    origins = tuple(
        f"{o.label}: {o.meaning}" for o in Origin if o in (context.origin, Origin.PRINTED, Origin.DEFINITION)
    )
    blocks.append(Points(origins, "Badges at every table and figure say where its numbers come from"))
    return tuple(blocks)


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
        ("taken from the data card", ", ".join(context.selection.from_card) or "nothing"),
        ("seed", str(context.seed)),
        ("report made", context.date),
        ("command", context.command or "not given"),
        *(("note on reading", note) for note in context.data.notes),
    ]
    frame = pd.DataFrame(rows, columns=["item", "value"])
    return Table("data", frame, "The data and what was asked of them", (context.origin,), facts=True)


def _settings(context: ReportContext) -> Table:
    study = context.study
    rows = [_fit_row("longer search", list(study.fits), [f.settings for f in study.fits.values()])]
    if study.paper_fits:
        paper = [f.settings for f in study.paper_fits.values()]
        rows.append(_fit_row("published procedure", list(study.paper_fits), paper))
    for k, bootstrap in study.bootstraps.items():
        settings = context.effort.for_bootstrap(study.fits[k]).settings
        row = _fit_row(f"bootstrap, {bootstrap.replicates} replicates", [k], [settings])
        rows.append(row | {"restarts": "3 a replicate", "finalists": "all", "screening": "–"})
    for name, main in (("posterior", True), ("posterior, other kappa", False)):
        sampler = context.effort.sampler(context.seed, main)
        row = dict.fromkeys(rows[0], "–")
        row |= {"fit": name, "states": ", ".join(map(str, context.shown_states)), "seed": str(sampler.seed)}
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
