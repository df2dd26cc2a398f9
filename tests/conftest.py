"""What all tests share: the hypothesis profile, kept bytecode, a browser, the way to files outside the checkout."""

import os
import sys
from pathlib import Path

import hypothesis
import pytest

from tests.browser import running

hypothesis.settings.register_profile(
    "workbench", derandomize=True, database=None, deadline=None, max_examples=40, print_blob=True
)
hypothesis.settings.load_profile("workbench")

# Images of machines like to set this. Here every worker imports all modules and tests, dozens of tests start
# processes, and without bytecode each of them compiles pandas, PyMC and the house from source: seconds of CPU time.
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)


@pytest.fixture(scope="session")
def checkout() -> Path:
    return Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def shared() -> Path:
    """Material beside the checkout (paper, oracles): `PROSOCIAL_SHARED`, else ``../shared``."""
    given = os.environ.get("PROSOCIAL_SHARED")
    folder = Path(given) if given else Path(__file__).parents[2] / "shared"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent: this test compares with material kept outside the checkout")
    return folder


# Not for the whole session: what a test starts of its own (an event loop, another driver) cannot begin meanwhile.
@pytest.fixture(scope="module")
def browser():
    """Chromium of the system, without a window; skips where there is none."""
    with running() as own:
        yield own
