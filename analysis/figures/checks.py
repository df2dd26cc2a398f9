"""Plot of predictive checks: where the observed value lies among simulated studies."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from analysis.credible import as_probability
from analysis.figures.style import COLOURS, FAINT, INK, axes, styled

FAR = 5.0
"""Standard deviations beyond which an observed value is drawn at the edge, with an arrow."""


@styled
def predictive_checks(table: pd.DataFrame, *, title: str = "", ax: Axes | None = None) -> Axes:
    """One row a check, in standard deviations of the simulated studies: bar the interval, diamond the observed.

    Diamonds are filled where the observed value lies outside the interval; p is the share of simulated studies
    above.

    Parameters
    ----------
    table : DataFrame
        ``family, check, observed, mean, sd, low, high, p, outside`` (`analysis.predictive_checks`).
    title : str
    ax : Axes, optional
    """
    n = len(table)
    ax = axes(6.2, 1.0 + 0.2 * n) if ax is None else ax
    mean, sd = table["mean"].to_numpy(), table["sd"].to_numpy()
    sd = np.where(sd > 0, sd, 1.0)
    low, high, seen = ((table[c].to_numpy() - mean) / sd for c in ("low", "high", "observed"))
    row = np.arange(n)
    ax.hlines(row, low, high, color=COLOURS[4], linewidth=5, alpha=0.8)
    ax.axvline(0, color=FAINT, linewidth=0.8)
    for i, (x, outside) in enumerate(zip(seen, table["outside"], strict=True)):
        colour = COLOURS[1] if outside else "white"
        if abs(x) > FAR:
            edge = FAR if x > 0 else -FAR
            ax.plot(edge, i, ">" if x > 0 else "<", color=COLOURS[1], markeredgecolor=INK, markersize=6)
            ax.annotate(f"{x:+.0f} sd".replace("-", "\N{MINUS SIGN}"), (edge, i), xytext=(-8 if x > 0 else 8, 0),
                        textcoords="offset points", ha="right" if x > 0 else "left", va="center",
                        fontsize=7)  # fmt: skip
        else:
            ax.plot(x, i, "D", markerfacecolor=colour, markeredgecolor=INK, markersize=4.4)
        p = as_probability(float(table["p"].iloc[i]))
        ax.annotate(p, (1.0, i), xycoords=("axes fraction", "data"), xytext=(5, 0), textcoords="offset points",
                    ha="left", va="center", fontsize=7, annotation_clip=False)  # fmt: skip
    ax.annotate("p", (1.0, -1.0), xycoords=("axes fraction", "data"), xytext=(5, 0), textcoords="offset points",
                ha="left", va="center", fontsize=7.5, color=FAINT, annotation_clip=False)  # fmt: skip
    for border in np.flatnonzero(table["family"].to_numpy()[1:] != table["family"].to_numpy()[:-1]):
        ax.axhline(border + 0.5, color=FAINT, linewidth=0.5, linestyle=":")
    ax.set_yticks(row, [_short(name) for name in table["check"]])
    ax.tick_params(axis="y", length=0, labelsize=7.5)
    ax.set_ylim(n - 0.4, -1.4 if n > 6 else -1.2)
    ax.set_xlim(-FAR - 0.3, FAR + 0.3)
    ax.set(xlabel="standard deviations from the mean of simulated studies", ylabel="check", title=title)
    ax.grid(axis="x")
    return ax


def _short(name: str) -> str:
    """Shorten a long schedule.

    Examples
    --------
    >>> _short("bc4_e8, HRHRHRHRHRHRHRH"), _short("help+signal, HRHRH")
    ('bc4_e8, HRHRHR... (15)', 'help+signal, HRHRH')
    """
    condition, comma, schedule = name.rpartition(", ")
    if not comma or len(schedule) <= 9 or " " in schedule:
        return name
    return f"{condition}, {schedule[:6]}... ({len(schedule)})"
