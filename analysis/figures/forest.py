"""Forest plot: the posterior of every entry beside its prior and the EM estimate with its bootstrap interval."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from analysis.figures.style import COLOURS, INK, RULE, above, axes, styled


@styled
def forest(
    table: pd.DataFrame, labels: list[str], *, title: str = "", xlabel: str = "probability", legend: bool = True,
    ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """One row an entry: grey band the prior, blue the posterior, orange diamond and line EM and its bootstrap.

    Parameters
    ----------
    table : DataFrame
        ``mean, low, high, prior_low, prior_high`` and, if there, ``em, boot_low, boot_high``.
    labels : list of str
        One a row.
    title, xlabel : str
    legend : bool
    ax : Axes, optional
    """
    n = len(table)
    ax = axes(4.3, 2.1 + 0.27 * n) if ax is None else ax
    row = np.arange(n)
    get = {c: table[c].to_numpy(dtype=np.float64) for c in table.columns if c not in ("table", "entry")}
    ax.barh(row, get["prior_high"] - get["prior_low"], left=get["prior_low"], height=0.78, color=RULE,
            alpha=0.7, linewidth=0, label="prior")  # fmt: skip
    ax.hlines(row - 0.14, get["low"], get["high"], color=COLOURS[0], linewidth=2.4, label="posterior")
    ax.plot(get["mean"], row - 0.14, "o", color=COLOURS[0], markersize=4.5)
    if "em" in get:
        if not np.isnan(get["boot_low"]).all():
            ax.hlines(row + 0.2, get["boot_low"], get["boot_high"], color=COLOURS[1], linewidth=1.2,
                      label="bootstrap")  # fmt: skip
        ax.plot(get["em"], row + 0.2, "D", markerfacecolor="white", markeredgecolor=COLOURS[1], markersize=4.2,
                label="EM")  # fmt: skip
    ax.set_yticks(row, labels)
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(n - 0.4, -0.6)
    ax.set_xlim(-0.03, 1.03)
    ax.set_xticks([0, 0.25, 0.5, 0.75, 1], ["0", ".25", ".5", ".75", "1"])
    ax.set(xlabel=xlabel, ylabel="entry", title=title)
    ax.xaxis.label.set_color(INK)
    ax.grid(axis="x")
    if legend:
        handles, words = ax.get_legend_handles_labels()
        order = sorted(range(len(words)), key=lambda i: ("prior", "posterior", "EM", "bootstrap").index(words[i]))
        ax.legend(
            [handles[i] for i in order], [words[i] for i in order], ncols=2, columnspacing=1.0, handlelength=1.6,
            **above(ax, title),
        )  # fmt: skip
    return ax
