"""Plots of safeguards: value against cost, what stricter settings take, and who is influenced."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from analysis.figures.axis_names import PERSON, with_unit
from analysis.figures.several import Panels, legend_of_all, panels
from analysis.figures.style import COLOURS, FAINT, INK, MARKERS, RULE, axes, spoken, styled

if TYPE_CHECKING:
    from models.planning.budget_plan import BudgetValues
    from models.planning.expected_cost import CostFrontier
    from models.safeguards.influence_report import InfluenceReport
    from models.safeguards.steps import Steps

SAFEGUARD_MARKERS = {"none": "o", "budget": "s", "influence": "^", "confidence": "D", "all together": "X"}
"""How points of a policy are drawn, by what guards it."""

LETTERS = "abcdefg"
"""Of policies, beside their points and in the legend."""


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
        # A letter beside the policy without safeguards: its colour alone is lost in grey print.
        ax.annotate(
            LETTERS[i % len(LETTERS)], (bare.cost, bare.value), xytext=(5, -8), textcoords="offset points",
            fontsize=7.5, color=INK, zorder=front + 1,
        )  # fmt: skip
        for run in (r for r in report.runs if r.policy == name):
            way = [bare.cost, run.cost], [bare.value, run.value]
            ax.plot(*way, color=colour, linewidth=0.6, alpha=0.6, zorder=4)
            ax.plot(
                [run.cost], [run.value], marker=SAFEGUARD_MARKERS.get(run.safeguards, "P"), color=colour,
                markersize=6 if run is bare else 4.5, linestyle="", zorder=front,
            )  # fmt: skip
    ax.set_xlabel(with_unit("expected cost, or limit on it", "unit of the charges"))
    ax.set_ylabel(with_unit("value", PERSON))
    ax.grid(axis="both")
    used = dict.fromkeys(r.safeguards for r in report.runs)
    handles: list[Any] = [
        Line2D([], [], color=INK, label="best under an expected cost"),
        Line2D([], [], linestyle="", marker="s", markersize=8, markerfacecolor="white", markeredgecolor=INK,
               label="best under a hard budget"),
    ]  # fmt: skip
    handles += [
        Line2D(
            [],
            [],
            color=COLOURS[i % len(COLOURS)],
            linewidth=3,
            label=f"{LETTERS[i % len(LETTERS)]}: {spoken(name)}",
        )
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
def stricter(steps: Sequence[Steps], *, ax: Any = None) -> Panels:
    """Value lost and influence left as a safeguard is made stricter: exact step functions.

    Parameters
    ----------
    steps : sequence of Steps
        One column each.
    ax : array of Axes, shape [2, steps], optional

    Raises
    ------
    InputError
        If what is given as `ax` has another shape.
    """
    size = 3.5 * len(steps) + 0.2, 4.8
    grid, _ = panels("stricter safeguards", ax, (2, len(steps)), size, sharex="col")
    for column, s in enumerate(steps):
        top, low = grid[0, column], grid[1, column]
        end = 1.0 if s.setting == "threshold" else float(max(s.levels[-1], 1e-9)) * 1.08
        level = np.append(s.levels, end)
        for ax, values, colour in ((top, s.values[0] - s.values, COLOURS[1]), (low, s.influences, COLOURS[0])):
            ax.step(level, np.append(values, values[-1]), where="post", color=colour)
            ax.set_ylim(bottom=min(0.0, float(values.min())), top=max(float(values.max()) * 1.08, 1e-9))
            ax.grid(axis="y")
        top.set_title(spoken(s.safeguard))
        tolerance = with_unit("tolerance", "reward units a decision")
        low.set_xlabel("probability asked for" if s.setting == "threshold" else tolerance)
        for one in (top, low):
            one.set_xlim(0, end)
    grid[0, 0].set_ylabel(with_unit("value lost", PERSON, lines=True))
    grid[1, 0].set_ylabel("times a person is moved")
    return grid


@styled
def who_is_influenced(
    report: InfluenceReport, policies: Sequence[str], sets: Sequence[str], *, ax: Any = None
) -> Panels:
    """Who is influenced, by starting state and first response, with intervals over the draws.

    Parameters
    ----------
    report : InfluenceReport
    policies : sequence of str
        One panel each.
    sets : sequence of str
        Sets of safeguards that are drawn beside each other.
    ax : array of Axes, shape [policies], optional

    Raises
    ------
    InputError
        If what is given as `ax` has another shape.
    """
    kinds = list(dict.fromkeys((row["by"], row["who"]) for row in report.who_rows()))
    size = 3.8 * len(policies) + 1.8, 0.3 * len(kinds) + 1.3
    made, own = panels("who is influenced", ax, (len(policies),), size, sharex=True, sharey=True)
    rows = {(r["policy"], r["safeguards"], r["by"], r["who"]): r for r in report.who_rows()}
    for one, name in zip(made, policies, strict=True):
        for i, safeguards in enumerate(sets):
            shift = 0.18 * (i - (len(sets) - 1) / 2)
            for y, (by, who) in enumerate(kinds):
                row = rows.get((name, safeguards, by, who))
                if row is None:
                    continue
                one.plot(
                    [row["low"], row["high"]], [y + shift] * 2, color=RULE, linewidth=3.5, solid_capstyle="butt"
                )
                marker, colour = MARKERS[i % len(MARKERS)], COLOURS[i % len(COLOURS)]
                one.plot(row["influence"], y + shift, marker, color=colour, clip_on=False, zorder=5)
        one.set_title(spoken(name), fontsize=8.5)
        one.grid(axis="x")
        one.tick_params(axis="y", length=0)
    # Once all are drawn: a limit given earlier would keep the first panel's right end for all of them.
    most = max(one.get_xlim()[1] for one in made)
    for one in made[:1] if own else made:
        one.set_xlim(0, most)
        one.set_yticks(range(len(kinds)), [f"{spoken(by)} {spoken(who)}".strip() for by, who in kinds])
        one.set_ylim(len(kinds) - 0.5, -0.5)
    middle = made[len(made) // 2 : len(made) // 2 + 1] if own else made
    for one in middle:
        one.set_xlabel(
            "times a person is moved to another state than if left alone" if own else "times a person is moved"
        )
    handles = [
        Line2D([], [], linestyle="", marker=MARKERS[i % len(MARKERS)], color=COLOURS[i % len(COLOURS)],
               label="no safeguard" if g == "none" else spoken(g))
        for i, g in enumerate(sets)
    ]  # fmt: skip
    legend_of_all(made, own, handles, "outside upper left", ncols=len(handles))
    return made
