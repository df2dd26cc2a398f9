"""Every figure of a report drawn once: as SVG for the page, and as SVG and PNG for the parts."""

from __future__ import annotations

from dataclasses import dataclass

from analysis.figures.style import to_png, to_svg
from analysis.report.section import Figure


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
    """

    def __init__(self, pictures: bool = False) -> None:
        self._pictures = pictures
        self._made: dict[str, list[Drawn]] = {}

    def of(self, figure: Figure) -> list[Drawn]:
        """Panels of a figure, in order; an exception while drawing names the figure."""
        if figure.key not in self._made:
            self._made[figure.key] = [
                Drawn(to_svg(drawn), to_png(drawn) if self._pictures else None) for drawn in figure.drawn()
            ]
        return self._made[figure.key]
