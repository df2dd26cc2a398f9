"""Section: how sure we are of the learned model, from its posterior."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from analysis.figures.chain_ranks import chain_ranks
from analysis.figures.contraction import contraction_dots
from analysis.figures.effects import contrast_by_state
from analysis.figures.forest import forest
from analysis.figures.style import spoken
from analysis.report.context import ReportContext
from analysis.report.doubts import flat, told_above
from analysis.report.section import (
    Block,
    Drawing,
    Figure,
    Headline,
    NotSupported,
    Part,
    Question,
    Table,
    Text,
    attempt,
)
from analysis.report.sections import uncertainty_effects
from analysis.uncertainty import KNOWN, PARTLY, BesideEm, beside_em, contraction, contrasts
from analysis.wording import counted
from models.cautions import caution_line
from models.posterior import Posterior

RANKED = 6
"""Quantities whose ranks by chain are shown."""


def make(context: ReportContext) -> tuple[Block, ...]:
    """Gate, contraction, effects and checks of every shown number of states."""
    intro = (
        "Baum-Welch gives one table; here is the distribution of all tables that the data leave possible "
        "(Bayesian hidden Markov model, states marginalised, prior Dirichlet(1) with two pseudo-counts more on "
        "staying). Contraction compares each entry with its prior: near 1 the data have spoken, near 0 the entry "
        "is what was assumed."
    )
    reading = (
        "Intervals are 90% equal-tailed posterior intervals. States of every draw are put into canonical order."
    )
    shown = sorted(context.shown_states, reverse=True)
    parts = (Part(f"{k} state{'s' * (k != 1)}", f"sure-{k}", _of(context, k)) for k in shown)
    return (Text(intro), Text(reading, "note"), *parts)


def _of(context: ReportContext, k: int) -> tuple[Block, ...]:
    posterior = context.posterior(k)
    gate = posterior.gate
    text = gate.sentence
    if not gate.passed and context.effort.quick:
        text += " This is a quick report with few draws; a full report takes more."
    told = Text(text, "note" if gate.passed else "warning", caution_line(posterior.draws_cautions))
    blocks: list[Block] = [*flat(context, (k,)), told]
    found = beside_em(posterior, context.study.fits[k], context.study.bootstraps.get(k))
    if found.stuck:
        blocks.append(Text(found.warning, "warning"))
    blocks += _contraction(context, k, posterior)
    blocks += attempt("what one action changes", partial(_contrasts, context, k, posterior))
    blocks += uncertainty_effects.causal(context, k, posterior)
    blocks += attempt("sensitivity to kappa", partial(uncertainty_effects.sensitivity, context, k))
    blocks += uncertainty_effects.checks(context, k, posterior)
    blocks.append(
        Part("Every entry beside the point estimate", f"forest-part-{k}", _forest(context, k, found), True)
    )
    blocks.append(Part("Do the chains agree?", f"ranks-part-{k}", (_ranks(context, k, posterior),), True))
    blocks.append(_headline(context, k, posterior, found))
    return told_above(blocks, posterior.draws_cautions)


def _contraction(context: ReportContext, k: int, posterior: Posterior) -> tuple[Block, ...]:
    found = contraction(posterior)
    frame = found.by_table.reset_index()
    frame["table"] = frame["table"].map(spoken)
    told = "; ".join(f"{r.table} {r.median:.2f}" for r in frame.itertuples() if not np.isnan(r.median))
    figure = Figure(
        f"contraction-{k}", (partial(contraction_dots, found.table, known=KNOWN, partly=PARTLY),),
        "Contraction of every entry against its prior, 1 - var(posterior) / var(prior), one dot an entry, by "
        f"table; the bar is the median. Below {PARTLY:g} an entry is mostly prior, above {KNOWN:g} the data "
        "determine it; below zero it is wider than before, as the states it leads between moved apart.",
        (f"Median contraction by table: {told}.",), (context.origin,),
    )  # fmt: skip
    return Text(found.sentence), figure


def _contrasts(context: ReportContext, k: int, posterior: Posterior) -> tuple[Block, ...]:
    if k == 1:
        raise NotSupported("with one state no action can change anything")
    found = contrasts(posterior, context.study.identifications[k].silent_transitions)
    table = found.table
    learned = table[table["evidence"] == "learned"]
    if learned.empty:
        return (Text(found.sentence),)
    actions = list(dict.fromkeys(learned["action"]))
    ends = found.scale * learned[["low", "high", "prior_low", "prior_high"]].to_numpy()
    margin = 0.06 * float(np.ptp(ends))
    limits = (float(ends.min()) - margin, float(ends.max()) + margin)
    panels, alt = [], []
    for action in actions:
        rows = learned[learned["action"] == action]
        null = rows["null_action"].iloc[0]
        title = f"{spoken(action)} instead of {spoken(null)}"
        panels.append(
            partial(contrast_by_state, rows, scale=found.scale, unit=found.unit, title=title, limits=limits)
        )
        told = "; ".join(
            f"{r.state} {found.scale * r.mean:+.1f} ({found.scale * r.low:+.1f} to {found.scale * r.high:+.1f})"
            for r in rows.itertuples()
        )
        alt.append(f"{title}: {told}, {found.unit}.")
    figure = Figure(
        f"contrasts-{k}", tuple(panels),
        f"What one action changes: the expected {found.measure} of the next round after it, less that after doing "
        "nothing, by state before; blue the posterior, grey the prior. Right: probability of an increase.",
        tuple(alt), (context.origin,),
    )  # fmt: skip
    return Text(found.sentence), figure


def _forest(context: ReportContext, k: int, found: BesideEm) -> tuple[Block, ...]:
    panels, alt = [], []
    for name in dict.fromkeys(found.table["table"]):
        rows = found.table[found.table["table"] == name]
        if rows["contraction"].isna().all():
            continue
        panels.append(partial(forest, rows, [entry_label(e) for e in rows["entry"]], title=spoken(name)))
        alt.append(f"{spoken(name)}, posterior means beside EM estimates: {_told(rows)}.")
    caption = (
        "Posterior mean and interval (blue) of every learned entry, its prior interval (grey), the EM estimate "
        "(diamond)" + (" and its bootstrap interval (orange)." if found.table["boot_low"].notna().any() else ".")
    )
    figure = Figure(f"forest-{k}", tuple(panels), caption, tuple(alt), (context.origin,))
    return Text(found.sentence), figure, _entries(context, k, found)


def entry_label(entry: str) -> str:
    """Short name of an entry inside its own table.

    Examples
    --------
    >>> entry_label("transition[help,s0,s1]"), entry_label("initial[s2]"), entry_label("emission[ask,s0,late]")
    ('s0 → s1', 's2', 's0: late')
    """
    kind, _, rest = entry.rstrip("]").partition("[")
    words = rest.split(",")
    if kind == "transition":
        return f"{words[1]} → {words[2]}"
    if kind == "initial":
        return words[0]
    return f"{words[1]}: {spoken(words[2])}" if len(words) == 3 else words[1]


def _told(rows: pd.DataFrame) -> str:
    return ", ".join(f"{entry_label(r.entry)} {r.mean:.2f} beside {r.em:.2f}" for r in rows.itertuples())


def _entries(context: ReportContext, k: int, found: BesideEm) -> Table:
    frame = found.table.copy()
    frame.insert(1, "name", [entry_label(e) for e in frame["entry"]])
    frame["table"] = frame["table"].map(spoken)
    frame = frame.drop(columns="entry")
    columns = ["table", "name", "mean", "low", "high", "contraction", "em", "boot_low", "boot_high", "prior_low",
               "prior_high"]  # fmt: skip
    headings = {"name": "entry", "low": "5%", "high": "95%", "em": "estimate", "boot_low": "5%", "boot_high": "95%",
                "prior_low": "5%", "prior_high": "95%"}  # fmt: skip
    return Table(
        f"posterior-{k}", frame[columns],
        "Every entry: posterior, EM estimate with bootstrap interval, prior. Contraction is empty where a table is "
        "held fixed, the estimate where the data say nothing of an action.",
        (context.origin,), headings=headings, formats=dict.fromkeys(columns[2:], ".3f"), row_headings=2,
        groups=(("", 2), ("posterior", 4), ("EM", 3), ("prior", 2)),
    )  # fmt: skip


def _ranks(context: ReportContext, k: int, posterior: Posterior) -> Figure:
    """Ranks of the entries the data say most about, one or two a table: those a reader will quote."""
    found = contraction(posterior).table.dropna(subset="contraction")
    best = found.sort_values("contraction", ascending=False).groupby("table", sort=False).head(1)[:RANKED]
    draws = posterior.flat()
    index = [posterior.entry_names.index(e) for e in best["entry"]]
    panels: list[Drawing] = []
    alt = []
    for i, entry, name in zip(index, best["entry"], best["table"], strict=True):
        panels.append(
            partial(chain_ranks, draws[:, :, i], title=f"{spoken(name)}, {entry_label(entry)}", legend=not panels)
        )
        means = ", ".join(f"{m:.3f}" for m in draws[:, :, i].mean(axis=1))
        alt.append(f"Ranks of {entry} by chain; chain means {means}.")
    return Figure(
        f"ranks-{k}", tuple(panels),
        "Ranks by chain of the entry of each table that the data say most about: flat where chains agree. The band "
        "holds 99% of independent draws.",
        tuple(alt), (context.origin,),
    )  # fmt: skip


def _headline(context: ReportContext, k: int, posterior: Posterior, found: BesideEm) -> Headline:
    """How many entries the data determine, how many are mostly prior; open where that is at least half of them."""
    learned = found.table["contraction"].dropna()
    known, prior = int((learned > KNOWN).sum()), int((learned < PARTLY).sum())
    text = (
        f"Of {counted(len(learned), 'entry', 'entries')} of the tables {known} are known from the data and {prior} "
        f"mostly prior (contraction above {KNOWN:g}, below {PARTLY:g}"
    )
    text += f"; median {learned.median():.2f})." if len(learned) else ")."
    flat_ = context.study.identifications[k].mostly_flat
    if flat_:
        text += " The likelihood is flat along most directions."
    misfit = uncertainty_effects.checked(context, k, posterior)
    if len(misfit.failed):
        text += f" The model FAILS {len(misfit.failed)} of {counted(len(misfit.table), 'predictive check')}."
    if not posterior.gate.passed:
        text += " The convergence gate FAILED."
    elif found.stuck:
        text += f" {found.warning}"
    failed = not posterior.gate.passed or bool(found.stuck)
    failed = failed or len(misfit.failed) > 0
    kind = "warning" if failed else "open" if flat_ or 2 * prior >= len(learned) else "plain"
    return Headline(
        text=text, kind=kind, question=Question.KNOWN, origin=(context.origin,), about=counted(k, "state")
    )
