"""Plot of how much the data say about every entry, table by table."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from analysis.figures.style import COLOURS, FAINT, INK, axes, spoken, styled

FLOOR = -0.25
"""Contractions below are drawn at the edge: wider than before is all they say."""


@styled
def contraction_dots(
    table: pd.DataFrame, *, known: float, partly: float, title: str = "", ax: Axes | None = None
) -> Axes:
    """One row a table of the model, one dot an entry, the median as a bar with its number.

    Parameters
    ----------
    table : DataFrame
        Columns ``table`` and ``contraction`` (`analysis.uncertainty`); entries held fixed are NaN.
    known, partly : float
        Where an entry counts as known, and as partly known.
    title : str
    ax : Axes, optional
    """
    groups = list(dict.fromkeys(table["table"]))
    ax = axes(5.4, 1.3 + 0.34 * len(groups)) if ax is None else ax
    ax.axvspan(FLOOR - 0.05, partly, color="#e9ebee", linewidth=0)
    ax.axvspan(known, 1.03, color="#e2f1ea", linewidth=0)
    for x, words in ((partly / 2, "prior"), ((partly + known) / 2, "in part"), ((known + 1) / 2, "data")):
        ax.text(x, -0.68, words, ha="center", va="center", fontsize=7.5, color=FAINT)
    for row, name in enumerate(groups):
        values = table.loc[table["table"] == name, "contraction"].to_numpy(dtype=np.float64)
        values = values[~np.isnan(values)]
        if not len(values):
            ax.text(0.5, row, "held fixed", ha="center", va="center", fontsize=8, color=FAINT, style="italic")
            continue
        shown = np.maximum(values, FLOOR)
        spread = np.linspace(-0.16, 0.16, len(values)) if len(values) > 1 else np.zeros(1)
        marker_colour = COLOURS[0] if name.startswith("moves") else COLOURS[1]
        ax.plot(shown, row + spread, "o" if name.startswith("moves") else "s", color=marker_colour, markersize=3.4,
                alpha=0.75, markeredgewidth=0)  # fmt: skip
        median = float(np.median(values))
        at = max(median, FLOOR)
        ax.plot([at, at], [row - 0.3, row + 0.3], color=INK, linewidth=1.8)
        words = f"{median:.2f}".replace("-", "\N{MINUS SIGN}")
        ax.annotate(words, (1.03, row), xytext=(6, 0), textcoords="offset points", ha="left", va="center",
                    fontsize=8, color=INK, annotation_clip=False)  # fmt: skip
    ax.annotate("median", (1.03, -0.68), xytext=(6, 0), textcoords="offset points", ha="left", va="center",
                fontsize=7.5, color=FAINT, annotation_clip=False)  # fmt: skip
    ax.set_yticks(range(len(groups)), [spoken(g) for g in groups])
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(len(groups) - 0.45, -0.95)
    ax.set_xlim(FLOOR - 0.05, 1.03)
    ax.set_xticks([FLOOR, 0, 0.25, 0.5, 0.75, 1], [f"≤{FLOOR:g}".replace("-", "\N{MINUS SIGN}"), "0", ".25", ".5",
                                                   ".75", "1"])  # fmt: skip
    ax.set(xlabel="contraction of an entry against its prior", ylabel="table", title=title)
    return ax
