"""Sections that another process makes: the report is the same, whatever goes wrong there."""

import os
import signal
import threading
import warnings
from pathlib import Path

import numpy as np
import pytest

from analysis import fits, wording
from analysis.report.build import HTML_NAME, build_report
from analysis.report.registry import Entry
from analysis.report.section import Text
from analysis.stored_results import stored_result
from models.compiled import cache_folder
from tests.analysis.report_cases import little_effort, small_study, some

KEYS = ("study", "uncertainty", "plan", "limits")
STORE_OF_CHECKOUT = fits.store_folder


@pytest.fixture
def shared_store(tmp_path, monkeypatch):
    """A store that other processes know of, through the environment."""
    little_effort(monkeypatch)
    monkeypatch.setattr(fits, "store_folder", STORE_OF_CHECKOUT)

    compiled = cache_folder().parent

    def at(name):
        (tmp_path / name).mkdir()
        (tmp_path / name / compiled.name).symlink_to(compiled)  # nothing is compiled anew
        monkeypatch.setenv("PROSOCIAL_CACHE", str(tmp_path / name))

    return at


def report(out, workers, sections):
    return build_report(
        small_study(), states=(2,), quick=True, out=out, parts=True, date="2026-01-01", sections=sections,
        workers=workers,
    )  # fmt: skip


def files(folder):
    return {path.relative_to(folder): path.read_bytes() for path in Path(folder).rglob("*") if path.is_file()}


def test_the_report_is_the_same_and_says_that_nothing_was_found(tmp_path, shared_store):
    shared_store("alone")
    alone = report(tmp_path / "one", 0, some(*KEYS))
    shared_store("beside")
    beside = report(tmp_path / "two", 1, some(*KEYS))
    assert alone.made_beside == ()
    assert beside.made_beside
    assert files(tmp_path / "one") == files(tmp_path / "two")
    assert beside.found == alone.found
    assert not any(beside.found.values())
    assert beside.drawn_before == alone.drawn_before
    assert not any(beside.drawn_before.values())
    again = report(tmp_path / "three", 1, some(*KEYS))
    assert all(again.found.values())
    assert all(again.drawn_before.values())
    assert again.made_beside == (), "with everything in the store no other process is worth its start"


def fails_elsewhere(context):
    if context.progress is None:
        raise RuntimeError("only in the other process")
    return (Text("made here"),)


def warns_elsewhere(context):
    if context.progress is None:
        warnings.warn("of a computation", RuntimeWarning, stacklevel=1)
    return (Text("made again"),)


def dies_elsewhere(context):
    if context.progress is None:
        os.kill(os.getpid(), signal.SIGKILL)
    return (Text("made here"),)


def fails_everywhere(context):
    raise RuntimeError("a section that cannot be made")


def of_long_section(make, tmp_path):
    """A report whose only section another process begins with; it has no progress to tell of."""
    return build_report(
        small_study(), states=(2,), quick=True, out=tmp_path / "out", date="2026-01-01",
        sections=(Entry("held-out", "A section", make),), workers=1, progress=lambda *told: None,
    )  # fmt: skip


def test_an_error_or_a_death_of_the_other_process_is_none_of_the_report(tmp_path, shared_store, monkeypatch):
    shared_store("store")
    monkeypatch.setattr("models.worker_processes.MOST_DEATHS", 1)
    for make in (fails_elsewhere, dies_elsewhere):
        made = of_long_section(make, tmp_path)
        assert made.made_beside == ()
        assert "made here" in (tmp_path / "out" / HTML_NAME).read_text()
        shared_store(make.__name__)  # so that the next one has to fit again


def test_warnings_of_the_other_process_are_told_here(tmp_path, shared_store):
    shared_store("store")
    with pytest.warns(RuntimeWarning, match="of a computation"):
        made = of_long_section(warns_elsewhere, tmp_path)
    assert made.made_beside == ("held-out",)


def test_a_section_that_fails_everywhere_fails_the_report(tmp_path, shared_store):
    shared_store("store")
    with pytest.raises(RuntimeError, match="cannot be made"):
        of_long_section(fails_everywhere, tmp_path)
    assert not (tmp_path / "out" / HTML_NAME).exists()


BEGAN, GO_ON, COMPUTED = threading.Event(), threading.Event(), []


def slow_square(x):
    COMPUTED.append(x)
    BEGAN.set()
    assert GO_ON.wait(20)
    return np.array([x * x])


def test_two_that_want_the_same_result_compute_it_once(monkeypatch, tmp_path):
    monkeypatch.setattr(fits, "store_folder", lambda: tmp_path)
    # The store keeps what functions of the workbench return, and finds these by name.
    monkeypatch.setattr(slow_square, "__module__", wording.__name__)
    monkeypatch.setattr(wording, "slow_square", slow_square, raising=False)
    out = []

    def want():
        out.append(stored_result("a square", slow_square, 3))

    first, second = threading.Thread(target=want), threading.Thread(target=want)
    first.start()
    assert BEGAN.wait(20)
    second.start()
    second.join(0.3)
    assert second.is_alive(), "it waits for the first one"
    GO_ON.set()
    first.join(20)
    second.join(20)
    assert COMPUTED == [3]
    assert sorted(stored.reused for stored in out) == [False, True]
    assert [stored.value.tolist() for stored in out] == [[9], [9]]
    assert not list(tmp_path.glob(".*.lock"))
