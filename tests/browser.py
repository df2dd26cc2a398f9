"""The browser that pages are tried in: chromium of the system, without a window. One home for all tests."""

import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import pytest

NAMES = ("chromium", "chromium-browser", "google-chrome")


def executable() -> str | None:
    """Path of the first browser that this machine has."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


@contextmanager
def running() -> Iterator[Any]:
    """A browser for a while; the test is skipped, saying why, where there is none.

    Only one at a time: the driver of a second one cannot start while the first one runs.
    """
    sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    path = executable()
    if path is None:
        pytest.skip("no chromium on this machine: the page cannot be tried in a browser")
    options = ["--no-sandbox"] if sys.platform == "linux" else []
    with sync_api.sync_playwright() as driver:
        made = driver.chromium.launch(executable_path=path, args=options)
        yield made
        made.close()
