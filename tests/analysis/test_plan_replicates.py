"""Plans valued in simulated truths: what a replicate holds, and that it can be repeated."""

import json

import numpy as np
import pytest

from analysis.cli import main
from analysis.plan_replicates import (
    BAYES,
    CAUTIOUS,
    PLUG_IN,
    SETTINGS,
    PlanReplicates,
    replicate_plans,
    run_truth,
)
from models.errors import InputError
from models.nuts import NutsSettings

TINY = PlanReplicates(
    replicates=3, participants=60, schedule="HRHR", sampler=NutsSettings(60, 60, 2), restarts=8, seed=4
)


@pytest.fixture(scope="module")
def report():
    return replicate_plans(TINY)


def test_nothing_is_worth_more_than_the_optimum(report):
    for result in report.results:
        assert set(result.values) == set(SETTINGS)
        for values in result.values.values():
            assert {BAYES, PLUG_IN, CAUTIOUS, "never", "always"} < set(values)
            assert max(values.values()) <= values["optimum"] + 1e-9


def test_a_replicate_depends_on_its_index_only(report):
    again = run_truth(TINY, 2)
    assert again.values == report.results[2].values


def test_rows_follow_from_values(report):
    for row in report.rows():
        v, base = report.values(row["setting"], row["plan"]), report.values(row["setting"], PLUG_IN)
        assert row["mean"] == pytest.approx(v.mean())
        assert row["gain"] == pytest.approx((v - base).mean())
        assert row["gain_low"] <= row["gain"] <= row["gain_high"]
        # Three truths: the worst tenth is the worst of them.
        assert row["tail"] == pytest.approx(v.min())


def test_a_plan_does_not_differ_from_itself(report):
    assert report.tail_difference(SETTINGS[0], BAYES, BAYES) == (0.0, 0.0, 0.0)
    low, high = report.tail_difference(SETTINGS[0], CAUTIOUS, "always")[1:]
    assert low <= high


@pytest.mark.parametrize(("change", "match"), [({"alpha": 0.0}, "alpha"), ({"replicates": 1}, "replicates")])
def test_settings_that_are_none(change, match):
    with pytest.raises(InputError, match=match):
        PlanReplicates(**change)


def test_the_command_writes_what_is_needed_to_repeat_it(tmp_path, monkeypatch, report):
    monkeypatch.setattr("analysis.plan_replicates.replicate_plans", lambda settings, **how: report)
    out = tmp_path / "plans.json"
    with pytest.raises(SystemExit) as stop:
        main(["replicate", "plans", "--replicates", "3", "--quiet", "--out", str(out)])
    assert not stop.value.code
    content = json.loads(out.read_text())
    assert content["command"].startswith("prosocial replicate plans --states 2 --replicates 3")
    assert "simulated" in content["what"]
    assert len(content["table"]) == len(report.rows())
    assert np.isfinite([row["mean"] for row in content["table"]]).all()
