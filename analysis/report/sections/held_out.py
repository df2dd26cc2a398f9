"""Section: conditions and schedules left out in turn and predicted from the rest."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from analysis import held_out_contenders
from analysis import response_rates as rates
from analysis.datasets import log_digest
from analysis.figures.held_out import held_out_by_round, held_out_rates
from analysis.fits import stored_fit
from analysis.held_out import HeldOut, held_out
from analysis.held_out_cells import cell_of_run, cells_of
from analysis.held_out_contenders import standard_contenders
from analysis.held_out_mixed import NAME
from analysis.held_out_words import NOUNS
from analysis.report.context import ReportContext
from analysis.report.section import Block, Figure, NotSupported, Omitted, Origin, Part, Points, Table, Text
from models.errors import InputError
from models.events import EventLog
from models.parameters import Array
from models.person_offset import PersonOffset
from models.posterior import Posterior
from models.protocol import Protocol

MOST_SHOWN = 12
"""Cells beyond which the report leaves nothing out: the command still does."""

MOST_LINES = 7
"""Models told apart by colour, line and marker in one plot; the best of them are shown round by round."""

DIFFERING_DRAWS, TRAIT_DRAWS = 1500, 500
"""Draws a chain where people differ, with states and without: beside states sigma mixes slowly."""

DIFFERING_WORK = 60_000
"""Nodes of the tree of histories x cells x quadrature nodes up to which people may differ: about a minute."""

RANKING = {
    "contender": "model", "log_score_diff": "log score below best", "dse": "its standard error",
    "log_score": "log score", "log_score_error": "its Monte Carlo error", "error": "mean absolute error",
    "crps": "mean CRPS", "round_crps": "mean CRPS by round", "inside": "inside", "cells": "of",
    "rounds_inside": "rounds inside", "rounds": "of ", "prior": "partly not learned", "gate": "fit",
}  # fmt: skip
RATES = {
    "cell": "left out", "contender": "model", "people": "people", "observed": "observed", "expected": "predicted",
    "low": "from", "high": "to", "error": "error", "inside": "inside", "crps": "CRPS", "prior": "prior or assumed",
}  # fmt: skip


def make(context: ReportContext) -> tuple[Block, ...]:
    """Conditions and schedules left out in turn; minutes of refits, so left out of quick reports."""
    log = context.log
    if context.effort.quick:
        raise NotSupported(
            "it refits every model for every condition, and this is a quick report; `prosocial compare --quick "
            "--held-out condition` is the short way"
        )
    counts = {by: len(set(cell_of_run(log, by))) for by in ("condition", "schedule")}
    if max(counts.values()) < 2:
        raise NotSupported("there is one condition and one schedule, so without it nothing is left to learn from")
    blocks: list[Block] = []
    for by, n in counts.items():
        title = f"A {by} that was not seen"
        if n < 2:
            blocks.append(Omitted(title, f"there is only one {by}"))
        elif n > MOST_SHOWN:
            reason = f"{n} {NOUNS[by][1]} are more than the {MOST_SHOWN} for which a report refits its models"
            blocks.append(Omitted(title, reason))
        else:
            blocks += _part(context, by, title)
    return tuple(blocks)


def _part(context: ReportContext, by: str, title: str) -> list[Block]:
    log = context.log
    try:
        cells_of(log, by)
    except InputError as error:
        return [Omitted(title, str(error))]

    plain = context.effort.sampler(context.seed, main=False)
    traits, differing = (replace(plain, draws=n, tune=500) for n in (TRAIT_DRAWS, DIFFERING_DRAWS))
    pins, states = dict.fromkeys(context.pins), context.shown_states
    offset = PersonOffset() if affordable(log, by) else None

    def fitter(rest: EventLog, k: int, held: Mapping[str, Array | None], people: PersonOffset | None) -> Posterior:
        sampler = plain if people is None else differing if k > 1 else traits
        return stored_fit(rest, log_digest(rest), k, pins=held, people=people, sampler=sampler).posterior

    def predict() -> HeldOut:
        contenders = standard_contenders(
            log, states, pins=pins, fitter=fitter, people=offset, seed=context.seed
        )  # fmt: skip
        return held_out(
            log, contenders, by, seed=context.seed, kind=context.data.card.kind, progress=context.progress
        )

    given = {
        "log": log, "by": by, "states": states, "pins": pins, "people": offset, "seed": context.seed,
        "kind": context.data.card.kind, "samplers": (plain, traits, differing),
        "particles": [vars(held_out_contenders)[n] for n in ("LETTING_IN", "HIERARCHICAL_PARTICLES")],
    }  # fmt: skip
    result = context.kept_from(
        f"every {by} left out in turn", predict, held_out, given,
        modules=(standard_contenders.__module__, stored_fit.__module__),
    )  # fmt: skip
    return [Part(title, f"held-out-by-{by}", blocks(result, log.protocol, context.origin))]


def affordable(log: EventLog, by: str) -> bool:
    """Whether the hierarchical version is fitted for every cell: by condition, up to `DIFFERING_WORK`."""
    cells = len(set(cell_of_run(log, by)))
    return by == "condition" and log.tree().n_nodes * cells * PersonOffset().points(log) <= DIFFERING_WORK


def blocks(result: HeldOut, protocol: Protocol, origin: Origin) -> tuple[Block, ...]:
    """Sentence, ranking, rates and figures of what was left out.

    Parameters
    ----------
    result : HeldOut
    protocol : Protocol
        Of the study.
    origin : Origin
        Of the data behind it.
    """
    made: list[Block] = [Text(result.sentence), _ranking(result, origin), _figure(result, protocol, origin)]
    made += [_rounds(result, protocol, origin), _rates(result, origin)]
    if result.warnings:
        made.append(Points(tuple(result.warnings), "What is missing, or not to be relied on as it stands"))
    return tuple(made)


def _ranking(result: HeldOut, origin: Origin) -> Table:
    caption = (
        f"Models by how well they predict what was left out by {result.by}. Log score: joint log predictive of the "
        "people left out, in nats; the standard error of the difference knows other people, not other cells. CRPS, "
        f"smaller is better, in the unit of the {result.measure}. Inside: observed rates in the "
        f"{result.level:.0%} predictive interval."
    )
    if NAME in result.contenders:
        caption += (
            " The mixed model is a logistic regression on the robot's behaviour with an intercept for every "
            "person, by maximum likelihood; its doubt is the normal approximation with the model's covariance."
        )
    if set(result.scores["kind"]) & {"traits", "people"}:
        caption += " Where people differ, each has an offset on the log-odds that all their responses share."
    formats = dict.fromkeys(("log_score", "log_score_diff", "dse"), ".1f") | {"log_score_error": ".2f"}
    formats |= dict.fromkeys(("error", "crps", "round_crps"), ".3f")
    formats |= dict.fromkeys(("inside", "cells", "rounds_inside", "rounds", "prior"), ",d")
    return Table(
        f"held-out-{result.by}-ranking", result.ranking[list(RANKING)], caption, (origin,), headings=RANKING,
        formats=formats,
    )  # fmt: skip


def _rates(result: HeldOut, origin: Origin) -> Table:
    columns = [c for c in RATES if c != "prior" or (result.overall["prior"] != "").any()]
    formats = {"people": ",d"} | dict.fromkeys(("observed", "expected", "low", "high", "crps"), ".3f")
    caption = (
        f"Observed and predicted {result.measure} of everything left out, with {result.level:.0%} predictive "
        "intervals; the error is predicted less observed."
    )
    return Table(
        f"held-out-{result.by}-rates", result.overall[columns], caption, (origin,),
        headings={c: RATES[c] for c in columns}, formats=formats | {"error": "+.3f"}, row_headings=2,
    )  # fmt: skip


def _figure(result: HeldOut, protocol: Protocol, origin: Origin) -> Figure:
    told = "; ".join(
        f"{cell}: observed {rows['observed'].iloc[0]:.2f}, "
        + ", ".join(f"{r.contender} {r.expected:.2f} ({r.low:.2f} to {r.high:.2f})" for r in rows.itertuples())
        for cell, rows in result.overall.groupby("cell", sort=False)
    )
    draw = partial(
        held_out_rates, result.overall, measure=result.measure, limits=rates.measure_range(protocol),
        level=result.level,
    )  # fmt: skip
    caption = (
        f"What each model predicts for a {result.by} that it has not seen, from the actions alone. The black line "
        "with its band is what was observed. Thin lines are predictive intervals of the observed rate, thick ones "
        "intervals of the expected rate, without chance. A filled marker means that the observed rate lies outside "
        "the predictive interval; a dagger, that part of the prediction is the prior or assumed."
    )
    alt = f"Observed and predicted {result.measure} by {result.by} left out. {told}."
    return Figure(f"held-out-{result.by}", (draw,), caption, (alt,), (origin,))


def _rounds(result: HeldOut, protocol: Protocol, origin: Origin) -> Figure:
    best = str(result.ranking["contender"].iloc[0])
    order = [name for name in result.contenders if name in set(result.ranking["contender"].iloc[:MOST_LINES])]
    table = result.by_round[result.by_round["contender"].isin(order)]
    values = table[["observed_low", "observed_high", "low", "high"]].to_numpy()
    ends = rates.measure_range(protocol)
    tenth = 0.1 * (ends[1] - ends[0])
    limits = (
        max(ends[0], float(np.floor(np.nanmin(values) / tenth) * tenth)),
        min(ends[1], float(np.ceil(np.nanmax(values) / tenth) * tenth)),
    )
    panels, alts = [], []
    for cell in result.cells:
        mine = table[table["cell"] == cell]
        panels.append(
            partial(
                held_out_by_round, mine, shown=best, order=order, measure=result.measure,
                limits=limits, title=cell if len(cell) <= 30 else f"{cell[:27]}...",
            )
        )  # fmt: skip
        told = ", ".join(
            f"round {r.at} {r.observed:.2f} ({r.expected:.2f})"
            for r in mine[mine["contender"] == best].itertuples()
        )
        alts.append(f"{cell} left out: observed {result.measure}, in brackets expected by {best}: {told}.")
    which = "each model" if len(order) == len(result.contenders) else f"each of the {len(order)} best models"
    caption = (
        f"The same round by round: observed rates with {result.level:.0%} intervals, what {which} expects, and "
        f"as a band the predictive interval of {best}, which has the best log score."
    )
    return Figure(f"held-out-{result.by}-rounds", tuple(panels), caption, tuple(alts), (origin,))
