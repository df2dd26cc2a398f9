"""Plots of plans under doubt: values over draws, plans side by side, caution, and how sure each decision is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from analysis.figures.axis_names import PERSON, SCHEDULE_VALUE, VALUE_OF_SCHEDULE, a_person, with_unit
from analysis.figures.several import Panels, legend_of_all, panels, words_below
from analysis.figures.style import COLOURS, FAINT, INK, LINES, MARKERS, RULE, SEQUENTIAL, axes, spoken, styled

if TYPE_CHECKING:
    from models.robust.frontier import Frontier
    from models.robust.pricing import PriceList
    from models.robust.stability import Stability, Standing

SHOWN = 400
"""Points that a curve over draws is drawn with."""


@styled
def value_distributions(values: Mapping[str, np.ndarray], weight: np.ndarray, *, ax: Axes | None = None) -> Axes:
    """Share of the draws in which something is worth at most so much, one curve each.

    Parameters
    ----------
    values : mapping of name to float64[d]
    weight : float64[d]
    ax : Axes, optional
    """
    ax = axes(6.6, 3.4) if ax is None else ax
    level = np.linspace(0, 1, SHOWN)
    for i, (name, own) in enumerate(values.items()):
        order = np.argsort(own, kind="stable")
        total = np.cumsum(weight[order])
        place = np.minimum(np.searchsorted(total, level), len(order) - 1)
        ax.plot(
            own[order][place], level, color=COLOURS[i % len(COLOURS)], linestyle=LINES[i % len(LINES)],
            label=f"{name}: mean {weight @ own:.4g}",
        )  # fmt: skip
    ax.set_ylim(0, 1)
    ax.set_yticks([0, 0.25, 0.5, 0.75, 1], ["0%", "25%", "50%", "75%", "100%"])
    ax.set_ylabel("share of draws worth at most")
    ax.set_xlabel(VALUE_OF_SCHEDULE)
    ax.grid(axis="both")
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.2, ncols=2)
    return ax


@styled
def plan_comparison(prices: PriceList, *, ax: Axes | None = None) -> Axes:
    """Plans side by side: mean, mean on held-out draws, lower tail, worst draw.

    Parameters
    ----------
    prices : PriceList
    ax : Axes, optional
    """
    shown = sorted(prices.prices, key=lambda p: p.mean)
    ax = axes(6.4, 0.27 * len(shown) + 1.2) if ax is None else ax
    for y, p in enumerate(shown):
        ax.plot([p.worst, p.mean], [y, y], color=RULE, linewidth=4, solid_capstyle="butt", zorder=1)
        ax.plot(p.worst, y, "|", color=FAINT, markersize=9, markeredgewidth=1.6)
        ax.plot(p.cvar, y, "s", color=COLOURS[1], markersize=5)
        ax.plot(p.held_out_mean, y, "D", color=INK, markerfacecolor="white", markersize=7)
        ax.plot(p.mean, y, "o", color=COLOURS[0], markersize=4.5)
    ax.set_yticks(range(len(shown)), [p.name for p in shown])
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(-0.6, len(shown) - 0.4)
    ax.set_xlabel(with_unit(SCHEDULE_VALUE, a_person(prices.schedule.unit)))
    ax.grid(axis="x")
    handles = [
        Line2D([], [], linestyle="", marker="o", color=COLOURS[0], label="mean of the draws"),
        Line2D([], [], linestyle="", marker="D", color=INK, markerfacecolor="white", label="mean, held-out draws"),
        Line2D([], [], linestyle="", marker="s", color=COLOURS[1], label=f"mean of the worst {prices.alpha:.0%}"),
        Line2D([], [], linestyle="", marker="|", color=FAINT, markeredgewidth=1.6, label="worst draw"),
    ]
    ax.legend(handles=handles, loc="lower left", bbox_to_anchor=(-0.1, 1.0), borderaxespad=0.2, ncols=2,
              columnspacing=1.0, handletextpad=0.2)  # fmt: skip
    return ax


@styled
def caution(frontiers: Mapping[str, Frontier], *, ax: Any = None) -> Panels:
    """What caution buys in the tail and costs on average, by how much of the draws counts.

    Parameters
    ----------
    frontiers : mapping of setting to Frontier
        All in one unit.
    ax : array of Axes, shape [2], optional

    Raises
    ------
    InputError
        If what is given as `ax` has another shape.
    """
    made, own = panels("caution", ax, (2,), (6.6, 3.0))
    left, right = made
    handles: list[Any] = []
    for i, (name, found) in enumerate(frontiers.items()):
        rows = found.rows()
        alpha = np.array([r["alpha"] for r in rows])
        best = max(r["mean"] for r in rows)
        style: dict[str, Any] = {"color": COLOURS[i % len(COLOURS)], "linestyle": LINES[i % len(LINES)]}
        style["marker"] = MARKERS[i % len(MARKERS)]
        handles += left.plot(alpha, [r["cvar"] - r["bayes_cvar"] for r in rows], label=name, markersize=4, **style)
        right.plot(alpha, [best - r["mean"] for r in rows], markersize=4, **style)
    for one, title in ((left, "gained in the worst share"), (right, "given up on average")):
        one.set_xscale("log")
        ticks = [1, 0.5, 0.25, 0.1, 0.05, 0.01]
        one.set_xticks(ticks, [f"{100 * t:g}%" for t in ticks])
        one.minorticks_off()
        one.set_title(title)
        one.grid(axis="y")
        one.set_ylim(bottom=min(0.0, one.get_ylim()[0]))
    unit = next((a_person(found.schedule.unit) for found in frontiers.values()), PERSON)
    for one in made[:1] if own else made:
        one.set_ylabel(with_unit("difference in value", unit, lines=True))
    words_below(made, own, "share of the draws that counts (all: the mean; few: caution)")
    legend_of_all(made, own, handles, "outside upper left", ncols=len(frontiers))
    return made


@styled
def stability_tree(found: Stability, *, ax: Axes | None = None) -> Axes:
    """Every decision of a plan along its histories, shaded by the share of the draws that agree.

    Time runs to the right; after an event with a response a history splits, the highest score on top. Frames are
    drawn bold where the plan acts (anything but the null action).

    Parameters
    ----------
    found : Stability
    ax : Axes, optional
    """
    s = found.schedule
    names = s.protocol.response_names
    up = np.argsort(np.argsort(s.protocol.scores, kind="stable"))
    place: dict[tuple[int, tuple[str, ...]], float] = {}
    last = s.n_events - 1
    finest = sum(s.mode(k).shows_response for k in range(last))
    for x in found.standings:
        y, width = 0.0, float(s.protocol.n_responses) ** finest
        for response in x.responses:
            width /= s.protocol.n_responses
            y += (up[names.index(response)] - (s.protocol.n_responses - 1) / 2) * width
        place[(x.event, x.responses)] = y
    height = 1.4 + 0.23 * s.protocol.n_responses**finest
    ax = axes(0.8 * s.n_events + 1.0, min(max(height, 2.4), 9.0)) if ax is None else ax
    norm = Normalize(0.5, 1.0, clip=True)
    half = 0.4
    for x in found.standings:
        y = place[(x.event, x.responses)]
        _edges(ax, x, found, place, half)
        agree = x.share[x.action]
        acts = x.action != s.mode(x.event).null_action
        ax.add_patch(
            Rectangle(
                (x.event - half, y - 0.4), 2 * half, 0.8, facecolor=SEQUENTIAL(norm(agree)),
                edgecolor=INK if acts else FAINT, linewidth=1.8 if acts else 0.6, zorder=3,
            )
        )  # fmt: skip
        dark = norm(agree) > 0.55
        ax.text(x.event, y, f"{_mark(x.action)} {100 * agree:.0f}", ha="center", va="center", fontsize=6.8,
                color="white" if dark else INK, zorder=4)  # fmt: skip
    span = max(abs(v) for v in place.values()) + 0.9
    ax.set_ylim(-span, span)
    ax.set_xlim(-0.6, last + 0.6)
    ax.set_xticks(range(s.n_events), [f"{k + 1}\n{s.mode(k).letter}" for k in range(s.n_events)])
    ax.set_yticks([])
    ax.spines["left"].set_visible(False)
    ax.set_xlabel("event and mode (number: % of the draws that agree with the plan)")
    return ax


def _edges(
    ax: Axes, x: Standing, found: Stability, place: Mapping[tuple[int, tuple[str, ...]], float], half: float
) -> None:
    """Lines to the histories that follow, as wide as they are probable."""
    told = len(x.responses) + found.schedule.mode(x.event).shows_response
    for after in found.standings:
        child = after.event == x.event + 1 and len(after.responses) == told
        if child and after.responses[: len(x.responses)] == x.responses:
            ends = place[(x.event, x.responses)], place[(after.event, after.responses)]
            wide = 0.5 + 4.0 * after.probability
            ax.plot([x.event + half, after.event - half], ends, color=FAINT, zorder=1, linewidth=wide)


def _mark(name: str) -> str:
    """Name of an action, short enough for a box."""
    text = spoken(name)
    return text if len(text) <= 10 else f"{text[:9]}."
