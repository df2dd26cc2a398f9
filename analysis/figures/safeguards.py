"""Plots of safeguards: value against cost, what stricter settings take, and who is influenced."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from analysis.figures.style import COLOURS, FAINT, INK, MARKERS, RULE, axes, spoken, styled

if TYPE_CHECKING:
    from models.planning.budget_plan import BudgetValues
    from models.planning.expected_cost import CostFrontier
    from models.safeguards.influence_report import InfluenceReport
    from models.safeguards.steps import Steps

SAFEGUARD_MARKERS = {"none": "o", "budget": "s", "influence": "^", "confidence": "D", "all together": "X"}
"""How points of a policy are drawn, by what guards it."""


@styled
def value_and_cost(
    frontier: CostFrontier, budgets: BudgetValues, report: InfluenceReport, policies: Sequence[str], *,
    ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """Best values under limits on the cost, and where policies stand with and without safeguards.

    The line is the best value under a limit on the *expected* cost, which is concave; hollow squares are best
    values under hard budgets, which need not be. Points are policies at their expected cost; a thin line leads from
    a policy to what safeguards make of it.

    Parameters
    ----------
    frontier : CostFrontier
    budgets : BudgetValues
    report : InfluenceReport
    policies : sequence of str
        Those that are drawn, up to seven.
    ax : Axes, optional
    """
    ax = axes(6.8, 4.2) if ax is None else ax
    most = max(
        1.0, budgets.enough, frontier.points[-1].cost, *(r.cost for r in report.runs if r.policy in policies)
    )
    cost = [p.cost for p in frontier.points]
    value = [p.value for p in frontier.points]
    ax.plot([*cost, most * 1.03], [*value, value[-1]], color=INK, zorder=2)
    hard = budgets.budgets <= budgets.enough
    ax.plot(
        budgets.budgets[hard], budgets.values[hard], "s", markersize=8, markerfacecolor="white",
        markeredgecolor=INK, zorder=3,
    )  # fmt: skip
    for i, name in enumerate(policies):
        colour, front = COLOURS[i % len(COLOURS)], 5 + len(policies) - i
        bare = report.run(name)
        for run in (r for r in report.runs if r.policy == name):
            way = [bare.cost, run.cost], [bare.value, run.value]
            ax.plot(*way, color=colour, linewidth=0.6, alpha=0.6, zorder=4)
            ax.plot(
                [run.cost], [run.value], marker=SAFEGUARD_MARKERS.get(run.safeguards, "P"), color=colour,
                markersize=6 if run is bare else 4.5, linestyle="", zorder=front,
            )  # fmt: skip
    ax.set_xlabel("expected cost, or limit on it, in the unit of the charges")
    ax.set_ylabel("value, reward units a person")
    ax.grid(axis="both")
    used = dict.fromkeys(r.safeguards for r in report.runs)
    handles: list[Any] = [
        Line2D([], [], color=INK, label="best under an expected cost"),
        Line2D([], [], linestyle="", marker="s", markersize=8, markerfacecolor="white", markeredgecolor=INK,
               label="best under a hard budget"),
    ]  # fmt: skip
    handles += [
        Line2D([], [], color=COLOURS[i % len(COLOURS)], linewidth=3, label=spoken(name))
        for i, name in enumerate(policies)
    ]
    handles += [
        Line2D([], [], linestyle="", marker=SAFEGUARD_MARKERS.get(g, "P"), color=FAINT,
               label="no safeguard" if g == "none" else spoken(g))
        for g in used
    ]  # fmt: skip
    ax.legend(handles=handles, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return ax


@styled
def stricter(steps: Sequence[Steps]) -> Figure:
    """Value lost and influence left as a safeguard is made stricter: exact step functions.

    Parameters
    ----------
    steps : sequence of Steps
    """
    figure = Figure(figsize=(3.4 * len(steps) + 0.2, 3.6), layout="constrained")
    grid: Any = figure.subplots(2, len(steps), squeeze=False, sharex="col")
    for column, s in enumerate(steps):
        top, low = grid[0, column], grid[1, column]
        end = 1.0 if s.setting == "threshold" else float(max(s.levels[-1], 1e-9)) * 1.08
        level = np.append(s.levels, end)
        for ax, values, colour in ((top, s.values[0] - s.values, COLOURS[1]), (low, s.influences, COLOURS[0])):
            ax.step(level, np.append(values, values[-1]), where="post", color=colour)
            ax.set_ylim(bottom=min(0.0, float(values.min())), top=max(float(values.max()) * 1.08, 1e-9))
            ax.grid(axis="y")
        top.set_title(spoken(s.safeguard))
        unit = "probability asked for" if s.setting == "threshold" else "tolerance, reward units a decision"
        low.set_xlabel(unit)
        low.set_xlim(0, end)
    grid[0, 0].set_ylabel("value lost")
    grid[1, 0].set_ylabel("times a person is moved")
    return figure


@styled
def who_is_influenced(report: InfluenceReport, policies: Sequence[str], sets: Sequence[str]) -> Figure:
    """Who is influenced, by starting state and first response, with intervals over the draws.

    Parameters
    ----------
    report : InfluenceReport
    policies : sequence of str
        One panel each.
    sets : sequence of str
        Sets of safeguards that are drawn beside each other.
    """
    kinds = list(dict.fromkeys((row["by"], row["who"]) for row in report.who_rows()))
    figure = Figure(figsize=(1.9 * len(policies) + 1.7, 0.3 * len(kinds) + 1.2), layout="constrained")
    panels: Any = figure.subplots(1, len(policies), squeeze=False, sharex=True, sharey=True)[0]
    rows = {(r["policy"], r["safeguards"], r["by"], r["who"]): r for r in report.who_rows()}
    for ax, name in zip(panels, policies, strict=True):
        for i, safeguards in enumerate(sets):
            shift = 0.18 * (i - (len(sets) - 1) / 2)
            for y, (by, who) in enumerate(kinds):
                row = rows.get((name, safeguards, by, who))
                if row is None:
                    continue
                ax.plot(
                    [row["low"], row["high"]], [y + shift] * 2, color=RULE, linewidth=3.5, solid_capstyle="butt"
                )
                marker, colour = MARKERS[i % len(MARKERS)], COLOURS[i % len(COLOURS)]
                ax.plot(row["influence"], y + shift, marker, color=colour, clip_on=False, zorder=5)
        ax.set_title(spoken(name), fontsize=8.5)
        ax.grid(axis="x")
        ax.tick_params(axis="y", length=0)
    # Once all are drawn: a limit given earlier would keep the first panel's right end for all of them.
    panels[0].set_xlim(left=0)
    panels[0].set_yticks(range(len(kinds)), [f"{spoken(by)} {spoken(who)}".strip() for by, who in kinds])
    panels[0].set_ylim(len(kinds) - 0.5, -0.5)
    panels[len(panels) // 2].set_xlabel("times a person is moved to another state than if left alone")
    handles = [
        Line2D([], [], linestyle="", marker=MARKERS[i % len(MARKERS)], color=COLOURS[i % len(COLOURS)],
               label="no safeguard" if g == "none" else spoken(g))
        for i, g in enumerate(sets)
    ]  # fmt: skip
    figure.legend(handles=handles, loc="outside upper left", ncols=len(handles))
    return figure
