"""Simulation-based calibration: it runs, it is reproducible, and it finds what is wrong."""

import json
from concurrent.futures import CancelledError, ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from threading import Event

import numpy as np
import pytest

from analysis import calibration_replicate
from analysis.calibration import Calibration, CalibrationRun, calibrate
from analysis.calibration_replicate import LARGEST_RANK, CalibrationSettings, Replicate, run_replicate
from analysis.calibration_statistics import quantities
from analysis.cli import main
from analysis.rank_uniformity import FAMILY_WISE, bonferroni, examine, interval_of_ranks, p_values, ranks_of
from analysis.replicates import prior_draw
from analysis.simulate import simulate_study1
from models.errors import InputError
from models.histories import UNSEEN
from models.labels import permute, stationary_distribution
from models.nuts import NutsSettings
from models.parameters import STICKY, DirichletPrior, Layout
from models.protocol import PUBLISHED
from models.study_density import ModelSpec, StudyDensity
from tests.random_cases import random_tables
from tests.reference import recursions

TINY = CalibrationSettings(2, 6, participants=60, sampler=NutsSettings(draws=400, tune=200, chains=2))


# -- the tests of ranks ----------------------------------------------------------------------------------
def synthetic(kind, replicates=200, statistics=18, seed=0):
    """Ranks of a standard normal truth among draws that are right, shifted, too narrow or too wide."""
    rng = np.random.default_rng(seed)
    shift, spread = {"right": (0, 1), "shifted": (0.5, 1), "narrow": (0, 0.6), "wide": (0, 1.7)}[kind]
    truth = rng.normal(size=(replicates, statistics))
    ranks = []
    for row in truth:
        draws = rng.normal(size=(LARGEST_RANK, statistics))
        draws[:, 0] = shift + spread * draws[:, 0]  # only the first statistic is wrong
        ranks.append(ranks_of(row, draws, rng))
    names = [f"s{i}" for i in range(statistics)]
    return examine(np.stack(ranks), LARGEST_RANK, names, np.random.default_rng(1))


@pytest.mark.parametrize("kind", ["shifted", "narrow", "wide"])
def test_a_wrong_posterior_is_found(kind):
    table = synthetic(kind)
    assert bonferroni(table) < FAMILY_WISE
    assert p_values(table).min(axis=1).idxmin() == "s0"
    assert bonferroni(table.drop(index="s0")) > FAMILY_WISE


def test_a_right_posterior_is_hardly_ever_rejected():
    """100 families at a 1% level: 1 expected, 7 and more happen once in 15,000."""
    rejected = sum(bonferroni(synthetic("right", 60, 4, seed)) < FAMILY_WISE for seed in range(100))
    assert rejected <= 6


def test_coverage_counts_ranks_exactly():
    ranks = np.arange(LARGEST_RANK + 1)[:, None]
    table = examine(ranks, LARGEST_RANK, ["all"], np.random.default_rng(0))
    assert table.loc["all", ["mean_rank", "coverage_50", "coverage_90"]].tolist() == [0.5, 0.5, 0.9]
    assert table.loc["all", "p_uniform"] > 0.99
    with pytest.raises(ValueError, match=r"no central interval of level 0\.9 among 13 ranks"):
        interval_of_ranks(0.9, 12)


def test_ranks_count_draws_below_and_break_ties_at_random():
    rng = np.random.default_rng(0)
    draws = np.array([[1.0, 5.0], [2.0, 5.0], [3.0, 5.0]])
    found = np.stack([ranks_of(np.array([2.5, 5.0]), draws, rng) for _ in range(200)])
    assert set(found[:, 0]) == {2}
    assert set(found[:, 1]) == {0, 1, 2, 3}


# -- what is ranked --------------------------------------------------------------------------------------
def test_quantities_do_not_depend_on_the_numbering_of_states():
    rng = np.random.default_rng(3)
    log, layout = simulate_study1(participants=80), Layout(PUBLISHED, 3)
    study = StudyDensity(log, ModelSpec(3))
    tables = random_tables(rng, PUBLISHED, 3)
    names, one = quantities(study, layout.pack(*tables))
    _, two = quantities(study, layout.pack(*permute(np.array([2, 0, 1]), *tables)))
    np.testing.assert_allclose(one, two, rtol=1e-12)
    assert len(names) == len(set(names)) >= 16
    assert one.shape == (len(names),)


def test_quantities_by_hand():
    rng = np.random.default_rng(4)
    log, layout = simulate_study1(participants=80), Layout(PUBLISHED, 2)
    tables = random_tables(rng, PUBLISHED, 2)
    score = log.emission_weights @ tables[2][..., 1] / log.emission_weights.sum()
    initial, transition, emission = tables = permute(np.argsort(score), *tables)
    score = np.sort(score)
    names, values = quantities(StudyDensity(log, ModelSpec(2)), np.tile(layout.pack(*tables), (2, 3, 1)))
    assert values.shape == (2, 3, len(names))
    assert np.ptp(values.reshape(6, -1), axis=0).max() == 0
    found = dict(zip(names, values[0, 0], strict=True))
    runs = [
        list(zip(log.action[b:e].tolist(), log.response[b:e].tolist(), strict=True))
        for b, e in zip(log.offsets, log.offsets[1:], strict=False)
    ]
    index = layout.emission_index
    total = sum(recursions.log_likelihood(run, *tables, index) for run in runs)
    help_, signal = PUBLISHED.action("help"), PUBLISHED.action("signal")
    always = stationary_distribution(transition[help_]) @ score
    wanted = {
        "log-likelihood": total,
        "log-prior": 2 * np.log([np.diag(t) for t in transition]).sum(),
        "expected score, first round": initial @ score,
        "share of the top state at the start": initial[1],
        "probability of staying, mean": np.mean([np.diag(t) for t in transition]),
        "help - no_help, to the top state": np.mean(transition[help_, :, 1] - transition[0, :, 1]),
        "signal - no_signal, to the top state": np.mean(transition[signal, :, 1] - transition[2, :, 1]),
        "signal - no_signal, score at the start": initial @ (emission[1, :, 1] - emission[0, :, 1]),
        "expected score after always help": always,
        "expected score of state 1": score[1],
    }
    for c, condition in enumerate(log.conditions):
        last = []
        for run in np.flatnonzero(log.condition == c):
            belief, events = initial, range(log.offsets[run], log.offsets[run + 1])
            for k in events:
                if log.response[k] != UNSEEN:
                    value = belief @ emission[index[log.action[k]], :, 1]
                belief = belief @ transition[log.action[k]]
            last.append(value)
        wanted[f"expected score, last response, {condition}"] = np.mean(last)
    for name, value in wanted.items():
        assert found[name] == pytest.approx(value, rel=1e-10), name


def test_truths_come_from_the_prior():
    rng = np.random.default_rng(5)
    layout = Layout(PUBLISHED, 2)
    stays = [np.diagonal(prior_draw(layout, STICKY, rng).transition, axis1=1, axis2=2) for _ in range(500)]
    assert np.mean(stays) == pytest.approx(0.75, abs=0.02)


# -- runs ------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def tiny():
    seen = []
    result = calibrate([TINY], progress=lambda *now: seen.append(now))
    return result, seen


def test_a_tiny_run_works(tiny):
    result, seen = tiny
    assert seen == [("calibrating 2 states", i + 1, 6) for i in range(6)]
    run = result.runs[0]
    assert run.ranks.shape == (6, len(run.replicates[0].names))
    assert run.ranks.min() >= 0
    assert run.ranks.max() <= LARGEST_RANK
    assert result.table.index.names == ["states", "statistic"]
    assert "after Bonferroni" in result.sentence
    assert result.to_dict()["runs"][0]["ranks"]["log-likelihood"].shape == (6,)


@pytest.mark.parametrize("pool", [ThreadPoolExecutor, ProcessPoolExecutor])
def test_it_is_reproducible_wherever_it_runs(tiny, pool):
    few = replace(TINY, replicates=3)
    with pool(1) as executor:
        again = calibrate([few], executor=executor)
        assert executor.submit(int, 3).result() == 3  # still open
    assert np.array_equal(again.runs[0].ranks, tiny[0].runs[0].ranks[:3])
    assert [r.min_ess for r in again.runs[0].replicates] == [r.min_ess for r in tiny[0].runs[0].replicates[:3]]


def test_another_seed_is_another_run(tiny):
    other = run_replicate(replace(TINY, seed=2), 0)
    assert not np.array_equal(other.ranks, tiny[0].runs[0].ranks[0])


def test_a_run_that_is_called_off_stops():
    stop = Event()
    stop.set()
    with pytest.raises(CancelledError):
        run_replicate(replace(TINY, sampler=NutsSettings(draws=100_000, tune=100, chains=1)), 0, stop=stop)


def test_too_short_samples_are_doubled(monkeypatch):
    monkeypatch.setattr(calibration_replicate, "MAX_DOUBLINGS", 1)
    short = replace(TINY, sampler=NutsSettings(draws=50, tune=100, chains=2))
    found = run_replicate(short, 0)
    assert found.draws == 100
    assert not found.long_enough


def fake(ranks, ess):
    names = [f"s{i}" for i in range(ranks.shape[1])]
    return tuple(Replicate(names, r, 1000, e, 1.0, 0) for r, e in zip(ranks, ess, strict=True))


def test_short_samples_are_left_out_and_counted():
    ranks = np.random.default_rng(6).integers(0, 100, size=(100, 4))
    ranks[:4] = 0
    ess = np.full(100, 900.0)
    ess[:4] = 3.0
    settings = CalibrationSettings(2, 100)
    result = Calibration((CalibrationRun(settings, fake(ranks, ess)),), 0.0)
    assert result.passed
    assert result.sentence.startswith("Calibrated as far as 96 studies can tell")
    assert "in 4 more the sampler did not converge" in result.sentence
    assert result.adjusted_p_of_all < result.adjusted_p
    ess[4:10] = float("nan")
    too_many = Calibration((CalibrationRun(settings, fake(ranks, ess)),), 0.0)
    assert not too_many.passed
    assert too_many.sentence.startswith("NOT settled by 90 studies")
    with pytest.raises(InputError, match="samples that are long enough: found 0"):
        _ = CalibrationRun(settings, fake(ranks, 0 * ess)).table
    wrong = Calibration((CalibrationRun(settings, fake(ranks // 3, np.full(100, 900.0))),), 0.0)
    assert not wrong.passed
    assert wrong.sentence.startswith("NOT calibrated: ranks of the truths in 100 studies are not uniform")


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: CalibrationSettings(0, 5), "calibration, states: found 0"),
        (lambda: CalibrationSettings(2, 0), "calibration, replicates: found 0"),
        (lambda: CalibrationSettings(2, 5, seed=-1), "calibration, seed: found -1"),
        (lambda: calibrate([TINY, TINY]), r"calibration, states: found \[2, 2\]"),
        (lambda: calibrate([]), "calibration, states"),
    ],
)
def test_refusals(make, message):
    with pytest.raises(InputError, match=message):
        make()


# -- the command -----------------------------------------------------------------------------------------
def test_the_command_writes_its_evidence(tmp_path, capsys):
    out = tmp_path / "calibration.json"
    arguments = ["calibrate", "--replicates", "2", "--participants", "60", "--out", str(out), "--json", "-"]
    with pytest.raises(SystemExit) as stop:
        main(arguments)
    assert not stop.value.code
    captured = capsys.readouterr()
    content = json.loads(out.read_text(encoding="utf-8"))
    assert json.loads(captured.out) == {**content, "out": str(out)}
    assert content["command"] == "prosocial calibrate --states 2 --replicates 2 --participants 60 --seed 1"
    assert {"date", "seed", "kernel_digest", "versions", "sentence", "passed"} <= set(content)
    assert content["runs"][0]["settings"]["replicates"] == 2
    assert content["sentence"] in captured.err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--replicates", "0"), "--replicates: found '0', wanted one positive number"),
        (("--states", "2,3", "--replicates", "5,5,5"), "wanted one positive number, or 2: one for each"),
        (("--states", "two"), "--states: found 'two'"),
        (("--out", "/"), "--out /: found a folder"),
    ],
)
def test_unusable_arguments(arguments, message, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["calibrate", *arguments])
    assert stop.value.code == 2
    assert message in capsys.readouterr().err


# -- for real --------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_posteriors_are_calibrated():
    result = calibrate([CalibrationSettings(2, 40, seed=11)])
    assert result.passed, result.sentence


@pytest.mark.slow
def test_a_prior_that_is_not_the_truths_is_found(monkeypatch):
    """Truths hardly ever stay in a state, posteriors believe that they mostly do."""
    restless = DirichletPrior(transition=3.0)
    right = calibration_replicate.prior_draw
    monkeypatch.setattr(
        calibration_replicate, "prior_draw", lambda layout, prior, rng: right(layout, restless, rng)
    )
    result = calibrate([CalibrationSettings(2, 40, seed=11)])
    assert not result.passed
    assert result.sentence.startswith("NOT calibrated")
