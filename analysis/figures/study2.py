"""Plots of study 2: outcomes over its rounds, how often conclusions come out, printed numbers in their place."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.ticker import FuncFormatter, PercentFormatter

from analysis.figures.several import Panels, legend_of_all, panels, words_below
from analysis.figures.style import (
    COLOURS,
    FAINT,
    INK,
    LINES,
    MARKERS,
    PRINTED_COLOUR,
    PRINTED_MARKER,
    axes,
    styled,
)

MEDIANS = ("|", "x", "1", "+")
"""Markers of medians, by what robots learned from."""

SPREAD = 0.42
"""Rounds over which the intervals of policies in the same round are spread, so that they do not hide each other."""


@styled
def four_panels(tables: Sequence[tuple[str, str, pd.DataFrame]], letters: str, *, ax: Any = None) -> Panels:
    """Outcomes over the rounds, one line a policy with its intervals.

    Parameters
    ----------
    tables : sequence of (title, axis label, DataFrame)
        Up to four: ``policy, round, mean, low, high`` each; policies in the same order in all.
    letters : str
        Modes of the rounds, which label the ticks.
    ax : array of Axes, shape [2, 2], optional

    Raises
    ------
    InputError
        If what is given as `ax` has another shape.
    """
    made, own = panels("outcomes over the rounds", ax, (2, 2), (7.0, 5.6))
    names = list(dict.fromkeys(tables[0][2]["policy"]))
    shifts = np.linspace(-SPREAD / 2, SPREAD / 2, len(names)) if len(names) > 1 else np.zeros(1)
    handles: list[Any] = []
    for one in made.flat[len(tables) :]:
        one.set_visible(False)
    for i, (title, label, table) in enumerate(tables):
        one = made.flat[i]
        for j, (name, shift) in enumerate(zip(names, shifts, strict=True)):
            part = table[table["policy"] == name]
            at, mean, low, high = (part[c].to_numpy(float) for c in ("round", "mean", "low", "high"))
            look: dict[str, Any] = {"color": COLOURS[j % len(COLOURS)], "marker": MARKERS[j % len(MARKERS)]}
            look["linestyle"] = LINES[j % len(LINES)]
            one.vlines(at + shift, low, high, color=look["color"], linewidth=0.9, alpha=0.75)
            one.plot(at + shift, mean, markersize=3.6, linewidth=1.3, **look)
            if i == 0:
                handles.append(Line2D([], [], label=name, **look))
        one.set_xticks(range(1, len(letters) + 1), [f"{k}\n{letter}" for k, letter in enumerate(letters, 1)])
        one.set_xlim(0.5, len(letters) + 0.5)
        one.set(title=title, ylabel=label)
        if float(table["low"].min()) >= 0 and float(table["high"].max()) <= 1:
            one.yaxis.set_major_formatter(PercentFormatter(1))
        one.grid(axis="y")
    words_below(made, own, "round (H: the human may help)")
    legend_of_all(made, own, handles, "outside upper center", ncols=min(len(names), 5))
    return made


@styled
def claim_shares(rows: pd.DataFrame, *, title: str = "", ax: Axes | None = None) -> Axes:
    """Share of simulated studies that lead to each conclusion, by planner.

    Parameters
    ----------
    rows : DataFrame
        ``claim, name, planner, whole, share, low, high``; names of whole conclusions are set bold.
    title : str
    ax : Axes, optional
    """
    labels = list(dict.fromkeys(zip(rows["claim"], rows["name"], strict=True)))
    planners = list(dict.fromkeys(rows["planner"]))
    ax = axes(6.8, 0.36 * len(labels) + 1.1) if ax is None else ax
    shifts = np.linspace(-0.27, 0.27, len(planners)) if len(planners) > 1 else np.zeros(1)
    for j, (planner, shift) in enumerate(zip(planners, shifts, strict=True)):
        part = rows[rows["planner"] == planner]
        at = np.arange(len(labels)) + shift
        part = part.set_index("claim").loc[[key for key, _ in labels]]
        share, low, high = (part[c].to_numpy(float) for c in ("share", "low", "high"))
        colour = COLOURS[j % len(COLOURS)]
        ax.hlines(at, low, high, color=colour, linewidth=1.1)
        ax.plot(
            share, at, linestyle="", marker=MARKERS[j % len(MARKERS)], color=colour, markersize=4.5, label=planner
        )
    ax.set_yticks(range(len(labels)), [name for _, name in labels])
    whole = set(rows.loc[rows["whole"], "claim"])
    for (key, _), tick in zip(labels, ax.get_yticklabels(), strict=True):
        tick.set_fontsize(8)
        if key in whole:
            tick.set_fontweight("bold")
    for y in np.arange(len(labels) - 1) + 0.5:
        ax.axhline(y, color="#eceff3", linewidth=0.7)
    ax.set_ylim(len(labels) - 0.5, -0.5)
    ax.set_xlim(-0.02, 1.02)
    ax.xaxis.set_major_formatter(PercentFormatter(1))
    ax.tick_params(axis="y", length=0)
    ax.set(xlabel="share of simulated studies that lead to the conclusion")
    ax.grid(axis="x")
    ax.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2, ncols=len(planners),
              title=title or None, alignment="right", handletextpad=0.1)  # fmt: skip
    return ax


@styled
def printed_in_place(
    rows: pd.DataFrame, *, xlabel: str, log: bool = False, title: str = "", ax: Axes | None = None
) -> Axes:
    """Printed numbers beside the distribution of the same numbers over simulated studies.

    Parameters
    ----------
    rows : DataFrame
        ``label, learning, q05, q25, q50, q75, q95, printed``.
    xlabel : str
    log : bool
        Logarithmic axis.
    title : str
    ax : Axes, optional
    """
    labels = list(dict.fromkeys(rows["label"]))
    kinds = list(dict.fromkeys(rows["learning"]))
    ax = axes(6.4, 0.42 * len(labels) + 1.1) if ax is None else ax
    shifts = np.linspace(-0.16, 0.16, len(kinds)) if len(kinds) > 1 else np.zeros(1)
    for j, (kind, shift) in enumerate(zip(kinds, shifts, strict=True)):
        part = rows[rows["learning"] == kind]
        at = np.array([labels.index(label) for label in part["label"]]) + shift
        q = {name: part[name].to_numpy(float) for name in ("q05", "q25", "q50", "q75", "q95")}
        colour = COLOURS[j % len(COLOURS)]
        ax.hlines(at, q["q05"], q["q95"], color=colour, linewidth=1.1)
        ax.hlines(at, q["q25"], q["q75"], color=colour, linewidth=4.5, alpha=0.45)
        ax.plot(
            q["q50"], at, MEDIANS[j % len(MEDIANS)], color=colour, markersize=9, markeredgewidth=1.8,
            label=f"simulated, {kind}",
        )  # fmt: skip
    first = rows.drop_duplicates("label")
    places = [labels.index(label) for label in first["label"]]
    ax.plot(first["printed"], places, linestyle="", marker=PRINTED_MARKER, color=PRINTED_COLOUR, markersize=8,
            label="printed")  # fmt: skip
    if log:
        ax.set_xscale("log")
        ax.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:g}"))
    elif float(rows["q05"].min()) < 0 < float(rows["q95"].max()):
        ax.axvline(0, color=FAINT, linewidth=0.9, zorder=0)
    ax.set_yticks(range(len(labels)), labels)
    ax.tick_params(axis="y", length=0, labelcolor=INK)
    ax.set_ylim(len(labels) - 0.5, -0.5)
    ax.set(xlabel=xlabel)
    ax.grid(axis="x")
    ax.legend(loc="lower left", bbox_to_anchor=(-0.35, 1.0), borderaxespad=0.2, ncols=len(kinds) + 1,
              title=title or None, alignment="left")  # fmt: skip
    return ax
