"""Plots of solutions: the gap over time, and what is done across beliefs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import NullFormatter

from analysis.figures.axis_names import REWARD, with_unit
from analysis.figures.several import Panels, panels, words_below
from analysis.figures.style import COLOURS, INK, LINES, MARKERS, RULE, axes, short_state, spoken, styled

if TYPE_CHECKING:
    from models.planning.solution import Solution

HATCHES = ("", "////", "....", "xxxx", "\\\\\\\\", "----")
"""Actions are told apart without colour too."""

SMALLEST_GAP, SHORTEST = 1e-12, 1e-4
"""Gaps and seconds are drawn at no less: both axes are logarithmic."""


@styled
def gap_over_time(solutions: Mapping[str, Solution], *, ax: Axes | None = None) -> Axes:
    """Draw the gap between the bounds of each solution, relative to their size, over the seconds of work.

    Parameters
    ----------
    solutions : mapping of name to Solution
    ax : Axes, optional
    """
    ax = axes(5.6, 3.4) if ax is None else ax
    for i, (name, solution) in enumerate(solutions.items()):
        seconds = np.maximum([p.seconds for p in solution.trace], SHORTEST)
        size = np.maximum([max(abs(p.lower), abs(p.upper)) for p in solution.trace], 1e-300)
        gap = np.maximum([p.upper - p.lower for p in solution.trace] / size, SMALLEST_GAP)
        ax.step(
            seconds, gap, where="post", color=COLOURS[i % len(COLOURS)], linestyle=LINES[i % len(LINES)],
            marker=MARKERS[i % len(MARKERS)], markersize=3.5,
            label=f"{name}: {solution.lower:.5g} to {solution.upper:.5g}, {solution.status}",
        )  # fmt: skip
    _powers_of_ten(ax, "x", lambda v: f"{v:g}")
    _powers_of_ten(ax, "y", lambda v: f"{100 * v:g}%")
    ax.set_xlabel(with_unit("time of work", "s"))
    ax.set_ylabel("gap between the bounds,\nrelative to the value")
    ax.grid(axis="y")
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.2)
    return ax


def _powers_of_ten(ax: Axes, which: Literal["x", "y"], write: Callable[[float], str]) -> None:
    """Make an axis logarithmic from one power of ten to another, in plain figures: the style turns mathtext off."""
    ax.set(**{f"{which}scale": "log"})
    low, high = ax.dataLim.intervalx if which == "x" else ax.dataLim.intervaly
    first, last = np.floor(np.log10(low)), np.ceil(np.log10(high))
    powers = np.arange(first, max(last, first + 1) + 1)
    axis = ax.xaxis if which == "x" else ax.yaxis
    ax.set(**{f"{which}lim": (10.0 ** powers[0], 10.0 ** powers[-1])})
    axis.set_ticks(10.0**powers, [write(10.0**p) for p in powers])
    axis.set_minor_formatter(NullFormatter())


@styled
def value_slices(solution: Solution, *, points: int = 60, ax: Any = None) -> Panels:
    """Draw value and action over a walk through the belief simplex, from each hidden state to the next.

    One panel a mode: the policy's value (lower bound), and below it what the policy does, looking one step
    ahead.

    Parameters
    ----------
    solution : Solution
    points : int
        Beliefs between two states.
    ax : array of Axes, shape [modes with a choice], optional

    Raises
    ------
    InputError
        If what is given as `ax` has another shape.
    """
    problem = solution.problem
    shown = [x for x in range(problem.n_modes) if (solution.mode == x).any()]
    made, own_figure = panels("value slices", ax, (len(shown),), (max(4.6, 3.4 * len(shown)), 3.3))
    for place, (one, x) in enumerate(zip(made, shown, strict=True)):
        n = len(problem.states[x])
        corners = np.eye(n)
        share = np.linspace(0, 1, points, endpoint=False)[:, None]
        walk = np.concatenate([np.empty((0, n)), *((1 - share) * a + share * b for a, b in pairwise(corners))])
        walk = np.concatenate([walk, corners[-1:]])
        at = np.arange(len(walk)) / points
        own = np.flatnonzero(solution.mode == x)
        worth = walk @ solution.alpha[own, :n].T
        one.plot(at, worth.max(axis=1), color=INK, linewidth=1.8)
        chosen = solution.policy.choose_many(walk, x)
        names = [spoken(c.action) for c in problem.choices[x]]
        low, high = worth.max(axis=1).min(), worth.max(axis=1).max()
        span = (high - low) or 1.0
        strip, height = low - 0.20 * span, 0.14 * span
        edges = np.flatnonzero(np.diff(chosen)) + 1
        for a, b in zip(np.r_[0, edges], np.r_[edges, len(at)], strict=True):
            end = at[b] if b < len(at) else at[-1]
            wide = max(end - at[a], 1e-9)
            one.add_patch(Rectangle((at[a], strip), wide, height, edgecolor="white", **_look(int(chosen[a]))))
            if wide / max(at[-1], 1e-9) > 0.022 * len(names[chosen[a]]):
                box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "boxstyle": "round,pad=0.12"}
                one.text(at[a] + wide / 2, strip + height / 2, names[chosen[a]], ha="center", va="center",
                        fontsize=8, bbox=box)  # fmt: skip
        one.set_ylim(strip - 0.05 * span, high + 0.08 * span)
        one.set_xticks(range(n), [short_state(s, i).replace(" ", "\n") for i, s in enumerate(problem.states[x])])
        for i in range(n):
            one.axvline(i, color=RULE, linewidth=0.8, zorder=0)
        one.set_title(spoken(problem.modes[x]), pad=22)
        one.set_ylabel(with_unit("value", REWARD) if place == 0 else "")
        legend = [Patch(edgecolor="white", label=names[c], **_look(int(c))) for c in np.unique(chosen)]
        one.legend(
            handles=legend, loc="lower left", bbox_to_anchor=(-0.02, 0.99), borderaxespad=0.2, ncols=4,
            handlelength=1.4, columnspacing=1.2,
        )  # fmt: skip
    words_below(made, own_figure, "belief, moving from certainty of one state to certainty of the next")
    return made


def _look(choice: int) -> dict[str, Any]:
    """How an action is filled."""
    return {"facecolor": (COLOURS[choice % len(COLOURS)], 0.55), "hatch": HATCHES[choice % len(HATCHES)]}
