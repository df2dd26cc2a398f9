"""Plots of plans: reward by state, gap over time, what is done across beliefs, where beliefs go."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import FuncFormatter

from analysis.figures.style import COLOURS, FAINT, INK, LINES, MARKERS, RULE, axes, short_state, spoken, styled
from models.reward import Reward

if TYPE_CHECKING:
    from models.planning.solution import Solution

HATCHES = ("", "////", "....", "xxxx", "\\\\\\\\", "----")
"""Actions are told apart without colour too."""


@styled
def reward_curves(
    x: Sequence[float], rs: Sequence[float], state_names: Sequence[str], *, marked: float | None = None,
    ax: Axes | None = None,
) -> Axes:  # fmt: skip
    r"""Draw what each state is worth a round, :math:`\exp(r x_s) - \exp(r x_0)`, for several `r`, as in the paper.

    Parameters
    ----------
    x : sequence of float
        Tokens a round, one a state.
    rs : sequence of float
        Steepness, per token.
    state_names : sequence of str
    marked : float, optional
        The `r` that is used, drawn thicker.
    ax : Axes, optional
    """
    ax = axes(4.6, 3.1) if ax is None else ax
    at = np.arange(len(x))
    for i, r in enumerate(rs):
        values = Reward(tuple(x), r).prosocial()
        ax.plot(at, values, color=COLOURS[i % len(COLOURS)], linestyle=LINES[i % len(LINES)],
                marker=MARKERS[i % len(MARKERS)], linewidth=2.4 if r == marked else 1.3,
                label=f"r = {r:g}" + (" (used)" if r == marked else ""))  # fmt: skip
    ax.set_yscale("symlog", linthresh=1.0)
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.set_xticks(at, [short_state(name, i) for i, name in enumerate(state_names)])
    ax.set_ylabel("reward of the state, reward units")
    ax.grid(axis="y")
    ax.legend()
    return ax


@styled
def gap_over_time(solutions: Mapping[str, Solution], *, ax: Axes | None = None) -> Axes:
    """Draw both bounds of each solution over the seconds of work.

    Parameters
    ----------
    solutions : mapping of name to Solution
    ax : Axes, optional
    """
    ax = axes(5.2, 3.2) if ax is None else ax
    for i, (name, solution) in enumerate(solutions.items()):
        colour = COLOURS[i % len(COLOURS)]
        seconds = np.maximum([p.seconds for p in solution.trace], 1e-4)
        lower, upper = ([getattr(p, which) for p in solution.trace] for which in ("lower", "upper"))
        mark: dict[str, Any] = {"marker": MARKERS[i % len(MARKERS)], "markersize": 3.5}
        ax.step(seconds, upper, where="post", color=colour, linestyle="--", linewidth=1.2, **mark)
        ax.step(seconds, lower, where="post", color=colour, linewidth=1.6, **mark,
                label=f"{name}: {solution.lower:.4g} to {solution.upper:.4g}, {solution.status}")  # fmt: skip
        ax.fill_between(seconds, lower, upper, step="post", color=colour, alpha=0.10, linewidth=0)
    ax.set_xscale("log")
    ax.ticklabel_format(axis="y", useOffset=False)
    ax.set_xlabel("seconds of work")
    ax.set_ylabel("bounds of the optimal value\n(solid lower, dashed upper)")
    ax.grid(axis="y")
    ax.legend(loc="lower right")
    return ax


@styled
def value_slices(solution: Solution, *, points: int = 60) -> Figure:
    """Draw value and action over a walk through the belief simplex, from each hidden state to the next.

    One panel a mode: the policy's value (lower bound), and below it which action the best vector takes.

    Parameters
    ----------
    solution : Solution
    points : int
        Beliefs between two states.
    """
    problem = solution.problem
    shown = [x for x in range(problem.n_modes) if (solution.mode == x).any()]
    figure = Figure(figsize=(max(4.8, 2.9 * len(shown)), 3.0), layout="constrained")
    for place, x in enumerate(shown):
        ax = figure.add_subplot(1, len(shown), place + 1)
        n = len(problem.states[x])
        corners = np.eye(n)
        share = np.linspace(0, 1, points, endpoint=False)[:, None]
        walk = np.concatenate([(1 - share) * a + share * b for a, b in pairwise(corners)])
        walk = np.concatenate([walk, corners[-1:]])
        at = np.arange(len(walk)) / points
        own = np.flatnonzero(solution.mode == x)
        worth = walk @ solution.alpha[own, :n].T
        ax.plot(at, worth.max(axis=1), color=INK, linewidth=1.8)
        chosen = solution.choice[own][worth.argmax(axis=1)]
        names = [c.action for c in problem.choices[x]]
        low, high = worth.max(axis=1).min(), worth.max(axis=1).max()
        span = (high - low) or 1.0
        strip, height = low - 0.16 * span, 0.10 * span
        edges = np.flatnonzero(np.diff(chosen)) + 1
        for a, b in zip(np.r_[0, edges], np.r_[edges, len(at)], strict=True):
            c = int(chosen[a])
            end = at[b] if b < len(at) else at[-1]
            look: dict[str, Any] = {"facecolor": COLOURS[c % len(COLOURS)], "hatch": HATCHES[c % len(HATCHES)]}
            bar = Rectangle((at[a], strip), max(end - at[a], 1e-9), height, alpha=0.55, edgecolor="white", **look)
            ax.add_patch(bar)
        for c in sorted(set(chosen.tolist())):
            ax.plot([], [], color=COLOURS[c % len(COLOURS)], linewidth=6, alpha=0.6, label=spoken(names[c]))
        ax.set_ylim(strip - 0.05 * span, high + 0.08 * span)
        ax.set_xticks(
            range(n), [short_state(s, i) for i, s in enumerate(problem.states[x])], rotation=20, ha="right"
        )
        for i in range(n):
            ax.axvline(i, color=RULE, linewidth=0.8, zorder=0)
        ax.set_title(spoken(problem.modes[x]))
        ax.set_ylabel("value" if place == 0 else "")
        ax.legend(title="action", loc="upper left")
    figure.supxlabel(
        "belief, moving from certainty of one state to certainty of the next", fontsize=8.5, color=FAINT
    )
    return figure
