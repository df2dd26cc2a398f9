"""Plots of who responded how: by round, and by condition and schedule."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from analysis.figures.style import COLOURS, FAINT, INK, SEQUENTIAL, axes, styled
from analysis.wording import counted

CROWDED = 16
"""Rounds beyond which intervals are drawn as a band instead of bars."""

POINTS_AN_INCH = 2.6
"""Rounds an inch of a panel up to which the numbers of responses fit under the points."""


@styled
def rate_by_round(
    table: pd.DataFrame,
    *,
    measure: str,
    limits: tuple[float, float],
    title: str = "",
    last_round: int | None = None,
    width: float = 3.05,
    ax: Axes | None = None,
) -> Axes:
    """Response rate by round with intervals, and the number of responses at the foot where there is room.

    Parameters
    ----------
    table : DataFrame
        Columns ``k, responses, rate, low, high`` (`analysis.response_rates`).
    measure : str
        Label of the vertical axis.
    limits : tuple of float
        Range of the measure.
    title : str
    last_round : int, optional
        Right end of the axis, so that panels compare.
    width : float
        Inches, unless `ax` is given.
    ax : Axes, optional
    """
    ax = axes(width, 2.5) if ax is None else ax
    k, rate = table["k"].to_numpy(), table["rate"].to_numpy()
    low, high = table["low"].to_numpy(), table["high"].to_numpy()
    end = int(k.max()) if last_round is None else last_round
    margin = 0.04 * (limits[1] - limits[0])
    if len(k) > CROWDED:
        ax.fill_between(k, low, high, color=COLOURS[0], alpha=0.22, linewidth=0)
        ax.plot(k, rate, color=COLOURS[0], marker="o", markersize=3)
    else:
        known = np.isfinite(low)
        bars = np.stack([rate - low, high - rate])[:, known]
        ax.errorbar(
            k[known], rate[known], bars, color=COLOURS[0], marker="o", capsize=2.5, linestyle="-", elinewidth=1.2
        )
        ax.plot(k[~known], rate[~known], "o", color=COLOURS[0])
        # Headroom for the counts, which belong to their point.
        for x, n in zip(k, table["responses"], strict=True) if len(k) <= POINTS_AN_INCH * width else ():
            ax.annotate(
                f"{n:,}", (x, 0), xycoords=("data", "axes fraction"), xytext=(0, 3), textcoords="offset points",
                ha="center", va="bottom", fontsize=7.2, color=FAINT,
            )  # fmt: skip
    ax.set(xlabel="round k", ylabel=measure, title=title)
    ax.set_xlim(-0.5, end + 0.5)
    bottom = limits[0] - (margin if len(k) > CROWDED else 3 * margin)
    ax.set_ylim(bottom, limits[1] + margin)
    ax.set_yticks(np.linspace(*limits, 5))
    ax.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
    ax.grid(axis="y")
    return ax


@styled
def rate_heat_map(
    table: pd.DataFrame,
    *,
    rows: str,
    columns: str,
    limits: tuple[float, float],
    row_order: list[str],
    column_order: list[str],
    ax: Axes | None = None,
) -> Axes:
    """Rate in every cell of two groupings, printed in the cell with the number of people behind it.

    The number is the message; the shade, darker for higher, only guides the eye and needs no scale.

    Parameters
    ----------
    table : DataFrame
        Columns named by `rows` and `columns`, and ``rate, people``.
    rows, columns : str
    limits : tuple of float
    row_order, column_order : list of str
        All cells are shown; those without a response say so.
    ax : Axes, optional
    """
    ax = axes(1.9 + 0.78 * len(column_order), 1.25 + 0.5 * len(row_order)) if ax is None else ax
    cells = table.set_index([rows, columns])[["rate", "people"]].reindex(
        pd.MultiIndex.from_product([row_order, column_order])
    )
    rates, people = (cells[c].to_numpy().reshape(len(row_order), -1) for c in ("rate", "people"))
    ax.pcolormesh(
        np.ma.masked_invalid(rates), cmap=SEQUENTIAL, vmin=limits[0], vmax=limits[1], edgecolors="white",
        linewidth=2,
    )  # fmt: skip
    middle = limits[0] + 0.55 * (limits[1] - limits[0])
    for i, j in np.ndindex(rates.shape):
        if np.isnan(rates[i, j]):
            ax.text(j + 0.5, i + 0.5, "no\nresponse", ha="center", va="center", fontsize=7, color=FAINT)
            continue
        colour = "white" if rates[i, j] > middle else INK
        ax.text(j + 0.5, i + 0.36, f"{rates[i, j]:.2f}", ha="center", va="center", color=colour, weight="bold")
        number = counted(int(people[i, j]), "person", "people")
        ax.text(j + 0.5, i + 0.72, number, ha="center", va="center", color=colour, fontsize=7)
    ax.set_xticks(np.arange(len(column_order)) + 0.5, column_order)
    ax.set_yticks(np.arange(len(row_order)) + 0.5, row_order)
    ax.invert_yaxis()
    ax.tick_params(length=0)
    ax.set(xlabel=columns, ylabel=rows)
    for spine in ax.spines.values():
        spine.set_visible(False)
    return ax
