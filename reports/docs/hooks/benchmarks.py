"""The page of benchmarks and its figures, made from the stored results while the site is built."""

from __future__ import annotations

from typing import Any

from mkdocs.structure.files import File, Files

from analysis.bench.page import page
from analysis.bench.results import read_results

PAGE = "benchmarks.md"


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add the page and its figures."""
    text, figures = page(read_results())
    files.append(File.generated(config, PAGE, content=text))
    for name, content in figures.items():
        files.append(File.generated(config, name, content=content))
    return files
