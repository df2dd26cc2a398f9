"""Part of the regression's section: an action's effect by latent state, beside the regression's one number."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from analysis.figures.signal_by_state import signal_effects
from analysis.figures.style import spoken
from analysis.printed_regression import STATE_CLAIM
from analysis.regression import LEVEL, Regression
from analysis.report.context import ReportContext
from analysis.report.section import Block, Drawing, Figure, NotSupported, Part, Table, Text
from analysis.signal_by_state import NEXT, ODDS, SAME, SignalByState, signal_by_state


def by_state(context: ReportContext, regression: Regression) -> tuple[Block, ...]:
    """The latent-state model's effect of a signal by state, for every number of states that is shown."""
    shown = [k for k in context.shown_states if k > 1]
    actions = [term for term in regression.table.terms if term.kind == "now"]
    if not actions:
        raise NotSupported("no response was shown under more than one action of the robot")
    if not shown:
        raise NotSupported("with one state there is nothing that an effect could depend on")
    blocks: list[Block] = []
    for term in actions:
        mode = context.protocol.modes[context.protocol.mode_of_action[context.protocol.action(term.action)]]
        if term.action == mode.null_action:
            continue
        if context.is_published_protocol:
            blocks.append(Text(f"Of signalling the paper says: “{STATE_CLAIM}”. Here is what a fit says of it."))
        for k in shown:
            posterior = context.posterior(k)
            if not posterior.gate.passed:
                blocks.append(Text(f"{k} states: {posterior.gate.sentence}", "warning"))
            found = signal_by_state(posterior, term.action, regression.marginal[term.name])
            blocks += [Text(found.sentence), _state_figure(context, found), _state_table(context, found)]
    note = (
        "The two are not the same quantity: the regression compares people for whom the robot always or never took "
        "the action, and so mixes what it does at once with what earlier acts left behind. Intervals of the "
        f"latent-state model are 90%, those of the regression {LEVEL:.0%}."
    )
    blocks.append(Text(note, "note"))
    return (Part("Does the effect depend on the state?", "regression-states-part", tuple(blocks)),)


def _state_figure(context: ReportContext, found: SignalByState) -> Figure:
    assert found.regression is not None
    ends = 100 * found.table.loc[found.table["quantity"] != ODDS, ["low", "high"]].to_numpy()
    reach = 1.15 * max(float(np.abs(ends).max()), 5.0)
    panels: list[Drawing] = []
    alt = []
    for quantity in (SAME, NEXT):
        rows = found.table[found.table["quantity"] == quantity]
        panels.append(
            partial(
                signal_effects, rows, regression=found.regression.difference, title=f"response in the {quantity}",
                limits=(-reach, reach), legend=not panels,
            )
        )  # fmt: skip
        told = "; ".join(
            f"{r.state} {100 * r.mean:+.1f} ({100 * r.low:+.1f} to {100 * r.high:+.1f})" for r in rows.itertuples()
        )
        alt.append(f"Effect in the {quantity}, percentage points: {told}.")
    return Figure(
        f"regression-states-{found.action}-{found.n_states}", tuple(panels),
        f"'{spoken(found.action)}' instead of '{spoken(found.null_action)}' at {found.n_states} states: "
        "posterior mean and 90% interval by state (blue), prior (grey, cut off where it leaves the axis), and "
        f"the regression's one number for everybody with its {LEVEL:.0%} interval (orange).",
        tuple(alt), (context.origin,),
    )  # fmt: skip


def _state_table(context: ReportContext, found: SignalByState) -> Part:
    frame = found.table.copy()
    difference = found.difference.rename_axis("quantity").reset_index()
    difference.insert(1, "state", "highest less lowest")
    frame = pd.concat([frame, difference.drop(columns="verdict")], ignore_index=True)
    order = {q: i for i, q in enumerate((SAME, ODDS, NEXT))}
    frame = frame.sort_values("quantity", key=lambda c: c.map(order), kind="stable")
    columns = [c for c in frame.columns if c not in ("quantity", "state")]
    table = Table(
        f"regression-states-table-{found.action}-{found.n_states}", frame,
        "Effects by state as probabilities and log odds, with prior and contraction.", (context.origin,),
        headings={"low": "5%", "high": "95%", "positive": "P(> 0)", "prior_low": "5% ", "prior_high": "95% "},
        formats=dict.fromkeys(columns, ".3f"), row_headings=2,
        groups=(("", 2), ("posterior", 4), ("prior", 2), ("", 1)),
    )  # fmt: skip
    title = f"Numbers at {found.n_states} states, {spoken(found.action)}"
    return Part(title, f"regression-states-part-{found.action}-{found.n_states}", (table,), True)
