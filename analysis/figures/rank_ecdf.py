"""Plot of simulation-based calibration: how far ranks of the truths are from uniform, every statistic a line."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import ArrayLike
from scipy import stats

from analysis.figures.style import COLOURS, FAINT, INK, RULE, axes, styled


@styled
def rank_ecdf(
    ranks: Mapping[str, ArrayLike], largest: int, *, level: float, tests: int, title: str = "",
    ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """Draw the share of ranks up to r less what uniform ranks would have, one line a statistic.

    The band is Kolmogorov and Smirnov's for one of `tests` tests at a family-wise `level` (Bonferroni): lines of a
    calibrated posterior leave it, in all panels together, with at most that probability. The line that goes
    farthest is named.

    Parameters
    ----------
    ranks : mapping of statistic to int[study]
        Each in 0..`largest`, one a study.
    largest : int
    level : float
    tests : int
        Lines in all panels that are judged together.
    title : str
    ax : Axes, optional
    """
    ax = axes(4.4, 2.9) if ax is None else ax
    grid = np.arange(-1, largest + 1)
    at = (grid + 1) / (largest + 1)
    sorted_ranks = {name: np.sort(np.asarray(own)) for name, own in ranks.items()}
    studies = len(next(iter(sorted_ranks.values())))
    half = float(stats.kstwo.ppf(1 - level / tests, studies))
    # A distribution function cannot leave [0, 1], so neither can what is left after taking off the diagonal.
    ax.fill_between(at, np.maximum(-half, -at), np.minimum(half, 1 - at), color=RULE, alpha=0.75, linewidth=0)
    curves = {name: np.searchsorted(own, grid, side="right") / studies - at for name, own in sorted_ranks.items()}
    worst = max(curves, key=lambda name: float(np.abs(curves[name]).max()))
    for name, curve in curves.items():
        if name != worst:
            ax.plot(at, curve, color=COLOURS[0], linewidth=0.7, alpha=0.5)
    ax.plot(at, curves[worst], color=COLOURS[1], linewidth=1.6)
    ax.axhline(0, color=FAINT, linewidth=0.8)
    ax.annotate(worst, (0.02, 0.03), xycoords="axes fraction", fontsize=8, color=COLOURS[1])
    ax.set_xlim(0, 1)
    ax.set_ylim(-1.35 * half, 1.35 * half)
    ax.set(xlabel="rank of the truth, as a share", ylabel="share of studies, less uniform", title=title)
    ax.xaxis.label.set_color(INK)
    return ax
