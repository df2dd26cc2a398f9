r"""Every table and figure of a report as files of their own: CSV and LaTeX, SVG and PNG.

``parts/index.csv`` says of each what it shows, where its numbers come from and what made it. CSV files hold the
numbers as they were computed; LaTeX files hold what the page shows, with a caption that names the origin, in plain
ASCII: `\input` them in a document that loads the packages that their first lines name (`analysis.report.latex`).
``summary.txt`` has the sentences of the report's head.

What is not to be relied on can be pasted elsewhere, far from the page that says so. So every part says it itself:
that its report was a quick one (`QUICK_MARK`), and what the warnings beside it on the page say of the fits that it
rests on (`analysis.report.output_map.Output.mark`), such as a posterior that missed its gate. Captions and first
lines of LaTeX say it, descriptions inside SVG and PNG, which change no picture, and a column of the index, which
speaks for the CSV files: a remark among their rows would be read as numbers.
"""

from __future__ import annotations

import csv
import io
import shutil
import struct
import tempfile
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import pandas as pd

from analysis.report.drawings import Drawings
from analysis.report.latex import latex
from analysis.report.output_map import Output
from analysis.report.render import prose
from analysis.report.section import Figure, Table
from models.errors import Phrase, located
from models.model_files import write_bytes, write_text

INDEX = "index.csv"
METHODS = "methods.txt"
SUMMARY = "summary.txt"

QUICK_MARK = "QUICK report: not for citation."
"""What stands on every part of a quick report."""

MARK_COLUMN = "citation"
"""Column of the index that holds the marks; empty for what a full report says nothing against."""

FORMULA = ("=", "+", "-", "@", "\t", "\r", "\n")
"""How a cell begins that spreadsheets take for a formula."""


PNG_HEAD = 33
"""Bytes of a PNG up to the end of its header chunk, which has to be the first."""


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


def write_parts(
    outputs: Sequence[Output], drawings: Drawings, folder: Path, methods: str, summary: Sequence[str] = (), *,
    quick: bool = False,
) -> Written:  # fmt: skip
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
    summary : sequence of str
        Lines of the summary; without any there is no such file.
    quick : bool
        Mark every part as not for citation, after what marks it anyway.

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
            mark = " ".join(filter(None, (output.mark, QUICK_MARK if quick else "")))
            files = (
                _figure(block, output.number, drawings, fresh, mark) if isinstance(block, Figure)
                else _table(block, output.number, fresh, mark)
            )  # fmt: skip
            row = {**output.row(), "files": " ".join(files), MARK_COLUMN: mark, "caption": block.caption}
            index.append(row)
        write_text(fresh / INDEX, _csv(pd.DataFrame(index)))
        write_text(fresh / METHODS, methods + "\n")
        if summary:
            write_text(fresh / SUMMARY, "\n".join(map(prose, summary)) + "\n")
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


def _figure(figure: Figure, number: int, drawings: Drawings, folder: Path, mark: str) -> list[str]:
    out = []
    drawn = drawings.of(figure)
    for i, panel in enumerate(drawn):
        stem = f"figure-{number:02d}-{figure.key}" + (f"-{i + 1}" if len(drawn) > 1 else "")
        svg = _described(panel.svg, mark)
        write_text(folder / f"{stem}.svg", f'<?xml version="1.0" encoding="UTF-8"?>\n{svg}\n')
        assert panel.png is not None
        write_bytes(folder / f"{stem}.png", _commented(panel.png, mark))
        out += [f"{stem}.svg", f"{stem}.png"]
    return out


def _described(svg: str, mark: str) -> str:
    """An SVG element that begins with the mark as its description; as it was without one."""
    end = svg.index(">") + 1
    return f"{svg[:end]}<desc>{escape(mark)}</desc>{svg[end:]}" if mark else svg


def _commented(png: bytes, mark: str) -> bytes:
    """A PNG whose text chunk holds the mark (PNG specification, section 11.3.4.3); as it was without one."""
    if not mark:
        return png
    chunk = b"tEXtComment\0" + mark.encode("latin-1", errors="replace")  # the signs that such a chunk may hold
    whole = struct.pack(">I", len(chunk) - 4) + chunk + struct.pack(">I", zlib.crc32(chunk))
    return png[:PNG_HEAD] + whole + png[PNG_HEAD:]


def _table(table: Table, number: int, folder: Path, mark: str) -> list[str]:
    stem = f"table-{number:02d}-{table.key}"
    write_text(folder / f"{stem}.csv", _csv(table.frame))
    write_text(folder / f"{stem}.tex", latex(table, mark))
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
