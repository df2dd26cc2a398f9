"""Plots of effects: by round beside the raw difference of randomised arms, and of one action by state."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from analysis.credible import as_probability
from analysis.figures.axis_names import with_unit
from analysis.figures.style import COLOURS, FAINT, INK, RULE, above, axes, styled

CROWDED = 9
"""Rounds beyond which the model's effect is a band and only every few rounds are labelled."""


@styled
def effect_by_round(
    table: pd.DataFrame, *, scale: float = 1.0, unit: str, title: str = "", legend: bool = True,
    limits: tuple[float, float] | None = None, ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """Effect of always against never by round, and over all responses at the right; raw differences beside.

    Parameters
    ----------
    table : DataFrame
        Rows of one action (`analysis.causal.CausalEffects.of`), the last over all rounds.
    scale : float
        From the table's numbers to `unit`.
    unit : str
    title : str
    legend : bool
    limits : tuple of float, optional
        Of the vertical axis, so that panels compare.
    ax : Axes, optional
    """
    n = len(table)
    ax = axes(4.6 if n <= CROWDED else 5.6, 3.2) if ax is None else ax
    value = {c: scale * table[c].to_numpy(dtype=np.float64) for c in ("mean", "low", "high", "carried", "raw",
                                                                     "raw_low", "raw_high")}  # fmt: skip
    x = np.arange(n, dtype=np.float64)
    x[-1] += 0.5
    ax.axhline(0, color=FAINT, linewidth=0.9)
    ax.axvspan(x[-1] - 0.6, x[-1] + 0.6, color="#f1f3f5", linewidth=0)
    known = ~np.isnan(value["raw"])
    shift = 0.13 if known.any() else 0.0
    if n > CROWDED:
        rounds = slice(0, n - 1)
        ax.fill_between(x[rounds], value["low"][rounds], value["high"][rounds], color=COLOURS[0], alpha=0.25, lw=0)
        ax.plot(x[rounds], value["mean"][rounds], color=COLOURS[0], label="model")
        drawn = np.array([n - 1])
    else:
        drawn = np.arange(n)
    middle, half = (value["low"] + value["high"]) / 2, (value["high"] - value["low"]) / 2
    ax.errorbar(x[drawn] - shift, middle[drawn], half[drawn], linestyle="none", color=COLOURS[0], capsize=3)
    ax.plot(x[drawn] - shift, value["mean"][drawn], "o", color=COLOURS[0], label="model" if n <= CROWDED else None)
    if not np.allclose(value["carried"], value["mean"]):
        ax.plot(x - shift, value["carried"], "v", markerfacecolor="white", markeredgecolor=COLOURS[0],
                markersize=4.5, label="of it carried over", linestyle="none")  # fmt: skip
    if known.any():
        middle, half = (value["raw_low"] + value["raw_high"]) / 2, (value["raw_high"] - value["raw_low"]) / 2
        ax.errorbar((x + shift)[known], middle[known], half[known], linestyle="none", color=COLOURS[1], capsize=3,
                    elinewidth=1.1)  # fmt: skip
        ax.plot((x + shift)[known], value["raw"][known], "s", markerfacecolor="white", markeredgecolor=COLOURS[1],
                markersize=5, label="randomised arms, raw")  # fmt: skip
    step = 1 if n <= CROWDED else int(np.ceil((n - 1) / 8))
    labels = [*range(0, n - 1, step), n - 1]
    ax.set_xticks(x[labels], [str(table["round"].iloc[i]) for i in labels])
    ax.set(xlabel="round k (shaded: all responses)", ylabel=with_unit("change", unit), title=title)
    ax.set_xlim(-0.6, x[-1] + 0.6)
    if limits is not None:
        ax.set_ylim(*limits)
    ax.grid(axis="y")
    if legend:
        ax.legend(ncols=3, columnspacing=1.0, handlelength=1.4, **above(ax, title))
    return ax


@styled
def contrast_by_state(
    table: pd.DataFrame, *, scale: float = 1.0, unit: str, title: str = "",
    limits: tuple[float, float] | None = None, ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """What one action changes by state: grey the prior, blue the posterior, at the right the chance of a plus.

    Parameters
    ----------
    table : DataFrame
        Rows of one action (`analysis.uncertainty.Contrasts`).
    scale : float
    unit : str
    title : str
    limits : tuple of float, optional
        Of the horizontal axis.
    ax : Axes, optional
    """
    n = len(table)
    ax = axes(4.4, 1.35 + 0.36 * n) if ax is None else ax
    row = np.arange(n)
    value = {
        c: scale * table[c].to_numpy(dtype=np.float64) for c in ("mean", "low", "high", "prior_low", "prior_high")
    }
    ax.barh(row, value["prior_high"] - value["prior_low"], left=value["prior_low"], height=0.72, color=RULE,
            alpha=0.7, linewidth=0, label="prior")  # fmt: skip
    ax.axvline(0, color=FAINT, linewidth=0.9)
    ax.hlines(row, value["low"], value["high"], color=COLOURS[0], linewidth=2.4, label="posterior")
    ax.plot(value["mean"], row, "o", color=COLOURS[0])
    for i, p in enumerate(table["positive"]):
        ax.annotate(as_probability(float(p)), (1.0, i), xycoords=("axes fraction", "data"), xytext=(6, 0),
                    ha="left", va="center", textcoords="offset points", fontsize=8, color=INK,
                    annotation_clip=False)  # fmt: skip
    ax.annotate("P(> 0)", (1.0, -0.72), xycoords=("axes fraction", "data"), xytext=(6, 0), ha="left", va="center",
                textcoords="offset points", fontsize=7.5, color=FAINT, annotation_clip=False)  # fmt: skip
    ax.set_yticks(row, [str(s).replace(" at the", "\nat the") for s in table["state"]])
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(n - 0.45, -0.95)
    ends = [min(value["low"].min(), value["prior_low"].min()), max(value["high"].max(), value["prior_high"].max())]
    margin = 0.06 * (ends[1] - ends[0])
    ax.set_xlim(*(limits or (ends[0] - margin, ends[1] + margin)))
    ax.set(xlabel=with_unit("change of the next response", unit), ylabel="state before", title=title)
    ax.grid(axis="x")
    return ax
