"""Plot of the paper's reward by state: a definition, not data."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes

from analysis.figures.style import COLOURS, LINES, MARKERS, axes, short_state, styled
from models.reward import Reward


@styled
def reward_by_state(
    x: Sequence[float],
    steepness: Sequence[float],
    state_names: Sequence[str],
    *,
    cost: float | None = None,
    ax: Axes | None = None,
) -> Axes:
    r"""Prosocial part of the reward, :math:`\exp(r x_s) - \exp(r x_0)`, one line a steepness r.

    Parameters
    ----------
    x : sequence of float
        Prosocial score of each state, tokens a round.
    steepness : sequence of float
    state_names : sequence of str
    cost : float, optional
        What one costly act costs, drawn for scale.
    ax : Axes, optional
    """
    ax = axes(5.4, 3.3) if ax is None else ax
    position = np.arange(len(x))
    ends = []
    for i, r in enumerate(steepness):
        value = Reward(tuple(x), r).prosocial()
        colour, marker, line = COLOURS[i % 7], MARKERS[i % 7], LINES[i % 7]
        ax.plot(position, value, color=colour, marker=marker, linestyle=line, label=f"{r:g}")
        ends.append(float(value[-1]))
    if cost is not None:
        ax.axhline(cost, color="black", linewidth=0.9, linestyle=(0, (2, 3)))
        ax.annotate(
            f"cost of one act: {cost:g}", (0, cost), xytext=(0, 3), textcoords="offset points", fontsize=8,
            va="bottom",
        )  # fmt: skip
    ticks = [f"{short_state(n, i)}\nx = {v:g}" for i, (n, v) in enumerate(zip(state_names, x, strict=True))]
    ax.set_xticks(position, ticks)
    # Values run from below one to hundreds: linear up to a few acts of helping, logarithmic beyond.
    ax.set_yscale("symlog", linthresh=10, linscale=0.8)
    shown = [v for v in (0, 5, 10, 30, 100, 300, 1000) if v <= 1.5 * max(*ends, 10.0)]
    ax.set_yticks(shown, [f"{v:g}" for v in shown])
    ax.minorticks_off()
    ax.set_ylim(-1, 1.3 * max(ends))
    ax.set(xlabel="latent state and its score x (tokens a round)", ylabel="reward of the state (reward units)")
    ax.legend(title="r (per token)", loc="center left", bbox_to_anchor=(1, 0.5), reverse=True)
    ax.grid(axis="y")
    return ax
