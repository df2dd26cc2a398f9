"""Plot of critical values: where a decision flips as one number moves."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes

from analysis.figures.axis_names import REWARD, with_unit
from analysis.figures.style import COLOURS, LINES, MARKERS, RULE, axes, spoken, styled
from models.errors import located
from models.sensitivity.reward_grid import ENOUGH, evenly, of_draws

if TYPE_CHECKING:
    from models.sensitivity.flips import Flips

READING_LABELS = {
    "infinite": "no horizon",
    "two-step": "two steps",
    "two-step-terminal": "two steps, then rewarded",
}
"""Readings in legends and headings."""


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
    ax = axes(4.6, 3.4) if ax is None else ax
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
        never = of_draws(max(0.0, 1 - total), n, evenly(flips.weight))
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
        ax.set_ylabel("share of draws that have flipped")
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
        return with_unit("steepness r", "per token")
    if name.startswith("cost_"):
        return with_unit(f"cost of {spoken(name.removeprefix('cost_'))}", REWARD)
    if name.startswith("x_"):
        return with_unit(f"score of state {name.removeprefix('x_')}", "tokens a round")
    return name
