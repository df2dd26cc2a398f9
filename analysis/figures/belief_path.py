"""Plot of a belief from round to round: what the robot thinks of one person."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter
from numpy.typing import NDArray

from analysis.figures.style import INK, SEQUENTIAL, axes, short_state, styled


@styled
def belief_path(
    beliefs: NDArray[np.float64], labels: Sequence[str], state_names: Sequence[str], *, ax: Axes | None = None
) -> Axes:
    """Stacked bars, one a belief, the least prosocial state at the bottom and palest.

    Parameters
    ----------
    beliefs : float64[n, s]
    labels : sequence of str
        What happened before each belief.
    state_names : sequence of str
    ax : Axes, optional
    """
    count, states = beliefs.shape
    ax = axes(2.6 + 0.85 * count, 3.2) if ax is None else ax
    floor = np.zeros(count)
    for s, shade in enumerate(np.linspace(0.12, 0.95, states)):
        ax.bar(
            np.arange(count), beliefs[:, s], 0.72, floor, color=SEQUENTIAL(shade), edgecolor="white",
            label=short_state(state_names[s], s),
        )  # fmt: skip
        for i, p in enumerate(beliefs[:, s]):
            if p >= 0.07:
                ax.text(
                    i, floor[i] + p / 2, f"{p:.2f}".lstrip("0"), ha="center", va="center", fontsize=8,
                    color="white" if shade > 0.5 else INK,
                )  # fmt: skip
        floor = floor + beliefs[:, s]
    ax.set_xticks(np.arange(count), labels)
    ax.tick_params(axis="x", length=0)
    ax.set(ylabel="belief (probability)", ylim=(0, 1))
    ax.yaxis.set_major_formatter(PercentFormatter(1))
    ax.legend(loc="center left", bbox_to_anchor=(1, 0.5), reverse=True)
    return ax
