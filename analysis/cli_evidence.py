"""What commands that make evidence share: the option for its file, and how they end."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Annotated, Any

import typer

from analysis.cli_options import Report, check_output, distinct_files, plain, write_output

OutOption = Annotated[
    str | None, typer.Option("--out", metavar="FILE", help="Write everything, study by study, as JSON.")
]


def begin_evidence(json_path: str | None, quiet: bool, out: str | None, **read: str | None) -> Report:
    """Check where results go before any work is done; `read` are files that the command reads, by option."""
    report = Report(json_path, quiet)
    if out is not None:
        check_output("--out", out)
    distinct_files({"--out": out, "--json": json_path, **{f"--{name}": path for name, path in read.items()}})
    return report


def finish_evidence(report: Report, out: str | None, content: Mapping[str, Any]) -> None:
    """Write the evidence file and the command's JSON: the same, and the file's name."""
    if out is not None:
        text = json.dumps(plain(content), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
        write_output("--out", out, text.encode())
    report.finish({**content, "out": out})
