"""Section: the tables that were learned, one part for every number of states."""

from __future__ import annotations

from functools import partial

import numpy as np

from analysis import response_rates as rates
from analysis.figures.beliefs import Interval, initial_belief, observation_curves
from analysis.figures.state_graph import DRAWN, LABELLED, farthest_move, state_graph
from analysis.figures.style import spoken
from analysis.figures.transitions import RowEvidence, transition_table
from analysis.report.context import ReportContext
from analysis.report.doubts import doubts, flat
from analysis.report.section import Block, Figure, NotSupported, Part, Text, attempt
from analysis.report.sections import learned_tables
from analysis.wording import counted
from models.identification import WEAK

LEVEL = 0.9
"""Level of bootstrap intervals."""

TOLERANCE = 1e-3
"""Estimates this close to their interval are inside: replicates stop a little before convergence."""


def make(context: ReportContext) -> tuple[Block, ...]:
    """Every fitted model; four states and the choice of BIC in full, the others folded away."""
    intro = (
        f"States are in order of their expected {rates.measure_name(context.protocol)}, s0 lowest; names are "
        "labels of that order. Four states (the paper's number) and the number BIC chooses are shown in full, the "
        "others are folded away."
    )
    shown = context.shown_states
    parts = []
    for k in context.study.states:
        why = []
        if k == 4:
            why.append("the paper's number")
        if k == context.study.best_by_bic:
            why.append("lowest BIC")
        title = counted(k, "state") + (f" ({', '.join(why)})" if why else "")
        parts.append((k, Part(title, f"model-{k}", _model(context, k), folded=k not in shown)))
    # What is shown in full comes first.
    parts.sort(key=lambda entry: (entry[1].folded, -entry[0]))
    return (*flat(context, sorted(shown, reverse=True)), Text(intro), *(part for _, part in parts))


def evidence_of(context: ReportContext, k: int, action: str) -> RowEvidence:
    """What stands behind the transition table of an action."""
    fit, found = context.study.fits[k], context.study.identifications[k]
    visits = fit.transition_count[context.protocol.action(action)].sum(axis=-1)
    return RowEvidence(action in found.silent_transitions, action in found.pinned, visits, WEAK)


def _model(context: ReportContext, k: int) -> tuple[Block, ...]:
    fit = context.study.fits[k]
    bootstrap = context.study.bootstraps.get(k)
    blocks: list[Block] = [*doubts(context, k, posterior=False), Text(fit.sentence)]
    if k not in context.shown_states:
        blocks = [*flat(context, (k,)), *blocks]
    if bootstrap is not None:
        text = (
            f"Intervals are {LEVEL:.0%} percentile intervals of a {bootstrap.kind} with {bootstrap.replicates} "
            "replicates, states put back in order each time. They assume that the model is right"
        )
        if bootstrap.replicates < 200:
            why = "this is a quick report" if context.effort.quick else "of the size of these data"
            text += f". Fewer replicates than the usual 200, because {why}: their ends are rough"
        blocks.append(Text(f"{text}.", "note"))
        outside, entries = _outside(context, k)
        if outside:
            blocks.append(
                Text(
                    f"{outside} of {entries} estimates {'lies' if outside == 1 else 'lie'} outside "
                    f"{'its' if outside == 1 else 'their'} own interval: replicates end at other "
                    "optima or in another order of states, so these data do not determine those entries.",
                    "warning",
                )
            )
    blocks += attempt("transition tables", partial(_transitions, context, k))
    blocks += attempt("the graph of states", partial(_graphs, context, k))
    blocks.append(_beliefs(context, k))
    blocks += learned_tables.states(context, k)
    blocks += learned_tables.entries(context, k, LEVEL)
    return tuple(blocks)


def _outside(context: ReportContext, k: int) -> tuple[int, int]:
    """Learned entries that lie outside their bootstrap interval, and learned entries in all."""
    fit, found, bootstrap = context.study.fits[k], context.study.identifications[k], context.study.bootstraps[k]
    protocol, model = context.protocol, fit.model
    learned = [a not in found.silent_transitions + found.pinned for a in protocol.action_names]
    seen = [a not in found.silent_emissions for a in protocol.emission_actions]
    outside = entries = 0
    for name, estimate, rows in (
        ("initial", model.initial, slice(None)),
        ("transition", model.transition, learned),
        ("emission", model.emission, seen),
    ):
        low, high = bootstrap.interval(name, LEVEL)
        wrong = (estimate < low - TOLERANCE) | (estimate > high + TOLERANCE)
        outside += int(wrong[rows].sum())
        entries += int(wrong[rows].size)
    return outside, entries


def _transitions(context: ReportContext, k: int) -> tuple[Block, ...]:
    if k == 1:
        raise NotSupported("with one state there is nothing to move between")
    fit, names = context.study.fits[k], context.protocol.action_names
    evidence = {a: evidence_of(context, k, a) for a in names}
    states = fit.model.state_names
    panels = tuple(
        partial(transition_table, fit.model.transition[i], states, a, evidence[a]) for i, a in enumerate(names)
    )
    alt = tuple(
        f"{spoken(a)}: {_alt_transitions(fit.model.transition[i], states, evidence[a])}"
        for i, a in enumerate(names)
    )
    caption = (
        "Transition probabilities T(s' | s, a): one table an action, rows before and columns after; every row sums "
        "to one. Beside each row the expected number of visits behind it."
    )
    weak = [a for a in names if _any_weak(evidence[a])]
    if weak:
        caption += f" A dagger marks rows with fewer than {WEAK:.0f} expected visits."
    if any(e.silent for e in evidence.values()):
        caption += " Hatched: no evidence, the data never show what follows the action."
    if any(e.pinned for e in evidence.values()):
        caption += " Grey: held fixed by choice, not learned."
    return (Figure(f"transitions-{k}", panels, caption, alt, (context.origin,)),)


def _any_weak(evidence: RowEvidence) -> bool:
    return not evidence.silent and not evidence.pinned and bool((evidence.visits < evidence.weak).any())


def _alt_transitions(table: np.ndarray, states: tuple[str, ...], evidence: RowEvidence) -> str:
    if evidence.silent:
        return "no evidence, the table is a placeholder."
    rows = [f"from {s} " + ", ".join(f"{p:.2f}" for p in table[i]) for i, s in enumerate(states)]
    note = f" ({evidence.note})" if evidence.note else ""
    return "; ".join(rows) + f"{note}."


def _graphs(context: ReportContext, k: int) -> tuple[Block, ...]:
    if k == 1:
        raise NotSupported("with one state there is nothing to move between")
    fit, names = context.study.fits[k], context.protocol.action_names
    evidence = {a: evidence_of(context, k, a) for a in names}
    drawn = [(i, a) for i, a in enumerate(names) if not evidence[a].silent and not evidence[a].pinned]
    if not drawn:
        raise NotSupported("no transition table was learned")
    states = fit.model.state_names
    farthest = max(farthest_move(fit.model.transition[i]) for i, _ in drawn)
    panels = tuple(
        partial(state_graph, fit.model.transition[i], states, a, evidence[a], farthest=farthest) for i, a in drawn
    )
    alt = tuple(f"Graph of the states under {spoken(a)}: {_moves(fit.model.transition[i])}." for i, a in drawn)
    left_out = [spoken(a) for a in names if a not in [b for _, b in drawn]]
    caption = (
        "State connectivity: the learned moves of each action. Solid arrows above lead to more prosocial states, "
        f"dashed arrows below lead back; width grows with probability, moves below {DRAWN:g} are not drawn and "
        f"those below {LABELLED:g} not labelled. A dashed circle rests on fewer than {WEAK:.0f} expected visits."
    )
    if left_out:
        caption += f" Not drawn, because it was not learned: {', '.join(left_out)}."
    return (Figure(f"graph-{k}", panels, caption, alt, (context.origin,)),)


def _moves(table: np.ndarray) -> str:
    moves = [
        (float(table[i, j]), f"s{i} to s{j} {table[i, j]:.2f}")
        for i, j in np.ndindex(table.shape)
        if i != j and table[i, j] >= LABELLED
    ]
    return ", ".join(text for _, text in sorted(moves, reverse=True)) or "no move of at least 0.05"


def _beliefs(context: ReportContext, k: int) -> Figure:
    fit, protocol = context.study.fits[k], context.protocol
    found, bootstrap = context.study.identifications[k], context.study.bootstraps.get(k)
    value = rates.value_of_response(protocol)
    values, intervals = {}, {}
    initial: Interval | None = None
    if bootstrap is not None:
        low, high = bootstrap.interval("initial", LEVEL)
        initial = (low, high)
    for i, action in enumerate(protocol.emission_actions):
        if action in found.silent_emissions:
            continue
        values[action] = fit.model.emission[i] @ value
        if bootstrap is not None:
            replicates = bootstrap.emission[:, i] @ value
            low, high = np.quantile(replicates, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], axis=0)
            intervals[action] = (low, high)
    measure = rates.measure_name(protocol)
    label = f"probability of {spoken(rates.high_response(protocol))}" if rates.is_share(protocol) else measure
    states = fit.model.state_names
    panels = (
        partial(observation_curves, values, intervals, states, measure=label, limits=rates.measure_range(protocol)),
        partial(initial_belief, fit.model.initial, initial, states),
    )
    curves = "; ".join(f"{spoken(a)} " + ", ".join(f"{v:.2f}" for v in vs) for a, vs in values.items())
    alt = (
        f"{label.capitalize()} by state, {', '.join(states)}: {curves}.",
        "Initial belief: "
        + ", ".join(f"{s} {p:.2f}" for s, p in zip(states, fit.model.initial, strict=True))
        + ".",
    )
    caption = f"Left: {label} in each state, by action. Right: belief before the first round."
    if bootstrap is not None:
        caption += f" Bars: {LEVEL:.0%} bootstrap intervals ({bootstrap.replicates} replicates)."
    if found.silent_emissions:
        names = ", ".join(spoken(a) for a in found.silent_emissions)
        caption += f" Left out, because no response was recorded under it: {names}."
    return Figure(f"beliefs-{k}", panels, caption, alt, (context.origin,))
