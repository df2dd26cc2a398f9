"""Drawings of a page in fewer bytes: short names, coordinates to a hundredth of a point, no idle space."""

from __future__ import annotations

import re

_ID = re.compile(r' id="([^"]+)"')
_PATH = re.compile(r' d="([^"]+)"')
_PLACE = re.compile(r' (x|y)="(-?\d+\.\d+)"')
_NUMBER = re.compile(r"-?\d+\.\d+")
_ALONE = re.compile(r"<g>\s*(<(?:path|use)\b[^>]*/>)\s*</g>")
DIGITS = "0123456789abcdefghijklmnopqrstuvwxyz"


class ShortNames:
    """Names that are unique to a page, as short as can be."""

    def __init__(self) -> None:
        self._count = 0

    def next(self) -> str:
        """A name nobody has had.

        Examples
        --------
        >>> names = ShortNames()
        >>> [names.next() for _ in range(37)][::18]
        ['i0', 'ii', 'i10']
        """
        number, out = self._count, ""
        self._count += 1
        while number or not out:
            number, digit = divmod(number, len(DIGITS))
            out = DIGITS[digit] + out
        return f"i{out}"

    def rename(self, svg: str) -> str:
        """An SVG element with new names for its own parts; references follow."""
        own = {name: self.next() for name in dict.fromkeys(_ID.findall(svg))}
        if not own:
            return svg
        pattern = re.compile(r'( id="|href="#|url\(#)([^")]+)')
        return pattern.sub(lambda found: found[1] + own.get(found[2], found[2]), svg)


def compact(svg: str) -> str:
    r"""The same picture, to a hundredth of a point.

    Parameters
    ----------
    svg : str
        An SVG element whose letters are taken out already (`analysis.report.letters`): theirs are the only paths
        that a hundredth of a unit is much for.

    Examples
    --------
    >>> compact('<path d="M 530.779 113.077 \nL 10.5 0.004 \nz \n" x="1.239"/>')
    '<path d="M530.78 113.08L10.5 0z" x="1.24"/>'
    """
    svg = _PATH.sub(lambda found: f' d="{_path(found[1])}"', svg)
    svg = _PLACE.sub(lambda found: f' {found[1]}="{_rounded(found[2])}"', svg)
    # A group of one thing that says nothing of it is no group.
    return re.sub(r"\n+", "\n", _ALONE.sub(r"\1", svg))


def _path(data: str) -> str:
    data = _NUMBER.sub(lambda found: _rounded(found[0]), data)
    data = re.sub(r"\s+", " ", data).strip()
    return re.sub(r" ?([A-Za-z]) ?", r"\1", data)


def _rounded(number: str) -> str:
    text = f"{float(number):.2f}".rstrip("0").rstrip(".")
    return "0" if text in ("-0", "") else text
