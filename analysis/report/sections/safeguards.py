"""Section: what safeguards change, what they cost, and who is influenced most."""

from __future__ import annotations

from functools import partial

import pandas as pd

from analysis.figures.safeguards import stricter, value_and_cost, who_is_influenced
from analysis.figures.style import spoken
from analysis.report.context import ReportContext
from analysis.report.doubts import doubts, reservations, told_above
from analysis.report.own_reward import (
    planned_states,
    rewarded_draws,
    rounds_in_words,
    rounds_of,
    title_of,
    unseen_or_left_out,
    want_reward,
)
from analysis.report.section import (
    Block,
    Figure,
    NotSupported,
    Omitted,
    Part,
    Points,
    Table,
    Text,
    attempt,
    with_something,
)
from analysis.safeguard_study import (
    BUDGET,
    CONFIDENCE,
    TOLERANCE,
    SafeguardStudy,
    Wanted,
    fallback_actions,
    safeguard_study,
)
from analysis.wording import counted
from models.planning.schedule import Schedule
from models.safeguards.consent import Consent
from models.safeguards.influence_report import ALL, LEVEL, NONE
from models.unseen import without_actions

DRAWS, QUICK_DRAWS = 400, 100
"""Draws of the posterior that are followed, evenly spaced."""

ONE_ACT = 15.0
"""What an act of help costs in the paper, which the default limits are counted in."""


def make(context: ReportContext) -> tuple[Block, ...]:
    """One part for each number of states that is shown in full."""
    want_reward(context)
    intro = (
        "The paper asks of a robot that shapes people: bounded costs, the least influence that is needed, "
        "consent, transparency and an audit log. Here the first four are put around policies over "
        f"{rounds_in_words(context)} and followed through all histories, in up to "
        f"{QUICK_DRAWS if context.effort.quick else DRAWS} evenly spaced draws of the posterior. Influence is how "
        "many times a person ends up in another state than if left alone: the total variation between the two, "
        "added up over the rounds. What an action is worth goes on with the policy that it is taken by, in each "
        "draw."
    )
    shown = planned_states(context)
    parts = []
    for k in shown:
        blocks = attempt("safeguards", partial(_model, context, k))
        parts.append(Part(title_of(context, k), f"safeguards-{k}", blocks, folded=k != shown[0]))
    return (Text(intro), *reservations(context), *with_something(parts))


def _model(context: ReportContext, k: int) -> tuple[Block, ...]:
    if k == 1:
        raise NotSupported("with one state nobody is moved anywhere, so there is nothing to guard")
    unseen = unseen_or_left_out(context)
    posterior = context.posterior(k)
    draws = without_actions(rewarded_draws(context, posterior.draws()), unseen)
    draws = draws.thin(QUICK_DRAWS if context.effort.quick else DRAWS)
    tell, label = context.progress, counted(k, "state")
    study = context.kept(
        f"safeguards, {label}",
        safeguard_study,
        Schedule.of(draws, rounds_of(context)),
        limits(context, k),
        progress=None if tell is None else lambda step, done, total: tell(f"{label}: {step}", done, total),
    )
    blocks: list[Block] = [*doubts(context, k, estimate=False)]
    if unseen:
        names = " and ".join(spoken(a) for a in unseen)
        blocks.append(Text(f"Left out: {names}. The data hold no evidence on what it does to people.", "warning"))
    blocks.append(Text(_settings(study)))
    blocks.append(Points(tuple(spoken(s) for s in study.sentences), "What they do"))
    blocks += [_table(context, study, k), _curve(context, study, k)]
    if study.report.most_influenced(study.best)["influence"] > 0:
        blocks += [_stricter(context, study, k), _who(context, study, k)]
    else:
        reason = f"the {study.best} leaves people as they would be if left alone, so there is nothing to limit"
        blocks.append(Omitted("Stricter safeguards, and who is influenced", reason))
    blocks.append(_decisions(study))
    return told_above(blocks, study.cautions)


def limits(context: ReportContext, k: int) -> Wanted:
    """The limits that are shown: those of the paper's costs, or as many acts of the costliest action.

    Raises
    ------
    NotSupported
        Where no action of a stated reward costs anything.
    """
    if context.stated is None:
        return Wanted(budget=BUDGET, tolerance=TOLERANCE, confidence=CONFIDENCE)
    most = max(context.stated.costs(k).values())
    if most <= 0:
        raise NotSupported("no action costs anything, so there is nothing to limit")
    return Wanted(
        budget=most * BUDGET / ONE_ACT, tolerance=most * TOLERANCE / ONE_ACT, confidence=CONFIDENCE
    )  # fmt: skip


def _settings(study: SafeguardStudy) -> str:
    """Which safeguards are shown, with their settings."""
    w = study.wanted
    acts = "; ".join(f"{spoken(m)}: {spoken(a)}" for m, a in fallback_actions(study.guarded.fallback).items())
    return (
        f"Shown are a budget of {w.budget:g} reward units a person, which is never exceeded; minimum "
        f"influence: among the actions worth up to {w.tolerance:g} less than the best, the one that moves "
        "people least; and confidence: an action other than the null action only if it pays with a "
        f"probability above {w.confidence:g} given what was seen. Without consent, or after it was withdrawn, "
        f"the robot goes by the mode alone ({acts}) and deletes what it believed. These settings are examples, "
        "not findings."
    )


def _table(context: ReportContext, study: SafeguardStudy, k: int) -> Table:
    headings = {
        "policy": "policy", "safeguards": "safeguards", "changed": "decisions changed", "value": "value",
        "lost": "lost", "cost": "expected cost", "most_cost": "largest cost", "help_rate": "help rate",
        "influence": "times moved", "influence_low": "from", "influence_high": "to",
    }  # fmt: skip
    frame = pd.DataFrame(study.report.table[list(headings)])
    # Each safeguard alone is shown for the best plan; for the others what all of them do together.
    keep = (frame["policy"] == study.best) | frame["safeguards"].isin([NONE, ALL])
    frame = frame[keep].reset_index(drop=True)
    formats = {
        "changed": ".0%", "value": ",.1f", "lost": ",.1f", "cost": ",.1f", "most_cost": ",.0f", "help_rate": ".3f",
        "influence": ".2f", "influence_low": ".2f", "influence_high": ".2f",
    }  # fmt: skip
    caption = (
        "What safeguards change, exactly, as a mean over the draws. Lost: value, to the same policy without "
        "safeguards; negative where they improve it. Largest cost: of all histories. Times moved: how many times a "
        f"person ends up in another state than if left alone, with the middle {LEVEL:.0%} of the draws."
    )
    return Table(
        f"safeguards-table-{k}", frame, caption, (context.origin,), headings=headings, formats=formats,
        row_headings=2,
    )  # fmt: skip


def _curve(context: ReportContext, study: SafeguardStudy, k: int) -> Figure:
    shape = "here they are" if study.budgets.concave else "here they are not"
    return Figure(
        f"safeguards-cost-{k}",
        (partial(value_and_cost, study.frontier, study.budgets, study.report, study.drawn),),
        "Value and cost. The line is the best that can be had under a limit on the expected cost, drawing "
        "lots between plans where that helps: concave, from the plan that spends nothing to the best plan "
        "without a limit. Hollow squares: the best under a budget that no history exceeds; they need not be "
        f"concave, {shape}. Points: policies, and what safeguards make of them.",
        (f"{study.frontier.sentence} {study.budgets.sentence}",), (context.origin,),
    )  # fmt: skip


def _stricter(context: ReportContext, study: SafeguardStudy, k: int) -> Figure:
    steps = [s for s in (study.tolerance, study.threshold) if s is not None]
    return Figure(
        f"safeguards-strict-{k}", (partial(stricter, steps),),
        f"The {study.best} under safeguards that are made stricter: value lost above, influence left below. "
        "Steps are where a decision changes; between them nothing does. A tolerance holds for each decision, "
        "so that losses add up over the rounds.",
        (" ".join(spoken(s.sentence) for s in steps),), (context.origin,),
    )  # fmt: skip


def _who(context: ReportContext, study: SafeguardStudy, k: int) -> Figure:
    most = study.report.most_influenced(study.best)
    left = study.report.most_influenced(study.best, ALL)
    told = (
        f"{study.best}: most influenced are people who start as {most['who']}, {most['influence']:.2g} times; "
        f"under all safeguards those who start as {left['who']}, {left['influence']:.2g} times."
    )
    return Figure(
        f"safeguards-who-{k}", (partial(who_is_influenced, study.report, study.drawn, (NONE, ALL)),),
        "Who is influenced: how many times people are moved, by the state they start in and by their first "
        f"response; bars span the middle {LEVEL:.0%} of the draws.",
        (told[0].upper() + told[1:],), (context.origin,),
    )  # fmt: skip


def _decisions(study: SafeguardStudy) -> Points:
    """What the guarded robot says of itself in the first rounds with a person who helps, and without consent."""
    robot, s = study.guarded, study.schedule
    best = 1 + max(range(s.protocol.n_responses), key=lambda o: s.protocol.scores[o])
    memory = robot.begin(s.modes[0])
    told = []
    for i in range(min(4, s.n_events)):
        told.append(f"Round {i + 1}: {robot.decide(memory).explanation}")
        if i + 1 < s.n_events:
            seen = best if s.mode(i).shows_response else 0
            memory = robot.observe(memory, robot.act(memory), seen, s.modes[i + 1])
    never = robot.decide(robot.begin(s.modes[0], Consent.NEVER)).explanation
    return Points(
        (*map(spoken, told), spoken(f"Without consent: {never}")),
        "Every decision explains itself: the first rounds with somebody who helps",
    )
