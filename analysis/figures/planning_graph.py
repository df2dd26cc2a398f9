"""The policy graph: what the robot does, and where each response takes it, without any belief to compute.

One row of boxes a mode, and from left to right how prosocial the robot takes the person to be.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import FancyArrowPatch, FancyBboxPatch

from analysis.figures.style import COLOURS, FAINT, INK, LINES, axes, spoken, styled

if TYPE_CHECKING:
    from analysis.policy_graph import Arrow, PolicyGraph

MOST_NODES = 6
"""Boxes in a row that still can be read."""

COLUMN, ROW = 1.32, 1.55
"""Inches between the centres of boxes."""

_WIDTH, _HEIGHT = 0.86, 0.30
"""Size of a box, in columns and rows."""

_EITHER = "whatever comes"

RESPONSE_COLOURS = COLOURS[3:4] + COLOURS[2:3] + COLOURS[4:]
"""Not those of the first two actions."""


@styled
def policy_graph(graph: PolicyGraph, *, most: int = MOST_NODES, ax: Axes | None = None) -> Axes:
    """Boxes are what the robot does, arrows what it does next, by the response that came.

    Below each action stand the share of the discounted time and the expected state of the person. The boxes in
    which the robot spends most of the time are drawn; arrows to others end in a dot.

    Parameters
    ----------
    graph : PolicyGraph
    most : int
        Boxes of one mode that are drawn at most.
    ax : Axes, optional
    """
    drawn = graph.busiest(most)
    words, controller = graph.controller.vocabulary, graph.controller
    modes = [x for x in range(len(words.modes)) if np.any(controller.mode[drawn] == x)]
    rows = {x: [int(n) for n in drawn if controller.mode[n] == x] for x in modes}
    columns = max(map(len, rows.values()))
    at: dict[int, tuple[float, float]] = {}
    for r, x in enumerate(modes):
        rows[x].sort(key=lambda n: graph.expected_state[n])
        # Shorter rows are centred: an arrow then leans towards the state it leads to.
        first = (columns - len(rows[x])) / 2
        at |= {n: (first + i, float(len(modes) - 1 - r)) for i, n in enumerate(rows[x])}
    ax = axes(COLUMN * columns + 1.5, ROW * len(modes) + 0.1) if ax is None else ax
    boxes = {n: _box(ax, graph, n, at[n]) for n in at}
    looks: dict[str, dict[str, Any]] = {}
    for n in at:
        for target, seen, chance in _joined(graph.follows[n]):
            look = looks.setdefault(seen, _look(seen, words.observations))
            if target in at:
                _arrow(ax, at[n], at[target], boxes[n], boxes[target], chance, look)
            else:
                _stub(ax, at[n], len(modes), look)
    for n in graph.starts:
        left, middle = at[n]
        side = 1 if middle == len(modes) - 1 else -1
        ax.annotate(
            "start", (left - 0.25, middle + side * _HEIGHT / 2),
            xytext=(left - 0.25, middle + side * (_HEIGHT / 2 + 0.22)), ha="center", va="center", fontsize=8,
            color=INK, arrowprops={"arrowstyle": "-|>", "color": INK, "shrinkB": 1, "shrinkA": 0},
        )  # fmt: skip
    for r, x in enumerate(modes):
        ax.text(-0.62, len(modes) - 1 - r, spoken(words.modes[x]).replace(" ", "\n"), ha="right", va="center",
                fontsize=8.5, weight="bold")  # fmt: skip
    order = [*reversed(words.observations), _EITHER]
    handles = [Line2D([], [], label=spoken(seen), **looks[seen]) for seen in order if seen in looks]
    ax.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=len(handles), borderaxespad=0.1)
    ax.set_xlim(-1.25, columns - 0.4)
    # Room for the start, and for arrows that stay in a row.
    level = any(at[n][1] == at[a.node][1] for n in at for a in graph.follows[n] if a.node in at)
    begun = {at[n][1] for n in graph.starts}
    low, high = (0.5 if level or y in begun else 0.36 for y in (0.0, len(modes) - 1.0))
    ax.set_ylim(-low, len(modes) - 1 + high)
    ax.axis("off")
    return ax


def _box(ax: Axes, graph: PolicyGraph, node: int, centre: tuple[float, float]) -> FancyBboxPatch:
    controller = graph.controller
    choice, mode = int(controller.choice[node]), int(controller.mode[node])
    action = spoken(controller.vocabulary.actions[mode][choice])
    colour = COLOURS[choice % len(COLOURS)]
    x, y = centre
    box = FancyBboxPatch(
        (x - _WIDTH / 2, y - _HEIGHT / 2), _WIDTH, _HEIGHT, boxstyle="round,pad=0,rounding_size=0.09",
        facecolor=(colour, 0.16), edgecolor=colour, linewidth=1.4, zorder=4, mutation_aspect=COLUMN / ROW,
    )  # fmt: skip
    ax.add_patch(box)
    ax.text(x, y + 0.045, action, ha="center", va="center", fontsize=9, weight="bold", zorder=5)
    detail = f"{_percent(graph.share[node])}, state {graph.expected_state[node]:.1f}"
    ax.text(x, y - 0.078, detail, ha="center", va="center", fontsize=7, color=FAINT, zorder=5)
    return box


def _joined(arrows: Sequence[Arrow]) -> Iterator[tuple[int, str, float]]:
    """Arrows of a box: target, what was seen, chance. Where what is seen does not matter they are one."""
    for mode in dict.fromkeys(a.mode for a in arrows):
        own = [a for a in arrows if a.mode == mode]
        if len({a.node for a in own}) == 1:
            yield own[0].node, _EITHER, sum(a.chance for a in own)
        else:
            yield from ((a.node, a.observation, a.chance) for a in own)


def _look(seen: str, observations: Sequence[str]) -> dict[str, Any]:
    """Lines tell responses apart by colour and dashes, the last one solid; grey where they make no difference."""
    if seen == _EITHER:
        return {"color": FAINT, "linestyle": "-"}
    place = len(observations) - 1 - observations.index(seen)
    return {"color": RESPONSE_COLOURS[place % len(RESPONSE_COLOURS)], "linestyle": LINES[place % len(LINES)]}


def _arrow(
    ax: Axes, start: tuple[float, float], end: tuple[float, float], box: FancyBboxPatch, into: FancyBboxPatch,
    chance: float, look: Mapping[str, Any],
) -> None:  # fmt: skip
    (x0, y0), (x1, y1) = start, end
    style = "-|>,head_length=4.5,head_width=2.4"
    common: dict[str, Any] = {"arrowstyle": style, "linewidth": 0.7 + 1.3 * chance, "zorder": 3, **look}
    if start == end:
        side = _HEIGHT / 2
        ends = (x0 + 0.12, y0 + side), (x0 + 0.36, y0 + side)
        ax.add_patch(FancyArrowPatch(*ends, connectionstyle="arc3,rad=-1.6", **common))
    elif y0 == y1:
        # Over the boxes between, the higher the farther.
        up = 1 if x1 > x0 else -1
        ends = (x0 + 0.2 * up, y0 + up * _HEIGHT / 2), (x1 - 0.2 * up, y1 + up * _HEIGHT / 2)
        bend = -0.35 / max(1.0, abs(x1 - x0) ** 0.5)
        ax.add_patch(FancyArrowPatch(*ends, connectionstyle=f"arc3,rad={bend}", **common))
    else:
        ax.add_patch(
            FancyArrowPatch(start, end, patchA=box, patchB=into, shrinkA=1, shrinkB=1.5,
                            connectionstyle="arc3,rad=0.10", **common)
        )  # fmt: skip


def _stub(ax: Axes, start: tuple[float, float], rows: int, look: Mapping[str, Any]) -> None:
    """An arrow to a box that is not drawn."""
    x, y = start
    side = 1 if y == rows - 1 else -1
    top = y + side * (_HEIGHT / 2 + 0.16)
    ax.plot([x + 0.3, x + 0.36], [y + side * _HEIGHT / 2, top], linewidth=1.0, zorder=2, **look)
    ax.plot([x + 0.36], [top], marker="o", markersize=3, color=look["color"], zorder=3)


def _percent(share: float) -> str:
    return "<1%" if 0 < share < 0.005 else f"{share:.0%}"
