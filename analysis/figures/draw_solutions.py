"""Plots of many draws solved: how stable decisions are over the belief simplex, and how values spread."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import PercentFormatter
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from analysis.figures.axis_names import REWARD, with_unit
from analysis.figures.several import Panels, panels, words_below
from analysis.figures.style import (
    COLOURS,
    FAINT,
    INK,
    LINES,
    MARKERS,
    RULE,
    SEQUENTIAL,
    axes,
    short_state,
    spoken,
    styled,
)
from models.errors import Phrase, located

if TYPE_CHECKING:
    from models.robust.belief_stability import BeliefStability
    from models.robust.controller_pool import ControllerPool
    from models.robust.history_stability import HistoryStability
    from models.robust.wider_solution import WideSolution

LEVELS = np.linspace(0, 1, 11)
"""Steps of the share in colour."""

FACES = 4
"""Triangles a mode at most; with more states the one of the first, middle and last is drawn."""

STEPS = 200
"""Steps that a curve over draws is drawn with at most."""


@styled
def stability_map(
    solution: WideSolution, *, points: int = 20, faces: Sequence[tuple[int, int, int]] | None = None,
    ax: Any = None,
) -> Panels:  # fmt: skip
    """Draw the share of draws that prefer an active action, over beliefs about three states at a time.

    One row a mode that leaves a choice; each triangle has certainty of one state in every corner. Undecided draws
    are split equally. The dark line is where the draws are split in half.

    Parameters
    ----------
    solution : WideSolution
        Of at least three states; the corners are far from the start, so solutions from there are needed.
    points : int
        Steps along an edge.
    faces : sequence of three state numbers, optional
        All faces of the simplex by default, if there are few.
    ax : array of Axes, shape [modes with a choice, faces], optional

    Raises
    ------
    InputError
        If the draws were solved from their start only, or what is given as `ax` has another shape.
    """
    from models.robust.belief_stability import belief_stability, face_grid

    _check_wide(solution)
    draws = solution.batch.draws
    n, names = draws.n_states, draws.model(0).state_names
    if faces is None:
        every = list(combinations(range(n), 3))
        faces = every if len(every) <= FACES else [(0, n // 2, n - 1)]
    modes = [x for x, mode in enumerate(draws.protocol.modes) if len(mode.actions) > 1]
    size = 1.2 + 1.75 * len(faces), 0.5 + 1.8 * len(modes)
    grid, _ = panels("stability map", ax, (len(modes), len(faces)), size)
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.5, np.sqrt(0.75)]])
    filled = None
    for row, x in enumerate(modes):
        for column, face in enumerate(faces):
            ax = grid[row, column]
            beliefs = face_grid(n, face, points)
            share = active_share(belief_stability(solution, beliefs, x), draws.protocol.modes[x].null_action)
            at = beliefs[:, list(face)] @ corners
            shape = Triangulation(at[:, 0], at[:, 1])
            filled = ax.tricontourf(shape, np.clip(share, 0, 1), levels=LEVELS, cmap=SEQUENTIAL)
            if share.min() < 0.5 < share.max():
                ax.tricontour(shape, share, levels=[0.5], colors=[INK], linewidths=1.4)
            ax.fill(*corners.T, fill=False, edgecolor=FAINT, linewidth=0.9)
            for k, (state, place) in enumerate(zip(face, corners, strict=True)):
                ax.text(
                    place[0], place[1] + (0.05 if k == 2 else -0.05), short_state(names[state], state),
                    ha="center", va="bottom" if k == 2 else "top", fontsize=7.5,
                )  # fmt: skip
            ax.set_aspect("equal")
            ax.set_axis_off()
            ax.set(xlim=(-0.16, 1.16), ylim=(-0.16, 1.05))
        active = [a.name for a in draws.protocol.modes[x].actions if a.name != draws.protocol.modes[x].null_action]
        grid[row, 0].set_title(" or ".join(map(spoken, active)), pad=8)
    if filled is not None:
        bar = (
            grid[0, 0]
            .get_figure()
            .colorbar(filled, ax=list(grid.flat), shrink=0.75, aspect=22, pad=0.02, ticks=[0, 0.25, 0.5, 0.75, 1])
        )
        bar.ax.yaxis.set_major_formatter(PercentFormatter(1))
        bar.set_label("share of draws that prefer it")
        bar.outline.set_visible(False)
    return grid


@styled
def stability_walk(solution: WideSolution, *, points: int = 40, ax: Any = None) -> Panels:
    """Draw what draws prefer and what each action loses, over a walk from each state to the next.

    One column a mode that leaves a choice. Above, the share of draws that prefer an active action; the band over it
    is the share whose actions differ by no more than the gap between their bounds. Below, what each action loses in
    the mean against the draw's best one.

    Parameters
    ----------
    solution : WideSolution
        As for `stability_map`.
    points : int
        Beliefs between two states.
    ax : array of Axes, shape [2, modes with a choice], optional

    Raises
    ------
    InputError
        If the draws were solved from their start only, or what is given as `ax` has another shape.
    """
    from models.robust.belief_stability import belief_stability, edge_walk

    _check_wide(solution)
    draws = solution.batch.draws
    n, names = draws.n_states, draws.model(0).state_names
    modes = [x for x, mode in enumerate(draws.protocol.modes) if len(mode.actions) > 1]
    size = max(4.2, 3.5 * len(modes)), 4.6
    grid, own = panels("stability walk", ax, (2, len(modes)), size, sharex=True, sharey="row")
    walk = edge_walk(n, points)
    at = np.arange(len(walk)) / points
    for place, x in enumerate(modes):
        top, below = grid[:, place]
        mode = draws.protocol.modes[x]
        found = belief_stability(solution, walk, x)
        active = [c for c, a in enumerate(mode.actions) if a.name != mode.null_action]
        share = found.share[:, active].sum(axis=1)
        label = " or ".join(spoken(mode.actions[c].name) for c in active)
        top.fill_between(
            at, share, share + found.undecided, color=COLOURS[0], alpha=0.25, linewidth=0, label="undecided"
        )
        top.plot(at, share, color=COLOURS[0], label=f"prefer {label}")
        top.set_ylim(-0.02, 1.02)
        top.yaxis.set_major_formatter(PercentFormatter(1))
        top.set_title(spoken(mode.name), pad=20)
        for c, action in enumerate(mode.actions):
            look = {"color": COLOURS[1 + c % 6], "linestyle": LINES[c % len(LINES)]}
            below.plot(at, found.loss[:, c], label=spoken(action.name), **look)
        below.set_xticks(range(n), [short_state(s, i).replace(" ", "\n") for i, s in enumerate(names)])
        for panel in (top, below):
            panel.grid(axis="y")
            for i in range(n):
                panel.axvline(i, color=RULE, linewidth=0.8, zorder=0)
            panel.legend(loc="lower left", bbox_to_anchor=(-0.02, 0.98), borderaxespad=0.2, ncols=3,
                         columnspacing=1.2)  # fmt: skip
    # After all panels of the row, which share their scale.
    most = max(below.get_ylim()[1] for below in grid[1])
    for below in grid[1]:
        below.set_ylim(0, most)
    grid[0, 0].set_ylabel("share of draws")
    grid[1, 0].set_ylabel(with_unit("expected loss", REWARD, lines=True))
    words_below(grid, own, "belief, moving from certainty of one state to certainty of the next")
    return grid


@styled
def stability_along(found: HistoryStability, *, ax: Axes | None = None) -> Axes:
    """Draw what draws prefer after every history of a study: one dot a history, larger the more probable it is.

    Height is the share of draws that prefer an active action, undecided draws split equally; lines go through the
    means over histories.

    Parameters
    ----------
    found : HistoryStability
    ax : Axes, optional
    """
    ax = axes(0.65 * len(found.events) + 1.6, 3.0) if ax is None else ax
    modes = list(dict.fromkeys(e.stability.mode for e in found.events))
    for i, mode in enumerate(modes):
        events = [e for e in found.events if e.stability.mode == mode]
        null = found.null_actions[mode]
        colour, marker = COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]
        means, active = [], [spoken(a) for a in events[0].stability.actions if a != null]
        for e in events:
            share, p = active_share(e.stability, null), e.probability / e.probability.sum()
            means.append(float(p @ share))
            ax.scatter(np.full(len(p), e.event + 1), share, s=8 + 220 * p, color=colour, alpha=0.45, linewidths=0,
                       marker=marker)  # fmt: skip
        label = f"{' or '.join(active)} ({spoken(mode)})" if active else f"no choice ({spoken(mode)})"
        ax.plot([e.event + 1 for e in events], means, color=colour, linestyle=LINES[i % len(LINES)], marker=marker,
                markersize=3.5, label=label)  # fmt: skip
    ax.axhline(0.5, color=RULE, linewidth=0.8, zorder=0)
    ax.set_ylim(-0.04, 1.04)
    ax.yaxis.set_major_formatter(PercentFormatter(1))
    ax.set_xticks([e.event + 1 for e in found.events], [f"{k + 1}\n{c}" for k, c in enumerate(found.letters)])
    ax.set(xlabel="event and mode", ylabel="share of draws that prefer it")
    ax.grid(axis="y")
    # Side by side where the figure is wide enough for it.
    columns = len(modes) if len(found.events) > 6 else 1
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.2, ncols=columns)
    return ax


@styled
def value_distribution(
    pool: ControllerPool, controllers: Sequence[str] | None = None, *, ax: Axes | None = None
) -> Axes:
    """Draw how values spread over the draws: what each draw offers at most, and what single controllers get.

    Every curve is a share of the draws, by weight, that are worth less; dots are means.

    Parameters
    ----------
    pool : ControllerPool
    controllers : sequence of str, optional
        Names; the best one in the mean, and the baselines that are there, by default.
    ax : Axes, optional
    """
    ax = axes(6.6, 3.4) if ax is None else ax
    if controllers is None:
        usual = [b for b in ("never", "always", "reactive") if b in pool.names]
        controllers = list(dict.fromkeys([pool.names[pool.best], *usual]))
    rows = [("optimum of each draw, upper bound", pool.upper)]
    best = pool.names[pool.best]
    shown = {name: f"{name} (best in the mean)" if name == best else name for name in controllers}
    rows += [(shown[name], pool.values[pool.number(name)]) for name in controllers]
    for i, (name, values) in enumerate(rows):
        colour = COLOURS[i % len(COLOURS)]
        order = np.argsort(values)
        share = np.cumsum(pool.weight[order])
        mean = float(pool.weight @ values)
        keep = np.unique(np.linspace(0, len(order) - 1, min(len(order), STEPS)).astype(int))
        ax.step(values[order][keep], share[keep], where="post", color=colour, linestyle=LINES[i % len(LINES)],
                label=f"{name}: {mean:.4g}")  # fmt: skip
        ax.plot([mean], [np.interp(mean, values[order], share)], "o", color=colour, markersize=4.5)
    ax.set_ylim(0, 1)
    ax.yaxis.set_major_formatter(PercentFormatter(1))
    ax.set_xlabel(with_unit("value without horizon", REWARD))
    ax.set_ylabel("share of draws below")
    ax.grid(axis="y")
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.2, ncols=2, title="mean", alignment="left")
    return ax


def _check_wide(solution: WideSolution) -> None:
    """Refuse draws that were solved from their start only: elsewhere their vectors may be poor."""
    from models.robust.wider_solution import WideSolution

    if not isinstance(solution, WideSolution):
        found = Phrase("draws solved from their start only")
        raise located(
            "decisions over the simplex, solution", found, "one from models.robust.wider_solution.widened"
        )


def active_share(stability: BeliefStability, null_action: str) -> NDArray[np.float64]:
    """Share of the draws that prefer any but the null action, undecided ones split equally, shape ``[g]``."""
    return 1.0 - stability.leaning[:, stability.actions.index(null_action)]
