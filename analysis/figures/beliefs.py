"""Plots of what a state means: how it responds, and how likely it is at the start."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from analysis.figures.style import COLOURS, LINES, MARKERS, axes, short_state, spoken, styled

Interval = tuple[NDArray[np.float64], NDArray[np.float64]]


@styled
def observation_curves(
    values: Mapping[str, NDArray[np.float64]],
    intervals: Mapping[str, Interval],
    state_names: Sequence[str],
    *,
    measure: str,
    limits: tuple[float, float],
    ax: Axes | None = None,
) -> Axes:
    """Expected response of each state, one line an action, with intervals where there are any.

    Parameters
    ----------
    values : mapping of action to float64[s]
        Actions without evidence are left out by the caller, who says so.
    intervals : mapping of action to (low, high)
    state_names : sequence of str
    measure : str
    limits : tuple of float
    ax : Axes, optional
    """
    n = len(state_names)
    ax = axes(max(3.4, 2.2 + 0.62 * n), 2.9) if ax is None else ax
    offsets = np.linspace(-0.09, 0.09, len(values)) if len(values) > 1 else [0.0]
    for i, (action, value) in enumerate(values.items()):
        x = np.arange(n) + offsets[i]
        colour, marker, line = COLOURS[i % 7], MARKERS[i % 7], LINES[i % 7]
        ax.plot(x, value, color=colour, marker=marker, linestyle=line, label=spoken(action))
        if action in intervals:
            _bars(ax, x, intervals[action], colour)
    _states_below(ax, state_names)
    margin = 0.05 * (limits[1] - limits[0])
    ax.set_ylim(limits[0] - margin, limits[1] + margin)
    ax.set_yticks(np.linspace(*limits, 5))
    ax.set(ylabel=measure)
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.2, ncols=min(len(values), 3))
    return ax


@styled
def initial_belief(
    initial: NDArray[np.float64],
    interval: Interval | None,
    state_names: Sequence[str],
    *,
    ax: Axes | None = None,
) -> Axes:
    """Bars of the initial belief with intervals where there are any."""
    n = len(state_names)
    ax = axes(max(3.0, 2.0 + 0.55 * n), 2.9) if ax is None else ax
    ax.bar(np.arange(n), initial, width=0.62, color=COLOURS[4], edgecolor=COLOURS[0], linewidth=1.0)
    if interval is not None:
        _bars(ax, np.arange(n, dtype=np.float64), interval, "black")
    _states_below(ax, state_names)
    ax.set(ylabel="initial belief (probability)", ylim=(0, 1.05))
    return ax


def _bars(ax: Axes, x: NDArray[np.float64], interval: Interval, colour: str) -> None:
    """Draw intervals where they are: one that leaves out its own estimate must be seen to do so."""
    low, high = interval
    middle, half = (low + high) / 2, (high - low) / 2
    ax.errorbar(x, middle, half, linestyle="none", color=colour, capsize=3, elinewidth=1.2)


def _states_below(ax: Axes, state_names: Sequence[str]) -> None:
    labels = [short_state(name, i).replace(" ", "\n", 1) for i, name in enumerate(state_names)]
    ax.set_xticks(np.arange(len(labels)), labels)
    ax.set_xlim(-0.5, len(labels) - 0.5)
    ax.set_xlabel("latent state")
    ax.grid(axis="y")
