"""A report on a protocol of one's own, with a reward that was stated for it."""

import json

import numpy as np
import pytest

from analysis.event_files import write_events
from analysis.report.build import build_report
from analysis.report.registry import SECTIONS
from analysis.report.sections import robust, safeguards, sensitivity_own
from models.errors import InputError
from models.planning.exact import solve_schedule
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED, Action, Mode, Protocol, Response
from models.reward import Reward
from tests.analysis.command import run_captured
from tests.analysis.report_cases import data_set, random_log

DEPOT = Protocol(
    "depot",
    (
        Mode("picker_in_need", "P", (Action("pass"), Action("carry", 6.0)), "pass", False),
        Mode("robot_stuck", "S", (Action("wait"), Action("ask", 1.0), Action("thank", 2.0)), "wait", True),
    ),
    (Response("drive_on", 0.0), Response("push", 1.0)),
)
WORTH = Reward.of_values([3.0, 30.0], {"carry": 4.0}, "points")
KEYS = ("provenance", "reward", "plan", "robust", "sensitivity", "safeguards")


@pytest.fixture(scope="module", autouse=True)
def few_draws(short_reports):
    short_reports.setattr(robust, "QUICK_DRAWS", 20)
    short_reports.setattr(robust, "QUICK_REPLICATES", 5)
    short_reports.setattr(safeguards, "QUICK_DRAWS", 8)
    short_reports.setattr(sensitivity_own, "QUICK_ENDLESS_DRAWS", 3)
    short_reports.setattr(sensitivity_own, "QUICK_FEW_DRAWS", 10)


def reported(out, **options):
    chosen = [entry for entry in SECTIONS if entry.key in KEYS]
    log = random_log(DEPOT, people=50, rounds=5)
    return build_report(
        data_set(log, kind="simulated"), states="2", quick=True, out=out, sections=chosen, date="2026-01-31",
        **options,
    )  # fmt: skip


@pytest.fixture(scope="module")
def own(tmp_path_factory):
    return reported(tmp_path_factory.mktemp("report"), reward=WORTH, schedule="PSPS", parts=True)


def section(report, key):
    (found,) = [s for s in report.sections if s.key == key]
    return found


def table(report, key):
    (found,) = [t for s in report.sections for t in s.tables if t.key == key]
    return found.frame


def test_no_planning_section_is_left_out(own):
    assert [s.key for s in own.sections if s.omitted] == []
    assert own.reward.states == (2,)


def test_the_plan_is_made_for_the_stated_reward(own):
    from dataclasses import replace

    model = replace(own.study.fits[2].model, reward=WORTH)
    plan = solve_schedule(Schedule.of(model, "PSPS"))
    values = table(own, "plan-values-2")
    assert values["value"].max() == pytest.approx(plan.value)
    assert any(
        f"The best plan for PSPS is worth {plan.value:.4g} points" in s for s in section(own, "plan").sentences
    )


def test_every_word_is_in_points_and_none_is_the_papers(own):
    page = own.html.read_text(encoding="utf-8")
    assert "reward units" not in page
    for key in KEYS[1:]:
        told = " ".join(section(own, key).sentences)
        assert "human may help" not in told
        assert "r 0.06" not in told
    assert "What a round is worth in each state above the lowest, as stated for this report" in page
    assert table(own, "reward-stated")["worth"].tolist() == pytest.approx([0, 27])
    costs = table(own, "reward-costs").set_index("action")["cost"]
    assert costs.to_dict() == {"pass": 0, "carry": 4, "wait": 0, "ask": 1, "thank": 2}


def test_figures_are_in_points_and_keep_their_makers(own):
    index = (own.parts.folder / "index.csv").read_text(encoding="utf-8")
    assert "figures.robust.plan_comparison" in index
    assert "drawn_in_unit" not in index


def test_the_arms_of_the_data_are_a_next_study(own):
    studies = table(own, "robust-next-2")["study"].tolist()
    assert [s.partition(" over")[0] for s in studies] == ["the same 2 arms", "random actions"]


def test_limits_are_counted_in_the_costliest_action(own):
    assert any("a budget of 8 points a person" in s for s in section(own, "safeguards").sentences)


def test_everything_that_was_stated_is_moved(own):
    rows = {kind: table(own, f"sensitivity-{kind}-2") for kind in ("cost", "worth", "discount", "belief", "beside")}
    assert "costs of robot stuck x 2" in set(rows["cost"]["variant"])
    assert {"all states x 0.5", "s0 -6.75", "s1 +6.75"} <= set(rows["worth"]["variant"])
    assert len(rows["beside"]) == 2


def test_methods_say_what_was_done(own):
    told = (own.parts.folder / "methods.txt").read_text(encoding="utf-8")
    assert (
        "What a round is worth in each state was stated by us and not learned (0, 27 with 2 states, in points)"
        in told
    )
    assert "3 without a horizon, 10 otherwise" in told
    assert "a budget of 8 points a person that no history exceeds" in told
    assert "in 8 evenly spaced draws of the posterior" in told
    assert "policies over PSPS" in told


def test_without_a_reward_it_is_said_how_to_state_one(tmp_path):
    report = reported(tmp_path)
    for key in KEYS[2:]:
        assert "`--values`" in section(report, key).omitted
    assert (
        "none: nobody said"
        in table(report, "data").set_index("item").loc["reward that plans are made for", "value"]
    )
    with pytest.raises(InputError, match="schedule: found 'PS', wanted none"):
        reported(tmp_path, schedule="PS")


def test_the_command(tmp_path, capsys, monkeypatch):
    from analysis.report import build, registry

    (tmp_path / "depot.toml").write_text(DEPOT.to_toml())
    write_events(random_log(DEPOT, people=50, rounds=5), tmp_path / "log.csv")
    few = [entry for entry in SECTIONS if entry.key in ("provenance", "reward")]
    monkeypatch.setattr(
        build.build_report, "__kwdefaults__", {**build.build_report.__kwdefaults__, "sections": few}
    )
    assert registry.SECTIONS is SECTIONS
    words = ("report", "--data", tmp_path / "log.csv", "--protocol", tmp_path / "depot.toml", "--states", "2",
             "--quick", "--no-parts", "--out", tmp_path / "out")  # fmt: skip
    more = ("--values", "3,30", "--unit", "points", "--cost", "carry=4", "--schedule", "PSPS", "--json", "-")
    status, out, err = run_captured(capsys, *words, *more)
    assert status == 0, err
    content = json.loads(out)
    assert content["reward"]["values"] == {"2": pytest.approx([0, 27])}
    assert (content["reward"]["unit"], content["reward"]["schedule"]) == ("points", "PSPS")
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "--values 3,30 --cost carry=4 --unit points --schedule PSPS" in page
    for option in (("--unit", "points"), ("--cost", "carry=4"), ("--schedule", "PSPS")):
        status, _, err = run_captured(capsys, *words, *option)
        assert (status, err.startswith(f"prosocial: {option[0]}: found ")) == (2, True)
        assert "it belongs to --values" in err
    status, _, err = run_captured(capsys, *words, "--values", "1,2,3")
    assert (status, "reward, numbers of states: found '3', wanted one of those fitted: 2" in err) == (2, True)


def test_the_published_protocol_keeps_the_printed_reward_unless_another_is_stated(tmp_path):
    chosen = [entry for entry in SECTIONS if entry.key == "reward"]
    data = data_set(random_log(PUBLISHED, people=40, rounds=4), kind="simulated")
    printed = build_report(data, states="2", quick=True, out=tmp_path, sections=chosen)
    assert "printed in the paper" in printed.sections[0].sentences[0]
    stated = build_report(
        data,
        states="2",
        quick=True,
        out=tmp_path,
        sections=chosen,
        reward={2: Reward.of_values(np.array([0.0, 9.0]))},
    )
    assert "0, 9 with 2 states (reward units)" in stated.sections[0].sentences[0]
