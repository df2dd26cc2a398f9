"""Plots of what decisions depend on: actions over the grid of rewards, shares of draws, and critical values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PatchCollection
from matplotlib.colors import Normalize
from matplotlib.patches import Patch, Rectangle

from analysis.figures.style import COLOURS, FAINT, INK, LINES, MARKERS, RULE, SEQUENTIAL, axes, spoken, styled
from models.errors import located
from models.sensitivity.reward_grid import (
    ENOUGH,
    LEANING,
    UNDECIDED,
    GridDecisions,
    chosen,
    evenly,
    of_draws,
    verdict,
)

if TYPE_CHECKING:
    from models.sensitivity.flips import Flips

OPEN_COLOUR, NULL_COLOUR = "#ffffff", "#eef1f4"

ACTING = ("////", "\\\\\\\\", "----", "||||")
"""Hatching of actions other than the null action."""

READING_LABELS = {
    "infinite": "no horizon",
    "two-step": "two steps",
    "two-step-terminal": "two steps, then rewarded",
}
"""Readings in legends and headings."""

GAP = 0.7
"""Between the blocks of a map, in cells."""


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


def _cells(found: GridDecisions, k: int, r: float) -> list[tuple[float, float, dict[str, float]]]:
    """Column, row and shares of every cell of one step and steepness."""
    nodes, grid = found.answers.nodes, found.grid
    if r not in grid.r:
        raise located("map of a grid, r", r, f"one of {', '.join(f'{v:g}' for v in grid.r)}")
    names = (*nodes.action_names(k), UNDECIDED)
    shares = found.shares(k)
    across, up = _drawn(found)
    out = []
    for g, (own, costs) in enumerate(grid.cells):
        if own == r:
            x = 0 if across is None else sorted(grid.costs[across]).index(costs[across])
            y = 0 if up is None else sorted(grid.costs[up]).index(costs[up])
            out.append((float(x), float(y), dict(zip(names, shares[g].tolist(), strict=True))))
    return out


def _drawn(found: GridDecisions) -> tuple[int | None, int | None]:
    """Which costs lie across and up; a third one cannot be drawn, and is refused."""
    count = len(found.grid.axes)
    if count > 2:
        raise located("map of a grid, costs that are varied", count, "at most two")
    return (0 if count else None), (1 if count > 1 else None)


def _labels(found: GridDecisions, which: int) -> list[str]:
    """Costs across (0) or up (1), rising."""
    axis = _drawn(found)[which]
    return [""] if axis is None else [f"{v:g}" for v in sorted(found.grid.costs[axis])]


def _name_axes(ax: Axes, found: GridDecisions) -> None:
    for which, axis in enumerate(_drawn(found)):
        if axis is not None:
            text = f"cost of {spoken(found.grid.axes[axis].name)}"
            (ax.set_xlabel if which == 0 else ax.set_ylabel)(text)
    ax.tick_params(length=0)
    for side in ("left", "bottom"):
        ax.spines[side].set_visible(False)


def _draw_actions(ax: Axes, found: GridDecisions, k: int, r: float, dx: float, dy: float) -> None:
    """What most draws do: colour, hatching and letter say the same."""
    nodes = found.answers.nodes
    names = list(nodes.action_names(k))
    letters = initials(names)
    cells: dict[str, list[tuple[float, float]]] = {}
    for x, y, shares in _cells(found, k, r):
        cells.setdefault(chosen(shares)[0], []).append((x + dx, y + dy))
    for name, places in cells.items():
        look = _look(k, nodes.null_choice(k), names, name)
        _squares(ax, places, edgecolor="white", linewidth=1.2, **look)
        if look["hatch"]:
            _spots(ax, places)
        for x, y in places:
            ax.text(
                x, y, letters.get(name, "?"), ha="center", va="center", fontsize=8, fontweight="bold", color=INK
            )


def _draw_shares(ax: Axes, found: GridDecisions, k: int, r: float, dx: float, dy: float) -> None:
    """Share of the draws that act; crossed out where it is a toss. Few draws that weigh the same are counted."""
    nodes, whole = found.answers.nodes, found.n_draws if _counts(found) else 100
    null = nodes.action_names(k)[nodes.null_choice(k)]
    norm = Normalize(0.0, 1.0)
    tossed = []
    for x, y, shares in _cells(found, k, r):
        acts = sum(v for name, v in shares.items() if name not in (null, UNDECIDED)) + 0.5 * shares[UNDECIDED]
        toss = verdict(*chosen(shares), found.n_draws) in ("coin toss", UNDECIDED)
        _squares(ax, [(x + dx, y + dy)], facecolor=SEQUENTIAL(norm(acts)), edgecolor=RULE, linewidth=0.8)
        if toss:
            tossed.append((x + dx, y + dy))
        text = f"{round(whole * acts, 1):g}" if whole < 100 else f"{100 * acts:.0f}"
        ax.text(
            x + dx, y + dy, text, ha="center", va="center", fontsize=7,
            color="white" if acts > 0.6 and not toss else INK, zorder=4,
        )  # fmt: skip
    if tossed:
        _squares(ax, tossed, facecolor="none", edgecolor=RULE, linewidth=0.8, hatch="xx", zorder=2)
        _spots(ax, tossed)


def _counts(found: GridDecisions) -> bool:
    """Whether a map of shares counts draws: fewer than `ENOUGH`, all of the same weight."""
    return 1 < found.n_draws < ENOUGH and found.even


def _squares(ax: Axes, places: Sequence[tuple[float, float]], **look: Any) -> None:
    """Cells of a map, all alike: one artist for all of them."""
    patches = [Rectangle((x - 0.5, y - 0.5), 1, 1) for x, y in places]
    ax.add_collection(PatchCollection(patches, **look), autolim=False)


def _spots(ax: Axes, places: Sequence[tuple[float, float]]) -> None:
    """White ground for letters and numbers on hatching."""
    x, y = zip(*places, strict=True)
    ax.scatter(x, y, s=100, color="white", alpha=0.85, linewidths=0, zorder=3)


def _look(k: int, null: int, names: Sequence[str], name: str) -> dict[str, Any]:
    """Colour and hatching of an action of a step: the null action plain, undecided white and crossed."""
    if name not in names:
        return {"facecolor": OPEN_COLOUR, "hatch": "xx"}
    i = names.index(name)
    if i == null:
        return {"facecolor": NULL_COLOUR, "hatch": ""}
    place = k + (i if i < null else i - 1)
    return {"facecolor": COLOURS[(4, 5, 2, 3)[place % 4]], "hatch": ACTING[place % len(ACTING)]}


_Draw = Callable[[Axes, GridDecisions, int, float, float, float], None]


def _one(found: GridDecisions, k: int, r: float, draw: _Draw, ax: Axes | None) -> Axes:
    ax = axes(2.4, 2.3) if ax is None else ax
    draw(ax, found, k, r, 0.0, 0.0)
    for which in (0, 1):
        labels = _labels(found, which)
        (ax.set_xticks if which == 0 else ax.set_yticks)(range(len(labels)), labels)
        (ax.set_xlim if which == 0 else ax.set_ylim)(-0.5, len(labels) - 0.5)
    _name_axes(ax, found)
    nodes = found.answers.nodes
    ax.set_title(f"step {k}, {spoken(nodes.protocol.modes[nodes.modes[k]].name)}, r = {r:g}")
    return ax


def _all(found: GridDecisions, draw: _Draw, ax: Axes | None) -> Axes:
    """Every step (down) and steepness (across) as blocks of one picture."""
    nodes, steep = found.answers.nodes, sorted(found.grid.r)
    across, up = _labels(found, 0), _labels(found, 1)
    wide, high = len(across) + GAP, len(up) + GAP
    if ax is None:
        ax = axes(min(1.0 + 0.3 * wide * len(steep), 12.0), 1.0 + 0.3 * high * found.n_steps)
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
    _name_axes(ax, found)
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
    return _one(found, k, r, _draw_actions, ax)


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
    return _one(found, k, r, _draw_shares, ax)


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
    ax = _all(found, _draw_actions, ax)
    nodes = found.answers.nodes
    # What looks alike and has the same letter, such as doing nothing in every mode, stands in the legend once.
    alike: dict[tuple[str, str, str], list[str]] = {}
    for k in range(found.n_steps):
        names = list(nodes.action_names(k))
        for name in names:
            look = _look(k, nodes.null_choice(k), names, name)
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
    ax = _all(found, _draw_shares, ax)
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
        title = f"how many of {n} draws act" if _counts(found) else f"percent of {n:,} draws"
    return _with_legend(ax, handles, title)


def _with_legend(ax: Axes, handles: list[Patch], title: str | None = None) -> Axes:
    ax.legend(
        handles=handles, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=min(len(handles), 5), handlelength=1.8,
        borderaxespad=0.2, title=title, alignment="left",
    )  # fmt: skip
    return ax


@styled
def critical_values(found: Sequence[Flips], *, ax: Axes | None = None) -> Axes:
    """At which value of a number a decision flips: in which share of the draws it has flipped by then.

    One curve for each reading; the legend says of how many draws, and how many never flip: a curve that ends below
    100% leaves draws without a flip in the range. Fewer than 20 draws have a mark each. A single model has one
    marker a flip, above what it does before and after.

    Parameters
    ----------
    found : sequence of Flips
        Of one number and one step.
    ax : Axes, optional

    Raises
    ------
    InputError
        If they are of different numbers or steps, or none.
    """
    kinds = {(f.parameter, f.step) for f in found}
    if len(kinds) != 1:
        raise located("critical values, numbers and steps", sorted(kinds), "one number and one step")
    ax = axes(4.2, 2.7) if ax is None else ax
    single = all(len(f.weight) == 1 for f in found)
    for i, flips in enumerate(found):
        look: dict[str, Any] = {"color": COLOURS[i % len(COLOURS)]}
        if single:
            _one_model(ax, flips, i, look)
            continue
        has = np.isfinite(flips.first)
        order = np.argsort(flips.first[has])
        share = np.cumsum(flips.weight[has][order])
        start, end = float(flips.scan[0]), float(flips.scan[-1])
        total, n = (float(share[-1]) if len(share) else 0.0), len(flips.weight)
        never = of_draws(1 - total, n, evenly(flips.weight))
        name = READING_LABELS.get(flips.reading, flips.reading)
        ax.step(
            [start, *flips.first[has][order].tolist(), end], [0.0, *share.tolist(), total], where="post",
            linestyle=LINES[i % len(LINES)], label=f"{name}: {never} never flip", **look,
        )  # fmt: skip
        if n < ENOUGH:
            ax.plot(flips.first[has][order], share, MARKERS[i % len(MARKERS)], markersize=5, **look)
    flips = found[0]
    ax.set_xlim(flips.scan[0], flips.scan[-1])
    mode = flips.nodes.protocol.modes[flips.nodes.modes[flips.step]].name
    ax.set_title(f"step {flips.step}, {spoken(mode)}")
    ax.set_xlabel(_parameter_words(flips.parameter))
    ax.grid(axis="both")
    if single:
        ax.set_ylim(-0.6, len(found) - 0.2)
        ax.set_yticks(range(len(found)), [READING_LABELS.get(f.reading, f.reading) for f in found])
        ax.tick_params(axis="y", length=0)
    else:
        ax.set_ylim(0, 1.03)
        ax.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0%", "25%", "50%", "75%", "100%"])
        ax.set_ylabel("draws that have flipped")
        ax.spines[["top", "right"]].set_visible(False)
        ax.legend(
            loc="upper left", bbox_to_anchor=(0, -0.24), fontsize=7.5, borderaxespad=0.1, labelspacing=0.3,
        )  # fmt: skip
    return ax


def _one_model(ax: Axes, flips: Flips, i: int, look: dict[str, Any]) -> None:
    """What one model does on either side of each flip."""
    low, high = float(flips.scan[0]), float(flips.scan[-1])
    ax.plot([low, high], [i, i], color=RULE, linewidth=3, solid_capstyle="butt", zorder=1)
    edges = [low, *np.sort(flips.middle).tolist(), high]
    order = np.argsort(flips.low)
    labels = [int(flips.before[order[0]]), *flips.after[order].tolist()] if len(order) else []
    words = [flips.nodes.words(flips.step, v) for v in labels] or list(flips.always)
    for j, text in enumerate(words):
        ax.text((edges[j] + edges[j + 1]) / 2, i + 0.12, spoken(text), ha="center", va="bottom", fontsize=7.5)
    for value in edges[1:-1]:
        ax.plot(value, i, MARKERS[i % len(MARKERS)], markersize=7, zorder=3, **look)
        ax.annotate(
            f"{value:.4g}", (value, i), (0, -8), textcoords="offset points", ha="center", va="top", fontsize=7.5
        )


def _parameter_words(name: str) -> str:
    if name == "r":
        return "r, steepness of the reward"
    if name.startswith("cost_"):
        return f"cost of {spoken(name.removeprefix('cost_'))}, reward units"
    if name.startswith("x_"):
        return f"score of state {name.removeprefix('x_')}, tokens a round"
    return name
