"""Cells of a map over the grid of rewards: what is decided in them, as colour, hatching and letter."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import Normalize
from matplotlib.patches import Rectangle

from analysis.figures.axis_names import with_unit
from analysis.figures.style import COLOURS, INK, RULE, SEQUENTIAL, spoken
from models.errors import located
from models.sensitivity.reward_grid import ENOUGH, UNDECIDED, GridDecisions, chosen, verdict

OPEN_COLOUR, NULL_COLOUR = "#ffffff", "#eef1f4"

ACTING = ("////", "\\\\\\\\", "----", "||||")
"""Hatching of actions other than the null action."""


def initials(names: Sequence[str]) -> dict[str, str]:
    """Letters for actions: as many of their first ones as tell them apart.

    Examples
    --------
    >>> initials(["no_help", "help"])
    {'no_help': 'N', 'help': 'H'}
    """
    size = 1
    while len({n[:size].upper() for n in names}) < len(names) and size < max(map(len, names)):
        size += 1
    return {n: n[:size].upper() for n in names}


def cells_of(found: GridDecisions, k: int, r: float) -> list[tuple[float, float, dict[str, float]]]:
    """Column, row and shares of every cell of one step and steepness."""
    nodes, grid = found.answers.nodes, found.grid
    if r not in grid.r:
        raise located("map of a grid, r", r, f"one of {', '.join(f'{v:g}' for v in grid.r)}")
    names = (*nodes.action_names(k), UNDECIDED)
    shares = found.shares(k)
    across, up = drawn_costs(found)
    out = []
    for g, (own, costs) in enumerate(grid.cells):
        if own == r:
            x = 0 if across is None else sorted(grid.costs[across]).index(costs[across])
            y = 0 if up is None else sorted(grid.costs[up]).index(costs[up])
            out.append((float(x), float(y), dict(zip(names, shares[g].tolist(), strict=True))))
    return out


def drawn_costs(found: GridDecisions) -> tuple[int | None, int | None]:
    """Which costs lie across and up; a third one cannot be drawn, and is refused."""
    count = len(found.grid.axes)
    if count > 2:
        raise located("map of a grid, costs that are varied", count, "at most two")
    return (0 if count else None), (1 if count > 1 else None)


def cost_labels(found: GridDecisions, which: int) -> list[str]:
    """Costs across (0) or up (1), rising."""
    axis = drawn_costs(found)[which]
    return [""] if axis is None else [f"{v:g}" for v in sorted(found.grid.costs[axis])]


def name_axes(ax: Axes, found: GridDecisions) -> None:
    """Say which cost lies across and which up, in the unit of the reward."""
    for which, axis in enumerate(drawn_costs(found)):
        if axis is not None:
            text = with_unit(f"cost of {spoken(found.grid.axes[axis].name)}", found.grid.base.unit)
            (ax.set_xlabel if which == 0 else ax.set_ylabel)(text)
    ax.tick_params(length=0)
    for side in ("left", "bottom"):
        ax.spines[side].set_visible(False)


def draw_actions(ax: Axes, found: GridDecisions, k: int, r: float, dx: float, dy: float) -> None:
    """What most draws do: colour, hatching and letter say the same."""
    nodes = found.answers.nodes
    names = list(nodes.action_names(k))
    letters = initials(names)
    cells: dict[str, list[tuple[float, float]]] = {}
    for x, y, shares in cells_of(found, k, r):
        cells.setdefault(chosen(shares)[0], []).append((x + dx, y + dy))
    for name, places in cells.items():
        look = look_of(k, nodes.null_choice(k), names, name)
        squares(ax, places, edgecolor="white", linewidth=1.2, **look)
        if look["hatch"]:
            spots(ax, places)
        for x, y in places:
            ax.text(
                x, y, letters.get(name, "?"), ha="center", va="center", fontsize=8, fontweight="bold", color=INK
            )


def draw_shares(ax: Axes, found: GridDecisions, k: int, r: float, dx: float, dy: float) -> None:
    """Share of the draws that act; crossed out where it is a toss. Few draws that weigh the same are counted."""
    nodes, whole = found.answers.nodes, found.n_draws if counts_draws(found) else 100
    null = nodes.action_names(k)[nodes.null_choice(k)]
    norm = Normalize(0.0, 1.0)
    tossed = []
    for x, y, shares in cells_of(found, k, r):
        acts = sum(v for name, v in shares.items() if name not in (null, UNDECIDED)) + 0.5 * shares[UNDECIDED]
        toss = verdict(*chosen(shares), found.n_draws) in ("coin toss", UNDECIDED)
        squares(ax, [(x + dx, y + dy)], facecolor=SEQUENTIAL(norm(acts)), edgecolor=RULE, linewidth=0.8)
        if toss:
            tossed.append((x + dx, y + dy))
        text = f"{round(whole * acts, 1):g}" if whole < 100 else f"{100 * acts:.0f}"
        ax.text(
            x + dx, y + dy, text, ha="center", va="center", fontsize=7,
            color="white" if acts > 0.6 and not toss else INK, zorder=4,
        )  # fmt: skip
    if tossed:
        squares(ax, tossed, facecolor="none", edgecolor=RULE, linewidth=0.8, hatch="xx", zorder=2)
        spots(ax, tossed)


def counts_draws(found: GridDecisions) -> bool:
    """Whether a map of shares counts draws: fewer than `ENOUGH`, all of the same weight."""
    return 1 < found.n_draws < ENOUGH and found.even


def squares(ax: Axes, places: Sequence[tuple[float, float]], **look: Any) -> None:
    """Cells of a map, all alike: one artist for all of them."""
    patches = [Rectangle((x - 0.5, y - 0.5), 1, 1) for x, y in places]
    ax.add_collection(PatchCollection(patches, **look), autolim=False)


def spots(ax: Axes, places: Sequence[tuple[float, float]]) -> None:
    """White ground for letters and numbers on hatching."""
    x, y = zip(*places, strict=True)
    ax.scatter(x, y, s=100, color="white", alpha=0.85, linewidths=0, zorder=3)


def look_of(k: int, null: int, names: Sequence[str], name: str) -> dict[str, Any]:
    """Colour and hatching of an action of a step: the null action plain, undecided white and crossed."""
    if name not in names:
        return {"facecolor": OPEN_COLOUR, "hatch": "xx"}
    i = names.index(name)
    if i == null:
        return {"facecolor": NULL_COLOUR, "hatch": ""}
    place = k + (i if i < null else i - 1)
    return {"facecolor": COLOURS[(4, 5, 2, 3)[place % 4]], "hatch": ACTING[place % len(ACTING)]}
