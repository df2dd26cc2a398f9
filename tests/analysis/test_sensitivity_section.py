"""The report's section on what decisions depend on."""

import pytest

from analysis import datasets
from analysis.report.build import build_report
from analysis.report.registry import Entry
from analysis.report.section import Omitted, Part
from analysis.report.sections import sensitivity
from analysis.sensitivity import SensitivityEffort
from tests.analysis.report_cases import CORRIDOR, data_set, little_effort, random_log

ONLY = [Entry("sensitivity", "What decisions depend on", sensitivity.make)]


@pytest.fixture(scope="module", autouse=True)
def little():
    with pytest.MonkeyPatch.context() as patch:
        little_effort(patch)
        effort = SensitivityEffort(4, 2, 2, 2, few_draws=20, few_critical=10, scan=9, endless_scan=5, moved=False)
        patch.setattr(sensitivity, "QUICK", effort)
        yield


def section(data, out, states):
    made = build_report(data, states=states, quick=True, out=out, sections=ONLY, date="2026-01-31", parts=False)
    return made, made.sections[0]


@pytest.fixture(scope="module")
def bundled(tmp_path_factory):
    return section(datasets.load("simulated_study1"), tmp_path_factory.mktemp("bundled"), (2, 3))


def test_what_is_said(bundled):
    _, shown = bundled
    said = " ".join(shown.sentences)
    for words in (
        "It prints neither a discount", "different currencies", "How many cells are knowledge",
        "Point estimate: ", "Quick. Draws asked, evenly spaced: 4 for policy without a horizon",
        "maps of the other readings",
    ):  # fmt: skip
        assert words in said
    keys = {f.key for f in shown.figures}
    assert any(k.startswith("sensitivity-actions-") for k in keys)
    assert any(k.startswith("sensitivity-shares-") for k in keys)
    assert any(k.startswith("sensitivity-critical-") for k in keys)
    assert all(svg.startswith("<svg") for f in shown.figures for svg in f.svgs())


def test_printed_findings_stand_beside_what_is_found(bundled):
    table = next(t for t in bundled[1].tables if t.key.startswith("sensitivity-findings-"))
    assert "printed" in table.printed
    assert len(table.frame) == 9
    assert {"estimate", "draws", "share", "truth"} <= set(table.frame.columns)
    told = {"holds", "holds in part", "does not hold", "cannot be told"}
    assert set(table.frame["truth"]) <= told


def test_numbers_of_states_come_with_the_warning(bundled):
    table = next(t for t in bundled[1].tables if t.key == "sensitivity-states")
    assert table.frame["states"].tolist() == [2, 3]
    assert "different currencies" in table.caption
    assert not any("value" in str(c) for c in table.frame.columns)


def test_every_kind_of_variant_has_a_table(bundled):
    keys = {t.key.rsplit("-", 1)[0] for t in bundled[1].tables}
    assert {"sensitivity-discount", "sensitivity-x", "sensitivity-belief", "sensitivity-beside"} <= keys
    beside = next(t for t in bundled[1].tables if t.key.startswith("sensitivity-beside"))
    assert {"kappa 0", "kappa 5"} <= set(beside.frame["variant"])


def test_other_protocols_are_told_why(tmp_path):
    _, shown = section(data_set(random_log(CORRIDOR)), tmp_path, (2,))
    assert "what a round is worth is not known" in str(shown.omitted)
    assert not [b for b in shown.flat() if isinstance(b, Part | Omitted)]
