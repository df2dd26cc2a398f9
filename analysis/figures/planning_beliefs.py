"""Plot of where a policy takes people, and of what the robot believes meanwhile."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from analysis.figures.style import COLOURS, INK, SEQUENTIAL, axes, short_state, styled

NARROWEST = 0.07
"""Areas that end thinner than that have no room for a name."""


@styled
def belief_trajectory(
    states: NDArray[np.float64],
    letters: str,
    state_names: Sequence[str],
    *,
    believed: NDArray[np.float64] | None = None,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Shares of people by state as stacked areas from event to event, palest for the least prosocial state.

    Dashed lines divide the robot's mean belief in the same way: where it is right on average they run along the
    edges of the areas.

    Parameters
    ----------
    states : float64[k + 1, s]
        Share of people in each state before each event, and after the last.
    letters : str
        Modes of the events.
    state_names : sequence of str
    believed : float64[k + 1, s], optional
        Mean belief of the robot, over the same states.
    title : str
    ax : Axes, optional
    """
    ax = axes(2.38, 2.2) if ax is None else ax
    n = states.shape[1]
    at = np.arange(len(states))
    shades = np.linspace(0.10, 0.85, n)
    ax.stackplot(at, states.T, colors=[SEQUENTIAL(s) for s in shades], edgecolor="white", linewidth=0.8)
    middle = np.cumsum(states[-1]) - states[-1] / 2
    for s in range(n):
        if states[-1, s] >= NARROWEST:
            ax.text(at[-1] + 0.15, middle[s], short_state(state_names[s], s), va="center", fontsize=8)
    if believed is not None:
        for s in range(n - 1):
            line = believed[:, : s + 1].sum(axis=1)
            # White below, so that the dashes show on pale and dark areas alike.
            ax.plot(at, line, color="white", linewidth=2.6)
            ax.plot(at, line, color=COLOURS[1], linewidth=1.5, linestyle=(0, (3, 1.6)))
    ax.set_xticks(at, [*letters, ""])
    ax.set_xlim(0, at[-1])
    ax.set_ylim(0, 1)
    ax.yaxis.set_major_formatter(PercentFormatter(1))
    ax.tick_params(axis="x", labelcolor=INK)
    ax.set(ylabel="share of people", title=title)
    return ax
