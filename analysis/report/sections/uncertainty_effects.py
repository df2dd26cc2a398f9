"""Parts of "How sure are we?": the causal question, kappa, and checks that the model could fail."""

from __future__ import annotations

from functools import partial

import numpy as np

from analysis.causal import CausalEffects, causal_effects
from analysis.figures.checks import predictive_checks
from analysis.figures.effects import effect_by_round
from analysis.figures.style import spoken
from analysis.kappa_sensitivity import KAPPAS, kappa_sensitivity
from analysis.predictive_checks import PredictiveChecks, posterior_checks, prior_predictive, prior_sentence
from analysis.report.context import ReportContext
from analysis.report.section import Block, Figure, Headline, NotSupported, Part, Question, Table, Text
from analysis.wording import counted
from models.posterior import Posterior

MOST_ROUNDS = 12
"""Rounds beyond which the table of effects is folded away."""


def causal(context: ReportContext, k: int, posterior: Posterior) -> tuple[Block, ...]:
    """Effects of always acting against never, beside the randomised arms."""
    found = context.kept(
        f"effects, {counted(k, 'state')}", causal_effects, posterior, context.log, kind=context.data.card.kind
    )
    shown = [a for a in found.actions if a not in found.silent]
    blocks: list[Block] = []
    for action in found.actions:
        warned = action in shown and found.of(action)["mode"].iloc[0] in found.not_randomised
        blocks.append(Text(found.sentence_of(action), "warning" if warned else "plain"))
    blocks.append(Text(found.caveat, "note"))
    if not shown:
        return tuple(blocks)
    blocks.append(_headline(context, k, found, posterior))
    return (*blocks, _effects_figure(context, k, found, shown), _effects_table(context, k, found, shown))


def _effects_figure(context: ReportContext, k: int, found: CausalEffects, shown: list[str]) -> Figure:
    every = found.table[found.table["action"].isin(shown)]
    ends = found.scale * every[["low", "high", "raw_low", "raw_high"]].to_numpy()
    margin = 0.06 * float(np.nanmax(ends) - np.nanmin(ends))
    limits = (float(np.nanmin(ends)) - margin, float(np.nanmax(ends)) + margin)
    panels, alt = [], []
    for action in shown:
        rows = found.of(action)
        title = f"always {spoken(action)}, not {spoken(rows['null_action'].iloc[0])}"
        panels.append(
            partial(effect_by_round, rows, scale=found.scale, unit=found.unit, title=title, limits=limits)
        )
        told = "; ".join(
            f"round {r.round} {found.scale * r.mean:+.1f} ({found.scale * r.low:+.1f} to "
            f"{found.scale * r.high:+.1f})" + ("" if np.isnan(r.raw) else f", raw {found.scale * r.raw:+.1f}")
            for r in rows.itertuples()
        )
        alt.append(f"{title}: {told}, {found.unit}.")
    caption = (
        f"Effect on the {found.measure} of always acting against never, by round, if everybody's schedule and all "
        "other actions stayed as they were: posterior mean and interval."
    )
    if every["raw"].notna().any():
        caption += (
            " Beside it the raw difference between the randomised arms, with intervals over people; before the "
            "first chance to act the model's effect is exactly zero, and the raw difference is chance."
        )
    if any(m in found.not_randomised for m in every["mode"]):
        caption += (
            " NOT RANDOMISED: the actions may answer to what people did, so this is no estimate of an effect."
        )
    return Figure(f"effects-{k}", tuple(panels), caption, tuple(alt), (context.origin,))


def _effects_table(context: ReportContext, k: int, found: CausalEffects, shown: list[str]) -> Block:
    frame = found.table[found.table["action"].isin(shown)].copy()
    frame["action"] = frame["action"].map(spoken)
    numbers = [
        "null",
        "act",
        "mean",
        "low",
        "high",
        "carried",
        "raw",
        "raw_low",
        "raw_high",
        "prior_low",
        "prior_high",
    ]
    frame[numbers] = (frame[numbers] * found.scale).round(1) + 0.0  # no minus before a rounded zero
    columns = ["action", "round", "runs", "exposed", *numbers[:5], "positive", *numbers[5:]]
    headings = {"null": "never", "act": "always", "mean": "effect", "positive": "P(> 0)", "carried": "carried over",
                "raw": "difference"}  # fmt: skip
    headings |= {
        f"{p}{end}": text for p in ("", "raw_", "prior_") for end, text in (("low", "5%"), ("high", "95%"))
    }
    formats = {"runs": ",d", "exposed": ".2f", **dict.fromkeys(numbers, ".1f"), "positive": ".2f"}
    unit = "percent and percentage points" if found.scale == 100 else found.unit
    table = Table(
        f"effects-table-{k}", frame[columns],
        f"Effects by round ({unit}). Exposed: share of a round's responses for which the action can have mattered.",
        (context.origin,), headings=headings, formats=formats, row_headings=2,
        groups=(("", 4), ("model", 7), ("randomised arms", 3), ("before any data", 2)),
    )  # fmt: skip
    if len(frame) > MOST_ROUNDS:
        return Part("Effects by round as a table", f"effects-part-{k}", (table,), True)
    return table


def sensitivity(context: ReportContext, k: int) -> tuple[Block, ...]:
    """The same answers under other values of kappa."""
    if k == 1:
        raise NotSupported("with one state nobody can stay or leave, so kappa has no meaning")
    posteriors = {kappa: context.posterior(k, kappa) for kappa in KAPPAS}
    found = context.kept(f"answers by kappa, {counted(k, 'state')}", kappa_sensitivity, posteriors, context.log)
    if found.table.empty:
        raise NotSupported("no effect was learned")
    headings = {"low": "5%", "high": "95%", "positive": "P(> 0)", "prior_low": "5%", "prior_high": "95%"}
    formats = {"kappa": ".0f", **dict.fromkeys(("mean", "low", "high", "prior_low", "prior_high"), ".1f"),
               "positive": ".2f"}  # fmt: skip
    medians = ", ".join(f"{r.contraction:.2f} at {r.kappa:g}" for r in found.fits.itertuples())
    table = Table(
        f"kappa-{k}", found.table, "Answers by kappa, the pseudo-counts on staying; 2 is the default. Median "
        f"contraction of transition entries: {medians}.",
        (context.origin,), headings=headings, formats=formats, row_headings=2,
        groups=(("", 2), ("posterior", 4), ("prior", 2)),
    )  # fmt: skip
    return Text(found.sentence), Part("Answers by kappa", f"kappa-part-{k}", (table,), True)


def checked(context: ReportContext, k: int, posterior: Posterior) -> PredictiveChecks:
    """Posterior predictive checks, computed once a report."""
    return context.kept(
        f"predictive checks, {counted(k, 'state')}", posterior_checks, posterior, context.log,
        draws=context.effort.simulated_studies, seed=context.seed,
    )  # fmt: skip


def checks(context: ReportContext, k: int, posterior: Posterior) -> tuple[Block, ...]:
    """Posterior predictive checks, and what the prior alone predicts."""
    draws, label = context.effort.simulated_studies, counted(k, "state")
    found = checked(context, k, posterior)
    outside = found.table[found.table["outside"]]
    named = "; ".join(f"{r.check} (p {r.p:.2f})" for r in outside.itertuples()) or "none"
    figure = Figure(
        f"checks-{k}", (partial(predictive_checks, found.table),),
        f"Posterior predictive checks: {found.draws} studies simulated from the posterior, each statistic in "
        "standard deviations of the simulated ones; bar the 90% interval, diamond the observed value, filled where "
        "outside. p is the share of simulated studies above.",
        (f"{len(found.table)} checks; observed values outside the predictive interval: {named}.",),
        (context.origin,),
    )  # fmt: skip
    prior = context.kept(
        f"prior predictive, {label}", prior_predictive, context.log, k, draws=draws, seed=context.seed
    )
    table = Table(
        f"prior-predictive-{k}", prior,
        "Predicted before any data, by kappa, under this design; beside it what was observed.",
        (context.origin,), headings={"low": "5%", "high": "95%"}, row_headings=2,
        formats={"kappa": ".0f", **dict.fromkeys(("mean", "low", "high", "observed"), ".3f")},
    )  # fmt: skip
    return (
        Text(found.sentence, "warning" if len(found.failed) else "plain"),
        figure,
        Part("What the prior alone predicts", f"prior-part-{k}", (Text(prior_sentence(prior)), table), True),
    )


def _headline(context: ReportContext, k: int, found: CausalEffects, posterior: Posterior) -> Headline:
    """What always acting changes, by the model; a sign is open where the interval holds zero."""
    parts, undecided, shown = [], 0, [a for a in found.actions if a not in found.silent]
    for action in shown:
        row = found.of(action).iloc[-1]
        open_ = not (row["low"] > 0 or row["high"] < 0)
        undecided += open_
        # No minus before a rounded zero.
        mean, low, high = (round(found.scale * float(row[c]), 1) + 0.0 for c in ("mean", "low", "high"))
        told = f"{low:+.1f} to {high:+.1f}" + (": sign not decidable" if open_ else "")
        parts.append(f"{mean:+.1f} with '{spoken(action)}' ({told})")
    text = (
        f"Always acting instead of never changes the {found.measure} by so many {found.unit}, by the model "
        f"({found.level:.0%} intervals): {'; '.join(parts)}."
    )
    if found.not_randomised:
        text += " Not randomised, so this is no estimate of an effect."
    passed = posterior.gate.passed
    if not passed:
        text += " The convergence gate FAILED."
    open_ = undecided == len(parts) or bool(found.not_randomised)
    kind = "warning" if not passed else "open" if open_ else "plain"
    return Headline(
        text=text, kind=kind, question=Question.EFFECT, origin=(context.origin,), about=counted(k, "state")
    )
