"""Section: the paper's reward, which is a definition and not a finding."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from analysis.figures.reward import reward_by_state
from analysis.report.context import ReportContext
from analysis.report.section import Block, Figure, NotSupported, Origin, Table, Text
from models.lspomdp import PUBLISHED_STATE_NAMES
from models.reward import Reward


def make(context: ReportContext) -> tuple[Block, ...]:
    """Figure and table of ``exp(r x_s) - exp(r x_0)``."""
    if not context.is_published_protocol:
        raise NotSupported(
            "the paper's reward belongs to its own actions and scores; protocol "
            f"{context.protocol.name!r} has others"
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
