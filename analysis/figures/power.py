"""Plots of sample sizes: power or expected contraction by number of people, printed sizes beside formulas."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import NullFormatter, NullLocator

from analysis.figures.style import (
    COLOURS,
    FAINT,
    INK,
    LINES,
    MARKERS,
    PRINTED_COLOUR,
    PRINTED_MARKER,
    RULE,
    axes,
    styled,
)

LONG_NAME = 24
"""Letters of a series' name from which the legend stands below the plot, where it covers no curve."""


@styled
def power_by_people(
    series: Mapping[str, pd.DataFrame],
    wanted: float,
    *,
    reached: Mapping[str, float] | None = None,
    printed: float | None = None,
    ylabel: str = "power",
    log_x: bool = False,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Draw one curve a series, the value wanted, and where each curve reaches it.

    Parameters
    ----------
    series : mapping of name to DataFrame
        Columns ``people`` and ``value``; with ``low, high`` as well the points carry intervals.
    wanted : float
        Drawn as a horizontal line.
    reached : mapping of name to float, optional
        People at which a series reaches it; marked and written where finite.
    printed : float, optional
        A number of people that the paper prints.
    ylabel : str
    log_x : bool
        For numbers of people that multiply.
    title : str
    ax : Axes, optional
    """
    below = max(map(len, series)) > LONG_NAME
    ax = axes(5.2, 3.3 + (0.4 + 0.2 * len(series)) * below) if ax is None else ax
    reached = reached or {}
    ax.axhline(wanted, color=FAINT, linewidth=0.9, linestyle=(0, (4, 3)))
    # Curves that end above the line leave room below its right end, others below its left one.
    right = all(float(table["value"].iloc[-1]) > wanted + 0.03 for table in series.values())
    ax.annotate(f"{wanted:g} wanted", (float(right), wanted), xycoords=("axes fraction", "data"),
                xytext=(-3 if right else 3, -9), textcoords="offset points", ha="right" if right else "left",
                color=FAINT, fontsize=8)  # fmt: skip
    widest = max(float(table["people"].max()) for table in series.values())
    for i, (name, table) in enumerate(series.items()):
        x, y = table["people"].to_numpy(float), table["value"].to_numpy(float)
        colour, line = COLOURS[i % len(COLOURS)], LINES[i % len(LINES)]
        few = "low" in table
        label = name
        if name in reached:
            label += f": {np.ceil(reached[name]):,.0f}" if np.isfinite(reached[name]) else f": not by {x[-1]:,.0f}"
        if few:
            # Neighbours are moved apart a little, so that intervals at the same number of people can be told apart.
            step = i - (len(series) - 1) / 2
            at = x * 1.03**step if log_x else x + 0.006 * widest * step
            low, high = table["low"].to_numpy(float), table["high"].to_numpy(float)
            ax.errorbar(at, y, (y - low, high - y), color=colour,
                        marker=MARKERS[i % len(MARKERS)], capsize=2.5, linewidth=0, elinewidth=1.0)  # fmt: skip
            # Between simulated numbers as `analysis.power_curves.reached` has it, so that its mark is on the line.
            root = np.linspace(np.sqrt(x[0]), np.sqrt(x[-1]), 200)
            ax.plot(root**2, np.interp(root, np.sqrt(x), y), color=colour, linestyle=line, linewidth=1.4)
            ax.plot([], [], color=colour, linestyle=line, marker=MARKERS[i % len(MARKERS)], label=label)
        else:
            ax.plot(x, y, color=colour, linestyle=line, label=label)
        if np.isfinite(reached.get(name, np.nan)):
            ax.plot([reached[name]], [wanted], marker="v", markersize=6, color=colour, markeredgecolor=INK,
                    markeredgewidth=0.6, linestyle="none", zorder=5)  # fmt: skip
    if printed is not None:
        ax.plot([printed], [wanted], marker=PRINTED_MARKER, markersize=10, color=PRINTED_COLOUR, linestyle="none",
                label=f"printed: {printed:,.0f}", zorder=6)  # fmt: skip
    if log_x:
        ax.set_xscale("log")
        ticks = sorted({float(v) for table in series.values() for v in table["people"]})
        ax.set_xticks(ticks, [f"{v:,.0f}" for v in ticks])
        ax.xaxis.set_minor_locator(NullLocator())
        ax.xaxis.set_minor_formatter(NullFormatter())
    lows = [float(table["low" if "low" in table else "value"].min()) for table in series.values()]
    ax.set_ylim(min(0.0, *lows) - 0.02 if min(lows) < 0 else 0.0, 1.02)
    ax.set(xlabel="people", ylabel=ylabel, title=title)
    ax.grid(axis="y")
    inside = "upper left" if _leaves_upper_left_free(series) else "lower right"
    place: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (-0.08, -0.17)} if below else {"loc": inside}
    ax.legend(title="people needed" if reached else None, title_fontsize=8.5, alignment="left", **place)
    return ax


@styled
def printed_beside_formulas(table: pd.DataFrame, *, title: str = "", ax: Axes | None = None) -> Axes:
    """One row a test that a study could have meant: people by formula, beside the printed number.

    Parameters
    ----------
    table : DataFrame
        ``study, test, n, printed`` (`analysis.power_printed.PrintedSizes.table`).
    title : str
    ax : Axes, optional
    """
    ax = axes(7.6, 1.1 + 0.3 * len(table)) if ax is None else ax
    for i, row in enumerate(table.itertuples()):
        ax.plot([row.n, row.printed], [i, i], color=RULE, linewidth=1.2, zorder=1)
        ax.plot(row.n, i, MARKERS[0], color=COLOURS[0], label="by formula" if i == 0 else None)
        ax.plot(
            row.printed, i, PRINTED_MARKER, color=PRINTED_COLOUR, markersize=9, label="printed" if i == 0 else None
        )
        ax.annotate(
            f"{row.n:,.0f}", (row.n, i), xytext=(0, 5), textcoords="offset points", ha="center", fontsize=7.5
        )
    ax.set_yticks(range(len(table)), [f"{row.study}: {row.test}" for row in table.itertuples()])
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(len(table) - 0.4, -0.6)
    ax.set_xlim(left=0)
    ax.set(xlabel="people", ylabel="test", title=title)
    ax.grid(axis="x")
    ax.legend(loc="lower right")
    return ax


def _leaves_upper_left_free(series: Mapping[str, pd.DataFrame]) -> bool:
    """Whether the curves end low, so that the legend is better placed above than below them."""
    last = [float(table["value"].iloc[-1]) for table in series.values()]
    return float(np.mean(last)) < 0.75
