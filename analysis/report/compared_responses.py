"""Section of a comparison: who responded how, round by round."""

from __future__ import annotations

from functools import partial

import pandas as pd

from analysis.figures.side_by_side import rates_side_by_side
from analysis.figures.style import spoken
from analysis.pair_differences import LEVEL, rate_differences
from analysis.report.compared_context import Comparison
from analysis.report.section import Block, Compared, Figure, Headline, NotSupported, Table, Text
from analysis.response_rates import measure_name, measure_range
from analysis.wording import counted


def make(comparison: Comparison) -> tuple[Block, ...]:
    """Rates of both sides by round and action, and how many differ."""
    a, b = (s.log for s in comparison.sides)
    if a is None or b is None:
        raise NotSupported("a fit holds no responses")
    table = rate_differences(a, b)
    if table.empty:
        raise NotSupported("no round shows responses to the same action on both sides")
    measure, limits = measure_name(a.protocol), measure_range(a.protocol)
    actions = list(dict.fromkeys(table["action"]))
    panels = tuple(
        partial(rates_side_by_side, table[table["action"] == action], measure, limits, title=spoken(action),
                legend=i == 0)
        for i, action in enumerate(actions)
    )  # fmt: skip
    alts = tuple(
        f"{measure.capitalize()} by round after {spoken(action)}, both sides with 95% intervals."
        for action in actions
    )
    apart = _apart(table)
    text = (
        f"Of {len(table)} pairs of rounds and actions that both sides have, {int(apart.sum())} differ by more than "
        f"their 95% intervals allow; if nothing differed, about {(1 - LEVEL) * len(table):.1f} would."
    )
    shown = table[["k", "action", "rate_a", "rate_b", "difference", "low", "high", "responses_a", "responses_b"]]
    formats = dict.fromkeys(("rate_a", "rate_b", "difference", "low", "high"), ".3f")
    headings = {"rate_a": "A", "rate_b": "B", "difference": "B less A", "responses_a": "responses A",
                "responses_b": "responses B"}  # fmt: skip
    origins = comparison.origins
    return (
        Text(text),
        Figure("rates", panels, f"{measure.capitalize()} of both sides, 95% intervals.", alts, origins),
        Table(
            "rate-differences", shown, f"{measure.capitalize()} by round and action, and B less A with 95% "
            "intervals.", origins, headings,
            formats | dict.fromkeys(("k", "responses_a", "responses_b"), ",d"), row_headings=2,
        ),
        _headline(comparison, table, measure),
    )  # fmt: skip


def _apart(table: pd.DataFrame) -> pd.Series:
    """Whether the interval of a difference leaves out zero."""
    return (table["low"] > 0) | (table["high"] < 0)


def _headline(comparison: Comparison, table: pd.DataFrame, measure: str) -> Headline:
    """How many rates differ clearly, and the one that does most; open where chance alone might do as much."""
    apart = _apart(table)
    n = int(apart.sum())
    own = table[apart] if n else table
    most = own.loc[own["difference"].abs().idxmax()]
    by_chance = (1 - LEVEL) * len(table)
    text = (
        f"The {measure} differs clearly in {n} of {counted(len(table), 'pair')} of round and action (by chance "
        f"about {by_chance:.1f}); most{'' if n else ', but not clearly,'} in round {most['k']:d} after "
        f"'{spoken(most['action'])}': {most['rate_a']:.2f} in A, {most['rate_b']:.2f} in B, B less A "
        f"{most['difference']:+.2f} (95% interval {most['low']:+.2f} to {most['high']:+.2f})."
    )
    kind = "plain" if n > by_chance else "open"
    return Headline(text=text, kind=kind, question=Compared.RESPONSES, origin=comparison.origins)
