"""Tables of one learned model: what its states are like, and every entry with its interval."""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis import response_rates as rates
from analysis.figures.style import spoken
from analysis.report.context import ReportContext
from analysis.report.section import Block, Part, Table, Text
from models.identification import WEAK
from models.labels import Array, dwell_time, expected_score, stationary_distribution, stationary_is_unique

LONG = 1000
"""Rounds beyond which a dwell time is not spelled out."""

EDGE = 1e-6
"""Dwell times this close to one round are boundary estimates."""


def states(context: ReportContext, k: int) -> tuple[Block, ...]:
    """Initial belief, expected response, stationary probability and dwell time of every state."""
    fit, protocol = context.study.fits[k], context.protocol
    found = context.study.identifications[k]
    model = fit.model
    weighted = expected_score(model.emission, rates.value_of_response(protocol).tolist(), fit.emission_weights)
    frame = pd.DataFrame({"state": [_named(n, i) for i, n in enumerate(model.state_names)]})
    frame["initial"] = model.initial
    frame["score"] = weighted
    headings = {"initial": "initial belief", "score": f"expected {rates.measure_name(protocol)}"}
    formats = {"initial": ".3f", "score": ".3f"}
    groups = [("", 3)]
    apart: list[str] = []
    learned = [a for a in protocol.action_names if a not in found.silent_transitions]
    for action in learned:
        table = model.transition[protocol.action(action)]
        if action not in found.pinned and stationary_is_unique(table):
            frame[f"stationary {action}"] = stationary_distribution(table)
        else:
            frame[f"stationary {action}"] = np.nan
            apart.append(action)
        frame[f"dwell {action}"] = [_rounds(d) for d in dwell_time(table)]
        headings |= {f"stationary {action}": "stationary", f"dwell {action}": "dwell"}
        formats |= {f"stationary {action}": ".3f", f"dwell {action}": ",.1f"}
        groups.append((spoken(action) + (" (held fixed)" if action in found.pinned else ""), 2))
    caption = (
        "States in canonical order. Stationary: long-run share of rounds in the state if the action were taken in "
        "every round. Dwell: expected number of rounds until the state is left."
    )
    if apart:
        caption += (
            f" –: not unique under {', '.join(spoken(a) for a in apart)}, since the chain falls apart (where it "
            "ends depends on where it began) or its table is held fixed."
        )
    table_block = Table(
        f"states-{k}", frame, caption, (context.origin,), headings=headings, formats=formats, groups=tuple(groups)
    )
    return (table_block, Text(_orders(context, k, learned))) if k > 1 else (table_block,)


def _rounds(dwell: float) -> object:
    """A dwell time; beyond any study it is only known to be long, unless the state is never left."""
    return f">{LONG:,}" if LONG < dwell < np.inf else dwell


def _named(name: str, index: int) -> str:
    return name if name == f"s{index}" else f"s{index} {name}"


def _orders(context: ReportContext, k: int, learned: list[str]) -> str:
    """Where an order by stability, which the paper's labels rest on, differs from the canonical one."""
    fit = context.study.fits[k]
    free = [a for a in learned if a not in context.study.identifications[k].pinned]
    if not free:
        return "No transition table was learned, so there is no order by stability to compare."
    same, differ, unknown = [], [], []
    for action in free:
        dwell = dwell_time(fit.model.transition[context.protocol.action(action)])
        order = dwell_order(dwell)
        if order is None:
            unknown.append(spoken(action))
        elif np.array_equal(order, np.arange(k)):
            same.append(spoken(action))
        else:
            differ.append(f"{', '.join(f's{i}' for i in order)} under {spoken(action)}")
    text = "The paper labels states by transition structure and stability, the workbench by expected response. "
    if not differ and not unknown:
        return f"{text}Ordered by dwell time, shortest first, the states come in the same order under every action."
    if differ:
        text += f"Ordered by dwell time, shortest first, they come as {'; '.join(differ)}"
        text += (
            f"; in the canonical order under {', '.join(same)}."
            if same
            else "; under no action in the canonical order."
        )
    elif same:
        text += (
            "Ordered by dwell time, shortest first, the states come in the canonical order under "
            f"{', '.join(same)}."
        )
    if unknown:
        text = (
            f"{text.rstrip()} Under {', '.join(unknown)} an order by dwell time is not identified: some states are "
            f"estimated to be left at once, or not within {LONG:,} rounds: the edge of what can be estimated."
        )
    return text


def dwell_order(dwell: Array) -> NDArray[np.int64] | None:
    """States by dwell time, shortest first; None where one lies at the edge: always left, or as good as never.

    Examples
    --------
    >>> dwell_order(np.array([3.0, 1.5])), dwell_order(np.array([3.0, np.inf]))
    (array([1, 0]), None)
    """
    if np.any(dwell < 1 + EDGE) or np.any(dwell > LONG):
        return None
    return np.argsort(dwell, kind="stable")


def entries(context: ReportContext, k: int, level: float) -> tuple[Block, ...]:
    """Every transition and response probability with its evidence, and its interval where there is one."""
    parts = [_transition_entries(context, k, level)] if k > 1 else []
    tables: tuple[Block, ...] = (*parts, _emission_entries(context, k, level))
    return (Part("Every entry with its evidence", f"entries-{k}", tables, folded=True),)


def _transition_entries(context: ReportContext, k: int, level: float) -> Table:
    fit, protocol = context.study.fits[k], context.protocol
    found, bootstrap = context.study.identifications[k], context.study.bootstraps.get(k)
    low, high = bootstrap.interval("transition", level) if bootstrap is not None else (None, None)
    rows = []
    for a, action in enumerate(protocol.action_names):
        silent, pinned = action in found.silent_transitions, action in found.pinned
        for i, j in np.ndindex(k, k):
            visits = float(fit.transition_count[a, i].sum())
            row: dict[str, object] = {
                "action": spoken(action), "from": f"s{i}", "to": f"s{j}",
                "probability": None if silent else fit.model.transition[a, i, j],
            }  # fmt: skip
            if low is not None and high is not None:
                known = not silent and not pinned
                row |= {"low": low[a, i, j] if known else None, "high": high[a, i, j] if known else None}
            row["visits"] = None if silent or pinned else visits
            row["evidence"] = (
                "no evidence" if silent else "held fixed" if pinned else "weak" if visits < WEAK else ""
            )
            rows.append(row)
    return _entry_table(
        context, f"transition-entries-{k}", rows, 3,
        "Transition probabilities; visits are expected counts of the row", level, bootstrap is not None,
    )  # fmt: skip


def _emission_entries(context: ReportContext, k: int, level: float) -> Table:
    fit, protocol = context.study.fits[k], context.protocol
    found, bootstrap = context.study.identifications[k], context.study.bootstraps.get(k)
    low, high = bootstrap.interval("emission", level) if bootstrap is not None else (None, None)
    rows = []
    for e, action in enumerate(protocol.emission_actions):
        silent = action in found.silent_emissions
        for i, o in np.ndindex(k, protocol.n_responses):
            visits = float(fit.emission_count[e, i].sum())
            row: dict[str, object] = {
                "action": spoken(action), "state": f"s{i}", "response": spoken(protocol.response_names[o]),
                "probability": None if silent else fit.model.emission[e, i, o],
            }  # fmt: skip
            if low is not None and high is not None:
                row |= {"low": None if silent else low[e, i, o], "high": None if silent else high[e, i, o]}
            row["visits"] = None if silent else visits
            row["evidence"] = "no evidence" if silent else "weak" if visits < WEAK else ""
            rows.append(row)
    return _entry_table(
        context, f"response-entries-{k}", rows, 3,
        "Response probabilities; visits are expected responses given in the state", level, bootstrap is not None,
    )  # fmt: skip


def _entry_table(
    context: ReportContext,
    key: str,
    rows: list[dict[str, object]],
    row_headings: int,
    caption: str,
    level: float,
    intervals: bool,
) -> Table:
    formats = {"probability": ".4f", "visits": ",.1f"}
    if intervals:
        formats |= {"low": ".4f", "high": ".4f"}
        caption += f"; low and high are {level:.0%} bootstrap intervals"
    return Table(key, pd.DataFrame(rows), caption, (context.origin,), formats=formats, row_headings=row_headings)
