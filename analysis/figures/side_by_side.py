"""Plots of two sides: entries of their tables, response rates, and what plans are worth in either."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from analysis.figures.axis_names import REWARD, with_unit
from analysis.figures.style import COLOURS, FAINT, INK, MARKERS, axes, styled

SIDES = ("a", "b")


@styled
def entries_side_by_side(
    table: pd.DataFrame, *, title: str = "", legend: bool = True, ax: Axes | None = None
) -> Axes:
    """Estimates with intervals of both sides, one row an entry; a star where the difference leaves out zero.

    Parameters
    ----------
    table : DataFrame
        ``entry, a, low_a, high_a, b, low_b, high_b, apart``.
    title : str
    legend : bool
    ax : Axes, optional
    """
    n = len(table)
    ax = axes(3.3, 1.0 + 0.26 * n) if ax is None else ax
    row = np.arange(n)
    for i, side in enumerate(SIDES):
        at = row + (0.17 if i else -0.17)
        ax.hlines(at, table[f"low_{side}"], table[f"high_{side}"], color=COLOURS[i], linewidth=2.0)
        ax.plot(table[side], at, MARKERS[i], color=COLOURS[i], markersize=4.5, label=side.upper())
    apart = table["apart"].to_numpy(dtype=bool)
    if apart.any():
        ax.plot(np.full(apart.sum(), 1.06), row[apart], "*", color=INK, markersize=6, label="differ")
    ax.set_yticks(row, table["entry"].tolist())
    ax.set_ylim(n - 0.4, -0.6)
    ax.set_xlim(-0.03, 1.1)
    ax.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", ".25", ".5", ".75", "1"])
    ax.set(xlabel="probability", ylabel="entry", title=title)
    ax.grid(axis="x")
    if legend:
        ax.legend(loc="lower right", bbox_to_anchor=(1, 1.0), ncols=3, borderaxespad=0.1, columnspacing=1.0)
    return ax


@styled
def rates_side_by_side(
    table: pd.DataFrame, measure: str, limits: tuple[float, float], *, title: str = "", legend: bool = True,
    ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """Response rates of both sides by round, after one action, with 95% intervals.

    Parameters
    ----------
    table : DataFrame
        ``k, rate_a, low_a, high_a, rate_b, low_b, high_b`` (`analysis.pair_differences.rate_differences`).
    measure : str
    limits : (float, float)
        Of the measure.
    title : str
    legend : bool
    ax : Axes, optional
    """
    ax = axes(3.4, 2.6) if ax is None else ax
    for i, side in enumerate(SIDES):
        rate = table[f"rate_{side}"]
        bars = np.stack([rate - table[f"low_{side}"], table[f"high_{side}"] - rate])
        ax.errorbar(
            table["k"] + (0.08 if i else -0.08), rate, np.nan_to_num(bars), color=COLOURS[i], marker=MARKERS[i],
            linestyle=("-", "--")[i], capsize=2.5, elinewidth=1.2, label=side.upper(),
        )  # fmt: skip
    margin = 0.04 * (limits[1] - limits[0])
    ax.set_ylim(limits[0] - margin, limits[1] + margin)
    ax.set(xlabel="round k", ylabel=measure, title=title)
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.grid(axis="y")
    if legend:
        ax.legend()
    return ax


@styled
def plans_exchanged(table: pd.DataFrame, *, title: str = "", ax: Axes | None = None) -> Axes:
    """What each side's plan is worth in both worlds: estimate and 95% interval over the world's draws.

    Parameters
    ----------
    table : DataFrame
        ``plan, world, value, low, high`` (`analysis.pair_differences.plan_exchange`).
    title : str
    ax : Axes, optional
    """
    ax = axes(4.2, 2.4) if ax is None else ax
    worlds, plans = sorted(set(table["world"])), sorted(set(table["plan"]))
    ticks = []
    for w, world in enumerate(worlds):
        for p, plan in enumerate(plans):
            own = table[(table["world"] == world) & (table["plan"] == plan)].iloc[0]
            at = 3 * w + p
            ax.hlines(at, own["low"], own["high"], color=COLOURS[p], linewidth=2.2)
            ax.plot(own["value"], at, MARKERS[p], color=COLOURS[p], markersize=6)
            ticks.append((at, f"plan of {plan} in {world}"))
        if w:
            ax.axhline(3 * w - 1, color=FAINT, linewidth=0.6)
    ax.set_yticks([t for t, _ in ticks], [word for _, word in ticks])
    ax.invert_yaxis()
    ax.set(xlabel=with_unit("value", REWARD), ylabel="", title=title)
    ax.grid(axis="x")
    return ax
