"""Every figure of a report drawn once: as SVG for the page, and as SVG and PNG for the parts.

One that was drawn before, of the same numbers by the same code, is found in the store (`analysis.stored_results`).
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass
from functools import partial

from analysis.figures.style import Drawn as Panel
from analysis.figures.style import figure_of, to_png, to_svg
from analysis.report.section import Figure
from analysis.stored_results import found_or_made

Packed = tuple[bytes, bytes | None]
"""SVG, compressed, and PNG of a panel: what the store holds."""


@dataclass(frozen=True)
class Drawn:
    """A drawn panel.

    Attributes
    ----------
    svg : str
        An SVG element.
    png : bytes or None
        None unless pictures were asked for.
    """

    svg: str
    png: bytes | None


class Drawings:
    """The drawn panels of figures, by key; drawn when first asked for.

    Parameters
    ----------
    pictures : bool
        Also as PNG, which takes about as long again.

    Attributes
    ----------
    found : dict of str to bool
        By key of a figure, whether it was found rather than drawn.
    """

    def __init__(self, pictures: bool = False) -> None:
        self._pictures = pictures
        self._made: dict[str, list[Drawn]] = {}
        self.found: dict[str, bool] = {}

    def of(self, figure: Figure) -> list[Drawn]:
        """Panels of a figure, in order; an exception while drawing names the figure."""
        if figure.key not in self._made:
            packed = self._packed(figure)
            self._made[figure.key] = [Drawn(zlib.decompress(svg).decode(), png) for svg, png in packed]
        return self._made[figure.key]

    def _packed(self, figure: Figure) -> list[Packed]:
        make = partial(draw, figure, self._pictures)
        given = {"panels": figure.panels, "pictures": self._pictures}
        stored = found_or_made(f"figure {figure.key}", make, draw, given, kind="drawing")
        self.found[figure.key] = stored.reused
        return stored.value


def draw(figure: Figure, pictures: bool) -> list[Packed]:
    """Draw every panel.

    Parameters
    ----------
    figure : Figure
    pictures : bool
        Also as PNG.
    """
    return [_packed(drawn, pictures) for drawn in figure.drawn()]


def _packed(drawn: Panel, pictures: bool) -> Packed:
    svg = zlib.compress(to_svg(drawn).encode(), 1)
    if not pictures:
        return svg, None
    figure_of(drawn).set_layout_engine("none")  # it is laid out, and that takes as long as drawing it
    return svg, to_png(drawn)
