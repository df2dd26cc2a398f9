"""Plots of the recovery study: errors and coverage by table, and how often the true number of states is found."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from scipy import stats

from analysis.figures.style import COLOURS, FAINT, INK, RULE, SEQUENTIAL, above, axes, spoken, styled

LEARNERS = (
    ("em_rmse", "EM", COLOURS[1], "D", -0.22),
    ("rmse", "posterior mean", COLOURS[0], "o", 0.0),
    ("prior_rmse", "prior mean, no data", FAINT, "|", 0.22),
)
"""Column, name, colour, marker and place within its row of what guesses an entry."""

BAND = 0.95
"""Probability of the band around a level in which an exact coverage is found."""


@styled
def recovery_errors(table: pd.DataFrame, *, title: str = "", ax: Axes | None = None) -> Axes:
    """One row a table of the model: an entry's root mean square error by learner, and theirs together as a bar.

    Parameters
    ----------
    table : DataFrame
        ``table, em_rmse, rmse, prior_rmse`` (`analysis.recovery.Recovery.table`), of one number of states.
    title : str
    ax : Axes, optional
    """
    groups = list(dict.fromkeys(table["table"]))
    ax = axes(4.9, 1.3 + 0.46 * len(groups)) if ax is None else ax
    for column, _, colour, marker, shift in LEARNERS:
        for row, name in enumerate(groups):
            values = table.loc[table["table"] == name, column].to_numpy(dtype=np.float64)
            spread = np.linspace(-0.07, 0.07, len(values)) if len(values) > 1 else np.zeros(1)
            ax.plot(values, row + shift + spread, marker, color=colour, markersize=3.2, alpha=0.6,
                    markeredgewidth=0.8 if marker == "|" else 0)  # fmt: skip
            together = float(np.sqrt(np.mean(values**2)))
            ax.plot([together] * 2, [row + shift - 0.11, row + shift + 0.11], color=colour, linewidth=2.4)
    _rows(ax, groups)
    ax.set_xlim(left=0)
    ax.set(xlabel="root mean square error (probability)", title=title)
    ax.legend(
        handles=[
            Line2D([], [], color=c, marker=m, linestyle="none", markersize=5, label=name)
            for _, name, c, m, _ in LEARNERS
        ],
        **above(ax, title, -0.35), ncols=3,
        handlelength=0.8, columnspacing=1.0,
    )  # fmt: skip
    return ax


@styled
def recovery_coverage(table: pd.DataFrame, studies: int, *, title: str = "", ax: Axes | None = None) -> Axes:
    """One row a table: share of studies whose posterior interval holds the truth, one dot an entry.

    The shaded bands are where 95% of the dots of exact intervals would lie.

    Parameters
    ----------
    table : DataFrame
        ``table, coverage_50, coverage_90``, of one number of states.
    studies : int
    title : str
    ax : Axes, optional
    """
    groups = list(dict.fromkeys(table["table"]))
    ax = axes(4.9, 1.3 + 0.46 * len(groups)) if ax is None else ax
    series = (("coverage_50", 0.5, COLOURS[2], "s", -0.16), ("coverage_90", 0.9, COLOURS[0], "o", 0.16))
    for column, level, colour, marker, shift in series:
        low, high = (stats.binom.ppf(p, studies, level) / studies for p in ((1 - BAND) / 2, (1 + BAND) / 2))
        ax.axvspan(low, high, color=colour, alpha=0.13, linewidth=0)
        ax.axvline(level, color=colour, linewidth=0.9)
        for row, name in enumerate(groups):
            values = table.loc[table["table"] == name, column].to_numpy(dtype=np.float64)
            spread = np.linspace(-0.09, 0.09, len(values)) if len(values) > 1 else np.zeros(1)
            ax.plot(values, row + shift + spread, marker, color=colour, markersize=3.6, alpha=0.65,
                    markeredgewidth=0)  # fmt: skip
            mean = float(values.mean())
            ax.plot([mean] * 2, [row + shift - 0.14, row + shift + 0.14], color=INK, linewidth=1.8)
    _rows(ax, groups)
    ax.set_xlim(-0.03, 1.03)
    ax.set_xticks([0, 0.25, 0.5, 0.75, 0.9, 1], ["0", ".25", ".5", ".75", ".9", "1"])
    ax.set(xlabel="share of studies whose interval holds the truth", title=title)
    ax.legend(
        handles=[
            Line2D([], [], color=c, marker=m, linestyle="none", markersize=5, label=f"{level:.0%} intervals")
            for _, level, c, m, _ in series
        ],
        **above(ax, title, -0.35), ncols=2,
        handlelength=0.8,
    )  # fmt: skip
    return ax


@styled
def states_found(chosen: pd.DataFrame, true_states: int, *, title: str = "", ax: Axes | None = None) -> Axes:
    """One bar a criterion: in which share of studies it chooses each number of states; the true one is hatched.

    Parameters
    ----------
    chosen : DataFrame
        ``name, states, share`` (`analysis.recovery.Recovery.chosen`).
    true_states : int
    title : str
    ax : Axes, optional
    """
    names = list(dict.fromkeys(chosen["name"]))
    sizes = sorted(set(chosen["states"]))
    ax = axes(4.9, 1.3 + 0.42 * len(names)) if ax is None else ax
    shade = {k: SEQUENTIAL(0.12 + 0.68 * i / max(1, len(sizes) - 1)) for i, k in enumerate(sizes)}
    for row, name in enumerate(names):
        left = 0.0
        for k in sizes:
            share = float(chosen.loc[(chosen["name"] == name) & (chosen["states"] == k), "share"].sum())
            true = k == true_states
            ax.barh(row, share, left=left, height=0.62, color=shade[k], edgecolor=INK if true else "white",
                    linewidth=0.8, hatch="////" if true else None)  # fmt: skip
            if share >= 0.06:
                ax.text(left + share / 2, row, str(k), ha="center", va="center", fontsize=8.5, color=INK,
                        bbox={"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none"})  # fmt: skip
            left += share
    ax.set_yticks(range(len(names)), names)
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(len(names) - 0.5, -0.5)
    ax.set_xlim(0, 1)
    ax.set(xlabel="share of studies in which it is best", ylabel="criterion", title=title)
    ax.legend(
        handles=[
            Patch(facecolor=shade[k], edgecolor=INK if k == true_states else RULE,
                  hatch="////" if k == true_states else None,
                  label=f"{k}, the truth" if k == true_states else str(k))
            for k in sizes
        ],
        title="states", title_fontsize=8.5,
        **above(ax, title, -0.35), ncols=len(sizes), handlelength=1.3, columnspacing=1.0, alignment="left",
    )  # fmt: skip
    return ax


def _rows(ax: Axes, groups: list[str]) -> None:
    ax.set_yticks(range(len(groups)), [spoken(name) for name in groups])
    ax.tick_params(axis="y", length=0)
    ax.set_ylabel("table")
    ax.set_ylim(len(groups) - 0.5, -0.5)
    ax.grid(axis="x")
    for border in range(len(groups) - 1):
        ax.axhline(border + 0.5, color=RULE, linewidth=0.6)
