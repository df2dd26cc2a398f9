"""The report in a real browser: accessible by axe-core's rules, nothing cut, at desktop and phone width."""

import pytest

from analysis import fits
from analysis.report.build import build_report
from analysis.report.compare import compare_report
from models.protocol import PUBLISHED
from tests.analysis.report_cases import data_set, little_effort, random_log
from tests.browser import executable

axe_playwright = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe-core is not installed")
# Asked before the reports are made, which takes longer than everything else.
pytestmark = pytest.mark.skipif(executable() is None, reason="no chromium on this machine")
WIDTHS = (1280, 390)


@pytest.fixture(scope="module", autouse=True)
def own_store(tmp_path_factory):
    folder = tmp_path_factory.mktemp("store")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fits, "store_folder", lambda: folder)
        little_effort(patch)
        yield


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """A quick report on a small study, with its planned results, and a comparison."""
    from analysis.event_files import write_events
    from analysis.report.analysis_plan import AnalysisPlan, Planned

    out = tmp_path_factory.mktemp("pages")
    log = random_log(PUBLISHED, people=40)
    plan = AnalysisPlan("plan.toml", "A plan", "2026-01-05", "", (Planned(("study",), "people help"),))
    report = build_report(data_set(log, kind="simulated"), states="2", quick=True, out=out, parts=False, plan=plan)
    write_events(log, out / "other.csv")
    pair = compare_report(
        "simulated_study1", str(out / "other.csv"), states="2", quick=True, out=out, parts=False
    )  # fmt: skip
    return {"report": report.html, "comparison": pair.html}


def opened(browser, path, width):
    # The page forbids scripts, its own and others'; the checker is one.
    context = browser.new_context(viewport={"width": width, "height": 900}, bypass_csp=True)
    page = context.new_page()
    page.goto(path.as_uri())
    page.evaluate("document.querySelectorAll('details').forEach(d => d.open = true)")
    return page


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("which", ["report", "comparison"])
def test_axe_finds_no_violation(browser, pages, which, width):
    page = opened(browser, pages[which], width)
    found = axe_playwright.Axe().run(page).response["violations"]
    page.context.close()
    told = [(v["id"], v["impact"], [n["html"][:120] for n in v["nodes"][:3]]) for v in found]
    assert not told


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("which", ["report", "comparison"])
def test_the_page_never_scrolls_sideways_and_what_is_wider_can_be_scrolled(browser, pages, which, width):
    page = opened(browser, pages[which], width)
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    cut = page.evaluate(
        """[...document.querySelectorAll('main *')].filter(e => e.scrollWidth > e.clientWidth + 1
           && e.clientWidth > 0 && getComputedStyle(e).overflowX === 'hidden' && !e.closest('.unseen'))
           .map(e => e.outerHTML.slice(0, 80))"""
    )
    page.context.close()
    assert not cut
