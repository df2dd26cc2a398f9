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
        "Point estimate: ", "maps of the other readings", "Quick. Draws asked, evenly spaced. Policy without a "
        "horizon: 4 about the grid, 2 about discount, scores, belief, prior, 2 about flips, 2 about certainty",
        "Two steps, nothing after them: 20 about the grid", "a horizon, 4 draws, of 80 cells step 0: all agree in ",
        "(all of 4 may still be 47% of the posterior)",
    ):  # fmt: skip
        assert words in said
    keys = {f.key for f in shown.figures}
    assert any(k.startswith("sensitivity-actions-") for k in keys)
    assert any(k.startswith("sensitivity-shares-") for k in keys)
    assert any(k.startswith("sensitivity-critical-") for k in keys)
    assert all(svg.startswith("<svg") for f in shown.figures for svg in f.svgs())


def test_so_few_draws_are_never_called_sure(bundled):
    knowledge = next(t for t in bundled[1].sentences if t.startswith("How many cells are knowledge"))
    endless = knowledge.split("Policy without a horizon")[1].split("Two steps")[0]
    assert " sure" not in endless
    assert "toss" not in endless
    # Twenty draws may disagree, and never be sure.
    rest = knowledge.split("Two steps", 1)[1]
    assert "a toss" in rest
    assert " sure" not in rest
    assert "90%" not in " ".join(t for t in bundled[1].sentences if t.startswith("no horizon"))


def test_a_share_of_few_draws_is_a_count(bundled):
    for table in bundled[1].tables:
        if table.key.rsplit("-", 1)[0] in ("sensitivity-discount", "sensitivity-x", "sensitivity-belief"):
            endless = table.frame[[c for c in table.frame if str(c).startswith("infinite")]]
            assert not endless.astype(str).apply(lambda c: c.str.contains("%")).any().any()
            assert endless.iloc[0].str.contains(" [12]/2$").all()
            assert "no horizon, 2 draws" in [heading for heading, _ in table.groups]


def test_the_legend_of_critical_values_names_the_draws(bundled):
    figure = next(f for f in bundled[1].figures if f.key.startswith("sensitivity-critical-"))
    ax = next(iter(figure.drawn()))
    told = [t.get_text() for t in ax.get_legend().get_texts()]
    assert any("of 2 draws never flip" in t for t in told)
    assert any("of 10 draws never flip" in t for t in told)
    assert max(ax.get_ylim()) < 1.1


def test_printed_findings_stand_beside_what_is_found(bundled):
    table = next(t for t in bundled[1].tables if t.key.startswith("sensitivity-findings-"))
    assert "printed" in table.printed
    assert table.wraps
    assert list(table.frame.columns) == ["printed", "infinite", "two-step", "two-step-terminal"]
    assert [text.split()[2 if i < 2 else 0] for i, text in enumerate(table.frame["printed"])] == [
        "helping", "after", "signalling"
    ]  # fmt: skip
    verdict = "(holds|holds in part|does not hold|cannot be told)"
    for reading, n in (("infinite", "[24]"), ("two-step", "20"), ("two-step-terminal", "20")):
        cell = f"point: {verdict}; draws: (\\d+%? of {n}|cannot be told); truth: {verdict}"
        assert table.frame[reading].str.fullmatch(cell).all()


def test_numbers_of_states_come_with_the_warning(bundled):
    table = next(t for t in bundled[1].tables if t.key == "sensitivity-states")
    assert table.frame["states"].tolist() == [2, 3]
    assert "different currencies" in table.caption
    assert sum("spread evenly and printed nowhere" in text for text in [table.caption, *bundled[1].sentences]) == 1
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
