"""The letters of a page's figures, drawn once for all of them.

Plots are outlines, letters included, so that they look the same on every machine; but every plot brings its own
copies, and names every part of itself, which was half of a report. Here the copies become references to one set of
outlines a page. A PDF renderer sees each plot alone and gets its copies back.
"""

from __future__ import annotations

import hashlib
import re

from markupsafe import Markup

_OUTLINE = re.compile(r'<path id="([^"]+)"(?: d="([^"]*)")? transform="scale\(0\.015\)"/>\s*')
"""How matplotlib writes a letter: its outline in the font's units, before any use; a space has none."""

_USE = re.compile(r'<use xlink:href="#([^"]+)"(?: transform="translate\((-?[\d.]+) 0\)")?/>\n?')
_SET = re.compile(r'<svg class="letters".*?</svg>\s*', re.DOTALL)
_LETTER = re.compile(r'<path id="(g\d+)".*?/>', re.DOTALL)


class Letters:
    """The set of outlines that a page's figures share."""

    def __init__(self) -> None:
        self._names: dict[str, str] = {}

    def take(self, svg: str) -> str:
        """Replace the letters of one SVG element by references, and drop what only its author could need.

        Parameters
        ----------
        svg : str
            As `analysis.figures.style.to_svg` writes it.

        Returns
        -------
        str
            The same picture; it needs the outlines of `markup` on the same page.
        """
        own: dict[str, str] = {}

        def learn(found: re.Match[str]) -> str:
            outline = re.sub(r"\s+", " ", found[2] or "").strip()
            own[found[1]] = self._names.setdefault(outline, f"g{len(self._names)}") if outline else ""
            return ""

        def refer(found: re.Match[str]) -> str:
            if found[1] not in own:
                return found[0]
            if not own[found[1]]:
                return ""
            # A tenth of a hundredth of the letter's size is more than anybody sees.
            shift = f' x="{round(float(found[2]), 1):g}"' if found[2] else ""
            return f'<use href="#{own[found[1]]}"{shift}/>\n'

        svg = _USE.sub(refer, _OUTLINE.sub(learn, svg))
        svg = re.sub(r"<!--.*?-->\s*", "", svg, flags=re.DOTALL)
        needed = set(re.findall(r'href="#([^"]+)"|url\(#([^)]+)\)', svg))
        wanted = {name for pair in needed for name in pair if name}
        svg = re.sub(r' id="([^"]+)"', lambda found: found[0] if found[1] in wanted else "", svg)
        return re.sub(r"<g/>\s*|<defs>\s*</defs>\s*", "", svg)

    def markup(self) -> Markup:
        """The outlines, as an element that takes no room; nothing if no figure has a letter."""
        if not self._names:
            return Markup("")
        paths = "\n".join(
            f'<path id="{name}" d="{outline}" transform="scale(0.015)"/>' for outline, name in self._names.items()
        )
        unseen = 'width="0" height="0" style="position: absolute" aria-hidden="true"'
        return Markup(f'<svg class="letters" {unseen}><defs>\n{paths}\n</defs></svg>')


def slim(svg: str) -> str:
    """One figure by itself with fewer bytes, its letters inside it.

    Letters are named by their outlines: figures of one page that each bring their own (a notebook) cannot take each
    other's for another letter.

    Parameters
    ----------
    svg : str
        As `analysis.figures.style.to_svg` writes it.
    """
    letters = Letters()
    text = letters.take(svg)
    copies = str(letters.markup())
    names = {found[1]: f"g{hashlib.sha256(found[0][found.end(1) - found.start() :].encode()).hexdigest()[:8]}"
             for found in _LETTER.finditer(copies)}  # fmt: skip

    def rename(found: re.Match[str]) -> str:
        return f"{found[1]}{names.get(found[2], found[2])}{found[3]}"

    own = "".join(found[0] for found in _LETTER.finditer(copies))
    whole = re.sub(
        r"<svg [^>]*>", lambda found: f"{found[0]}<defs>{own}</defs>" if own else found[0], text, count=1
    )
    return re.sub(r'( id="|href="#)(g\d+)(")', rename, whole)


def each_with_its_own(page: str) -> str:
    """Give every figure of a page its copies of the letters back."""
    shared = _SET.search(page)
    if shared is None:
        return page
    outlines = {found[1]: found[0] for found in _LETTER.finditer(shared[0])}

    def put_back(found: re.Match[str]) -> str:
        used = [name for name in dict.fromkeys(re.findall(r'href="#(g\d+)"', found[2])) if name in outlines]
        copies = "".join(outlines[name] for name in used)
        return f"{found[1]}<defs>{copies}</defs>{found[2]}" if used else found[0]

    return re.sub(r"(<svg [^>]*>)(.*?</svg>)", put_back, _SET.sub("", page), flags=re.DOTALL)
