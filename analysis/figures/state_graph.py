"""The state connectivity graph of one action: states from left to right by prosociality, moves as arrows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch
from numpy.typing import NDArray

from analysis.figures.style import COLOURS, FAINT, INK, axes, spoken, styled
from analysis.figures.transitions import RowEvidence

DRAWN, LABELLED = 0.01, 0.05
"""Moves less probable than the first are not drawn, less than the second not labelled."""

RADIUS = 0.3
INCH = 0.98
"""Inches between the centres of neighbouring circles, the same in every graph."""

_BEND = 0.62
_RIM = 0.62
"""Angle (radians from the vertical) at which arrows leave and meet a circle."""


@styled
def state_graph(
    table: NDArray[np.float64],
    state_names: Sequence[str],
    action: str,
    evidence: RowEvidence,
    *,
    farthest: int | None = None,
    ax: Axes | None = None,
) -> Axes:
    """Circles and arrows; the probability to stay stands inside each circle.

    Moves towards more prosocial states bend above the line and are solid, moves back bend below and are dashed;
    the width of an arrow grows with its probability.

    Parameters
    ----------
    table : float64[s, s']
    state_names : sequence of str
    action : str
    evidence : RowEvidence
        Rows without evidence, or with few visits, get a dashed circle.
    farthest : int, optional
        Leave room for moves over this many states, so that graphs side by side compare; all by default.
    ax : Axes, optional
    """
    n = len(table)
    reach = _apex(n - 1 if farthest is None else farthest)
    named = state_names != tuple(f"s{i}" for i in range(n))
    below = reach + (0.5 if named else 0.25)
    ax = axes(INCH * (n + 0.1), INCH * (reach + 0.25 + below) + 0.3) if ax is None else ax
    for i, j in np.ndindex(n, n):
        p = float(table[i, j])
        if i == j or p < DRAWN or evidence.silent:
            continue
        up = j > i
        _arrow(ax, i, j, p)
        if p >= LABELLED:
            box = {"facecolor": "white", "edgecolor": "none", "boxstyle": "round,pad=0.1"}
            # Outside the bend, so that even a short thick arrow stays visible.
            height = (1 if up else -1) * (_apex(abs(i - j)) + 0.1)
            ax.text(
                (i + j) / 2, height, _short(p), ha="center", va="center", fontsize=8.5, bbox=box,
                color=INK, weight="bold" if p >= 0.25 else "normal", zorder=4 + up,
            )  # fmt: skip
    for i, name in enumerate(state_names):
        weak = evidence.silent or (not evidence.pinned and evidence.visits[i] < evidence.weak)
        ax.add_patch(
            Circle((i, 0), RADIUS, facecolor="white", edgecolor=INK, linewidth=1.3, zorder=6,
                   linestyle=(0, (2, 2)) if weak else "-")
        )  # fmt: skip
        ax.text(i, 0.085, f"s{i}", ha="center", va="center", fontsize=10, weight="bold", zorder=7)
        stay = "?" if evidence.silent else f"stay {_short(float(table[i, i]))}"
        ax.text(i, -0.11, stay, ha="center", va="center", fontsize=7, zorder=7)
        if name != f"s{i}":
            ax.text(i, -reach - 0.26, name, ha="center", va="top", fontsize=8, color=FAINT)
    ax.set_xlim(-0.5, n - 0.5)
    ax.set_ylim(-below, reach + 0.25)
    ax.set_aspect("equal")
    ax.axis("off")
    note = f" ({evidence.note})" if evidence.note else ""
    ax.set_title(f"{spoken(action)}{note}")
    return ax


def farthest_move(table: NDArray[np.float64]) -> int:
    """Number of states that the longest drawn move passes over, at least 1."""
    distances = [abs(i - j) for i, j in np.ndindex(table.shape) if table[i, j] >= DRAWN]
    return max([1, *distances])


def _short(p: float) -> str:
    return "1" if p > 1 - 1e-6 else "0" if p < 1e-4 else f"{p:.2f}".lstrip("0").replace("1.00", ">.99")


def _apex(distance: int) -> float:
    """Height of the highest point of an arrow between circles that far apart."""
    span = max(distance, 1) - 2 * RADIUS * np.sin(_RIM)
    # A quadratic Bezier passes half way to its control point, which arc3 puts at rad x distance.
    return float(RADIUS * np.cos(_RIM) + 0.5 * _BEND * span)


def _arrow(ax: Axes, i: int, j: int, p: float) -> None:
    """Draw one move from circle to circle."""
    side = 1.0 if j > i else -1.0
    dx, dy = RADIUS * np.sin(_RIM), RADIUS * np.cos(_RIM)
    start, end = (i + side * dx, side * dy), (j - side * dx, side * dy)
    ax.add_patch(
        FancyArrowPatch(
            start, end, connectionstyle=f"arc3,rad={-_BEND}", arrowstyle="-|>,head_length=4,head_width=2.2",
            linewidth=0.5 + 3.2 * p, color=COLOURS[0] if side > 0 else COLOURS[1],
            linestyle="-" if side > 0 else (0, (4, 1.2)), shrinkA=0, shrinkB=0,
            alpha=1.0 if p >= LABELLED else 0.55, mutation_scale=1.0 + 0.8 * p, zorder=3,
        )
    )  # fmt: skip
