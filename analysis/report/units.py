"""The unit of the reward in the words and figures of a report: points, say, where values are not reward units.

Results name their own unit, in sentences, views and most of their figures. What is left is said by the sections
themselves (headings, captions, what a table is of) and by axes that are drawn from bare numbers.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from matplotlib.figure import Figure as MplFigure
from matplotlib.text import Text as MplText

from analysis.figures.style import Drawn
from analysis.report.section import Block, Drawing, Figure, Omitted, Part, Points, Section, Table, Text
from models.reward import UNIT

PLANNING = ("reward", "plan", "robust", "sensitivity", "safeguards")
"""Keys of the sections that use a stated reward; others speak of the paper's."""


def in_unit(sections: Sequence[Section], unit: str) -> tuple[Section, ...]:
    """Sections of which those that plan speak of the reward's own unit, and not of reward units.

    Parameters
    ----------
    sections : sequence of Section
    unit : str
        In the plural, such as ``points``.
    """
    if unit == UNIT:
        return tuple(sections)
    return tuple(
        replace(s, blocks=tuple(_block(b, unit) for b in s.blocks)) if s.key in PLANNING else s for s in sections
    )


def drawn_in_unit(unit: str, panel: Drawing) -> Drawn:
    """A panel whose axes, legends and notes name the reward's own unit."""
    drawn = panel()
    figure = drawn if isinstance(drawn, MplFigure) else drawn.figure
    for text in figure.findobj(MplText):
        own = text.get_text()
        if UNIT in own:
            text.set_text(own.replace(UNIT, unit))
    return drawn


def original(panel: Drawing) -> Drawing:
    """The panel behind one that was changed here."""
    while isinstance(panel, partial) and panel.func is drawn_in_unit:
        panel = panel.args[1]
    return panel


def _block(block: Block, unit: str) -> Block:
    def said(text: str) -> str:
        return text.replace(UNIT, unit)

    if isinstance(block, Part):
        return replace(block, title=said(block.title), blocks=tuple(_block(b, unit) for b in block.blocks))
    if isinstance(block, Figure):
        panels = tuple(partial(drawn_in_unit, unit, panel) for panel in block.panels)
        return replace(block, panels=panels, caption=said(block.caption), alt=tuple(map(said, block.alt)))
    if isinstance(block, Table):
        headings = {column: said(text) for column, text in block.headings.items()}
        return replace(block, caption=said(block.caption), headings=headings)
    if isinstance(block, Text):
        return replace(block, text=said(block.text))
    if isinstance(block, Points):
        return replace(block, items=tuple(map(said, block.items)), lead=said(block.lead))
    if isinstance(block, Omitted):
        return replace(block, reason=said(block.reason))
    return block
