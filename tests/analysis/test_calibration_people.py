"""Calibration where people differ: truths with sigma, offsets shared between runs, what is ranked, and power."""

import json
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal, stats
from scipy.integrate import quad

from analysis import calibration_replicate
from analysis.calibration import calibrate
from analysis.calibration_replicate import LARGEST_RANK, CalibrationSettings, run_replicate, thinned
from analysis.calibration_statistics import quantities
from analysis.cli import main
from analysis.design import study1_design
from analysis.rank_uniformity import FAMILY_WISE, bonferroni, examine, ranks_of
from analysis.replicates import prior_draw, prior_spread, several_runs, simulated_study
from models.draw_kernels import constrained, person_log_likelihoods
from models.errors import InputError
from models.events import EventLog
from models.gate import MIN_ESS, convergence_gate
from models.histories import UNSEEN
from models.labels import permute
from models.lspomdp import LatentStatePOMDP
from models.nuts import NutsSettings
from models.parameters import STICKY, Layout
from models.person_offset import PersonOffset, each_person
from models.protocol import PUBLISHED
from models.simulation import simulate_responses
from models.smc import prior_particles
from models.study_density import ModelSpec, StudyDensity
from tests.random_cases import random_tables
from tests.reference import people as reference

TINY = CalibrationSettings(
    1, 4, 30, sampler=NutsSettings(draws=200, tune=150, chains=2), people=PersonOffset(), runs_per_person=2
)


# -- truths and studies ----------------------------------------------------------------------------------
def test_sigma_comes_from_its_prior_and_that_is_the_densitys():
    rng = np.random.default_rng(1)
    drawn = [prior_spread(PersonOffset(0.7), rng) for _ in range(4000)]
    assert stats.kstest(drawn, stats.halfnorm(scale=0.7).cdf).pvalue > 0.001
    log = simulated_study(prior_draw(Layout(PUBLISHED, 2), STICKY, rng), 20, "s", rng, runs=2, spread=0.5)
    density = StudyDensity(log, ModelSpec(2, people=PersonOffset(0.7))).density
    theirs = constrained(density, prior_particles(density, 4000, rng))[:, -1]
    assert stats.ks_2samp(drawn, theirs).pvalue > 0.001


def test_several_runs_keep_the_condition_and_change_the_schedule():
    log = several_runs(97, 3, "s", np.random.default_rng(2))
    assert log.n_runs == 3 * 97
    by_person = log.condition.reshape(97, 3)
    assert np.all(by_person == by_person[:, :1])
    sizes = dict(zip((c.name for c in study1_design().conditions), study1_design().allocation(97), strict=True))
    assert [sizes[name] for name in log.conditions] == np.bincount(by_person[:, 0]).tolist()
    schedules = log.schedules().reshape(97, 3)
    counts = np.bincount(np.unique(schedules, return_inverse=True)[1].ravel())
    assert len(counts) == len(study1_design().schedules)
    assert stats.chisquare(counts).pvalue > 0.001
    same = np.mean(schedules[:, 0] == schedules[:, 1])
    assert same == pytest.approx(1 / 6, abs=4 * np.sqrt(5 / 36 / 97))
    # Every rule of the event log holds: read back from a table it is the same log.
    again = EventLog.from_frame(log.to_frame())
    for name in ("offsets", "participant", "sequence", "condition", "action", "response"):
        np.testing.assert_array_equal(getattr(again, name), getattr(log, name))


def test_one_run_is_the_published_design():
    one = several_runs(50, 1, "s", np.random.default_rng(3))
    wanted = study1_design().draw(50, "s", np.random.default_rng(3))
    np.testing.assert_array_equal(one.action, wanted.action)
    np.testing.assert_array_equal(one.condition, wanted.condition)


@pytest.mark.parametrize("spread", [0.0, 2.5])
def test_a_person_has_one_offset_in_all_runs(spread):
    """One state, help probability one half: first responses of two runs of a person are alike as sigma says."""
    truth = LatentStatePOMDP(np.ones(1), np.ones((4, 1, 1)), np.full((2, 1, 2), 0.5), PUBLISHED)
    n = 4000
    log = simulated_study(truth, n, "s", np.random.default_rng(4), runs=2, spread=spread)
    first = np.array([
        log.response[a:b][log.response[a:b] != UNSEEN][0]
        for a, b in zip(log.offsets[:-1], log.offsets[1:], strict=True)
    ]).reshape(n, 2)  # fmt: skip
    both = quad(lambda z: stats.norm.pdf(z) / (1 + np.exp(-spread * z)) ** 2, -9, 9)[0]
    for pair, wanted in ((first, both), (np.c_[first[:, 0], np.roll(first[:, 1], 1)], 0.25)):
        assert np.mean(pair.all(axis=1)) == pytest.approx(wanted, abs=4 * np.sqrt(wanted * (1 - wanted) / n))


def test_people_who_do_not_differ_give_the_study_they_always_gave():
    """Stored plain calibrations can be repeated only while design and responses use these random numbers."""
    truth = prior_draw(Layout(PUBLISHED, 2), STICKY, np.random.default_rng(5))
    plain = simulated_study(truth, 30, "s", np.random.default_rng(6))
    rng = np.random.default_rng(6)
    wanted, _ = simulate_responses(truth, study1_design().draw(30, "s", rng), rng)
    np.testing.assert_array_equal(plain.action, wanted.action)
    np.testing.assert_array_equal(plain.response, wanted.response)


# -- what is ranked --------------------------------------------------------------------------------------
def test_quantities_against_person_by_person_integration():
    rng = np.random.default_rng(7)
    tables = random_tables(rng, PUBLISHED, 2)
    truth = LatentStatePOMDP(*tables, PUBLISHED)
    log = simulated_study(truth, n := 6, "s", rng, runs=3, spread=1.2)
    score = log.emission_weights @ tables[2][..., 1]
    initial, transition, emission = tables = permute(np.argsort(score), *tables)
    study, sigma = StudyDensity(log, ModelSpec(2, people=PersonOffset(0.8, 61))), 1.2
    theta = np.append(study.layout.pack(*tables), sigma)
    names, values = quantities(study, np.tile(theta, (2, 3, 1)))
    assert values.shape == (2, 3, len(names))
    assert np.ptp(values.reshape(6, -1), axis=0).max() < 1e-12
    assert len(names) == len(set(names))
    found = dict(zip(names, values[0, 0], strict=True))
    runs = [
        list(zip(log.action[a:b].tolist(), log.response[a:b].tolist(), strict=True))
        for a, b in zip(log.offsets[:-1], log.offsets[1:], strict=True)
    ]
    index = study.layout.emission_index
    total = sum(
        reference.person_log_likelihood_by_integration(runs[3 * i : 3 * i + 3], tables, index, (0, 1), sigma)
        for i in range(n)
    )
    assert found["log-likelihood"] == pytest.approx(total, abs=1e-4)
    people = each_person(study.density.people, study.density.tree, study.person)
    by_person = person_log_likelihoods(study.density, theta, study.person, people)
    assert found["log-likelihood"] == pytest.approx(by_person.sum(), rel=1e-12)
    stays = 2 * np.log([np.diag(t) for t in transition]).sum()
    assert found["log-prior"] == pytest.approx(stays - sigma**2 / (2 * 0.8**2))
    assert found["sigma"] == sigma

    def first_round(z):
        moved = reference.tilted(emission, (0, 1), sigma * z)[..., 1]
        return initial @ (log.emission_weights @ moved / log.emission_weights.sum())

    moments = [quad(lambda z, n=n: stats.norm.pdf(z) * first_round(z) ** n, -9, 9)[0] for n in (1, 2)]
    assert found["expected score, first round"] == pytest.approx(first_round(0.0))
    assert found["expected score, first round, all people"] == pytest.approx(moments[0], abs=1e-5)
    variance = found["expected score, first round, variance between people"]
    assert variance == pytest.approx(moments[1] - moments[0] ** 2, abs=1e-5)
    turned = np.append(study.layout.pack(*permute(np.array([1, 0]), *tables)), sigma)
    np.testing.assert_allclose(quantities(study, turned)[1], values[0, 0], rtol=1e-12)


# -- ranks among draws that depend on each other ---------------------------------------------------------
def autoregressive(rho, draws, rng):
    """Two chains of standard normal draws, each correlated `rho` with the one before; ``[chain, draw, 1]``."""
    noise = rng.standard_normal((2, draws)) * np.sqrt(1 - rho**2)
    noise[:, 0] /= np.sqrt(1 - rho**2)
    return signal.lfilter([1.0], [1.0, -rho], noise)[..., None]


def test_slowly_moving_draws_are_thinned_until_ranks_are_uniform():
    """As slow as the gate lets pass (an effective size of 400 among 4,000); the raw draws would not do."""
    rng = np.random.default_rng(8)
    ess, spread_out, together = [], [], []
    for _ in range(600):
        chains = autoregressive(0.79, 2000, rng)
        truth = rng.standard_normal(1)
        ess.append(2 * 2000 * (1 - 0.79) / (1 + 0.79))
        spread_out.append(ranks_of(truth, thinned(chains), rng))
        together.append(ranks_of(truth, chains[0, :LARGEST_RANK], rng))
    assert thinned(chains).shape == (LARGEST_RANK, 1)
    assert MIN_ESS < ess[0] < 1.2 * MIN_ESS
    assert convergence_gate(chains, ["sigma"], 0).min_ess_bulk == pytest.approx(ess[0], rel=0.3)
    assert bonferroni(examine(np.stack(spread_out), LARGEST_RANK, ["sigma"], rng)) > FAMILY_WISE
    assert bonferroni(examine(np.stack(together), LARGEST_RANK, ["sigma"], rng)) < FAMILY_WISE


# -- runs ------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def tiny():
    return calibrate([TINY])


def test_a_tiny_run_works(tiny):
    run = tiny.runs[0]
    assert "sigma" in run.replicates[0].names
    assert run.ranks.shape == (4, len(run.replicates[0].names))
    assert run.sentence.startswith("1 state: 4 studies of 30 people who differ, 2 runs each")
    assert "twice the quadrature nodes change no study's log-likelihood by more than" in run.sentence
    kept = tiny.to_dict()["runs"][0]
    assert kept["settings"]["people"] == {"scale": 1.5, "nodes": None}
    assert kept["settings"]["runs_per_person"] == 2
    assert all(0 < check < 1 for check in kept["node_check"])


def test_it_is_reproducible_wherever_it_runs(tiny):
    with ThreadPoolExecutor(1) as executor:
        again = calibrate([replace(TINY, replicates=2)], executor=executor)
    assert np.array_equal(again.runs[0].ranks, tiny.runs[0].ranks[:2])


def test_too_short_samples_are_doubled_on_account_of_sigma(monkeypatch):
    """Whatever mixes worst decides: here everything but sigma is said to be constant."""
    monkeypatch.setattr(calibration_replicate, "MAX_DOUBLINGS", 1)

    def only_sigma(study, theta):
        names, values = quantities(study, theta)
        return names, np.where(np.array(names) == "sigma", values, 0.0)

    monkeypatch.setattr(calibration_replicate, "quantities", only_sigma)
    found = run_replicate(replace(TINY, sampler=NutsSettings(draws=60, tune=100, chains=2)), 0)
    assert found.draws == 120
    assert not found.long_enough


@pytest.mark.parametrize("runs", [0, -1])
def test_refusals(runs):
    with pytest.raises(InputError, match=f"calibration, runs_per_person: found {runs}, wanted an integer of at"):
        replace(TINY, runs_per_person=runs)


# -- the command -----------------------------------------------------------------------------------------
def test_the_command_writes_its_evidence(tmp_path):
    out = tmp_path / "calibration_people.json"
    arguments = ["calibrate", "--states", "1", "--replicates", "2", "--participants", "30", "--people-differ"]
    with pytest.raises(SystemExit) as stop:
        main([*arguments, "--runs-per-person", "2", "--out", str(out), "--quiet"])
    assert not stop.value.code
    content = json.loads(out.read_text(encoding="utf-8"))
    assert content["command"] == (
        "prosocial calibrate --states 1 --replicates 2 --participants 30 --seed 1 --people-differ "
        "--person-scale 1.5 --runs-per-person 2"
    )
    assert "where people differ: simulated people" in content["what"]
    assert "sigma" in content["runs"][0]["ranks"]


@pytest.mark.parametrize("option", [("--person-scale", "1"), ("--runs-per-person", "3")])
def test_options_that_have_no_meaning_are_refused(option, capsys):
    with pytest.raises(SystemExit) as stop:
        main(["calibrate", *option])
    assert stop.value.code == 2
    assert f"{option[0]}: found {option[1]}" in capsys.readouterr().err


# -- for real --------------------------------------------------------------------------------------------
REAL = CalibrationSettings(1, 30, 100, seed=12, people=PersonOffset(), runs_per_person=3)


@pytest.mark.slow
def test_posteriors_are_calibrated():
    result = calibrate([replace(REAL, states=2, replicates=16), REAL])
    assert result.passed, result.sentence


@pytest.mark.slow
def test_offsets_that_change_between_runs_are_found(monkeypatch):
    """A model that takes runs for people would be calibrated to this; ours must not be."""
    right = calibration_replicate.simulated_study

    def forgetful(truth, participants, study, rng, *, runs, spread):
        log = right(truth, participants * runs, study, rng, runs=1, spread=spread)
        order = np.argsort(log.condition, kind="stable")
        log = replace_runs(log, order)
        return replace(
            log, participant=np.repeat(np.arange(1, participants + 1), runs),
            sequence=np.tile(np.arange(runs), participants),
        )  # fmt: skip

    monkeypatch.setattr(calibration_replicate, "simulated_study", forgetful)
    result = calibrate([replace(REAL, replicates=24)])
    assert not result.passed
    assert result.sentence.startswith("NOT calibrated")
    assert result.p_values.loc[(1, "sigma")].min() * result.p_values.size < FAMILY_WISE


def replace_runs(log, order):
    pieces = [np.arange(log.offsets[run], log.offsets[run + 1]) for run in order]
    events = np.concatenate(pieces)
    return replace(
        log, offsets=np.append(0, np.cumsum([len(p) for p in pieces])).astype(np.int64),
        condition=log.condition[order], action=log.action[events], response=log.response[events],
    )  # fmt: skip
