"""Part of "given the doubt": the repeated interaction without an end, every draw solved with its certificate."""

from __future__ import annotations

from functools import partial

import numpy as np

from analysis.endless_study import EndlessStudy, endless_study
from analysis.figures.draw_solutions import stability_along, stability_map, stability_walk, value_distribution
from analysis.figures.style import spoken
from analysis.report.context import ReportContext
from analysis.report.own_reward import rounds_of
from analysis.report.section import Block, Figure, Text
from analysis.wording import counted
from models.model_draws import ModelDraws
from models.planning.latent import LatentBatch
from models.planning.mode_process import alternating

DRAWS = 400
"""Evenly spaced draws that are solved, each from its start and from all corners of the simplex."""

QUICK_DRAWS = 40


def endless_blocks(context: ReportContext, draws: ModelDraws, k: int) -> tuple[Block, ...]:
    """What the draws want if the interaction goes on for ever.

    Parameters
    ----------
    context : ReportContext
    draws : ModelDraws
        With the reward, and without actions that are left out.
    k : int
        Number of states.
    """
    some = draws.thin(QUICK_DRAWS if context.effort.quick else DRAWS)
    batch = LatentBatch(some, alternating(some.protocol))
    tell = context.progress
    study = context.kept(
        f"draws without an end, {counted(k, 'state')}", endless_study, batch, rounds_of(context),
        progress=None if tell is None else lambda step, done, total: tell(f"{k} states: {step}", done, total),
    )  # fmt: skip
    return (
        Text(
            f"Without an end (discount {batch.discount:g}, modes in turn), {len(batch):,} evenly spaced draws: "
            f"{_certified(study)} {spoken(study.pool.sentence)}"
        ),
        *_figures(context, study, k),
    )


def _certified(study: EndlessStudy) -> str:
    s = study.solution
    return (
        f"{int(s.certified.sum()):,} are solved to a relative gap of {s.precision:g}, the largest gap is "
        f"{s.relative_gap.max():.2g}."
    )


def _figures(context: ReportContext, study: EndlessStudy, k: int) -> tuple[Block, ...]:
    said = spoken(study.along.sentence)
    pool = study.pool
    simplex = Figure(
        f"robust-map-{k}", (partial(stability_map, study.wide),),
        "Share of the draws that prefer to act, without an end, over beliefs about three states at a time: "
        "certainty of one state in every corner, one belief for all draws, undecided draws split equally. The dark "
        "line is where the draws are split in half.",
        ("Share of the draws that prefer to act over the belief simplex. See the text.",), (context.origin,),
    )  # fmt: skip
    return (
        *((simplex,) if k >= 3 else ()),
        Figure(
            f"robust-walk-{k}", (partial(stability_walk, study.wide),),
            "Decisions without an end over the robot's belief, one belief for all draws, moving from certainty of "
            "one state to the next. Above: share of the draws that prefer to act; the band holds draws whose "
            "actions differ by no more than the gap between their bounds. Below: what each action loses. "
            "Draws are solved from all corners, so that the picture holds far from the start.",
            ("Shares and losses of the actions over beliefs. See the text.",), (context.origin,),
        ),
        Figure(
            f"robust-along-{k}", (partial(stability_along, study.along),),
            f"The same along the histories of {rounds_of(context)}, each draw at its own belief, with what is "
            "believed of the draws after that history. One dot a history, larger the more probable it is; the "
            "robot follows the plan of the mean tables until then.",
            (said,), (context.origin,),
        ),
        Text(said),
        Figure(
            f"robust-endless-{k}", (partial(value_distribution, pool),),
            "What the repeated interaction is worth in each draw: its own optimum, the controller that is best on "
            "average, and baselines.",
            (f"{pool.names[pool.best]} is best on average, {np.max(pool.means):.4g}.",), (context.origin,),
        ),
    )  # fmt: skip
