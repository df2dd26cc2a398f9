"""The report as PDF, through WeasyPrint, which is an optional extra."""

from __future__ import annotations

import importlib.util
from typing import Any

from analysis.report.letters import each_with_its_own
from models.errors import InputError

MISSING = "--pdf: WeasyPrint cannot be used ({}); install the extra `pdf`, or print the HTML file from a browser"


def available() -> bool:
    """Whether WeasyPrint is installed."""
    return importlib.util.find_spec("weasyprint") is not None


def check_available() -> None:
    """Refuse early, before any fit, if there can be no PDF.

    Raises
    ------
    InputError
    """
    if not available():
        raise InputError(MISSING.format("not installed"))


def to_pdf(page: str) -> bytes:
    """Turn the page into a PDF; nothing is fetched.

    Raises
    ------
    InputError
        If WeasyPrint, or a system library it needs, is missing.
    """
    try:
        import weasyprint
    except (ImportError, OSError) as error:
        raise InputError(MISSING.format(error)) from None

    def refuse(url: str, *_: Any, **__: Any) -> Any:
        raise ValueError(f"the report is self-contained, yet it refers to {url}")

    document: bytes = weasyprint.HTML(string=each_with_its_own(page), url_fetcher=refuse).write_pdf()
    return document
