"""What tests of analyses share: a store of fits and results that is nobody else's, and reports of little effort."""

import pytest

from analysis import cli_report, fits


@pytest.fixture(scope="module", autouse=True)
def store_of_this_file(tmp_path_factory):
    """A store for each file of tests.

    Tests replace functions and constants that no key of the store sees: what they keep must never be found by
    the user of the checkout, nor by tests that replace other things.
    """
    folder = tmp_path_factory.mktemp("store")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fits, "store_folder", lambda: folder)
        # Another process would know nothing of this store, nor of anything else that a test puts in place.
        patch.setattr(cli_report, "usual_workers", lambda: 0)
        yield folder


@pytest.fixture(scope="module")
def short_reports(store_of_this_file):
    """Reports of this file are of few draws; what the patch is for, so that a file may shorten more."""
    from tests.analysis.report_cases import little_effort  # a second of imports that most files do without

    with pytest.MonkeyPatch.context() as patch:
        little_effort(patch)
        yield patch
