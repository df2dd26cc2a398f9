"""Sections to one self-contained HTML page: figures inline, no script, nothing fetched."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from analysis.report.compact import ShortNames, compact
from analysis.report.context import ReportContext
from analysis.report.drawings import Drawings
from analysis.report.letters import Letters
from analysis.report.output_map import numbers
from analysis.report.section import Figure, Origin, Part, Section, Table
from analysis.report.summary import summarised

TEMPLATES = Path(__file__).parent / "templates"
MINUS = "\N{MINUS SIGN}"


@dataclass(frozen=True)
class PageHead:
    """What the page says above and below its sections.

    Attributes
    ----------
    title : str
    origins : tuple of Origin
    digests : tuple of str
        Of the contents that the page is about.
    seed : int
    date, command : str
    quick : bool
        Marks the page as not for citation.
    conditions : tuple of str
        Those selected; empty for all.
    """

    title: str
    origins: tuple[Origin, ...]
    digests: tuple[str, ...]
    seed: int
    date: str
    command: str
    quick: bool
    conditions: tuple[str, ...] = ()

    @classmethod
    def of(cls, context: ReportContext) -> PageHead:
        """Of a report on one data set."""
        return cls(
            context.data.card.title, (context.origin,), (context.data.digest,), context.seed, context.date,
            context.command, context.effort.quick, context.conditions,
        )  # fmt: skip


@dataclass(frozen=True)
class Panel:
    """A drawn panel: the SVG element and its natural width in CSS pixels."""

    svg: Markup
    width: int


def render(
    sections: Sequence[Section], head: PageHead, drawings: Drawings | None = None,
    status: Mapping[str, str] | None = None,
) -> str:  # fmt: skip
    """Draw every figure and fill the page; an exception in a figure fails the report.

    Parameters
    ----------
    sections : sequence of Section
    head : PageHead
    drawings : Drawings, optional
        Where the figures are drawn, or are drawn already.
    status : mapping of str to str, optional
        By key of a figure or table, whether it was planned; nothing is said of others.
    """
    keys = page_keys(sections)
    twice = {key for key in keys if keys.count(key) > 1}
    if twice:
        raise ValueError(f"parts of the report have the same key: {', '.join(sorted(twice))}")
    page, letters = _environment().get_template("report.html.j2"), Letters()
    return page.render(
        sections=sections,
        head=head,
        answers=summarised(sections),
        number=numbers(sections),
        status=status or {},
        panels=partial(panels, letters=letters, drawings=drawings or Drawings(), names=ShortNames()),
        letters=letters,
        rows=rows,
        prose=prose,
        kind=lambda block: type(block).__name__,
        css=Markup((TEMPLATES / "report.css").read_text(encoding="utf-8")),
    )


def page_keys(sections: Sequence[Section]) -> list[str]:
    """Anchors of the page: keys of sections, parts, figures and tables."""
    blocks = [b for s in sections for b in s.flat() if isinstance(b, Figure | Table | Part)]
    return [*(s.key for s in sections), *(b.key for b in blocks)]


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


def panels(figure: Figure, letters: Letters, drawings: Drawings, names: ShortNames) -> list[Panel]:
    """Drawn panels, letters shared, other ids made unique to the page and the alternative text put in."""
    out = []
    for drawn, alt in zip(drawings.of(figure), figure.alt, strict=True):
        svg = names.rename(compact(letters.take(drawn.svg)))
        points = re.search(r'<svg[^>]* width="([\d.]+)pt" height="([\d.]+)pt"', svg)
        assert points is not None
        width = round(float(points[1]) * 96 / 72)
        # The size is the page's business; the view box keeps the proportions.
        svg = re.sub(r'( width="[\d.]+pt"| height="[\d.]+pt")', "", svg, count=2)
        label = Markup.escape(alt)
        svg = svg.replace("<svg ", f'<svg role="img" aria-label="{label}" ', 1)
        out.append(Panel(Markup(svg), width))
    return out


def rows(table: Table) -> list[list[dict[str, Any]]]:
    """Cells of a table: text, and whether it names the row, is a number, was printed elsewhere."""
    columns = list(table.frame.columns)
    out = []
    for values in table.frame.itertuples(index=False, name=None):
        cells = []
        for i, (column, value) in enumerate(zip(columns, values, strict=True)):
            cells.append(
                {
                    "text": shown(value, table.formats.get(column, "")),
                    "heading": i < table.row_headings,
                    "number": column in table.formats,
                    "printed": column in table.printed,
                }
            )
        out.append(cells)
    return out


def prose(text: str) -> str:
    """Write minus signs as such in a sentence.

    Examples
    --------
    >>> prose("from -560.23 within 1e-5, 2-5 states")
    'from −560.23 within 1e-5, 2-5 states'
    """
    return re.sub(r"(?<![\w.-])-(?=\d)", MINUS, text)


def shown(value: Any, spec: str = "") -> str:
    """Write one value for people.

    Examples
    --------
    >>> shown(-560.234, ".2f"), shown(None), shown(True), shown(float("inf"), ".1f"), shown(1200, ",d")
    ('−560.23', '–', 'yes', '∞', '1,200')
    """
    if value is None or (isinstance(value, float | np.floating) and math.isnan(value)):
        return "–"
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, float | np.floating) and math.isinf(value):
        return "∞" if value > 0 else f"{MINUS}∞"
    if not spec or isinstance(value, str):
        return str(value)
    if spec.endswith("d"):
        value = int(value)
    return format(value, spec).replace("-", MINUS)
