"""Plot of one action's effect by latent state, beside the one number of a regression."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from analysis.figures.axis_names import with_unit
from analysis.figures.style import COLOURS, FAINT, RULE, above, axes, styled
from models.glmm_marginal import Estimate


@styled
def signal_effects(
    table: pd.DataFrame, *, regression: Estimate | None = None, title: str = "",
    limits: tuple[float, float] | None = None, legend: bool = True, ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """Effects in percentage points: grey the prior, blue the posterior by state, orange the regression's for all.

    Parameters
    ----------
    table : DataFrame
        Rows of one quantity (`analysis.signal_by_state.SignalByState.table`).
    regression : Estimate, optional
        Difference of probabilities over people.
    title : str
    limits : tuple of float, optional
        Of the horizontal axis, in percentage points.
    legend : bool
    ax : Axes, optional
    """
    n = len(table)
    ax = axes(4.6, 1.55 + 0.36 * n) if ax is None else ax
    row = np.arange(n)
    value = {
        c: 100 * table[c].to_numpy(dtype=np.float64) for c in ("mean", "low", "high", "prior_low", "prior_high")
    }
    ax.barh(row, value["prior_high"] - value["prior_low"], left=value["prior_low"], height=0.72, color=RULE,
            alpha=0.7, linewidth=0, label="prior")  # fmt: skip
    if regression is not None:
        ax.axvspan(100 * regression.lower, 100 * regression.upper, color=COLOURS[1], alpha=0.18, linewidth=0)
        ax.axvline(100 * regression.value, color=COLOURS[1], linestyle="--", label="regression")
    ax.axvline(0, color=FAINT, linewidth=0.9)
    ax.hlines(row, value["low"], value["high"], color=COLOURS[0], linewidth=2.4)
    ax.plot(value["mean"], row, "o", color=COLOURS[0], label="posterior")
    ax.set_yticks(row, [str(s) for s in table["state"]])
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(n - 0.45, -0.55)
    if limits is not None:
        ax.set_xlim(*limits)
    ax.set(xlabel=with_unit("change", "percentage points"), ylabel="state before", title=title)
    ax.grid(axis="x")
    if legend:
        ax.legend(ncols=3, columnspacing=1.0, handlelength=1.4, **above(ax, title))
    return ax
