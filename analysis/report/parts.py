r"""Every table and figure of a report as files of their own: CSV and LaTeX, SVG and PNG.

``parts/index.csv`` says of each what it shows, where its numbers come from and what made it. CSV files hold the
numbers as they were computed; LaTeX files hold what the page shows, with a caption that names the origin, in plain
ASCII: `\input` them in a document that loads ``booktabs``.
"""

from __future__ import annotations

import csv
import io
import re
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from analysis.report.drawings import Drawings
from analysis.report.output_map import Output
from analysis.report.render import rows
from analysis.report.section import Figure, Table
from models.errors import Phrase, located
from models.model_files import write_bytes, write_text

INDEX = "index.csv"
METHODS = "methods.txt"

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
}  # fmt: skip
"""What LaTeX writes for signs beyond ASCII."""

SPECIAL = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": "$<$", ">": "$>$", "|": "$|$",
}  # fmt: skip


FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
"""How a cell begins that spreadsheets take for a formula."""


@dataclass(frozen=True)
class Written:
    """The folder of a report's parts.

    Attributes
    ----------
    folder : Path
    figures, tables : int
    """

    folder: Path
    figures: int
    tables: int


def check_parts_folder(folder: Path) -> None:
    """Refuse to replace a folder that no report has made.

    Raises
    ------
    InputError
        If it holds something else, or is a file.
    """
    if folder.is_dir() and any(folder.iterdir()) and not (folder / INDEX).is_file():
        raise located(f"{folder}", Phrase("a folder of other files"), f"none, or one with {INDEX} of a report")
    if folder.exists() and not folder.is_dir():
        raise located(f"{folder}", Phrase("a file"), "no such name: the parts of the report go there")


def write_parts(outputs: Sequence[Output], drawings: Drawings, folder: Path, methods: str) -> Written:
    """Write every figure and table, complete before they replace those of the report before.

    Parameters
    ----------
    outputs : sequence of Output
        In the order of the page.
    drawings : Drawings
        With pictures.
    folder : Path
        Replaced.
    methods : str
        The paragraph on methods.

    Raises
    ------
    InputError
        If `folder` holds something else.
    """
    check_parts_folder(folder)
    folder.parent.mkdir(parents=True, exist_ok=True)
    fresh = Path(tempfile.mkdtemp(dir=folder.parent, prefix=f".{folder.name}."))
    try:
        index = []
        for output in outputs:
            block = output.block
            files = (
                _figure(block, output.number, drawings, fresh) if isinstance(block, Figure)
                else _table(block, output.number, fresh)
            )  # fmt: skip
            index.append({**output.row(), "files": " ".join(files), "caption": block.caption})
        write_text(fresh / INDEX, _csv(pd.DataFrame(index)))
        write_text(fresh / METHODS, methods + "\n")
        fresh.chmod(0o755)
        old = folder.with_name(f"{fresh.name}.old")
        if folder.exists():
            folder.replace(old)
        fresh.replace(folder)
        shutil.rmtree(old, ignore_errors=True)
    except BaseException:
        shutil.rmtree(fresh, ignore_errors=True)
        raise
    kinds = [isinstance(o.block, Figure) for o in outputs]
    return Written(folder, sum(kinds), len(kinds) - sum(kinds))


def _figure(figure: Figure, number: int, drawings: Drawings, folder: Path) -> list[str]:
    out = []
    drawn = drawings.of(figure)
    for i, panel in enumerate(drawn):
        stem = f"figure-{number:02d}-{figure.key}" + (f"-{i + 1}" if len(drawn) > 1 else "")
        write_text(folder / f"{stem}.svg", f'<?xml version="1.0" encoding="UTF-8"?>\n{panel.svg}\n')
        assert panel.png is not None
        write_bytes(folder / f"{stem}.png", panel.png)
        out += [f"{stem}.svg", f"{stem}.png"]
    return out


def _table(table: Table, number: int, folder: Path) -> list[str]:
    stem = f"table-{number:02d}-{table.key}"
    write_text(folder / f"{stem}.csv", _csv(table.frame))
    write_text(folder / f"{stem}.tex", latex(table))
    return [f"{stem}.csv", f"{stem}.tex"]


def _csv(frame: pd.DataFrame) -> str:
    buffer = io.StringIO()
    safe = frame.map(no_formula).set_axis([no_formula(c) for c in frame.columns], axis=1)
    safe.to_csv(buffer, index=False, lineterminator="\n", quoting=csv.QUOTE_MINIMAL)
    return buffer.getvalue()


def no_formula(value: Any) -> Any:
    """A cell that a spreadsheet does not run: text that begins as a formula does gets an apostrophe before it.

    Examples
    --------
    >>> [no_formula(v) for v in ("=1+1", "-2.5", "help", -1.5, "@SUM(A1)", "- none")]
    ["'=1+1", '-2.5', 'help', -1.5, "'@SUM(A1)", "'- none"]
    """
    if not isinstance(value, str) or not value.startswith(FORMULA):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"
    return value


def latex(table: Table) -> str:
    """A table as LaTeX (booktabs): what the page shows, its origin in the caption.

    Parameters
    ----------
    table : Table
    """
    columns = list(table.frame.columns)
    align = "".join("r" if c in table.formats else "l" for c in columns)
    origin = ", ".join(o.label for o in table.origin)
    head = [
        escaped(table.headings.get(c, str(c)) + (" (printed in the paper)" if c in table.printed else ""))
        for c in columns
    ]
    lines = [
        f"% {table.key}: {origin}",
        r"\begin{table}",
        rf"\caption{{[{escaped(origin)}] {escaped(table.caption)}}}",
        rf"\label{{tab:{table.key}}}",
        rf"\begin{{tabular}}{{{align}}}",
        r"\toprule",
    ]
    if table.groups:
        spans = [rf"\multicolumn{{{n}}}{{c}}{{{escaped(heading)}}}" for heading, n in table.groups]
        lines.append(" & ".join(spans) + r" \\")
    if not table.facts:
        lines += [" & ".join(head) + r" \\", r"\midrule"]
    # A bracket after the end of a row would be read as the space to leave there.
    texts = [" & ".join(escaped(cell["text"]) for cell in row) for row in rows(table)]
    lines += [("{}" if text.startswith("[") else "") + text + r" \\" for text in texts]
    lines += [r"\bottomrule", r"\end{tabular}", r"\end{table}"]
    return "\n".join(lines) + "\n"


def escaped(text: str) -> str:
    r"""Text as LaTeX, in ASCII; signs without a name in `ASCII` are given by number.

    Examples
    --------
    >>> escaped("−3 % of s_1 → ∞")
    '$-$3 \\% of s\\_1 $\\rightarrow$ $\\infty$'
    """
    out = "".join(SPECIAL.get(c) or ASCII.get(c) or c for c in re.sub(r"\s+", " ", str(text)))
    return "".join(c if ord(c) < 128 else rf"\symbol{{{ord(c)}}}" for c in out)
