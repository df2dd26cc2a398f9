"""The report's page made again, and in a real browser: axe-core's rules, nothing cut, on a desktop and a phone."""

from importlib.util import find_spec

import pytest

from analysis import fits
from analysis.event_files import write_events
from analysis.report.analysis_plan import AnalysisPlan, Planned
from analysis.report.build import build_report
from analysis.report.compare import compare_report
from models.protocol import PUBLISHED
from tests.analysis.report_cases import data_set, random_log
from tests.browser import executable

pytestmark = pytest.mark.usefixtures("short_reports")
WIDTHS = (1280, 390)
DATE = "2026-01-31"


def shown_by_a_browser(test):
    """Asked before the reports are made, which takes longer than everything else."""
    no_axe = pytest.mark.skipif(find_spec("axe_playwright_python") is None, reason="axe-core is not installed")
    return no_axe(pytest.mark.skipif(executable() is None, reason="no chromium on this machine")(test))


PLAN = AnalysisPlan("plan.toml", "A plan", "2026-01-05", "", (Planned(("study",), "people help"),))


@pytest.fixture(scope="module")
def log():
    return random_log(PUBLISHED, people=40)


def made(log, out, date):
    """A quick report on a small study, with its planned results."""
    return build_report(
        data_set(log, kind="simulated"), states="2", quick=True, out=out, parts=False, plan=PLAN, date=date
    )  # fmt: skip


@pytest.fixture(scope="module")
def report(log, tmp_path_factory):
    return made(log, tmp_path_factory.mktemp("report"), DATE)


@pytest.fixture(scope="module")
def comparison(log, tmp_path_factory):
    out = tmp_path_factory.mktemp("comparison")
    write_events(log, out / "other.csv")
    return compare_report(
        "simulated_study1", str(out / "other.csv"), states="2", quick=True, out=out, parts=False
    )  # fmt: skip


def test_same_seed_same_bytes_apart_from_the_date(log, report, tmp_path, monkeypatch):
    # Computed twice, not found in the store.
    monkeypatch.setattr(fits, "store_folder", lambda: tmp_path / "store")
    first = report.html.read_text(encoding="utf-8")
    again = made(log, tmp_path, "2027-02-01").html.read_text(encoding="utf-8")
    assert first != again
    assert first == again.replace("2027-02-01", DATE)


# -- in a browser ----------------------------------------------------------------------------------
def opened(browser, path, width):
    # The page forbids scripts, its own and others'; the checker is one.
    context = browser.new_context(viewport={"width": width, "height": 900}, bypass_csp=True)
    page = context.new_page()
    page.goto(path.as_uri())
    page.evaluate("document.querySelectorAll('details').forEach(d => d.open = true)")
    return page


@shown_by_a_browser
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("which", ["report", "comparison"])
def test_axe_finds_no_violation(browser, request, which, width):
    from axe_playwright_python.sync_playwright import Axe

    page = opened(browser, request.getfixturevalue(which).html, width)
    found = Axe().run(page).response["violations"]
    page.context.close()
    told = [(v["id"], v["impact"], [n["html"][:120] for n in v["nodes"][:3]]) for v in found]
    assert not told


@shown_by_a_browser
@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("which", ["report", "comparison"])
def test_the_page_never_scrolls_sideways_and_what_is_wider_can_be_scrolled(browser, request, which, width):
    page = opened(browser, request.getfixturevalue(which).html, width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    cut = page.evaluate(
        """[...document.querySelectorAll('main *')].filter(e => e.scrollWidth > e.clientWidth + 1
           && e.clientWidth > 0 && getComputedStyle(e).overflowX === 'hidden' && !e.closest('.unseen'))
           .map(e => e.outerHTML.slice(0, 80))"""
    )
    page.context.close()
    assert not cut
