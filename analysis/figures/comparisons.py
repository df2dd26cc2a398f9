"""Plots of a mixed analysis of variance: means of groups over time, and groups compared two by two."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from analysis.figures.style import COLOURS, FAINT, LINES, MARKERS, axes, styled
from analysis.posthoc import Comparisons


@styled
def cell_means(cells: pd.DataFrame, *, xlabel: str, ylabel: str, title: str = "", ax: Axes | None = None) -> Axes:
    """One line a group over the times, with the intervals of the cell means.

    Parameters
    ----------
    cells : DataFrame
        ``group, time, mean, low, high`` (`analysis.anova.MixedAnova.cells`).
    xlabel, ylabel : str
        Names of time and measure.
    title : str
    ax : Axes, optional
    """
    ax = axes(5.0, 3.3) if ax is None else ax
    times = list(dict.fromkeys(cells["time"]))
    groups = list(dict.fromkeys(cells["group"]))
    shifts = np.linspace(-0.12, 0.12, len(groups)) if len(groups) > 1 else np.zeros(1)
    for i, (group, shift) in enumerate(zip(groups, shifts, strict=True)):
        part = cells[cells["group"] == group]
        mean, low, high = (part[column].to_numpy(float) for column in ("mean", "low", "high"))
        ax.errorbar(np.arange(len(times)) + shift, mean, (mean - low, high - mean), label=group,
                    color=COLOURS[i % len(COLOURS)], linestyle=LINES[i % len(LINES)],
                    marker=MARKERS[i % len(MARKERS)], capsize=2.5, linewidth=1.4, elinewidth=1.0)  # fmt: skip
    ax.set_xticks(range(len(times)), times)
    ax.set_xlim(-0.4, len(times) - 0.6)
    ax.set(xlabel=xlabel, ylabel=ylabel, title=title)
    ax.grid(axis="y")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
    return ax


@styled
def compared_groups(compared: Comparisons, *, xlabel: str, title: str = "", ax: Axes | None = None) -> Axes:
    """One row a comparison: the difference with its simultaneous interval; filled where it excludes zero.

    Parameters
    ----------
    compared : Comparisons
    xlabel : str
        Name of the measure.
    title : str
    ax : Axes, optional
    """
    table = compared.table
    ax = axes(5.0, 1.1 + 0.26 * len(table)) if ax is None else ax
    ax.axvline(0, color=FAINT, linewidth=0.9)
    for i, row in enumerate(table.itertuples()):
        sure = row.low > 0 or row.high < 0
        ax.plot([row.low, row.high], [i, i], color=COLOURS[0], linewidth=1.6)
        ax.plot(row.difference, i, "o", color=COLOURS[0], markerfacecolor=COLOURS[0] if sure else "white")
    ax.set_yticks(range(len(table)), [f"{row.group} - {row.reference}" for row in table.itertuples()])
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(len(table) - 0.5, -0.5)
    ax.set(xlabel=f"difference, {xlabel} ({compared.level:.0%} together)", ylabel=compared.method, title=title)
    ax.grid(axis="x")
    return ax
