"""Study 2: rounds in a closed loop, the exact planner's values from the game, event logs, refusals."""

from dataclasses import replace

import numpy as np
import pytest

from analysis import fits
from analysis.event_files import read_events, write_events
from analysis.policy_study import STUDY2
from analysis.report.effort import Effort
from analysis.simulate import calibrated_truth, simulate_study1
from analysis.study2 import FEWEST, run_study2
from analysis.study2_claims import as_printed
from analysis.study2_learning import (
    ANEW_FINALISTS,
    ANEW_RESTARTS,
    ANEW_ROUNDS,
    FINALISTS,
    RESTARTS,
    ROUNDS,
    learned_anew,
    learned_from,
)
from analysis.study2_policies import CAUTIOUS, EXACT, MORE, PAPER, Learned, PolicySet, ls_pomdp, make_policies
from models.baum_welch import BaumWelch
from models.errors import InputError
from models.events import EventLog
from models.lspomdp import LatentStatePOMDP
from models.model_files import write_model
from models.nuts import NutsSettings
from models.planning.evaluation import evaluate_schedule
from models.planning.mode_process import schedule_modes
from models.protocol import PUBLISHED
from tests.analysis.report_cases import CORRIDOR
from tests.analysis.study2_cases import instant_rounds, knowing, policies
from tests.models.planning.policy_cases import person
from tests.planning_cases import sticky_draws

ERRORS = 4
"""Standard errors that a simulated mean may be from the exact value."""


@pytest.fixture
def instant(monkeypatch):
    """Rounds that take no time."""
    monkeypatch.setattr("models.game.rounds.play_rounds", instant_rounds())


def compare(study, made, truth):
    """Value, help rate and costly actions of every policy against the exact planner."""
    for policy in made.policies:
        exact, own = evaluate_schedule(policy, truth, study.letters), study.of(policy.name)
        for name, values, wanted in (
            ("value", study.reward[own], exact.value),
            ("help rate", study.helped[own].mean(axis=1), exact.help_rate),
            ("costly actions", study.costly[own], exact.costly_actions),
        ):
            error = values.std(ddof=1) / np.sqrt(len(own))
            assert abs(values.mean() - wanted) <= ERRORS * error + 1e-9, (policy.name, name)


def test_values_of_the_exact_planner_come_out_of_the_rounds(instant):
    truth = person()
    made = policies((*PAPER, EXACT))
    compare(run_study2(made, truth, knowing(), 30_000, seed=4), made, truth)


def test_a_robot_that_is_wrong_is_worth_what_evaluation_says(instant):
    """Evaluation follows all histories of a policy in a truth that it does not know."""
    truth = person()
    learned = Learned(sticky_draws(1, 9, 3).model(0), None, "another model")
    made = make_policies(learned, (*PAPER, EXACT))
    compare(run_study2(made, truth, learned, 30_000, seed=5), made, truth)


@pytest.mark.slow
def test_the_game_gives_the_exact_planners_numbers():
    truth = calibrated_truth()
    made = make_policies(knowing(truth), (*PAPER, EXACT))
    study = run_study2(made, truth, knowing(truth), 12_000, seed=3)
    assert study.missed == 0
    compare(study, made, truth)
    # The same numbers as the exact planner prints them, to see that they are the ones that are meant.
    printed = {"always": (153.1, 0.917, 9.0), "never": (162.6, 0.637, 0.0), "reactive": (198.5, 0.838, 4.0),
               "exact plan": (219.4, 0.868, 3.0)}  # fmt: skip
    for name, (value, rate, costly) in printed.items():
        own = study.of(name)
        for values, wanted, digit in (
            (study.reward[own], value, 0.05), (study.helped[own].mean(axis=1), rate, 0.0005),
            (study.costly[own], costly, 0.05),
        ):  # fmt: skip
            assert abs(values.mean() - wanted) <= ERRORS * values.std(ddof=1) / np.sqrt(len(own)) + digit, name


# -- the closed loop -------------------------------------------------------------------------------
def test_policies_act_on_what_they_saw(instant):
    """One person at a time through the policy's own interface gives the same actions."""
    truth, learned = person(), Learned(sticky_draws(1, 2, 3).model(0), None, "another model")
    made = make_policies(learned, (*PAPER, EXACT))
    study = run_study2(made, truth, learned, 60, seed=8)
    modes = schedule_modes(PUBLISHED, STUDY2)
    for i in range(study.n_people):
        policy = made.policies[study.policy[i]]
        memory = policy.begin(modes[0])
        for k, mode in enumerate(modes):
            choice = policy.act(memory)
            assert study.action[i, k] == PUBLISHED.mode_of_action.index(mode) + choice
            if k + 1 < len(modes):
                memory = policy.observe(memory, choice, int(study.response[i, k]) + 1, modes[k + 1])


def test_beliefs_are_those_of_the_learned_model(instant):
    """Also where it takes what it sees for impossible: then the belief goes on without."""
    sure = LatentStatePOMDP(
        [0.5, 0.5], [[[0.8, 0.2], [0.1, 0.9]]] * 4, [[[1.0, 0.0], [1.0, 0.0]], [[0.3, 0.7], [0.0, 1.0]]]
    )
    learned = Learned(sure, None, "a model that is sure of itself")
    study = run_study2(make_policies(learned), person(), learned, 50, seed=2)
    for i in range(study.n_people):
        belief = sure.initial
        for k in range(study.n_rounds):
            action, seen = PUBLISHED.action_names[study.action[i, k]], study.response[i, k]
            told = None if seen < 0 else PUBLISHED.response_names[seen]
            assert study.belief[i, k] == pytest.approx(belief, abs=1e-12)
            belief = sure.update(belief, action, told, impossible="keep")
        assert study.belief[i, -1] == pytest.approx(belief, abs=1e-12)
        assert study.believed_state[i, -1] == pytest.approx(belief[1])
        assert study.believed_top[i, -1] == pytest.approx(belief[-1])


def test_the_response_is_what_happened_in_the_game(monkeypatch):
    monkeypatch.setattr("models.game.rounds.play_rounds", instant_rounds(late=0.25))
    study = run_study2(policies(), person(), knowing(), 2_000, seed=6)
    willing = study.willing[:, study.shows]
    assert not study.helped[~willing].any()
    assert study.missed == int((willing & (study.helped == 0)).sum())
    assert 0.2 < study.missed / willing.sum() < 0.3
    silent = [k for k in range(study.n_rounds) if k not in study.shows]
    assert (study.response[:, silent] == -1).all()
    assert not study.willing[:, silent].any()


def test_people_are_willing_as_the_truth_says(instant):
    study = run_study2(policies(), person(), knowing(), 20_000, seed=7)
    for k in study.shows:
        for action in np.unique(study.action[:, k]):
            row = person().emission_index[action]
            for s in range(3):
                own = (study.action[:, k] == action) & (study.state[:, k] == s)
                n, p = own.sum(), person().emission[row, s, 1]
                if n > 50:
                    assert abs(study.willing[own, k].mean() - p) <= ERRORS * np.sqrt(p * (1 - p) / n)


def test_a_mixture_of_plans_is_drawn_from(instant):
    learned = Learned(person(), sticky_draws(4, 5, 3), "four models")
    made = make_policies(learned, ("never", *MORE), alpha=0.5)
    cautious = made.policies[-1]
    assert cautious.name == CAUTIOUS
    assert cautious.randomised
    study = run_study2(made, person(), learned, 8_000, seed=3)
    compare(study, made, person())
    exact, own = evaluate_schedule(cautious, person(), STUDY2), study.of(CAUTIOUS)
    for k, shares in enumerate(exact.action_path):
        for name, share in shares.items():
            took = (study.action[own, k] == PUBLISHED.action(name)).mean()
            assert abs(took - share) <= ERRORS * np.sqrt(share * (1 - share) / len(own)) + 1e-9


# -- people and seeds ------------------------------------------------------------------------------
def test_policies_have_equally_many_people(instant):
    study = run_study2(policies(), person(), knowing(), 103, seed=2)
    sizes = [len(study.of(p)) for p in PAPER]
    assert sizes == [21, 21, 21, 20, 20]
    assert not np.array_equal(study.policy, np.arange(103) % 5)


def test_a_seed_gives_the_same_study_and_threads_do_not_matter():
    one, other = (run_study2(policies(), person(), knowing(), 40, seed=9, threads=t) for t in (1, 2))
    assert np.array_equal(one.team, other.team)
    assert np.array_equal(one.response, other.response)
    assert not np.array_equal(one.team, run_study2(policies(), person(), knowing(), 40, seed=10).team)


def test_a_progress_is_told(instant):
    told = []
    run_study2(policies(), person(), knowing(), 20, progress=lambda *what: told.append(what))
    assert told[-1] == ("rounds", 9, 9)


def test_part_of_the_people_is_a_study_of_its_own(instant):
    study = run_study2(policies((*PAPER, EXACT)), person(), knowing(), 60, seed=2)
    swapped = as_printed(study, EXACT)
    assert swapped.policies == (EXACT, *PAPER[1:])
    for name in swapped.policies:
        assert np.array_equal(swapped.team[swapped.of(name)], study.team[study.of(name)])
    assert as_printed(swapped, EXACT) is swapped
    with pytest.raises(InputError, match="people, policy"):
        study.some(np.arange(60), PAPER)


# -- as data ---------------------------------------------------------------------------------------
def test_the_log_is_an_event_log_with_tokens(instant, tmp_path):
    study = run_study2(policies(), person(), knowing(), 25, seed=2)
    log = study.log
    again = EventLog.from_frame(log.to_frame())
    assert np.array_equal(again.action, log.action)
    assert log.conditions == tuple(sorted(PAPER))
    assert set(log.schedules()) == {STUDY2}
    path = tmp_path / "study2.csv.gz"
    write_events(log, path)
    read = read_events(path).log
    assert np.array_equal(read.tokens["team_tokens"].reshape(25, 9), study.team)
    assert np.array_equal(read.tokens["human_tokens"] + read.tokens["robot_tokens"], read.tokens["team_tokens"])
    condition = np.array(read.conditions)[read.condition]
    assert condition.tolist() == [study.policies[p] for p in study.policy]
    assert study.cumulative[:, -1] == pytest.approx(study.team.sum(axis=1))


# -- refusals --------------------------------------------------------------------------------------
def test_too_few_people_and_bad_seeds(instant):
    with pytest.raises(InputError, match=rf"participants: found 9 under 5 policies, wanted at least {5 * FEWEST}"):
        run_study2(policies(), person(), knowing(), 9)
    with pytest.raises(InputError, match="seed"):
        run_study2(policies(), person(), knowing(), 20, seed=-1)


def test_another_protocol():
    tables = np.full((CORRIDOR.n_actions, 2, 2), 0.5), np.full((len(CORRIDOR.emission_actions), 2, 3), 1 / 3)
    other = LatentStatePOMDP([0.5, 0.5], *tables, CORRIDOR)
    with pytest.raises(InputError, match="truth, protocol: found 'corridor'"):
        run_study2(policies(), other, knowing(), 20)
    with pytest.raises(InputError, match="learned model, protocol: found 'corridor'"):
        run_study2(policies(), person(), knowing(other), 20)


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("never", "kind"), "policy: found 'kind', wanted one of ls-POMDP, always"),
        (("never", "never"), "never twice"),
        ((), "policies: found none, wanted at least 1, of"),
        (("never", CAUTIOUS), "posterior: found none, wanted one: the truth itself is a single model"),
    ],
)
def test_policies_that_cannot_be_made(names, words):
    with pytest.raises(InputError, match=words):
        policies(names)


# -- what the robot has learned --------------------------------------------------------------------
def test_what_the_robot_may_have_learned_from(monkeypatch, tmp_path):
    monkeypatch.setattr("analysis.study2_learning.RESTARTS", 4)
    truth = person()
    assert learned_from("truth", truth).model is truth
    one, other = (learned_from("em", truth, participants=80, states=2, seed=s) for s in (1, 2))
    assert one.model.n_states == 2
    assert not np.array_equal(one.model.transition, other.model.transition)
    assert "80 simulated people" in one.words
    bundled = learned_from("bundled", truth, states=2)
    study = simulate_study1(calibrated_truth(), 540, 1)
    best = BaumWelch(2, restarts=4, finalists=30, rounds=3, seed=1).fit(study)
    assert bundled.model.transition == pytest.approx(best.model.transition)
    assert bundled.found.log_likelihood == best.log_likelihood
    assert f"(log-likelihood {best.log_likelihood:.3f})" in bundled.words
    # The bundled study is the simulated one with seed 1, so these two are no two confirmations.
    again = learned_from("em", calibrated_truth(), states=2)
    assert np.array_equal(again.model.transition, bundled.model.transition)
    assert "540 simulated people, which is the bundled one" in again.words
    assert "bundled" not in one.words
    path = tmp_path / "model.json"
    write_model(truth, path)
    assert learned_from(str(path), truth).model.transition == pytest.approx(truth.transition)
    with pytest.raises(InputError, match="some policies need a posterior"):
        learned_from(str(path), truth, posterior=True)
    with pytest.raises(InputError, match="participants of study 1: found 1"):
        learned_from("em", truth, participants=1)


def test_the_search_is_that_of_a_full_report():
    own = BaumWelch(4, restarts=RESTARTS, finalists=FINALISTS, rounds=ROUNDS, seed=3)
    assert own == Effort.of(quick=False).search(4, {}, 3)


def test_a_posterior_is_taken_from_the_store(monkeypatch, tmp_path):
    monkeypatch.setattr("analysis.study2_learning.RESTARTS", 4)
    monkeypatch.setattr(fits, "store_folder", lambda: tmp_path)
    few = NutsSettings(50, 50, 2)
    options = {"participants": 60, "states": 2, "posterior": True, "sampler": few}
    one, other = (learned_from("em", person(), **options) for _ in range(2))
    assert one.draws.n_draws == 100
    assert np.array_equal(one.draws.transition, other.draws.transition)
    assert len(list(tmp_path.glob("*.nc"))) == 1
    # So few draws fail their gate, which is said, and of whom.
    (note,) = (note for note in one.notes if "Convergence gate FAILED" in note)
    assert note.startswith("About Bayes-adaptive and cautious alone")
    assert note.endswith("The other policies use the point estimate.")
    anew = learned_anew(person(), 1, participants=60, states=2, sampler=few)
    assert anew.found.settings == replace(
        one.found.settings, restarts=ANEW_RESTARTS, finalists=ANEW_FINALISTS, rounds=ANEW_ROUNDS
    )
    assert make_policies(one, ("never", *MORE)).names == ("never", *MORE)


def test_ls_pomdp_wants_modes_that_take_turns():
    with pytest.raises(InputError, match="modes that take turns"):
        ls_pomdp(person(), "HRRH")
    policy, notes = ls_pomdp(person(), "RHR")
    assert notes == ()
    assert isinstance(PolicySet((policy,), notes).names, tuple)


def test_the_papers_policies_are_the_printed_ones():
    from analysis.design import published

    assert list(PAPER) == published()["study2"]["policies"]
    assert published()["study2"]["sequence"] == STUDY2
