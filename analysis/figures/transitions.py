"""Plot of one transition table, which also says which of its rows are knowledge."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from analysis.figures.style import FAINT, GREYS, INK, RULE, SEQUENTIAL, axes, short_state, spoken, styled


@dataclass(frozen=True)
class RowEvidence:
    """What stands behind the rows of one transition table.

    Attributes
    ----------
    silent : bool
        The data say nothing about this table.
    pinned : bool
        It was held fixed.
    visits : float64[s]
        Expected visits to each row; below `weak` a row is marked.
    weak : float
    """

    silent: bool
    pinned: bool
    visits: NDArray[np.float64]
    weak: float

    @property
    def note(self) -> str:
        """Two words for a title; empty for a table that was learned."""
        return "no evidence" if self.silent else "held fixed" if self.pinned else ""


@styled
def transition_table(
    table: NDArray[np.float64],
    state_names: Sequence[str],
    action: str,
    evidence: RowEvidence,
    *,
    ax: Axes | None = None,
) -> Axes:
    r"""Heat map of :math:`T(s' \mid s, a)` with its numbers; rows are the state before, columns after.

    Tables without evidence are hatched and carry no numbers, a table held fixed is grey, and rows that rest on few
    visits have a dagger.

    Parameters
    ----------
    table : float64[s, s']
    state_names : sequence of str
    action : str
    evidence : RowEvidence
    ax : Axes, optional
    """
    n = len(table)
    ax = axes(2.1 + 0.5 * n, 1.2 + 0.4 * n) if ax is None else ax
    colours = GREYS if evidence.pinned else SEQUENTIAL
    labels = [short_state(name, i) for i, name in enumerate(state_names)]
    if evidence.silent:
        ax.add_patch(Rectangle((0, 0), n, n, facecolor="#f4f5f7", hatch="////", edgecolor=FAINT, linewidth=0))
        box = {"facecolor": "white", "edgecolor": RULE, "boxstyle": "round,pad=0.4"}
        ax.text(n / 2, n / 2, "no evidence:\na placeholder", ha="center", va="center", fontsize=8.5, bbox=box)
        ax.set(xlim=(0, n), ylim=(0, n))
    else:
        ax.pcolormesh(table, cmap=colours, vmin=0, vmax=1, edgecolors="white", linewidth=1.5)
        for i, j in np.ndindex(n, n):
            p = float(table[i, j])
            colour = "white" if p > 0.55 else INK
            ax.text(j + 0.5, i + 0.5, _probability(p), ha="center", va="center", fontsize=8.5, color=colour)
        weak = (evidence.visits < evidence.weak) & (not evidence.pinned)
        labels_left = [f"† {label}" if mark else label for label, mark in zip(labels, weak, strict=True)]
        for i in range(n):
            visits = "" if evidence.pinned else f"{evidence.visits[i]:,.1f}"
            ax.text(n + 0.12, i + 0.5, visits, ha="left", va="center", fontsize=7.5, color=FAINT)
        if not evidence.pinned:
            ax.text(n + 0.12, -0.12, "visits", ha="left", va="bottom", fontsize=7.5, color=FAINT)
    slanted = n > 2 and max(map(len, labels)) > 3
    ax.set_xticks(np.arange(n) + 0.5, labels, rotation=30 if slanted else 0, ha="right" if slanted else "center")
    ax.set_yticks(np.arange(n) + 0.5, labels if evidence.silent else labels_left)
    ax.invert_yaxis()
    ax.tick_params(length=0)
    for spine in ax.spines.values():
        spine.set_visible(False)
    note = f" ({evidence.note})" if evidence.note else ""
    ax.set(xlabel="state after", ylabel="state before", title=f"{spoken(action)}{note}")
    return ax


def _probability(value: float) -> str:
    """Two decimals, with exact boundary values told from rounded ones.

    Examples
    --------
    >>> _probability(0.0), _probability(0.002), _probability(0.25), _probability(0.9999)
    ('0', '<.01', '.25', '>.99')
    """
    if value < 1e-4 or value > 1 - 1e-6:
        return f"{round(value)}"
    if value < 0.005:
        return "<.01"
    return ">.99" if value >= 0.995 else f"{value:.2f}".lstrip("0")
