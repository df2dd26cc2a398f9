"""The report's section on planning under doubt, and its figures."""

import json

import numpy as np
import pytest

from analysis import datasets, evidence
from analysis.figures.robust import caution, plan_comparison, stability_tree, value_distributions
from analysis.policy_study import STUDY2
from analysis.report.build import build_report
from analysis.report.registry import SECTIONS
from analysis.report.sections import evidence as evidence_section
from analysis.report.sections import robust, robust_endless
from analysis.simulate import simulate_study1
from models.planning.exact import solve_schedule
from models.planning.schedule import Schedule
from models.robust.candidates import standard_candidates
from models.robust.contested import contested
from models.robust.frontier import frontier
from models.robust.pricing import price
from models.robust.stability import decision_stability
from tests.analysis.report_cases import CORRIDOR, data_set, little_effort, random_log
from tests.planning_cases import sticky_draws

ONLY = [e for e in SECTIONS if e.key == "robust"]


@pytest.fixture(scope="module", autouse=True)
def little():
    with pytest.MonkeyPatch.context() as patch:
        little_effort(patch)
        patch.setattr(robust, "QUICK_DRAWS", 40)
        patch.setattr(robust, "QUICK_REPLICATES", 4)
        patch.setattr(robust_endless, "QUICK_DRAWS", 6)
        yield


def section(data, out, states):
    made = build_report(data, states=states, quick=True, out=out, sections=ONLY, date="2026-01-31")
    return made, made.sections[0]


@pytest.fixture(scope="module")
def bundled(tmp_path_factory):
    return section(datasets.load("simulated_study1"), tmp_path_factory.mktemp("bundled"), (2,))


def test_what_is_asked_is_answered(bundled):
    _, shown = bundled
    said = " ".join(shown.sentences)
    for words in (
        "first is right in", "being wrong there costs", "all doubt together costs", "Perfect knowledge",
        "Without an end", "the draws are most divided", "an upper bound on EVPI",
        "40 draws are too few to say what single blocks",
    ):  # fmt: skip
        assert words in said
    for words in ("against never helping", "Listening to responses", "Caution", "Quick: 40 draws"):
        assert words in said or any(words in b.lead for b in shown.flat() if hasattr(b, "lead"))
    keys = {f.key for f in shown.figures}
    wanted = {"tree", "values", "comparison", "caution", "blocks", "studies", "walk", "along", "endless"}
    assert {f"robust-{k}-2" for k in wanted} <= keys
    captions = {f.key: f.caption for f in shown.figures}
    assert "Every point is certified" in captions["robust-caution-2"]
    # Costs of a mode whose decision never flips are no contested ones, and the caption names the others.
    assert ("Contested costs: those at which" in captions["robust-caution-2"]) is any(
        "contested costs" in b for b in shown.sentences
    )
    told = next(t for t in shown.tables if t.key == "robust-next-2").frame
    assert (told["enough"] == "yes").tolist() == (told["effective"] >= 100).tolist()
    assert all(svg.startswith("<svg") for f in shown.figures for svg in f.svgs())


def test_no_plan_of_the_table_beats_the_exact_ones(bundled):
    frame = next(t for t in bundled[1].tables if t.key == "robust-plans-2").frame.set_index("name")
    assert frame["mean"].max() == pytest.approx(frame.loc["Bayes-adaptive", "mean"])
    assert frame["cvar"].max() == pytest.approx(frame.loc["cautious", "cvar"])
    compared = next(t for t in bundled[1].tables if t.key == "robust-regrets-2").frame.set_index("name")
    assert compared["max_regret"].min() == pytest.approx(compared.loc["minimax regret", "max_regret"])
    assert compared["cvar_regret"].min() == pytest.approx(compared.loc["cautious regret", "cvar_regret"])
    assert compared["gain_cvar"].max() == pytest.approx(compared.loc["cautious gain", "gain_cvar"])
    assert "plug-in estimate" in frame.index


def test_a_study_without_signals_leaves_them_out(tmp_path):
    log = simulate_study1(participants=80, seed=3)
    quiet = [c for c in log.conditions if "no-signal" in c]
    _, shown = section(data_set(log.select(conditions=quiet), kind="simulated"), tmp_path, (2,))
    said = " ".join(shown.sentences)
    assert "Left out: signal." in said
    assert "help+signal" not in said


def test_one_state_and_other_protocols_are_left_out(tmp_path):
    _, shown = section(data_set(simulate_study1(participants=40), kind="simulated"), tmp_path / "one", (1,))
    assert shown.blocks == ()
    assert "nothing the robot does changes anybody" in shown.omitted
    _, other = section(data_set(random_log(CORRIDOR, people=30)), tmp_path / "other", (2,))
    assert "what a round is worth is not known" in other.omitted


def test_plans_in_truth_are_shown_as_stored(tmp_path, monkeypatch, bundled):
    row = {
        "setting": "published costs", "plan": "Bayes-adaptive", "mean": 1.0, "tail": 0.5, "mean_regret": 0.1,
        "tail_regret": 0.2, "gain": 0.3, "gain_low": -0.1, "gain_high": 0.7,
    }  # fmt: skip
    content = evidence.record("Plans in simulated truths.", "prosocial replicate plans", 1,
                              {"table": [row], "sentence": "What came of it."})  # fmt: skip
    monkeypatch.setattr(evidence, "FOLDER", tmp_path)
    (tmp_path / "plans_in_truth.json").write_text(json.dumps(content))
    found = evidence.read_evidence("plans_in_truth", tmp_path)
    (table,) = evidence_section._plans_in_truth(found)
    assert table.frame.loc[0, "gain"] == 0.3


@pytest.mark.parametrize("letters", ["H", "RHR", STUDY2])
def test_figures_draw_whatever_the_schedule(letters):
    schedule = Schedule.of(sticky_draws(8, 3), letters)
    prices = price(schedule, standard_candidates(schedule))
    tree = stability_tree(decision_stability(schedule, solve_schedule(schedule)))
    boxes = [t.get_text() for t in tree.texts]
    assert len(boxes) == len(decision_stability(schedule, solve_schedule(schedule)).standings)
    shown = plan_comparison(prices)
    assert [t.get_text() for t in shown.get_yticklabels()][-1] in {p.name for p in prices.prices}
    curves = value_distributions({p.name: p.values for p in prices.prices[:3]}, schedule.draws.weight)
    for line, p in zip(curves.lines, prices.prices, strict=False):
        x, y = line.get_data()
        assert np.all(np.diff(x) >= 0)
        half = np.interp(0.5, y, x)
        assert p.values.min() - 1e-9 <= half <= p.values.max() + 1e-9
    both = {"these": frontier(schedule, (1.0, 0.2)), "contested": frontier(contested(schedule)[0], (1.0, 0.2))}
    figure = caution(both)
    assert [len(ax.lines) for ax in figure.axes] == [2, 2]
