"""Plots of a logistic regression: odds ratios from several sources, and rates beside what the fit says of them."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.ticker import FixedLocator, NullLocator

from analysis.figures.axis_names import with_unit
from analysis.figures.style import (
    COLOURS,
    FAINT,
    INK,
    MARKERS,
    PRINTED_COLOUR,
    PRINTED_MARKER,
    axes,
    styled,
)

TICKS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000)
PRINTED = "printed"
"""Source that is drawn in the way reserved for printed numbers."""

KNOWN = ("AGHQ", "Laplace", "Bayesian twin")
"""Sources with a colour of their own: those of `analysis.regression_sources`."""


@styled
def odds_forest(
    table: pd.DataFrame, *, sources: list[str], title: str = "", xlabel: str = "odds ratio", legend: bool = True,
    ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """Odds ratios with intervals on a logarithmic axis: one row a term, in each one line a source.

    Parameters
    ----------
    table : DataFrame
        ``term, source, estimate, low, high`` (`analysis.regression_sources.long_form`); a term without a source
        leaves its line empty. Intervals that leave the axis end in an arrow.
    sources : list of str
        In order.
    title, xlabel : str
    legend : bool
    ax : Axes, optional
    """
    terms = list(dict.fromkeys(table["term"]))
    ax = axes(5.6, 0.95 + len(terms) * (0.28 + 0.2 * len(sources))) if ax is None else ax
    values = table[["estimate", "low", "high"]].to_numpy(dtype=np.float64)
    finite = values[np.isfinite(values) & (values > 0)]
    limits = _limits(finite) if len(finite) else (0.5, 2.0)
    step = 0.8 / max(len(sources), 1)
    for j, source in enumerate(sources):
        rows = table[table["source"] == source]
        if rows.empty:
            continue
        y = np.array([terms.index(t) for t in rows["term"]]) - 0.4 + step * (j + 0.5)
        colour, marker, size = _look(source, j)
        low, high = (np.clip(rows[c].to_numpy(dtype=np.float64), *limits) for c in ("low", "high"))
        ax.hlines(y, low, high, color=colour, linewidth=1.8)
        for side, end, sign in (("low", limits[0], "<"), ("high", limits[1], ">")):
            beyond = rows[side].to_numpy(dtype=np.float64)
            out = beyond < end if sign == "<" else beyond > end
            if out.any():  # an empty line that is not clipped would still take part in the layout
                ax.plot(np.full(out.sum(), end), y[out], sign, color=colour, markersize=4.5, clip_on=False)
        estimate = rows["estimate"].to_numpy(dtype=np.float64)
        inside = (estimate >= limits[0]) & (estimate <= limits[1])
        ax.plot(estimate[inside], y[inside], marker, color=colour, markersize=size, label=source)
    ax.axvline(1, color=FAINT, linewidth=0.9)
    for i in range(1, len(terms)):
        ax.axhline(i - 0.5, color="#e6e9ed", linewidth=0.8)
    ax.set_xscale("log")
    ax.set_xlim(*limits)
    shown = [t for t in TICKS if limits[0] <= t <= limits[1]]
    ax.xaxis.set_major_locator(FixedLocator(shown))
    ax.xaxis.set_minor_locator(NullLocator())
    ax.set_xticks(shown, [f"{t:g}" for t in shown])
    ax.set_yticks(range(len(terms)), terms)
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(len(terms) - 0.5, -0.5)
    ax.set(xlabel=xlabel, title=title)
    ax.grid(axis="x")
    if legend:
        ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
    return ax


def _limits(values: np.ndarray) -> tuple[float, float]:
    """A little beyond everything, with 1 inside, but never more than three powers of ten from 1."""
    low = min(float(values.min()) / 1.25, 0.8)
    high = max(float(values.max()) * 1.25, 1.25)
    return max(low, 1e-3), min(high, 1e3)


def _look(source: str, index: int) -> tuple[str, str, float]:
    if source == PRINTED:
        return PRINTED_COLOUR, PRINTED_MARKER, 9.0
    # Known sources look the same in every figure, whoever stands beside them.
    known = KNOWN.index(source) if source in KNOWN else len(KNOWN) + index
    return COLOURS[known % (len(COLOURS) - 1)], MARKERS[known % len(MARKERS)], 5.5


@styled
def rates_beside(table: pd.DataFrame, *, measure: str, title: str = "", ax: Axes | None = None) -> Axes:
    """Observed rates of conditions with intervals, and what the fit says of each.

    Parameters
    ----------
    table : DataFrame
        ``condition, rate, low, high, predicted, predicted_low, predicted_high``
        (`analysis.regression_checks.by_condition`).
    measure : str
    title : str
    ax : Axes, optional
    """
    n = len(table)
    ax = axes(5.4, 1.2 + 0.44 * n) if ax is None else ax
    get = {c: table[c].to_numpy(dtype=np.float64) for c in table.columns if c != "condition"}
    row = np.arange(n)
    ax.hlines(row - 0.14, get["low"], get["high"], color=COLOURS[1], linewidth=1.6)
    ax.plot(get["rate"], row - 0.14, "s", markerfacecolor="white", markeredgecolor=COLOURS[1], label="observed")
    ax.hlines(row + 0.14, get["predicted_low"], get["predicted_high"], color=COLOURS[0], linewidth=2.2)
    ax.plot(get["predicted"], row + 0.14, "o", color=COLOURS[0], label="regression")
    ax.set_yticks(row, [str(c) if len(str(c)) <= 32 else f"{str(c)[:29]}..." for c in table["condition"]])
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(n - 0.5, -0.5)
    ends = np.concatenate([v[np.isfinite(v)] for k, v in get.items() if k not in ("responses", "people")])
    ax.set_xlim(max(0.0, np.floor(20 * ends.min() - 0.2) / 20), min(1.0, np.ceil(20 * ends.max() + 0.2) / 20))
    ax.set(xlabel=measure, title=title)
    ax.xaxis.label.set_color(INK)
    ax.grid(axis="x")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
    return ax


@styled
def residual_classes(table: pd.DataFrame, *, limit: float, title: str = "", ax: Axes | None = None) -> Axes:
    """Mean residual of every class in its standard errors; the band holds all classes in 95% of good models.

    Parameters
    ----------
    table : DataFrame
        ``grouping, value, z`` (`analysis.regression_checks.Residuals`).
    limit : float
        Half-width of the band.
    title : str
    ax : Axes, optional
    """
    n = len(table)
    ax = axes(5.4, 1.1 + 0.2 * n) if ax is None else ax
    groupings = list(dict.fromkeys(table["grouping"]))
    where = table["grouping"].map(groupings.index).to_numpy()
    y = np.arange(n) + 0.6 * where
    z = table["z"].to_numpy(dtype=np.float64)
    ax.axvspan(-limit, limit, color="#e9eef4", linewidth=0)
    ax.axvline(0, color=FAINT, linewidth=0.9)
    for i, name in enumerate(groupings):
        mine = where == i
        ax.plot(z[mine], y[mine], MARKERS[i], color=COLOURS[i], label=name, markersize=5.5)
    named = [f"round {v}" if g == "round" else v for g, v in zip(table["grouping"], table["value"], strict=True)]
    ax.set_yticks(y, [f"{v[:29]}..." if len(v) > 32 else v for v in named])
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(y[-1] + 0.7, -0.7)
    reach = max(limit, float(np.abs(z[np.isfinite(z)]).max(initial=0.0))) * 1.15
    ax.set_xlim(-reach, reach)
    ax.set(xlabel=with_unit("mean residual", "standard errors"), title=title)
    ax.grid(axis="x")
    ax.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
    return ax
