"""Section of a comparison: what the difference changes for plans."""

from __future__ import annotations

from functools import partial

import pandas as pd

from analysis.figures.side_by_side import plans_exchanged
from analysis.pair_differences import plan_exchange
from analysis.report.compared_context import Comparison
from analysis.report.section import Block, Compared, Drawing, Figure, Headline, NotSupported, Part, Table, Text
from analysis.report.units import drawn_in_unit
from analysis.side_by_side import Side
from analysis.wording import counted
from models.errors import InputError
from models.protocol import PUBLISHED
from models.reward import UNIT, Reward, default_x

STUDY_SCHEDULE = "HRHRHRHRH"

IN_A_DRAW = (
    "Both plans are made for the estimates; in a draw below 0 the other side's plan is the better one."
)  # fmt: skip

NO_LOSS = 1e-9
"""Of what a round is worth: below that a loss is rounding."""


def make(comparison: Comparison) -> tuple[Block, ...]:
    """One part for each number of states."""
    protocol = comparison.sides[0].protocol
    if protocol != PUBLISHED and not all(_has_own_reward(side) for side in comparison.sides):
        raise NotSupported(f"what a round is worth is not known for protocol {protocol.name!r}")
    letters = comparison.schedule or STUDY_SCHEDULE
    try:
        protocol.modes_from_letters(letters)
    except InputError:
        if comparison.schedule is not None:
            raise
        letters = "".join(m.letter for m in protocol.modes) * 3
    parts = tuple(_part(comparison, k, letters) for k in comparison.states)
    if len(comparison.states) > 1:
        warning = "Values from different numbers of states are in different currencies and do not compare."
        return (Text(warning, "warning"), *parts)
    return parts


def _part(comparison: Comparison, k: int, letters: str) -> Part:
    table = plan_exchange(*comparison.sides, k, letters)
    units = {side.label: unit_of_side(side, k) for side in comparison.sides}
    text, lost = _words(table, letters, units)
    shown = table[["plan", "world", "first_action", "value", "low", "high", "loss", "loss_low", "loss_high"]]
    headings = {"world": "valued in", "first_action": "first action", "loss_low": "loss, low",
                "loss_high": "loss, high"}  # fmt: skip
    formats = dict.fromkeys(("value", "low", "high", "loss", "loss_low", "loss_high"), ".1f")
    draw: Drawing = partial(plans_exchanged, table, title=counted(k, "state"))
    alt = "Value of either side's plan in both models, with 95% intervals over the draws."
    alike = len(set(units.values())) == 1
    unit = units["A"] if alike else "; ".join(f"{own} in {label}" for label, own in units.items())
    if unit != UNIT and alike:
        draw = partial(drawn_in_unit, unit, draw)
    origins, failed = comparison.origins, comparison.cautions(k)
    said = f"Over {text}" + (f" {'; '.join(failed)}." if failed else "")
    # What the estimates are not told of is said at length in the section alone.
    below = "" if lost is None else " " + IN_A_DRAW
    headline = Headline(
        text=said, kind="warning" if failed else "plain" if lost else "open", question=Compared.PLANS,
        origin=origins, about=counted(k, "state"),
    )  # fmt: skip
    return Part(counted(k, "state").capitalize(), f"plans-{k}", (
        *comparison.doubts(k),
        Text(f"With {counted(k, 'state')}, over {text}{below}"),
        Figure(f"plans-exchanged-{k}", (draw,), f"What the best plan of each side is worth over {letters} "
               "in the models of both: estimate, and 95% of the draws.", (alt,), origins),
        Table(f"plan-exchange-{k}", shown, f"The same in numbers, {unit}; the loss is against the "
              "best plan of that side's own estimate.", origins, headings, formats, row_headings=2),
        *([headline] if k in comparison.told_states else []),
    ))  # fmt: skip


def unit_of_side(side: Side, states: int) -> str:
    """What values of a side's model are in."""
    return side.estimates[states].reward.unit


def _words(table: pd.DataFrame, letters: str, units: dict[str, str]) -> tuple[str, bool | None]:
    """How the plans begin and the most that is lost by acting on the other; whether it surely is, if any."""
    exchanged = table[table["plan"] != table["world"]]
    worst = exchanged.loc[exchanged["loss"].idxmax()]
    first = table.drop_duplicates("plan").set_index("plan")["first_action"]
    same = "start alike" if first["A"] == first["B"] else f"start with {first['A']} (A) and {first['B']} (B)"
    text = f"{letters}, the two plans {same}. "
    if worst["loss"] < NO_LOSS:
        return text + "By the estimates nothing is lost by acting on the other side's model.", None
    text += (
        f"The most that is lost by acting on the other side's model is {worst['loss']:.1f} {units[worst['world']]} "
        f"(plan of {worst['plan']} in {worst['world']}; 95% over the draws {worst['loss_low']:.1f} to "
        f"{worst['loss_high']:.1f})."
    )
    return text, bool(worst["loss_low"] > 0)


def _has_own_reward(side: Side) -> bool:
    """Whether all models of a side say what a round is worth: anything but the scores that are taken by default."""
    return all(m.reward != Reward(default_x(m.n_states)) for m in side.estimates.values())
