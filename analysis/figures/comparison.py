"""Plot of a model comparison: how much worse each model predicts people, and what each criterion chooses."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, FuncFormatter, NullLocator

from analysis.figures.style import COLOURS, FAINT, INK, RULE, axes, styled

SERIES = (
    ("elpd_diff", "dse", "LOO", COLOURS[0], "o", -0.13),
    ("kfold_diff", "kfold_dse", "k-fold over people", COLOURS[1], "s", 0.13),
)
LINEAR = 10.0
"""Nats up to which the axis is linear; beyond, it is logarithmic: rivals may be hundreds of nats away."""
MARKS = (-10_000, -3000, -1000, -300, -100, -30, -10, -5, 0, 5, 10, 30, 100)


@styled
def elpd_differences(
    table: pd.DataFrame,
    choices: Mapping[str, list[str]],
    *,
    errors: float = 2.0,
    close: float = 4.0,
    ax: Axes | None = None,
) -> Axes:
    """One row a model: its elpd below the best, by LOO and by k-fold, and at the right the criteria that choose it.

    K-fold is drawn for the models that have it; where none has, LOO stands alone in the middle of its row.

    Parameters
    ----------
    table : DataFrame
        ``model, elpd_diff, dse, kfold_diff, kfold_dse`` (`analysis.comparison.Comparison.table`).
    choices : mapping of model to names of criteria
    errors : float
        Half length of the intervals in standard errors of the difference.
    close : float
        Half width of the shaded band: differences that say nothing.
    ax : Axes, optional
    """
    n = len(table)
    ax = axes(7.2, 1.2 + 0.36 * n) if ax is None else ax
    row = np.arange(n)
    series = [one for one in SERIES if table[one[0]].notna().any()]
    for column, error, label, colour, marker, aside in series:
        shift = aside if len(series) > 1 else 0.0
        values, half = table[column].to_numpy(float), errors * table[error].to_numpy(float)
        ax.hlines(row + shift, values - half, values + half, color=colour, linewidth=1.6)
        ax.plot(values, row + shift, marker, color=colour, linestyle="none", markersize=5.5, label=label)
    ax.axvspan(-close, close, color=RULE, alpha=0.6, linewidth=0, zorder=0)
    ax.axvline(0, color=INK, linewidth=0.8)
    for i, model in enumerate(table["model"]):
        if choices.get(model):
            names = textwrap.fill(", ".join(choices[model]), 34)
            ax.annotate(
                f"\N{BLACK LEFT-POINTING SMALL TRIANGLE} {names}", (1.0, i), xytext=(6, 0),
                xycoords=("axes fraction", "data"), textcoords="offset points", va="center", fontsize=8, color=INK,
            )  # fmt: skip
    ax.annotate(
        "best by", (1.0, 1.0), xytext=(6, 2), xycoords="axes fraction", textcoords="offset points", fontsize=8,
        color=FAINT, va="bottom",
    )  # fmt: skip
    ax.set_yticks(row, table["model"])
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(n - 0.5, -0.5)
    ax.set_xscale("symlog", linthresh=LINEAR)
    low, high = ax.get_xlim()
    ax.set_xlim(low, max(high, close))
    ax.xaxis.set_major_locator(FixedLocator([m for m in MARKS if low <= m <= max(high, close)]))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,.0f}".replace("-", "\N{MINUS SIGN}")))
    ax.set_xlabel(f"elpd below the best (nats, ± {errors:g} standard errors)")
    ax.grid(axis="x")
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.2, ncols=2)
    return ax
