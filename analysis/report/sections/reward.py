"""Section: what a round is worth: the paper's reward, a definition, or the one stated for this report."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from analysis.figures.reward import reward_by_state
from analysis.figures.style import spoken
from analysis.report.context import ReportContext
from analysis.report.section import Block, Figure, NotSupported, Origin, Table, Text
from analysis.stated_reward import StatedReward, letters_in_words
from models.lspomdp import PUBLISHED_STATE_NAMES
from models.reward import Reward

ACROSS = (
    "Values of models with different numbers of states compare only as far as the same round is worth the same in "
    "each of them."
)


def make(context: ReportContext) -> tuple[Block, ...]:
    """Figure and table of ``exp(r x_s) - exp(r x_0)``, or the table of a stated reward."""
    if context.stated is not None:
        return _stated(context, context.stated)
    if not context.is_published_protocol:
        raise NotSupported(
            "the paper's reward belongs to its own actions and scores; protocol "
            f"{context.protocol.name!r} has others, and no reward was stated (`--values`)"
        )
    printed = context.published["reward"]
    x, cost = tuple(map(float, printed["x"])), float(printed["cost_help"])
    steepness = [float(r) for r in context.published["sensitivity"]["r"]]
    text = (
        "A round in state s is worth exp(r x_s) - exp(r x_0), less the cost of what the robot does; one act of "
        f"helping or signalling costs {cost:g}. The scores x and the published steepness "
        f"r = {printed['r_policy']:g} are printed in the paper; no data of this report enter. Values of models "
        "with different numbers of states are in different currencies."
    )
    values = np.array([Reward(x, r).prosocial() for r in steepness])
    published = values[steepness.index(float(printed["r_policy"]))]
    alt = (
        "Reward of the four states for each steepness r. At the published r they are "
        + ", ".join(f"{v:.1f}" for v in published)
        + f" reward units; at r = {steepness[-1]:g} the highest state is worth {values[-1, -1]:.0f}."
    )
    draw = partial(reward_by_state, x, steepness, PUBLISHED_STATE_NAMES, cost=cost)
    caption = (
        "Reward of each state by steepness r. The axis is linear up to 10 and logarithmic above. The dotted line "
        "is the cost of one act of helping or signalling."
    )
    frame = pd.DataFrame({"state": [f"s{i} {n}" for i, n in enumerate(PUBLISHED_STATE_NAMES)], "x": x})
    for r, value in zip(steepness, values, strict=True):
        frame[f"r = {r:g}"] = value
    table = Table(
        "reward-values", frame, "Reward of each state in reward units, by steepness r",
        (Origin.DEFINITION, Origin.PRINTED), headings={"x": "score x (tokens a round)"},
        formats={"x": "g", **{f"r = {r:g}": ",.2f" for r in steepness}}, printed=("x",),
    )  # fmt: skip
    return (Text(text), Figure("reward-by-state", (draw,), caption, (alt,), (Origin.DEFINITION,)), table)


def _stated(context: ReportContext, stated: StatedReward) -> tuple[Block, ...]:
    """A reward of the report's own: what each state is worth, and what each action costs."""
    origin = (context.origin,) if stated.measured else (Origin.DEFINITION,)
    rows = [
        {"states": k, "state": f"s{s}", "worth": float(value)}
        for k in stated.states
        for s, value in enumerate(stated.rewards[k].prosocial())
    ]
    modes = {a.name: m.name for m in context.protocol.modes for a in m.actions}
    costs = [
        {"action": spoken(name), "mode": spoken(modes[name]), "cost": cost}
        for name, cost in stated.costs(stated.states[0]).items()
    ]
    text = (
        f"{stated.sentence} The plans of this report are made for this reward, over the rounds {stated.schedule} "
        f"({letters_in_words(context.protocol)}). The paper's reward belongs to its own actions and is not used."
    )
    if len(stated.states) > 1:
        text += f" {ACROSS}"
    tables = (
        Table(
            "reward-stated", pd.DataFrame(rows), "What a round with a person in each state is worth, above the "
            f"lowest state ({stated.unit})", origin, headings={"worth": stated.unit}, formats={"worth": ",.2f"},
            row_headings=2,
        ),
        Table(
            "reward-costs", pd.DataFrame(costs), f"What each action costs ({stated.unit})", (Origin.DEFINITION,),
            headings={"cost": stated.unit}, formats={"cost": ",.2f"},
        ),
    )  # fmt: skip
    return (Text(text), *tables)
