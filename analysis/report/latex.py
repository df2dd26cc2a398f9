r"""A table of a report as LaTeX: what the page shows, as wide as a page at most.

Columns stand as wide as their cells where all of them fit. Where they do not, the widths are shared out: cells wrap
(``p`` columns of ``array``), numbers stay to the right, long names and digests may break, and print gets smaller as
far as the longest words ask for it. Long tables go on on the next page (``longtable``).
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from analysis.report.render import rows
from analysis.report.section import Table

ASCII = {
    "\N{MINUS SIGN}": "$-$", "\N{EN DASH}": "--", "\N{EM DASH}": "---", "\N{INFINITY}": r"$\infty$",
    "\N{MULTIPLICATION SIGN}": r"$\times$", "\N{PLUS-MINUS SIGN}": r"$\pm$",
    "\N{LESS-THAN OR EQUAL TO}": r"$\le$", "\N{GREATER-THAN OR EQUAL TO}": r"$\ge$",
    "\N{RIGHTWARDS ARROW}": r"$\rightarrow$", "\N{MIDDLE DOT}": r"$\cdot$",
    "\N{GREEK CAPITAL LETTER DELTA}": r"$\Delta$",
    "\N{GREEK SMALL LETTER KAPPA}": r"$\kappa$", "\N{GREEK SMALL LETTER ALPHA}": r"$\alpha$",
    "\N{GREEK SMALL LETTER CHI}": r"$\chi$", "\N{GREEK SMALL LETTER ETA}": r"$\eta$",
    "\N{GREEK SMALL LETTER SIGMA}": r"$\sigma$", "\N{GREEK SMALL LETTER BETA}": r"$\beta$",
    "\N{GREEK SMALL LETTER EPSILON}": r"$\epsilon$", "\N{GREEK SMALL LETTER GAMMA}": r"$\gamma$",
    "\N{GREEK SMALL LETTER RHO}": r"$\rho$", "\N{GREEK SMALL LETTER LAMDA}": r"$\lambda$",
    "\N{SUPERSCRIPT TWO}": "$^2$", "\N{HORIZONTAL ELLIPSIS}": r"\ldots{}", "\N{DEGREE SIGN}": r"$^\circ$",
    "\N{LEFT SINGLE QUOTATION MARK}": "`", "\N{RIGHT SINGLE QUOTATION MARK}": "'",
    "\N{LEFT DOUBLE QUOTATION MARK}": "``", "\N{RIGHT DOUBLE QUOTATION MARK}": "''", "\N{NO-BREAK SPACE}": "~",
    "\N{ZERO WIDTH SPACE}": r"\allowbreak{}",
}  # fmt: skip
"""What LaTeX writes for signs beyond ASCII."""

SPECIAL = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": "$<$", ">": "$>$", "|": "$|$",
}  # fmt: skip

PAGE, SIDEWAYS = 345.0, 550.0
"""Text widths that are reckoned with, in points, upright and on a page turned: of ``article``, the narrowest."""

SIZES = {"small": 9.25, "footnotesize": 8.5, "scriptsize": 8.0}
"""Sizes of print that are tried: points of a letter that is one em wide at 10 points, as small print is wider."""

LINES = {PAGE: 38, SIDEWAYS: 20}
"""Lines that a table may have before it goes on on the next page."""

WIDTHS = (
    ("ijl.,:;'|!I`", 0.29), ("frst()[]-/ ", 0.4), ("mw\N{EN DASH}", 0.8), ("MWQ%@+=<>_\N{MINUS SIGN}", 0.9),
    ("\N{MULTIPLICATION SIGN}\N{PLUS-MINUS SIGN}\N{LESS-THAN OR EQUAL TO}\N{GREATER-THAN OR EQUAL TO}", 0.9),
    ("\N{RIGHTWARDS ARROW}\N{INFINITY}\N{HORIZONTAL ELLIPSIS}\N{EM DASH}", 1.05), ("\N{ZERO WIDTH SPACE}", 0.0),
)  # fmt: skip
"""Widths of letters in ems, a little more than they are; capitals are 0.76, all others 0.53."""

GAP, NARROW = 12.0, 6.0
"""Space between columns, in points: LaTeX's own, and that of tables of more than `FEW` columns."""

FEW = 6

BREAK = "\N{ZERO WIDTH SPACE}"

UNBROKEN, PIECE = 16, 8
"""Letters from which on a word may break anywhere, and of how many such pieces are."""


@dataclass(frozen=True)
class Layout:
    """How a table fits a page.

    Attributes
    ----------
    size : str
        Of print.
    page : float
        `PAGE`, or `SIDEWAYS` if it is to be turned.
    gap : float
        Space between columns, in points.
    shares : tuple of float or None
        Share of the width that each column wraps at; None: as wide as its cells.
    lines : int
    """

    size: str
    page: float
    gap: float
    shares: tuple[float | None, ...]
    lines: int

    @property
    def long(self) -> bool:
        """Whether it goes on on the next page, or has a page of its own."""
        return self.page == SIDEWAYS or self.lines > LINES[self.page]


def latex(table: Table, mark: str = "") -> str:
    """A table as LaTeX: what the page shows, its origin in the caption; the first line names the packages it needs.

    Parameters
    ----------
    table : Table
    mark : str
        What the first line and the caption end with: why not to cite it.
    """
    columns = list(table.frame.columns)
    head = [
        breakable(table.headings.get(c, str(c)) + (" (printed in the paper)" if c in table.printed else ""))
        for c in columns
    ]
    body = [[breakable(cell["text"]) for cell in row] for row in rows(table)]
    layout = laid_out([*([] if table.facts else [head]), *body], len(columns), table.groups)
    turned = layout.page == SIDEWAYS
    packages = [
        "booktabs", *["array"] * any(layout.shares), *["longtable"] * layout.long, *["lscape"] * turned
    ]  # fmt: skip
    origin = ", ".join(o.label for o in table.origin)
    spec = "".join(_column(c in table.formats, w) for c, w in zip(columns, layout.shares, strict=True))
    said = f"{table.caption} {mark}".rstrip()
    caption = rf"\caption{{[{escaped(origin)}] {escaped(breakable(said))}}}\label{{tab:{table.key}}}"
    top = _top(table, head)
    # A bracket after the end of a row would be read as the space to leave there.
    texts = [" & ".join(map(escaped, row)) for row in body]
    lines = [("{}" if text.startswith("[") else "") + text + r" \\" for text in texts]
    size = [rf"\{layout.size}", rf"\setlength{{\tabcolsep}}{{{layout.gap / 2:g}pt}}"]
    size += [r"\setlength{\LTcapwidth}{\linewidth}"] * layout.long
    noted = f" {escaped(mark)}" if mark else ""
    comment = [rf"% Needs \usepackage{{{','.join(packages)}}}.{noted}", f"% {table.key}: {origin}"]
    if layout.long:
        opened = [
            r"\begin{landscape}" if turned else "{",
            *size,
            rf"\begin{{longtable}}{{{spec}}}",
            caption + r" \\",
        ]
        again = [r"\toprule", *top, r"\endfirsthead", *([r"\toprule", *top, r"\endhead"] if top else [])]
        closed = [r"\bottomrule", r"\end{longtable}", r"\end{landscape}" if turned else "}"]
        return "\n".join([*comment, *opened, *again, *lines, *closed]) + "\n"
    opened = [r"\begin{table}", r"\centering", caption, *size, rf"\begin{{tabular}}{{{spec}}}", r"\toprule"]
    closed = [r"\bottomrule", r"\end{tabular}", r"\end{table}"]
    return "\n".join([*comment, *opened, *top, *lines, *closed]) + "\n"


def _top(table: Table, head: Sequence[str]) -> list[str]:
    """The rows above the numbers: headings over several columns, with a line below, and those of the columns."""
    out = []
    if table.groups:
        spans, rules, first = [], [], 1
        for heading, n in table.groups:
            spans.append(rf"\multicolumn{{{n}}}{{c}}{{{escaped(heading)}}}")
            rules += [rf"\cmidrule(lr){{{first}-{first + n - 1}}}"] if heading.strip() else []
            first += n
        out += [" & ".join(spans) + r" \\", *([" ".join(rules)] if rules else [])]
    return out if table.facts else [*out, " & ".join(map(escaped, head)) + r" \\", r"\midrule"]


def _column(number: bool, share: float | None) -> str:
    if share is None:
        return "r" if number else "l"
    side = "raggedleft" if number else "raggedright"
    return rf">{{\{side}\arraybackslash}}p{{{share:.3f}\linewidth}}"


def laid_out(
    texts: Sequence[Sequence[str]], columns: int, groups: Sequence[tuple[str, int]] = ()
) -> Layout:  # fmt: skip
    """How a table is fitted onto a page.

    The print is the largest in which the longest words of all columns stand next to each other; where none does,
    the page is turned. Words too long for that as well stand out of their columns.

    Parameters
    ----------
    texts : sequence of rows of text
    columns : int
    groups : sequence of (heading, number of columns)
        Headings above neighbouring columns, which do not break.
    """
    gap = GAP if columns <= FEW else NARROW
    whole = [max([1.0, *(ems(row[j]) for row in texts)]) for j in range(columns)]
    least = [max([1.0, *(ems(w) for row in texts for w in _words(row[j]))]) for j in range(columns)]
    tried = [(page, size) for page in (PAGE, SIDEWAYS) for size in SIZES]
    for page, size in tried:
        room = (page - gap * columns) / SIZES[size]
        wide, narrow = (_with_groups(own, groups, gap / SIZES[size]) for own in (whole, least))
        if sum(wide) <= room:
            return Layout(size, page, gap, (None,) * columns, len(texts))
        if sum(narrow) <= room:
            break
    letters = shared(wide, narrow, room)
    lines = sum(max(math.ceil(ems(t) / n) for t, n in zip(row, letters, strict=True)) for row in texts)
    # Down to a whole thousandth: together they are never more than the page.
    shares = tuple(math.floor(1000 * n * SIZES[size] / page) / 1000 for n in letters)
    return Layout(size, page, gap, shares, lines)


def _with_groups(widths: Sequence[float], groups: Sequence[tuple[str, int]], gap: float) -> list[float]:
    """Widths with what a heading above several columns needs more, on each of them."""
    out, first = list(widths), 0
    for heading, n in groups:
        lacking = ems(heading) - sum(out[first : first + n]) - gap * (n - 1)
        for j in range(first, first + n):
            out[j] += max(0.0, lacking / n)
        first += n
    return out


def ems(text: str) -> float:
    """About how wide a text is set, in ems, rather too much than too little.

    Examples
    --------
    >>> round(ems("0.123"), 2), ems("") < ems("ill") < ems("WWW")
    (2.41, True)
    """
    return sum(next((w for own, w in WIDTHS if c in own), 0.76 if c.isupper() else 0.53) for c in text)


def shared(whole: Sequence[float], least: Sequence[float], room: float) -> list[float]:
    """Widths that add up to `room`: columns get what they need up to a common limit, and `least` at least.

    Examples
    --------
    >>> [round(width) for width in shared([10, 200, 80], [5, 12, 9], 90)]
    [10, 40, 40]
    """
    low, high = 0.0, float(max(whole))
    for _ in range(60):
        limit = (low + high) / 2
        total = sum(max(n, min(w, limit)) for w, n in zip(whole, least, strict=True))
        low, high = (low, limit) if total > room else (limit, high)
    found = [float(max(n, min(w, low))) for w, n in zip(whole, least, strict=True)]
    shrunk = min(1.0, room / sum(found))
    return [w * shrunk for w in found]


def breakable(text: Any) -> str:
    """Text whose long words (digests, paths, dotted names) may break: after a mark, else every `PIECE` letters.

    Examples
    --------
    >>> breakable("digest 0123456789abcdef01").split(BREAK)
    ['digest 01234567', '89abcdef01']
    """
    return re.sub(rf"\S{{{UNBROKEN},}}", lambda found: _broken(found[0]), str(text))


def _broken(word: str) -> str:
    parts = re.findall(r"[^_/.,:;=-]+[_/.,:;=-]*|[_/.,:;=-]+", word)
    pieces = [part[i : i + PIECE] for part in parts for i in range(0, len(part), PIECE)]
    # A piece of one or two letters goes with the one before: nobody breaks there.
    joined: list[str] = []
    for piece in pieces:
        if joined and len(piece) < 3 and len(joined[-1]) < PIECE + 2:
            joined[-1] += piece
        else:
            joined.append(piece)
    return BREAK.join(joined)


def _words(text: str) -> list[str]:
    """Pieces of a text that do not break."""
    return [word for word in re.split(rf"[\s{BREAK}]+", text) if word] or [""]


def escaped(text: str) -> str:
    r"""Text as LaTeX, in ASCII; signs without a name in `ASCII` are given by number.

    Examples
    --------
    >>> escaped("−3 % of s_1 → ∞")
    '$-$3 \\% of s\\_1 $\\rightarrow$ $\\infty$'
    """
    out = "".join(SPECIAL.get(c) or ASCII.get(c) or c for c in re.sub(r"\s+", " ", str(text)))
    return "".join(c if ord(c) < 128 else rf"\symbol{{{ord(c)}}}" for c in out)
