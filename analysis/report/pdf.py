"""The report as PDF, through WeasyPrint, which is an optional extra."""

from __future__ import annotations

import importlib.util
import re
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

    document: bytes = weasyprint.HTML(string=sized(each_with_its_own(page)), url_fetcher=refuse).write_pdf()
    return document


def sized(page: str) -> str:
    """Give every figure the size of its view box: without one, this renderer takes all to be twice as wide as high.

    Examples
    --------
    >>> sized('<svg role="img" viewBox="0 0 30 20">')
    '<svg role="img" width="30" height="20" viewBox="0 0 30 20">'
    """
    box = r'(<svg (?![^>]* width=)[^>]*?)viewBox="0 0 ([\d.]+) ([\d.]+)"'
    return re.sub(box, r'\1width="\2" height="\3" viewBox="0 0 \2 \3"', page)
