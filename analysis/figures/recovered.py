"""Plot of estimates with intervals beside the truth they were drawn from."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from analysis.figures.style import COLOURS, INK, above, axes, styled


@styled
def beside_truth(
    labels: Sequence[str],
    estimate: NDArray[np.float64],
    interval: tuple[NDArray[np.float64], NDArray[np.float64]],
    truth: NDArray[np.float64],
    *,
    measure: str,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """One row an entry: the interval as a bar, the estimate as a dot, the truth as a diamond.

    Parameters
    ----------
    labels : sequence of str
    estimate, truth : float64[n]
        Probabilities.
    interval : (low, high)
        A percentile interval need not contain its estimate.
    measure : str
    title : str
    ax : Axes, optional
    """
    n = len(labels)
    ax = axes(4.6, 1.1 + 0.26 * n) if ax is None else ax
    row = np.arange(n)
    ax.hlines(row, *interval, color=COLOURS[4], linewidth=5, label="interval")
    ax.plot(estimate, row, "o", color=COLOURS[0], markersize=5, label="estimate")
    ax.plot(truth, row, "D", markerfacecolor="white", markeredgecolor=INK, markersize=5.5, label="truth")
    ax.set_yticks(row, labels)
    ax.tick_params(axis="y", length=0)
    ax.set(xlabel=measure, xlim=(-0.03, 1.03), title=title)
    ax.set_ylim(n - 0.4, -0.6)
    ax.grid(axis="x")
    ax.legend(ncols=3, **above(ax, title))
    return ax
