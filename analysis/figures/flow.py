"""Plot of how long runs last."""

from __future__ import annotations

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator, PercentFormatter

from analysis.figures.style import COLOURS, LINES, MARKERS, axes, styled


@styled
def still_going(table: pd.DataFrame, *, ax: Axes | None = None) -> Axes:
    """Share of runs that have an event k, one step line a condition.

    Parameters
    ----------
    table : DataFrame
        Columns ``condition, k, share`` (`analysis.participant_flow.still_going`).
    ax : Axes, optional
    """
    ax = axes(5.6, 3.1) if ax is None else ax
    last = int(table["k"].max())
    for i, (name, rows) in enumerate(table.groupby("condition", observed=True, sort=True)):
        k, share = [*rows["k"], rows["k"].max() + 1], [*rows["share"], 0.0]
        ax.plot(
            k, share, drawstyle="steps-post", color=COLOURS[i % len(COLOURS)], linestyle=LINES[i % len(LINES)],
            marker=MARKERS[i % len(MARKERS)], markevery=(i, max(1, last // 6)), label=str(name),
        )  # fmt: skip
    ax.set(xlabel="round k", ylabel="share of runs that have this round", xlim=(0, last + 1.2), ylim=(-0.02, 1.03))
    ax.yaxis.set_major_formatter(PercentFormatter(1))
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.grid(axis="y")
    if len(set(table["condition"])) > 1:
        ax.legend(title="condition", loc="center left", bbox_to_anchor=(1, 0.5))
    return ax
