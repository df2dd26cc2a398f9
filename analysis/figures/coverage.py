"""Plot of coverage: how often intervals hold the truth, beside the range in which exact intervals stay."""

from __future__ import annotations

import pandas as pd
from matplotlib.axes import Axes

from analysis.figures.style import COLOURS, FAINT, RULE, axes, styled

SHAPES = {
    ("AGHQ", "profile"): "o", ("AGHQ", "Wald"): "s", ("Laplace", "profile"): "^", ("Laplace", "Wald"): "D",
}  # fmt: skip
"""Markers, so that rules can be told apart in grey print too."""

FILLS = {"AGHQ": COLOURS[0], "Laplace": COLOURS[1]}


@styled
def coverage_by_parameter(
    table: pd.DataFrame, level: float, *, title: str = "", legend: bool = True, ax: Axes | None = None
) -> Axes:
    """One row a parameter: the share of studies whose interval holds the truth, by rule and kind of interval.

    Parameters
    ----------
    table : DataFrame
        ``rule, parameter, interval, share, studies, low, high`` of one rate of help
        (`analysis.interval_coverage.CoverageResult.table`).
    level : float
        Of the intervals.
    title : str
    legend : bool
    ax : Axes, optional
    """
    parameters = list(dict.fromkeys(table["parameter"]))
    pairs = list(dict.fromkeys(zip(table["rule"], table["interval"], strict=True)))
    ax = axes(4.6, 1.3 + 0.5 * len(parameters)) if ax is None else ax
    first = table.iloc[0]
    ax.axvspan(
        first["low"] / first["studies"], first["high"] / first["studies"], color=RULE, alpha=0.8, linewidth=0
    )
    ax.axvline(level, color=FAINT, linewidth=0.9)
    for i, (rule, kind) in enumerate(pairs):
        part = table[(table["rule"] == rule) & (table["interval"] == kind)].set_index("parameter")
        shift = 0.17 * (i - (len(pairs) - 1) / 2)
        ax.plot(
            part.loc[parameters, "share"], [row + shift for row in range(len(parameters))], SHAPES[rule, kind],
            color=FILLS[rule], markerfacecolor=FILLS[rule] if kind == "profile" else "white", markersize=5,
            linestyle="none", label=f"{rule}, {kind}",
        )  # fmt: skip
    ax.set_yticks(range(len(parameters)), parameters)
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(len(parameters) - 0.5, -0.5)
    ax.set_xlim(-0.03, 1.03)
    ax.set(xlabel=f"share of studies whose {level:.0%} interval holds the truth", ylabel="parameter", title=title)
    ax.grid(axis="x")
    for border in range(len(parameters) - 1):
        ax.axhline(border + 0.5, color=RULE, linewidth=0.6)
    if legend:
        ax.legend(loc="center left", bbox_to_anchor=(0.0, 0.5))
    return ax
