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
    ax : Axes, optional
    """
    n = len(table)
    ax = axes(4.4, 2.7) if ax is None else ax
    reach = 0.4
    for i, j in np.ndindex(n, n):
        p = float(table[i, j])
        if i == j or p < DRAWN or evidence.silent:
            continue
        up = j > i
        apex = _arrow(ax, i, j, p)
        reach = max(reach, abs(apex))
        if p >= LABELLED:
            box = {"facecolor": "white", "edgecolor": "none", "boxstyle": "round,pad=0.12"}
            ax.text(
                (i + j) / 2, apex, f"{p:.2f}".lstrip("0"), ha="center", va="center", fontsize=8.5, bbox=box,
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
            ax.text(i, -reach - 0.2, name, ha="center", va="top", fontsize=8, color=FAINT)
    ax.set_xlim(-0.45, n - 0.55)
    ax.set_ylim(-reach - 0.42, reach + 0.15)
    ax.set_aspect("equal")
    ax.axis("off")
    note = f" ({evidence.note})" if evidence.note else ""
    ax.set_title(f"{spoken(action)}{note}")
    return ax


def _short(p: float) -> str:
    return "1" if p > 1 - 1e-6 else "0" if p < 1e-4 else f"{p:.2f}".lstrip("0").replace("1.00", ">.99")


def _arrow(ax: Axes, i: int, j: int, p: float) -> float:
    """Draw one move from circle to circle; returns the height of its apex."""
    side = 1.0 if j > i else -1.0
    dx, dy = RADIUS * np.sin(_RIM), RADIUS * np.cos(_RIM)
    start, end = (i + side * dx, side * dy), (j - side * dx, side * dy)
    ax.add_patch(
        FancyArrowPatch(
            start, end, connectionstyle=f"arc3,rad={-_BEND}", arrowstyle="-|>,head_length=4,head_width=2.2",
            linewidth=0.5 + 4.0 * p, color=COLOURS[0] if side > 0 else COLOURS[1],
            linestyle="-" if side > 0 else (0, (4, 1.2)), shrinkA=0, shrinkB=0,
            alpha=1.0 if p >= LABELLED else 0.55, mutation_scale=1.0 + 0.8 * p, zorder=3,
        )
    )  # fmt: skip
    # A quadratic Bezier passes half way to its control point, which arc3 puts at rad x distance.
    return float(side * (dy + 0.5 * _BEND * abs(end[0] - start[0])))
