"""The same study in the eyes of models that fit as well: what differs is the robot's scale."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.simulate import simulate_study1
from analysis.study2 import run_study2
from analysis.study2_analysis import analyse
from analysis.study2_beliefs import SCALE, WITHIN, BeliefSpread, belief_spread, near_equal, seen_by
from analysis.study2_learning import learned_from
from analysis.study2_outcomes import BELIEF
from analysis.study2_policies import PAPER, make_policies
from models.baum_welch import BaumWelch
from models.inference import log_likelihood
from models.lspomdp import LatentStatePOMDP
from models.protocol import PUBLISHED
from tests.analysis.study2_cases import instant_rounds, knowing
from tests.models.planning.policy_cases import person


@pytest.fixture(autouse=True)
def instant(monkeypatch):
    monkeypatch.setattr("models.game.rounds.play_rounds", instant_rounds())


@pytest.fixture
def study():
    return run_study2(make_policies(knowing(), PAPER), person(), knowing(), 40, seed=2)


def by_hand(model, letters, actions, responses):
    """Beliefs of one person after each round, by Bayes' rule written out."""
    belief, out = np.array(model.initial), []
    for letter, action, response in zip(letters, actions, responses, strict=True):
        row = model.emission_index[action]
        if letter == "H":
            belief = belief * model.emission[row, :, response]
            belief = belief / belief.sum()
        belief = belief @ model.transition[action]
        out.append(belief)
    return np.array(out)


def test_beliefs_are_those_of_the_study_and_of_bayes_rule(study):
    own = seen_by(study, study.robot)
    assert own.belief == pytest.approx(study.belief, abs=1e-14)
    other = other_model()
    found = seen_by(study, other)
    for i in (0, 7, 23):
        wanted = by_hand(other, study.letters, study.action[i], study.response[i])
        assert found.belief[i, 1:] == pytest.approx(wanted, abs=1e-12)
    assert found.robot is other
    for name in ("action", "response", "team", "policy"):
        assert np.array_equal(getattr(found, name), getattr(study, name))


def other_model():
    rng = np.random.default_rng(4)
    return LatentStatePOMDP(
        rng.dirichlet(np.ones(3)), rng.dirichlet(np.ones(3), (4, 3)), rng.dirichlet(np.ones(2), (2, 3)), PUBLISHED
    )  # fmt: skip


def test_models_that_fit_as_well(monkeypatch):
    """Four states on few people who have two: the likelihood has more optima than people have minds."""
    monkeypatch.setattr("analysis.study2_beliefs.WITHIN", 3.0)
    log = simulate_study1(person(), 80, 3)
    found = BaumWelch(4, restarts=30, finalists=6, rounds=1).fit(log)
    models = near_equal(found, log)
    assert models
    assert [below for below, _ in models] == sorted(below for below, _ in models)
    for below, model in models:
        assert below <= 3.0
        assert log_likelihood(model, log) == pytest.approx(found.log_likelihood - below, abs=1e-6)
        assert (
            np.abs(model.transition - found.model.transition).max() > 1e-3
            or np.abs(model.emission - found.model.emission).max() > 1e-3
        )
    again = near_equal(found, log)
    assert [below for below, _ in again] == [below for below, _ in models]


def test_spread_of_the_tests(study, monkeypatch):
    monkeypatch.setattr("analysis.study2_beliefs.near_equal", lambda found, log: [(0.05, other_model())])
    learned = replace(knowing(), found=object(), log=object())
    spread = belief_spread(study, learned)
    first, second = spread.table.to_dict("records")
    tests = analyse(study).anovas[BELIEF].table.set_index("effect")
    assert first["F policy"] == pytest.approx(tests.loc["policy", "f"])
    assert first["p time"] == pytest.approx(tests.loc["time", "p"])
    again = analyse(seen_by(study, other_model())).anovas[BELIEF].table.set_index("effect")
    assert second["F policy:time"] == pytest.approx(again.loc["policy:time", "f"])
    low, high = sorted((first["F policy"], second["F policy"]))
    assert f"F of policy {low:.2f} to {high:.2f}" in spread.sentence
    assert "1 other model within 0.1" in spread.sentence
    assert spread.sentence.startswith(SCALE)


def test_without_a_fit_there_is_nothing_to_compare(study):
    spread = belief_spread(study, knowing())
    assert (len(spread.table), spread.searches, spread.sentence) == (1, 0, SCALE)
    alone = BeliefSpread(spread.table, 24)
    assert f"found no other model within {WITHIN:g}" in alone.sentence
    better = BeliefSpread(spread.table.loc[[0, 0]].assign(below=[0.0, -0.25]), 24)
    assert "One of them fits better, by 0.250." in better.sentence


@pytest.mark.slow
def test_two_fits_of_the_bundled_study_disagree_about_belief_and_about_nothing_else():
    """Optima .055 log-likelihood apart: the belief tests of one are significant and those of the other hardly."""
    from analysis.simulate import calibrated_truth

    truth = calibrated_truth()
    learned = learned_from("bundled", truth)
    study = run_study2(make_policies(learned, PAPER), truth, learned, 100, seed=1)
    spread = belief_spread(study, learned)
    assert len(spread.table) >= 2
    assert (spread.table["below"] <= WITHIN).all()
    assert spread.table["F policy"].max() > 4 * spread.table["F policy"].min()
