"""Plot of distances: numbers of ours beside printed ones, in half-widths of the interval that decides."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from analysis.figures.style import COLOURS, FAINT, PRINTED_COLOUR, PRINTED_MARKER, RULE, axes, styled

FARTHEST = 4.0
"""Numbers farther apart are drawn at the edge, as arrows."""


@styled
def distances_from_print(
    table: pd.DataFrame, *, title: str = "", legend: bool = True, ax: Axes | None = None
) -> Axes:
    """One row a printed number: it is the star, ours lies as far from it as it says.

    Parameters
    ----------
    table : DataFrame
        ``quantity, distance, differs``: name, ours less printed in half-widths of the interval that decides, and
        whether they differ.
    title : str
    legend : bool
    ax : Axes, optional
    """
    n = len(table)
    ax = axes(6.4, 1.2 + 0.215 * n) if ax is None else ax
    row = np.arange(n)
    distance, differs = table["distance"].to_numpy(float), table["differs"].to_numpy(bool)
    ax.axvspan(-1, 1, color=RULE, alpha=0.6, linewidth=0)
    ax.plot(np.zeros(n), row, PRINTED_MARKER, color=PRINTED_COLOUR, markersize=6, linestyle="", label="printed")
    shown = np.clip(distance, -FARTHEST, FARTHEST)
    ax.hlines(row, 0, shown, color=FAINT, linewidth=0.7)
    for which, colour, marker, name in (
        (~differs, COLOURS[0], "o", "ours, compatible or the same"),
        (differs, COLOURS[1], "s", "ours, differs"),
    ):
        inside = which & (np.abs(distance) <= FARTHEST)
        # The name is in the legend even where all of a kind lie beyond the edge.
        ax.plot(shown[inside], row[inside], marker, color=colour, markersize=5, linestyle="", label=name)
    for sign, marker in ((-1, "<"), (1, ">")):
        beyond = sign * distance > FARTHEST
        if beyond.any():  # an empty line that is not clipped would still take part in the layout
            ax.plot(shown[beyond], row[beyond], marker, color=COLOURS[1], markersize=6, linestyle="", clip_on=False)
    ax.set_yticks(row, list(table["quantity"]))
    ax.tick_params(axis="y", length=0, labelsize=8)
    ax.set_ylim(n - 0.4, -0.6)
    ax.set_xlim(-FARTHEST - 0.15, FARTHEST + 0.15)
    ax.set_xlabel("ours less printed, in half-widths")
    ax.set_title(title, pad=22 if legend else None)
    ax.grid(axis="x")
    if legend:
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=3, handletextpad=0.1)
    return ax
