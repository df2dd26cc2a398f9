"""What tests of analyses share: a store of fits and results that is nobody else's."""

import pytest

from analysis import fits


@pytest.fixture(scope="module", autouse=True)
def store_of_this_file(tmp_path_factory):
    """A store for each file of tests.

    Tests replace functions and constants that no key of the store sees: what they keep must never be found by
    the user of the checkout, nor by tests that replace other things.
    """
    folder = tmp_path_factory.mktemp("store")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fits, "store_folder", lambda: folder)
        yield folder
