"""Rank plots, which show whether chains agree."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray
from scipy.stats import rankdata

from analysis.figures.style import COLOURS, FAINT, LINES, axes, styled

BINS = 20


@styled
def chain_ranks(
    draws: NDArray[np.float64], *, title: str = "", legend: bool = True, ax: Axes | None = None
) -> Axes:
    """Share of each chain's draws by their rank among all draws; flat lines are chains that agree.

    The band holds 99% of independent draws in a bin; draws of a chain resemble their predecessors, so a little
    outside is no alarm.

    Parameters
    ----------
    draws : float64[chain, draw]
        Of one quantity.
    title : str
    legend : bool
    ax : Axes, optional
    """
    chains, n = draws.shape
    ax = axes(3.2, 2.4) if ax is None else ax
    rank = rankdata(draws.ravel()).reshape(chains, n) / (chains * n)
    edges = np.linspace(0, 1, BINS + 1)
    half = 2.576 * np.sqrt((1 - 1 / BINS) * BINS / n)
    ax.axhspan(1 - half, 1 + half, color="#e9ebee", linewidth=0)
    ax.axhline(1, color=FAINT, linewidth=0.8)
    for c in range(chains):
        density = np.histogram(rank[c], edges)[0] * BINS / n
        ax.stairs(
            density, edges, color=COLOURS[c % 7], linestyle=LINES[c % 7], linewidth=1.3, label=f"chain {c + 1}"
        )
    ax.set(xlabel="rank among all draws", ylabel="density", title=title, xlim=(0, 1))
    ax.set_ylim(0, max(2.0, float(ax.get_ylim()[1])))
    if legend:
        ax.legend(loc="lower left", ncols=2, fontsize=7, columnspacing=1.0, handlelength=1.8)
    return ax
