"""Part of study 2: how often the paper's conclusions come out in replicates, and where its numbers lie in them."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from analysis.evidence import Evidence
from analysis.figures.study2 import claim_shares, printed_in_place
from analysis.printed_anova import MEASURES
from analysis.report.section import Block, Figure, Origin, Table, Text
from analysis.report.sections.study2_game import other_game
from analysis.study2_evidence import NOT_DECIDABLE, shown_claims
from analysis.study2_evidence import WORDS as KINDS
from analysis.study2_outcomes import BELIEF, OBSERVED, TEAM
from analysis.study2_policies import LS_POMDP

SIMULATED = (Origin.SIMULATED,)
BESIDE = (Origin.SIMULATED, Origin.PRINTED)


def again_blocks(found: Evidence) -> tuple[Block, ...]:
    """Shares of replicates that lead to each conclusion, means by policy, and the printed numbers among theirs.

    Parameters
    ----------
    found : Evidence
        Of `prosocial replicate study2`.
    """
    content = found.content
    rows = shown_claims(content)
    settings = content["settings"]
    blocks: list[Block] = [*other_game(content)]
    for kind in settings:
        own = rows[rows["learning"] == kind]
        told = "; ".join(
            f"{r.text}: {'not decidable' if np.isnan(r.share) else f'{r.share:.1%}'}"
            for r in own[own["whole"] & (own["planner"] == LS_POMDP)].itertuples()
        )
        blocks.append(
            Figure(
                f"study2-claims-{kind}", (partial(claim_shares, own, title=f"Robot: {KINDS[kind]}. Planner:"),),
                f"Share of {settings[kind]['replicates']:,} simulated studies that lead to each conclusion of the "
                f"paper (bold) and to its parts; robot: {KINDS[kind]}. Each planner takes the place of the paper's "
                "own among its four other policies. Intervals are 95%"
                + (f", over {settings[kind]['worlds']} studies 1." if kind == "em" else "."),
                (f"{LS_POMDP}: {told}.",), SIMULATED,
            )
        )  # fmt: skip
    blocks.append(_shares(rows, settings))
    blocks.append(_policy_means(pd.DataFrame(content["means"])))
    numbers = pd.DataFrame(content["numbers"])
    blocks += [Text(_outside(numbers)), _in_place(numbers)]
    return tuple(blocks)


def _shares(rows: pd.DataFrame, settings: dict[str, dict[str, object]]) -> Table:
    own = rows[rows["planner"] == LS_POMDP]
    wide = own.pivot_table(index="claim", columns="learning", values="share", dropna=False)
    first = own.drop_duplicates("claim").set_index("claim")
    plain = first["name"].str.removesuffix(NOT_DECIDABLE)
    name = [n.upper() if whole else n for n, whole in zip(plain, first["whole"], strict=True)]
    frame = wide.loc[first.index, list(settings)].assign(conclusion=name, paper=first["printed"])
    return Table(
        "study2-claims-table", frame[["conclusion", *settings, "paper"]].reset_index(drop=True),
        f"Share of simulated studies that lead to each conclusion (capitals) and to its parts, {LS_POMDP} the "
        "planner, and whether the paper's own study does. No share: the conclusion is on the robot's own scale, so "
        "its fit decides.", BESIDE, printed=("paper",),
        headings={**{k: KINDS[k] for k in settings}, "paper": "paper's study"},
        formats=dict.fromkeys(settings, ".1%"),
    )  # fmt: skip


def _policy_means(rows: pd.DataFrame) -> Table:
    measures = {TEAM: "tokens a round", OBSERVED: "observed help", BELIEF: "believed state",
                "costly_actions": "costly actions", "reward": "reward"}  # fmt: skip
    wide = rows.pivot_table(index=["learning", "policy"], columns="measure", values="mean")[list(measures)]
    order = rows[["learning", "policy"]].drop_duplicates()
    frame = wide.loc[list(order.itertuples(index=False, name=None))].reset_index()
    return Table(
        "study2-policies", frame.assign(learning=frame["learning"].map(KINDS)),
        "Means over all simulated people, by what the robot knew. Reward: by the true states and the published "
        "reward, summed over the rounds. Believed state: by each robot's own model, so on its own scale.",
        SIMULATED, row_headings=2, headings={"learning": "robot", **measures},
        formats={TEAM: ".2f", OBSERVED: ".3f", BELIEF: ".2f", "costly_actions": ".2f", "reward": ",.1f"},
    )  # fmt: skip


def _outside(rows: pd.DataFrame) -> str:
    """Which printed numbers hardly any simulated study has, whatever the robot knows."""
    off: dict[str, dict[str, str]] = {}
    for kind in KINDS:
        own = rows[(rows["planner"] == LS_POMDP) & (rows["learning"] == kind)]
        sides = {
            r.number: "below" if r.printed < r.q05 else "above"
            for r in own.itertuples()
            if r.printed < r.q05 or r.printed > r.q95
        }
        off[kind] = sides
    both = {n: side for n, side in off["em"].items() if off["truth"].get(n) == side}
    named = "; ".join(f"{_spoken(n)} ({side})" for n, side in both.items())
    total = len(rows["number"].unique())
    counts = " and ".join(f"{len(off[kind])} ({words})" for kind, words in KINDS.items())
    return (
        f"Of the {total} printed numbers, {counts} lie outside the middle 90% of simulated studies; in both, on "
        f"the same side: {named or 'none'}."
    )


def _spoken(number: str) -> str:
    for key, name in MEASURES.items():
        number = number.replace(key, name)
    return number


def _in_place(rows: pd.DataFrame) -> Figure:
    own = rows[rows["planner"] == LS_POMDP]
    own = own.assign(learning=own["learning"].map(KINDS))
    panels, alt = [], []
    for start, xlabel, log in (
        ("F ", "F of the mixed analysis of variance", True),
        (f"difference {TEAM}, ", f"tokens a round less {LS_POMDP}", False),
        (f"difference {OBSERVED}, ", f"observed help less {LS_POMDP}", False),
    ):
        part = own[own["number"].str.startswith(start)]
        part = part.assign(label=[_spoken(n.removeprefix(start)) for n in part["number"]])
        panels.append(partial(printed_in_place, part, xlabel=xlabel, log=log))
        told = "; ".join(
            f"{r.label}: printed {r.printed:g}, simulated ({r.learning}) {r.q05:.3g} to {r.q95:.3g}"
            for r in part.itertuples()
        )
        alt.append(f"{xlabel}. {told}.")
    return Figure(
        "study2-printed", tuple(panels),
        "Every number that the paper prints (stars) beside its distribution over simulated studies: median, middle "
        "half (thick) and middle 90% (thin).", tuple(alt), BESIDE,
    )  # fmt: skip
