"""What all tests share: the hypothesis profile, and the way to files kept outside the checkout."""

import os
from pathlib import Path

import hypothesis
import pytest

hypothesis.settings.register_profile(
    "workbench", derandomize=True, database=None, deadline=None, max_examples=40, print_blob=True
)
hypothesis.settings.load_profile("workbench")


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
