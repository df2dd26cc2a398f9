"""Plots of what decisions depend on: actions over the grid of rewards, shares of draws, and critical values."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch

from analysis.figures.critical_values import READING_LABELS, critical_values
from analysis.figures.reward_cells import (
    OPEN_COLOUR,
    cost_labels,
    counts_draws,
    draw_actions,
    draw_shares,
    initials,
    look_of,
    name_axes,
)
from analysis.figures.style import FAINT, RULE, SEQUENTIAL, axes, figure_of, spoken, styled
from models.sensitivity.reward_grid import ENOUGH, LEANING, UNDECIDED, GridDecisions

__all__ = [
    "READING_LABELS", "action_map", "action_panel", "critical_values", "initials", "share_map", "share_panel",
]  # fmt: skip

GAP = 0.7
"""Between the blocks of a map, in cells."""

COLUMN, STEP = 1.7, 1.6
"""Inches of a column of the legend, and of the words beside a step, which a map of few cells must have room for."""


_Draw = Callable[[Axes, GridDecisions, int, float, float, float], None]


def _one(found: GridDecisions, k: int, r: float, draw: _Draw, ax: Axes | None) -> Axes:
    ax = axes(2.4, 2.3) if ax is None else ax
    draw(ax, found, k, r, 0.0, 0.0)
    for which in (0, 1):
        labels = cost_labels(found, which)
        (ax.set_xticks if which == 0 else ax.set_yticks)(range(len(labels)), labels)
        (ax.set_xlim if which == 0 else ax.set_ylim)(-0.5, len(labels) - 0.5)
    name_axes(ax, found)
    nodes = found.answers.nodes
    ax.set_title(f"step {k}, {spoken(nodes.protocol.modes[nodes.modes[k]].name)}, r = {r:g}")
    return ax


def _all(found: GridDecisions, draw: _Draw, ax: Axes | None) -> Axes:
    """Every step (down) and steepness (across) as blocks of one picture."""
    nodes, steep = found.answers.nodes, sorted(found.grid.r)
    across, up = cost_labels(found, 0), cost_labels(found, 1)
    wide, high = len(across) + GAP, len(up) + GAP
    if ax is None:
        ax = axes(min(1.0 + 0.3 * wide * len(steep), 12.0), 1.0 + max(0.3 * high, STEP) * found.n_steps)
    for k in range(found.n_steps):
        for i, r in enumerate(steep):
            draw(ax, found, k, r, i * wide, -k * high)
        mode = spoken(nodes.protocol.modes[nodes.modes[k]].name)
        ax.text(
            wide * len(steep) - GAP - 0.2, -k * high + (len(up) - 1) / 2, f"step {k}: {mode}", rotation=-90,
            ha="left", va="center", fontsize=7.5,
        )  # fmt: skip
    for i, r in enumerate(steep):
        ax.text(
            i * wide - 0.5, len(up) - 0.35, f"r = {r:g}", ha="left", va="bottom", fontsize=8.5, fontweight="bold"
        )
    ax.set_xticks(
        [i * wide + j for i in range(len(steep)) for j in range(len(across))], across * len(steep), fontsize=7.5
    )
    ax.set_yticks(
        [-k * high + j for k in range(found.n_steps) for j in range(len(up))], up * found.n_steps, fontsize=7.5
    )
    ax.set_xlim(-0.6, wide * len(steep) - GAP + 0.5)
    ax.set_ylim(-high * (found.n_steps - 1) - 0.6, len(up) + 0.5)
    name_axes(ax, found)
    return ax


@styled
def action_panel(found: GridDecisions, k: int, r: float, *, ax: Axes | None = None) -> Axes:
    """What most draws do at one step and steepness, over the costs: colour, hatching and letter say the same.

    Parameters
    ----------
    found : GridDecisions
    k : int
        Step.
    r : float
        One of the grid's.
    ax : Axes, optional

    Raises
    ------
    InputError
        On an `r` that the grid does not have, or more than two costs that are varied.
    """
    return _one(found, k, r, draw_actions, ax)


@styled
def share_panel(found: GridDecisions, k: int, r: float, *, ax: Axes | None = None) -> Axes:
    """Share of the draws that act at one step and steepness, in percent, over the costs.

    Undecided draws count half. Cells in which less than three quarters of the draws agree are crossed out: there it
    is a toss. Fewer than 20 draws are counted instead, and say nothing of tosses.

    Parameters
    ----------
    found : GridDecisions
    k : int
    r : float
    ax : Axes, optional

    Raises
    ------
    InputError
        As `action_panel` does.
    """
    return _one(found, k, r, draw_shares, ax)


@styled
def action_map(found: GridDecisions, *, ax: Axes | None = None) -> Axes:
    """The paper's figure: what is done at each step (down) and each `r` (across) over the costs.

    Parameters
    ----------
    found : GridDecisions
    ax : Axes, optional

    Raises
    ------
    InputError
        If more than two costs are varied.
    """
    ax = _all(found, draw_actions, ax)
    nodes = found.answers.nodes
    # What looks alike and has the same letter, such as doing nothing in every mode, stands in the legend once.
    alike: dict[tuple[str, str, str], list[str]] = {}
    for k in range(found.n_steps):
        names = list(nodes.action_names(k))
        for name in names:
            look = look_of(k, nodes.null_choice(k), names, name)
            own = alike.setdefault((initials(names)[name], look["facecolor"], look["hatch"]), [])
            own += [spoken(name)] * (spoken(name) not in own)
    handles = [
        Patch(edgecolor=FAINT, label=f"{letter}: {', '.join(own)}", facecolor=colour, hatch=hatch)
        for (letter, colour, hatch), own in alike.items()
    ]
    if np.any(found.answers.choice < 0):
        handles.append(Patch(edgecolor=FAINT, label="?: undecided", facecolor=OPEN_COLOUR, hatch="xx"))
    return _with_legend(ax, handles)


@styled
def share_map(found: GridDecisions, *, ax: Axes | None = None) -> Axes:
    """Where a recommendation is knowledge and where it is a toss: share of the draws that act, in every cell.

    Parameters
    ----------
    found : GridDecisions
    ax : Axes, optional

    Raises
    ------
    InputError
        If more than two costs are varied.
    """
    ax = _all(found, draw_shares, ax)
    handles = [
        Patch(facecolor=SEQUENTIAL(v), edgecolor=RULE, label=text)
        for v, text in ((0.0, "no draw acts"), (0.5, "half of the draws"), (1.0, "all draws"))
    ]
    open_cells = bool(np.any(found.answers.choice < 0))
    if found.n_draws >= ENOUGH or open_cells:
        text = f"fewer than {LEANING:.0%} agree: a toss" if found.n_draws >= ENOUGH else UNDECIDED
        handles.append(Patch(facecolor="white", edgecolor=FAINT, hatch="xx", label=text))
    title, n = None, found.n_draws
    if n > 1:
        title = f"how many of {n} draws act" if counts_draws(found) else f"percent of {n:,} draws"
    return _with_legend(ax, handles, title)


def _with_legend(ax: Axes, handles: list[Patch], title: str | None = None) -> Axes:
    # As many columns as the figure is wide enough for: a map of few cells is narrow.
    room = max(1, int(figure_of(ax).get_figwidth() / COLUMN))
    ax.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=min(len(handles), 5, room),
        handlelength=1.8,
        borderaxespad=0.2, title=title, alignment="left",
    )  # fmt: skip
    return ax
