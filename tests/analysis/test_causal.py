"""Effects by standardisation: against brute force, where there is none, and where it is known."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

from analysis import response_rates as rates
from analysis.causal import ALL_ROUNDS, causal_effects, expected_responses, silent_actions, with_action
from analysis.randomised_arms import arm_differences, arms, why_not_randomised
from analysis.simulate import simulate_study1
from models.bayesian_fit import fit
from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.protocol import PUBLISHED
from tests.analysis.posterior_cases import SHORT, posterior_of, random_model, sampled, study
from tests.analysis.report_cases import CORRIDOR, log_of, random_log


def enumerated(model, log, actions):
    """Mean expected score by round: every path of states written out."""
    value = rates.value_of_response(model.protocol)
    total, runs = {}, {}
    for run in range(log.n_runs):
        taken = actions[log.offsets[run] : log.offsets[run + 1]]
        for k, action in enumerate(taken):
            table = model.protocol.emission_index[action]
            if table < 0:
                continue
            mean = 0.0
            for path in itertools.product(range(model.n_states), repeat=k + 1):
                p = model.initial[path[0]]
                for j in range(k):
                    p *= model.transition[taken[j], path[j], path[j + 1]]
                mean += p * float(model.emission[table, path[-1]] @ value)
            total[k], runs[k] = total.get(k, 0.0) + mean, runs.get(k, 0) + 1
    return {k: total[k] / runs[k] for k in total}, runs


@pytest.mark.parametrize(("protocol", "states"), [(PUBLISHED, 2), (PUBLISHED, 3), (CORRIDOR, 2)])
def test_expected_responses_equal_brute_force(protocol, states):
    rng = np.random.default_rng(3)
    log = random_log(protocol, people=12, rounds=5, stop=0.15)
    models = [random_model(rng, states, protocol) for _ in range(3)]
    draws = ModelDraws.from_models(models)
    for mode in protocol.modes:
        for action in mode.actions:
            actions = with_action(log, mode.name, action.name)
            found, runs = expected_responses(draws, log, actions)
            for d, model in enumerate(models):
                wanted, counted = enumerated(model, log, actions)
                assert counted == {k: n for k, n in enumerate(runs) if n}
                np.testing.assert_allclose([found[d, k] for k in wanted], list(wanted.values()), atol=1e-13)


def test_no_effect_where_tables_are_equal():
    rng = np.random.default_rng(1)
    models = []
    for _ in range(5):
        m = random_model(rng, 3)
        equal = {"no_help": "help", "no_signal": "signal"}
        transition, emission = m.transition.copy(), m.emission.copy()
        for null, act in equal.items():
            transition[PUBLISHED.action(act)] = transition[PUBLISHED.action(null)]
        emission[1] = emission[0]
        models.append(replace(m, transition=transition, emission=emission))
    found = causal_effects(posterior_of(models), study(), kind="simulated")
    assert np.abs(found.table[["mean", "low", "high", "carried"]].to_numpy()).max() < 1e-14
    assert set(found.table["action"]) == {"help", "signal"}


def test_signal_acts_at_once_and_what_is_carried_over_is_told_apart():
    """Equal transitions, unequal response tables: the whole effect is immediate."""
    m = random_model(np.random.default_rng(5), 2)
    transition = np.stack([m.transition[0]] * 4)
    found = causal_effects(posterior_of([replace(m, transition=transition)] * 2), study())
    rows = found.of("signal")
    assert np.abs(rows["mean"]).min() > 1e-3
    np.testing.assert_allclose(rows["carried"], 0, atol=1e-14)
    assert np.abs(found.of("help")["mean"]).max() < 1e-14


def test_effect_before_the_first_chance_is_zero_and_exposure_says_so():
    rows = causal_effects(sampled(2), study()).of("help")
    first = rows[rows["round"] == "0"].iloc[0]
    assert (first["mean"], first["exposed"], first["positive"]) == (0.0, 0.0, 0.5)
    schedules = study().schedules()
    at_one = [s for s in schedules if s[1] == "H"]
    assert rows[rows["round"] == "1"]["exposed"].iloc[0] == np.mean([s[0] == "R" for s in at_one])
    last = rows.iloc[-1]
    by_round = rows.iloc[:-1]
    assert last["round"] == ALL_ROUNDS
    assert last["mean"] == pytest.approx(by_round["mean"] @ by_round["runs"] / by_round["runs"].sum())


def test_a_known_effect_is_recovered_from_a_large_study():
    truth = two_states()
    log = simulate_study1(truth, participants=4000, seed=4)
    wanted = causal_effects(posterior_of([truth] * 2), log).table
    found = causal_effects(sampled_large(log), log, kind="simulated").table
    for action in ("help", "signal"):
        w, f = (t[t["action"] == action].iloc[-1] for t in (wanted, found))
        assert w["mean"] > 0.05
        assert f["high"] - f["low"] < 0.06
        assert f["low"] < w["mean"] < f["high"]
        assert f["raw_low"] < w["mean"] < f["raw_high"]
        assert f["high"] - f["low"] < f["raw_high"] - f["raw_low"]


def two_states():
    """Help lifts people, a signal helps at once and a little later."""
    rise, fall = [[0.6, 0.4], [0.05, 0.95]], [[0.9, 0.1], [0.3, 0.7]]
    return LatentStatePOMDP(
        np.array([0.5, 0.5]),
        np.array([fall, rise, [[0.9, 0.1], [0.1, 0.9]], [[0.8, 0.2], [0.1, 0.9]]]),
        np.array([[[0.9, 0.1], [0.2, 0.8]], [[0.7, 0.3], [0.1, 0.9]]]),
    )


def sampled_large(log):
    """Chains around the highest maximum: one that crosses the states of the two arms is hundreds of nats lower."""
    posterior = fit(log, 2, sampler=SHORT)
    by_chain = posterior.data["log_likelihood"].to_dataset()["participant"].sum("person").mean("draw")
    best = np.flatnonzero(by_chain > by_chain.max() - 20)
    groups = {name: posterior.data[name].to_dataset().isel(chain=best) for name in ("posterior", "log_likelihood")}
    groups["prior"] = posterior.data["prior"].to_dataset()
    return replace(posterior, data=xr.DataTree.from_dict(groups))


def test_a_prior_that_leaves_out_the_raw_difference_is_named():
    found = causal_effects(sampled(4), study())
    row = found.of("help").iloc[-1]
    assert ("pulls this effect towards zero" in found.sentence_of("help")) == (row["raw"] > row["prior_high"])
    wide = replace(found, table=found.table.assign(raw=0.9))
    assert "pulls this effect towards zero" in wide.sentence_of("help")


# -- randomised arms -------------------------------------------------------------------------------
def test_raw_difference_is_that_of_the_arms_within_strata():
    log = study()
    table = arms(log)
    assert table.shape == (4, 2)
    found = arm_differences(log, "no_help", "help", 0.9)
    seen = log.response >= 0
    helped = log.response == PUBLISHED.response_names.index("help")
    condition = np.array(log.conditions)[log.condition[log.run_of_event]]
    value = weight = 0.0
    for signal in ("signal", "no-signal"):
        on, off = (seen & (condition == f"{c}+{signal}") for c in ("help", "no-help"))
        n = on.sum() + off.sum()
        value, weight = value + n * (helped[on].mean() - helped[off].mean()), weight + n
    assert found.loc["all", "raw"] == pytest.approx(value / weight)
    assert np.all((found["raw_low"] < found["raw"]) & (found["raw"] < found["raw_high"]))


def test_intervals_of_rates_at_one_are_not_empty():
    people = [(i, 0, "a" if i % 2 else "b", [("help" if i % 2 else "no_help", "none"), ("signal", "help")])
              for i in range(20)]  # fmt: skip
    found = arm_differences(log_of(people), "no_help", "help", 0.9)
    assert found.loc["all", "raw"] == 0
    assert found.loc["all", "raw_low"] < -0.05
    assert found.loc["all", "raw_high"] > 0.05


def test_actions_that_vary_within_people_are_not_called_randomised():
    log = random_log(PUBLISHED)
    assert "may answer to what people did" in why_not_randomised(log, "human_needs_help")
    found = causal_effects(sampled(2), log, kind="real")
    assert found.table["raw"].isna().all()
    assert "NOT RANDOMISED" in found.sentence_of("help")
    assert "simulated" not in found.sentence


def test_simulated_data_are_called_so():
    found = causal_effects(sampled(2), study(), kind="simulated")
    assert "simulated, so they say nothing about people" in found.sentence
    assert "randomised arms differ by" in found.sentence
    assert "intention-to-treat" in found.sentence


def test_an_action_never_shown_has_no_effect_to_report():
    log = study().select(conditions=["help+no-signal", "no-help+no-signal"])
    assert silent_actions(log) == ("signal",)
    found = causal_effects(sampled(2), log)
    assert "says nothing" in found.sentence_of("signal")
    assert "nothing to compare" in found.not_randomised["robot_needs_help"]


def test_another_protocol_is_refused():
    with pytest.raises(InputError, match="corridor"):
        causal_effects(sampled(2), random_log(CORRIDOR))
