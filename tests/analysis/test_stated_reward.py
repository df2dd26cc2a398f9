"""Rewards of one's own: read, checked against the models, and what comes of them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from analysis.em_study import run_em
from analysis.own_sensitivity import cost_variants, own_sensitivity, worth_variants
from analysis.simulate import calibrated_truth, simulate_study1
from analysis.state_scores import state_scores
from analysis.stated_reward import Measured, StatedReward, read_values, stated_reward, usual_schedule
from models.baum_welch import BaumWelch
from models.errors import InputError
from models.model_draws import ModelDraws
from models.model_files import model_from_dict, model_to_dict
from models.protocol import PUBLISHED
from models.reward import UNIT, Reward
from models.sensitivity.reward_grid import reward_of
from tests.analysis.report_cases import CORRIDOR, random_log
from tests.random_cases import random_tables


@pytest.fixture(scope="module")
def study():
    log = random_log(CORRIDOR, people=30, rounds=5)
    return run_em(log, (1, 2), settings=lambda k: BaumWelch(k, restarts=2, finalists=1), pins={}, seed=1)


@pytest.fixture
def draws():
    rng = np.random.default_rng(3)
    tables = [random_tables(rng, CORRIDOR, 2) for _ in range(4)]
    stack = [np.stack(part) for part in zip(*tables, strict=True)]
    reward = Reward.of_values([0.0, 12.0], {"assist": 8.0}, "points")
    return ModelDraws(CORRIDOR, *stack, np.full(4, 0.25), {}, ("low", "high"), reward)


# -- reading ---------------------------------------------------------------------------------------------------
def test_inline_and_file_say_the_same(tmp_path):
    path = tmp_path / "worth.json"
    path.write_text(json.dumps({"values": [3, 10.5], "costs": {"ask": 1}, "unit": "points"}))
    read = read_values([str(path)], CORRIDOR)
    assert read == read_values(["3,10.5"], CORRIDOR, {"ask": 1.0}, "points")
    assert read[2].prosocial() == pytest.approx([0, 7.5])
    assert (read[2].unit, read[2].costs) == ("points", {"ask": 1.0})


def test_several_numbers_of_states(tmp_path):
    path = tmp_path / "worth.json"
    path.write_text(json.dumps([{"values": [0, 1]}, {"values": [0, 1, 3]}]))
    assert set(read_values([str(path)], CORRIDOR)) == {2, 3} == set(read_values(["0,1", "0,1,3"], CORRIDOR))
    assert read_values(["measured"], CORRIDOR, {"ask": 2.0}) == Measured({"ask": 2.0}, "tokens")


WRONG = {
    "no numbers": (["a,b"], "--values: found 'a,b', wanted values with commas, one a state"),
    "twice": (["0,1", "1,2"], "--values 1,2: found 'values for 2 states again', wanted one list each"),
    "no number at all": (["nan,1"], "--values nan,1: reward, values: found [nan, 1.0], wanted finite numbers"),
    "unknown action": (["0,1"], "--values 0,1, cost of: found 'help', wanted one of wait, ask"),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_cannot_be_read(case):
    texts, message = WRONG[case]
    with pytest.raises(InputError) as caught:
        read_values(texts, CORRIDOR, {"help": 1.0} if case == "unknown action" else None)
    assert str(caught.value).startswith(message)


FILES = {
    '{"worth": [1, 2]}': "key: found 'worth', wanted one of values, costs, unit",
    '{"values": ["a"]}': "values: found ['a'], wanted a list of numbers",
    '{"values": [1, 2], "costs": 3}': "costs: found 3, wanted an object",
    "[]": "values: found [], wanted a list of numbers",
    "{": "",
}


@pytest.mark.parametrize("content", FILES)
def test_files_that_cannot_be_read(content, tmp_path):
    path = tmp_path / "worth.json"
    path.write_text(content)
    with pytest.raises(InputError) as caught:
        read_values([str(path)], CORRIDOR)
    assert str(caught.value).startswith(str(path))
    assert FILES[content] in str(caught.value)


# -- against the models ----------------------------------------------------------------------------------------
def test_rewards_are_for_models_that_were_fitted(study):
    stated = stated_reward({2: Reward.of_values([0, 4]), 3: Reward.of_values([0, 4, 5])}, study)
    assert stated.states == (2,)
    assert stated.of_model(study.fits[2].model).reward == Reward.of_values([0, 4])
    with pytest.raises(InputError, match="reward, numbers of states: found '3', wanted one of those fitted: 1, 2"):
        stated_reward(Reward.of_values([0, 4, 5]), study)
    with pytest.raises(InputError, match="team_tokens"):
        stated_reward("measured", study)
    with pytest.raises(InputError, match="reward: found 'paper', wanted values, or measured"):
        stated_reward("paper", study)
    with pytest.raises(InputError):
        stated_reward(Reward.of_values([0, 4]), study, schedule="XYZ")


def test_measured_is_the_mean_of_the_tokens():
    log = simulate_study1(participants=40)
    log = replace(log, tokens={"team_tokens": np.random.default_rng(1).poisson(40.0, log.n_events).astype(float)})
    study = run_em(log, (2,), settings=lambda k: BaumWelch(k, restarts=2, finalists=1), pins={}, seed=1)
    stated = stated_reward(Measured({"help": 2.0}, "tokens"), study)
    scores = state_scores(study.fits[2].model, log)
    assert stated.rewards[2].prosocial() == pytest.approx(scores - scores[0])
    assert stated.measured
    assert stated.costs(2)["help"] == 2.0
    assert "measured: the mean team tokens" in stated.sentence


def test_units_are_one_and_travel_with_models():
    mixed = {2: Reward.of_values([0, 1], unit="points"), 3: Reward.of_values([0, 1, 2])}
    with pytest.raises(InputError, match="reward, units: found 'points, reward units', wanted one unit"):
        StatedReward(mixed, "HR", False, PUBLISHED)
    with pytest.raises(InputError, match="reward, unit: found '', wanted a word"):
        Reward.of_values([0, 1], unit="")
    truth = calibrated_truth()
    assert "unit" not in model_to_dict(truth)["reward"]
    assert model_from_dict(model_to_dict(truth)).reward.unit == UNIT
    own = replace(truth, reward=Reward.of_values([0, 1, 2, 3], unit="points"))
    again = model_from_dict(model_to_dict(own)).reward
    assert (again, again.stated) == (own.reward, True)
    assert not truth.reward.stated


def test_the_usual_schedule_is_that_of_whole_runs():
    log = random_log(CORRIDOR, people=20, rounds=4)
    letters = usual_schedule(log)
    assert letters in set(log.schedules())
    assert len(letters) == 4


# -- what decisions depend on ----------------------------------------------------------------------------------
def test_variants_move_one_thing(draws):
    base = reward_of(draws)
    table = base.table(CORRIDOR)
    for variant in cost_variants(draws, base):
        moved = variant.reward.table(CORRIDOR) - table
        assert np.ptp(moved, axis=1) == pytest.approx(0)  # by action, not by state
        assert np.any(moved)
    free = next(v for v in cost_variants(draws, base) if v.name == "costs of all modes x 0")
    assert free.reward.table(CORRIDOR) == pytest.approx(np.tile(base.prosocial(), (CORRIDOR.n_actions, 1)))
    for variant in worth_variants(draws, base):
        assert np.ptp(variant.reward.table(CORRIDOR) - table, axis=0) == pytest.approx(0)  # by state, not by action
        assert variant.reward.unit == "points"
    assert worth_variants(draws, base)[0].reward.prosocial() == pytest.approx([0, 6])


def test_with_free_actions_and_without_worth_decisions_follow(draws):
    found = own_sensitivity(draws, endless_draws=2, few_draws=4, readings=("two-step", "two-step-terminal"))
    rows = {(r["variant"], r["reading"], r["k"]): r for r in found.rows["cost"]}
    null = {m.null_action for m in CORRIDOR.modes}
    # The last step of the reading that rewards nothing after it can only cost.
    last = len(CORRIDOR.modes) - 1
    assert rows["as given", "two-step", last]["action"] in null
    assert found.draws == {"two-step": 4, "two-step-terminal": 4}
    assert "two-step: " in found.sentence
    one = ModelDraws(CORRIDOR, np.ones((1, 1)), np.ones((1, 6, 1, 1)), np.full((1, 4, 1, 3), 1 / 3), np.ones(1), {})
    with pytest.raises(InputError, match="with one state"):
        own_sensitivity(one)
