"""Stored evidence: what a file holds, when it is stale, how the report shows it, and that it can be repeated."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from analysis import calibration_replicate, evidence
from analysis.calibration import calibrate
from analysis.calibration_replicate import CalibrationSettings
from analysis.cli_options import plain
from analysis.datasets import log_digest
from analysis.design import published
from analysis.evidence import Evidence, read_evidence, record
from analysis.recovery import recover
from analysis.recovery_study import RecoverySettings, run_study
from analysis.report.context import ReportContext
from analysis.report.section import NotSupported, Omitted, Origin, Section
from analysis.report.sections import evidence as section
from analysis.simulate import calibrated_truth, simulate_study1
from models.compiled import kernel_digest, kernel_sources
from models.errors import InputError
from models.nuts import NutsSettings
from models.person_offset import PersonOffset
from models.protocol import PUBLISHED
from models.smc import SmcSettings
from tests.analysis.report_cases import CORRIDOR, random_log

CALIBRATION = CalibrationSettings(2, 3, participants=80, sampler=NutsSettings(60, 60, 2))
PEOPLE = CalibrationSettings(
    1, 3, participants=20, sampler=NutsSettings(60, 60, 2), people=PersonOffset(), runs_per_person=2
)
STORED = ("calibration", "calibration_people", "recovery")
RECOVERY = RecoverySettings(
    (1, 2), 3, participants=80, true_states=2, sampler=NutsSettings(60, 60, 2), restarts=4, finalists=2,
    select=True, evidence=SmcSettings(30, 1, moves=1),
)  # fmt: skip


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """A folder with tiny evidence, made by the present code."""
    folder = tmp_path_factory.mktemp("evidence")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(calibration_replicate, "MIN_ESS", 0)  # long samples are not what is tested here
        made = {
            "calibration": calibrate([CALIBRATION]).to_dict(), "calibration_people": calibrate([PEOPLE]).to_dict(),
            "recovery": recover(RECOVERY).to_dict(),
        }  # fmt: skip
    for name in STORED[:2]:
        made[name]["runs"][0]["min_ess"] = [500.0, 500.0, 3.0]
    for name, result in made.items():
        content = plain(record("A tiny run: simulated.", f"prosocial {name} --seed 1", 1, result))
        (folder / f"{name}.json").write_text(json.dumps(content))
    return folder


class Context(SimpleNamespace):
    is_published_schedule = ReportContext.is_published_schedule


def context_of(log):
    return Context(
        log=log, protocol=log.protocol, is_published_protocol=log.protocol == PUBLISHED, published=published()
    )


# -- files ---------------------------------------------------------------------------------------------
def test_fresh_evidence_is_not_stale(results):
    found = read_evidence("recovery", results)
    assert found.changes == []
    assert not found.stale
    assert "by 'prosocial recovery --seed 1', with the code and versions of this report." in found.provenance
    assert found.sentence.startswith("3 simulated studies of 80 people")


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"kernel_digest": "0123"}, "compiled code 0123, now "),
        ({"modules": ["models.gone"]}, "now none (models.gone is not in this checkout)"),
        ({"versions": {"numpy": "1.0"}}, "numpy 1.0, now "),
        ({"versions": {}}, "nutpie unknown, now "),
    ],
)
def test_evidence_of_other_code_is_called_stale(results, change, told):
    found = read_evidence("recovery", results)
    old = Evidence(found.path, {**found.content, **change})
    assert old.stale
    assert told in "; ".join(old.changes)
    assert "STALE: made with other code or versions than this report" in old.provenance
    assert "'make evidence' makes it anew" in old.provenance


def test_only_code_that_the_result_rests_on_counts(results):
    """Kernels of other models and of the PyMC front door do not; what is unknown rests on everything."""
    found = read_evidence("recovery", results)
    assert found.content["modules"] == list(evidence.ENGINE)
    rests_on = {path.stem for path in kernel_sources(*evidence.ENGINE)}
    used = {path.stem for path in kernel_sources("analysis.calibration", "analysis.recovery")}
    assert used - rests_on <= {"likelihood_op", "simplex_op"}
    assert {"hmm_density", "people_kernel", "simulation", "predictive", "em_kernel", "smc"} <= rests_on
    assert not [name for name in rests_on if name.startswith("glmm")]
    content = {key: value for key, value in found.content.items() if key != "modules"}
    assert Evidence(found.path, content).stale
    assert not Evidence(found.path, {**content, "kernel_digest": kernel_digest()}).stale


def test_a_date_that_is_missing_is_said(results):
    found = read_evidence("recovery", results)
    content = {key: value for key, value in found.content.items() if key != "date"}
    assert "Made on a date that was not recorded by" in Evidence(found.path, content).provenance


def test_absent_and_unusable_files(tmp_path):
    assert read_evidence("nothing", tmp_path) is None
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(InputError, match=r"bad\.json: not readable evidence"):
        read_evidence("bad", tmp_path)
    (tmp_path / "other.json").write_text('{"what": "x"}')
    with pytest.raises(InputError, match=r"other\.json, keys that are missing: found 'command, seed, kernel_"):
        read_evidence("other", tmp_path)


# -- in the report -------------------------------------------------------------------------------------
def shown(log, monkeypatch, folder):
    monkeypatch.setattr(evidence, "FOLDER", folder)
    return Section("t", "k", section.make(context_of(log)))


def test_the_report_shows_stored_evidence_as_simulated(results, monkeypatch):
    made = shown(simulate_study1(participants=60), monkeypatch, results)
    assert {origin for block in (*made.tables, *made.figures) for origin in block.origin} == {Origin.SIMULATED}
    assert {table.key for table in made.tables} == {
        "calibration-runs", "calibration-statistics", "calibration-people-runs", "calibration-people-statistics",
        "recovery-every",
    }  # fmt: skip
    assert [len(figure.svgs()) for figure in made.figures] == [1, 1, 3]
    text = " ".join(made.sentences)
    assert "SIMULATED people whose truth is known" in text
    plain, people, _ = (figure.caption for figure in made.figures)
    assert "People differ by an offset, with 2 runs each" in people
    assert "People differ" not in plain
    for name in STORED:
        assert read_evidence(name, results).sentence in text
        assert f"by 'prosocial {name} --seed 1', with the code and versions of this report" in text
    runs = [table for table in made.tables if table.key.endswith("-runs")]
    assert [table.frame[["studies", "left out"]].to_numpy().tolist() for table in runs] == 2 * [[[3, 1]]]


def test_stale_evidence_is_a_warning(results, monkeypatch, tmp_path):
    for path in results.iterdir():
        content = json.loads(path.read_text()) | {"kernel_digest": "0123"}
        (tmp_path / path.name).write_text(json.dumps(content))
    made = shown(simulate_study1(participants=60), monkeypatch, tmp_path)
    warned = [block.text for block in made.flat() if getattr(block, "kind", "") == "warning"]
    assert sum("STALE" in text for text in warned) == 3


def test_absent_evidence_is_said_to_be_absent(monkeypatch, tmp_path):
    made = shown(simulate_study1(participants=60), monkeypatch, tmp_path)
    left_out = [block for block in made.flat() if isinstance(block, Omitted)]
    assert [block.what for block in left_out] == [
        "evidence of calibration", "evidence of calibration where people differ", "evidence of recovery",
        "evidence of plans in simulated truths",
    ]  # fmt: skip
    assert "make evidence" in left_out[0].reason


@pytest.mark.parametrize("protocol", [PUBLISHED, CORRIDOR])
def test_other_designs_are_not_supported(protocol):
    with pytest.raises(NotSupported, match="this study has another"):
        section.make(context_of(random_log(protocol, people=20)))


# -- what is stored ------------------------------------------------------------------------------------
@pytest.mark.parametrize(("name", "wanted"), [("calibration", {2: 200, 3: 100}), ("calibration_people", {2: 100})])
def test_stored_evidence_is_complete_and_passed(name, wanted):
    found = read_evidence(name)
    assert found.content["passed"] is True
    sizes = {run["settings"]["states"]: run["settings"]["replicates"] for run in found.content["runs"]}
    assert all(sizes[states] >= replicates for states, replicates in wanted.items())
    assert min(len(run["statistics"]) for run in found.content["runs"]) >= 8
    differ = [run["settings"]["people"] is not None for run in found.content["runs"]]
    assert differ == len(wanted) * [name == "calibration_people"]


@pytest.mark.slow
@pytest.mark.parametrize("name", STORED)
def test_a_slice_of_stored_evidence_comes_out_again(name):
    """The first study, made anew: data and maximum exactly, what is sampled within its Monte Carlo error."""
    found = read_evidence(name)
    if found is None or found.stale:
        pytest.skip(f"evidence of {name} is absent or was made with other code: run `make evidence`")
    if name != "recovery":
        stored = found.content["runs"][0]
        own = stored["settings"]
        settings = CalibrationSettings(
            own["states"], 1, own["participants"], seed=own["seed"], runs_per_person=own["runs_per_person"],
            people=None if own["people"] is None else PersonOffset(**own["people"]),
        )  # fmt: skip
        again = calibrate([settings]).runs[0].replicates[0]
        ranks = np.array([stored["ranks"][statistic][0] for statistic in again.names])
        assert np.abs(ranks - again.ranks).max() < 35  # of 100; two samples of 400 apart by more is one in 10^6
        return
    own = found.content["settings"]
    truth = None if own["truth"] is None else calibrated_truth()
    study = run_study(
        RecoverySettings((2,), 1, own["participants"], truth, own["true_states"], seed=own["seed"]), 0
    )
    (stored,) = [fit for fit in found.content["fits"] if fit["states"] == 2]
    np.testing.assert_allclose(study[2].truth, stored["truth"][0], atol=1e-6)
    np.testing.assert_allclose(study[2].em, stored["em"][0], atol=1e-4)
    np.testing.assert_allclose(study[2].mean, stored["mean"][0], atol=0.05)


def test_logs_of_one_seed_are_one_log():
    """What the slice above leans on."""
    first, second = (simulate_study1(participants=50, seed=3) for _ in range(2))
    assert log_digest(first) == log_digest(second)
    assert replace(RECOVERY, replicates=1).seed == RECOVERY.seed
