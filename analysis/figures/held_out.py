"""Plots of what was left out and predicted from the rest: rates of whole cells, and one cell round by round."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from analysis.figures.style import COLOURS, FAINT, INK, LINES, MARKERS, RULE, axes, styled

ROW, GAP = 0.19, 0.16
"""Inches of a contender's row and between cells."""


@styled
def held_out_rates(
    table: pd.DataFrame, *, measure: str, limits: tuple[float, float], level: float, ax: Axes | None = None
) -> Axes:
    """Observed and predicted rates of every cell, one row a contender.

    A vertical line with a band is the observed rate and its interval; of each contender the thin line is the
    predictive interval, the thick one that of the expected rate. Markers are filled where the observed rate lies
    outside the predictive interval; a dagger stands where part of the prediction is the prior.

    Parameters
    ----------
    table : DataFrame
        One row a cell and contender (`analysis.held_out.HeldOut.overall`).
    measure : str
    limits : tuple of float
        Range of the measure.
    level : float
        Of the intervals.
    ax : Axes, optional
    """
    cells, names = (list(dict.fromkeys(table[c])) for c in ("cell", "contender"))
    height = len(cells) * (len(names) * ROW + GAP)
    ax = axes(6.6, height + 1.3) if ax is None else ax
    top, ticks = 0.0, []
    for cell in cells:
        mine = table[table["cell"] == cell].set_index("contender").loc[names]
        bottom = top + len(names) * ROW
        first = mine.iloc[0]
        ax.fill_betweenx(
            [top, bottom], first["observed_low"], first["observed_high"], color=RULE, linewidth=0, zorder=0
        )
        ax.plot([first["observed"]] * 2, [top, bottom], color=INK, linewidth=1.4)
        for i, (name, row) in enumerate(mine.iterrows()):
            y = top + (i + 0.5) * ROW
            colour = COLOURS[i % len(COLOURS)]
            ax.plot([row["low"], row["high"]], [y, y], color=colour, linewidth=1.1)
            ax.plot([row["expected_low"], row["expected_high"]], [y, y], color=colour, linewidth=3.2, alpha=0.75)
            face = "white" if row["inside"] else colour
            ax.plot(
                row["expected"], y, MARKERS[i % len(MARKERS)], color=colour, markerfacecolor=face, markersize=5.4
            )
            text = f"{name} \N{DAGGER}" if row["prior"] else str(name)
            ticks.append((y, text))
        ax.annotate(
            f"{cell if len(cell) <= 34 else cell[:31] + '...'}", (0.0, top), xycoords=("axes fraction", "data"),
            xytext=(2, 1), textcoords="offset points", fontsize=8.2, weight="bold", va="bottom",
        )  # fmt: skip
        top = bottom + GAP
    ax.set_yticks([y for y, _ in ticks], [text for _, text in ticks], fontsize=7.6)
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(top - GAP + 0.05, -GAP - 0.03)
    values = table[["low", "high", "observed_low", "observed_high", "observed", "expected"]].to_numpy()
    ends = np.nanmin(values), np.nanmax(values)
    margin = 0.04 * (limits[1] - limits[0])
    ax.set_xlim(max(limits[0], ends[0]) - margin, min(limits[1], ends[1]) + margin)
    ax.set_xlabel(measure)
    ax.grid(axis="x")
    handles = [
        (Line2D([], [], color=INK, linewidth=1.4), "observed"),
        (Patch(color=RULE), f"its {level:.0%} interval"),
        (Line2D([], [], color=FAINT, linewidth=1.1), f"{level:.0%} predictive interval"),
        (Line2D([], [], color=FAINT, linewidth=3.2, alpha=0.75), "interval of the expected rate"),
        (Line2D([], [], color=FAINT, marker="o", linestyle="none", markerfacecolor="white"), "observed inside"),
        (Line2D([], [], color=FAINT, marker="o", linestyle="none"), "observed outside"),
    ]
    ax.legend(
        [h for h, _ in handles], [text for _, text in handles], loc="lower left", bbox_to_anchor=(0, 1.0), ncols=3,
        fontsize=7.6, borderaxespad=0.2,
    )  # fmt: skip
    return ax


@styled
def held_out_by_round(
    table: pd.DataFrame,
    *,
    shown: str,
    order: Sequence[str],
    measure: str,
    limits: tuple[float, float],
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """One cell round by round: what was observed, one contender's predictive interval, what all expected.

    Parameters
    ----------
    table : DataFrame
        Rows of one cell by round and contender (`analysis.held_out.HeldOut.by_round`).
    shown : str
        Contender whose predictive interval is drawn, as a band.
    order : sequence of str
        Contenders in the order of colours, line styles and markers.
    measure : str
    limits : tuple of float
        Shown of the measure, so that panels compare.
    title : str
    ax : Axes, optional
    """
    ax = axes(3.2, 3.1) if ax is None else ax
    for i, name in enumerate(order):
        mine = table[table["contender"] == name]
        k = mine["at"].astype(int).to_numpy()
        colour = COLOURS[i % len(COLOURS)]
        if name == shown:
            ax.fill_between(k, mine["low"], mine["high"], color=colour, alpha=0.18, linewidth=0)
        ax.plot(
            k, mine["expected"], color=colour, linestyle=LINES[i % len(LINES)], marker=MARKERS[i % len(MARKERS)],
            markersize=3.4 if len(k) <= 16 else 0, linewidth=1.3, label=name,
        )  # fmt: skip
    seen = table[table["contender"] == order[0]]
    bars = np.stack([seen["observed"] - seen["observed_low"], seen["observed_high"] - seen["observed"]])
    ax.errorbar(
        seen["at"].astype(int), seen["observed"], np.nan_to_num(bars), color=INK, marker="D", markerfacecolor=INK,
        markersize=4, linestyle="none", capsize=2.5, elinewidth=1.1, label="observed", zorder=4,
    )  # fmt: skip
    ax.set(xlabel="round k", ylabel=measure, title=title)
    margin = 0.04 * (limits[1] - limits[0])
    ax.set_ylim(limits[0] - margin, limits[1] + margin)
    rounds = seen["at"].astype(int)
    if len(set(rounds)) == 1:  # a locator would put its ticks at fractions of a round
        ax.set_xticks([int(rounds.iloc[0])])
        ax.set_xlim(rounds.iloc[0] - 0.5, rounds.iloc[0] + 0.5)
    else:
        ax.xaxis.set_major_locator(MaxNLocator(integer=True, nbins=8))
    ax.grid(axis="y")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.19), fontsize=7, ncols=2, handlelength=2.4)
    return ax
