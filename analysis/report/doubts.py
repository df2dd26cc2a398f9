"""Why numbers of a section may not be trusted, said once beside the first of them.

Results repeat the cautions of what they are made from in every sentence (`models.cautions`), which is right where a
sentence stands alone. Below a warning that says the same at length it is once too often.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

from analysis.figures.style import spoken
from analysis.randomised_arms import answering
from analysis.report.context import ReportContext
from analysis.report.section import Block, Figure, Part, Points, Text
from analysis.stakes import other_stakes
from analysis.wording import counted
from models.cautions import caution_line, uncautioned


def doubts(context: ReportContext, k: int, *, estimate: bool = True, posterior: bool = True) -> tuple[Text, ...]:
    """Warnings on the fits of one number of states, which also mark what stands beside them; none where both hold.

    Parameters
    ----------
    context : ReportContext
    k : int
        Number of states.
    estimate, posterior : bool
        Whether numbers rest on the point estimate, and on draws of the posterior.
    """
    out = []
    if posterior and not (gate := context.posterior(k).gate).passed:
        text = f"{gate.sentence} What follows rests on these draws."
        out.append(Text(text, "warning", caution_line((gate.caution,))))
    if estimate and (caution := context.study.fits[k].caution):
        text = (
            f"{caution}: its tables are no maximum of the likelihood. Do not rely on what follows from the point "
            "estimate."
        )
        out.append(Text(text, "warning", caution_line((caution,))))
    return tuple(out)


def flat(context: ReportContext, states: Sequence[int]) -> tuple[Text, ...]:
    """That the histories leave most directions of the tables open, for the numbers of states where they do.

    Parameters
    ----------
    context : ReportContext
    states : sequence of int
    """
    found = [(k, context.study.identifications[k]) for k in states]
    return tuple(
        Text(f"With {counted(k, 'state')}: {own.flat_sentence}", "warning") for k, own in found if own.mostly_flat
    )


def stakes(context: ReportContext) -> tuple[Text, ...]:
    """That these people played for something else than what the paper's reward is about, where they did."""
    note = "" if context.stated is not None else other_stakes(context.data.card)
    return (Text(note, "note"),) if note else ()


def unassigned(context: ReportContext) -> str:
    """That actions were not assigned, so that what follows them need be no effect of theirs; empty if they were."""
    modes = answering(context.log)
    if not modes:
        return ""
    return (
        f"NOT RANDOMISED: in these data the robot's action (mode {' and '.join(spoken(m) for m in modes)}) varies "
        "within a person and may answer to what that person did. The learned tables say what came after an action, "
        "not what it caused, and a gain of a plan is no effect of acting."
    )


def reservations(context: ReportContext) -> tuple[Text, ...]:
    """What stands before every section that plans: other stakes, and actions that nobody assigned."""
    note = unassigned(context)
    return (*stakes(context), *((Text(note, "warning"),) if note else ()))


def told_above(blocks: Iterable[Block], cautions: Sequence[str]) -> tuple[Block, ...]:
    """Blocks whose sentences do not repeat cautions that stand above them."""
    return tuple(_without(block, cautions) for block in blocks) if cautions else tuple(blocks)


def _without(block: Block, cautions: Sequence[str]) -> Block:
    if isinstance(block, Part):
        return replace(block, blocks=told_above(block.blocks, cautions))
    if isinstance(block, Text):
        return replace(block, text=uncautioned(block.text, cautions))
    if isinstance(block, Points):
        return replace(block, items=tuple(uncautioned(text, cautions) for text in block.items))
    if isinstance(block, Figure):
        return replace(block, alt=tuple(uncautioned(text, cautions) for text in block.alt))
    return block
