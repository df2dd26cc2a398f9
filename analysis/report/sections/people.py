"""Section: whether people differ beyond their latent state."""

from __future__ import annotations

from functools import partial

from analysis.datasets import log_digest
from analysis.figures.checks import predictive_checks
from analysis.fits import stored_fit
from analysis.people import PeopleStudy, people_study, spread_sentence
from analysis.report.context import ReportContext
from analysis.report.section import Block, Figure, NotSupported, Points, Table, Text
from analysis.wording import counted
from models.cautions import caution_line
from models.person_offset import PersonOffset
from models.posterior import Posterior

HEADINGS = {
    "states": "states", "median": "median", "low": "5%", "high": "95%", "contraction": "contraction",
    "elpd_difference": "LOO, differing less plain", "error": "its standard error", "failed_plain": "plain",
    "failed": "people differ", "checks": "of", "gate": "sampling", "node_check": "quadrature error",
}  # fmt: skip
FORMATS = {
    "states": "d", "median": ".2f", "low": ".2f", "high": ".2f", "contraction": ".2f", "elpd_difference": "+.1f",
    "error": ".1f", "failed_plain": "d", "failed": "d", "checks": "d", "node_check": ".2g",
}  # fmt: skip


def make(context: ReportContext) -> tuple[Block, ...]:
    """The hierarchical version beside the plain one; a minute of sampling, so left out of quick reports."""
    if context.effort.quick:
        raise NotSupported(
            "the hierarchical model takes a minute, and this is a quick report; `prosocial bayes --people-differ` "
            "fits it"
        )
    if context.log.n_participants < 10:
        raise NotSupported("fewer than 10 people say nothing about how much people differ")
    smallest = min((k for k in context.shown_states if k > 1), default=2)
    states, draws = (1, smallest), context.effort.simulated_studies
    learned = {(k, offset): _learn(context, k, offset) for k in states for offset in (None, PersonOffset())}

    def compared() -> PeopleStudy:
        return people_study(context.log, states, lambda *which: learned[which], draws=draws, seed=context.seed)

    result = context.kept_from(
        "people who differ beside people who do not", compared, people_study,
        {"log": context.log, "learned": learned, "draws": draws, "seed": context.seed},
    )  # fmt: skip
    return blocks(context, result)


def _learn(context: ReportContext, k: int, people: PersonOffset | None) -> Posterior:
    if people is None and k in context.study.states:
        return context.posterior(k)
    tell = context.progress
    label = f"posterior, {counted(k, 'state')}" + (", people differ" if people else "")
    return stored_fit(
        context.log, log_digest(context.log), k, pins=dict.fromkeys(context.pins), people=people,
        sampler=context.effort.sampler(context.seed),
        progress=None if tell is None else lambda _, done, total: tell(label, done, total),
    ).posterior  # fmt: skip


def blocks(context: ReportContext, result: PeopleStudy) -> tuple[Block, ...]:
    """Sentence, table, checks and warnings."""
    origin = context.origin
    intro = (
        "In the model above all people share the tables, and differ only in the state they are in. Here each "
        "person also has an offset of their own on the log-odds of helping, which never changes (a random "
        "intercept, integrated out); with one state, that is all there is. A trait that stays and a state that "
        "hardly moves look alike in short runs."
    )
    made: list[Block] = [Text(intro), Text(result.sentence)]
    made += [Text(spread_sentence(pair.hierarchical)) for pair in result.pairs]
    made.append(
        Table(
            "people-table", result.table,
            "How much people differ (standard deviation of their log-odds of helping), whether knowing it helps to "
            "predict people who were left out, and how many posterior predictive checks fail.",
            (origin,), headings=HEADINGS, formats=FORMATS,
            groups=(("", 1), ("people's standard deviation", 4), ("prediction of people", 2), ("failed checks", 3),
                    ("", 2)),
        )
    )  # fmt: skip
    last = result.pairs[-1]
    panels = (
        partial(predictive_checks, last.plain_checks.table, title="plain"),
        partial(predictive_checks, last.checks.table, title="people differ"),
    )
    alt = tuple(
        f"{title}: {len(found.failed)} of {len(found.table)} checks fail, {int(found.table['outside'].sum())} lie "
        "outside their interval."
        for title, found in (("Plain", last.plain_checks), ("People differ", last.checks))
    )
    made.append(
        Figure(
            "people-checks", panels,
            f"Posterior predictive checks at {counted(last.n_states, 'state')}, without and with people who "
            "differ: bar the 90% interval of simulated studies, diamond the observed value, filled where outside.",
            alt, (origin,),
        )
    )  # fmt: skip
    if result.warnings:
        gates = [pair.hierarchical.gate.caution for pair in result.pairs]
        mark = caution_line(tuple(dict.fromkeys(filter(None, gates))))
        made.append(Points(tuple(result.warnings), "Not to be relied on as they stand", mark))
    return tuple(made)
