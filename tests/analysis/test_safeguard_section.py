"""The report's section on safeguards."""

import pytest

from analysis import datasets
from analysis.report.build import build_report
from analysis.report.registry import Entry
from analysis.report.section import Omitted, Points
from analysis.report.sections import safeguards
from analysis.simulate import simulate_study1
from models.reward import Reward
from tests.analysis.report_cases import CORRIDOR, data_set, little_effort, random_log

ONLY = [Entry("safeguards", "What safeguards change", safeguards.make)]


@pytest.fixture(scope="module", autouse=True)
def little():
    with pytest.MonkeyPatch.context() as patch:
        little_effort(patch)
        patch.setattr(safeguards, "QUICK_DRAWS", 12)
        yield


def section(data, out, states):
    made = build_report(data, states=states, quick=True, out=out, sections=ONLY, date="2026-01-31")
    return made.sections[0]


@pytest.fixture(scope="module")
def bundled(tmp_path_factory):
    return section(datasets.load("simulated_study1"), tmp_path_factory.mktemp("bundled"), (2,))


def test_what_is_asked_is_answered(bundled):
    said = " ".join(bundled.sentences)
    points = " ".join(p for b in bundled.flat() if isinstance(b, Points) for p in b.items)
    for words in ("Influence is how many times", "a budget of 30 reward units", "These settings are examples"):
        assert words in said
    for words in ("moves a person", "Within a budget of 30", "Round 1:", "Without consent:"):
        assert words in said + points
    assert {f.key for f in bundled.figures} == {f"safeguards-{k}-2" for k in ("cost", "strict", "who")}
    assert all(svg.startswith("<svg") for f in bundled.figures for svg in f.svgs())


def test_table(bundled):
    frame = next(t for t in bundled.tables if t.key == "safeguards-table-2").frame
    budget = frame[frame["safeguards"] == "all together"]
    assert (budget["most_cost"] <= 30).all()
    assert (frame["influence_low"] <= frame["influence_high"]).all()
    assert frame.loc[0, "policy"] == "Bayes-adaptive plan"
    assert (frame["influence"] >= 0).all()


def test_a_plan_that_never_acts_gives_no_empty_frames(tmp_path):
    hardly = Reward.of_values([0.0, 0.01], {"help": 15.0, "signal": 5.0})
    made = build_report(
        data_set(simulate_study1(participants=40), kind="simulated"), states=(2,), quick=True, out=tmp_path,
        sections=ONLY, date="2026-01-31", reward=hardly,
    ).sections[0]  # fmt: skip
    assert [f.key for f in made.figures] == ["safeguards-cost-2"]
    left = next(block for block in made.flat() if isinstance(block, Omitted))
    assert "leaves people as they would be if left alone" in left.reason


def test_one_state_and_other_protocols_are_left_out(tmp_path):
    one = section(data_set(simulate_study1(participants=40), kind="simulated"), tmp_path / "one", (1,))
    assert one.blocks == ()
    assert "nobody is moved anywhere" in one.omitted
    other = section(data_set(random_log(CORRIDOR, people=30)), tmp_path / "other", (2,))
    assert "what a round is worth is not known" in other.omitted


def test_a_study_without_signals_leaves_them_out(tmp_path):
    log = simulate_study1(participants=80, seed=3)
    quiet = [c for c in log.conditions if "no-signal" in c]
    shown = section(data_set(log.select(conditions=quiet), kind="simulated"), tmp_path, (2,))
    assert "Left out: signal." in " ".join(shown.sentences)
