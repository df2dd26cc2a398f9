"""Forecasters of what was left out against brute force and closed forms, and what of them is the prior."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from analysis.causal import expected_responses
from analysis.held_out import held_out, predicted
from analysis.held_out_cells import (
    averaging,
    cells_of,
    distinct_designs,
)
from analysis.held_out_contenders import standard_contenders
from analysis.held_out_rivals import CountingForecaster, rivals
from analysis.response_rates import value_of_response
from models.histories import UNSEEN
from models.lspomdp import LatentStatePOMDP
from models.protocol import PUBLISHED
from tests.analysis.held_out_cases import SHORT, forecaster_of, learned, study
from tests.analysis.posterior_cases import random_model
from tests.analysis.report_cases import CORRIDOR, log_of, random_log
from tests.models.test_simulation import design_of
from tests.random_cases import cases
from tests.reference.enumeration import path_probabilities


# -- the latent-state model --------------------------------------------------------------------------------
@given(cases(max_states=3, max_length=5, max_runs=4))
def test_latent_expectations_are_the_sum_over_state_paths(case):
    log = design_of(case.runs, case.protocol)
    model = LatentStatePOMDP(*case.tables, case.protocol)
    value = value_of_response(case.protocol)
    wanted = []
    for run in case.runs:
        joint = path_probabilities([(a, -1) for a, _ in run], *case.tables, case.index)
        for k, (a, o) in enumerate(run):
            if o >= 0:
                score = case.emission[case.index[a]] @ value
                wanted.append(sum(p * score[path[k]] for path, p in joint.items()))
    expected = forecaster_of([model, model], log).expected(log)
    assert np.allclose(expected[:, log.response != UNSEEN], wanted, atol=1e-12)


def test_latent_expectations_by_round_are_those_of_the_causal_question():
    """Where nothing is missing, rounds average over the same runs."""
    log = study()
    models = [random_model(np.random.default_rng(i), 3) for i in range(4)]
    forecaster = forecaster_of(models, log)
    design, times = distinct_designs(log)
    parts = [("round", str(k)) for k in range(5)]
    found = np.nan_to_num(forecaster.expected(design)) @ averaging(design, parts, times)
    assert np.allclose(found, expected_responses(forecaster.models, log, log.action)[0])


def frequencies(forecaster, design, n=4000):
    """Share of simulated studies' response values at every event, all draws in turn."""
    value = value_of_response(design.protocol)
    seen = design.response != UNSEEN
    total = np.zeros(design.n_events)
    for i in range(n):
        response = forecaster.responses(design, i % forecaster.n_draws, np.random.default_rng([7, i]))
        assert np.array_equal(response == UNSEEN, ~seen)
        total[seen] += value[response[seen]]
    return total[seen] / n


@pytest.mark.parametrize("kind", ["latent", "constant", "markov"])
def test_simulated_responses_have_the_expected_mean(kind):
    log = random_log(CORRIDOR, people=12, missing=0.2)
    if kind == "latent":
        rng = np.random.default_rng(3)
        forecaster = forecaster_of([random_model(rng, 2, CORRIDOR) for _ in range(50)], log)
    else:
        forecaster = learned(log, kind, 50)
    seen = log.response != UNSEEN
    expected = forecaster.expected(log)[:, seen].mean(axis=0)
    found = frequencies(forecaster, log)
    assert np.abs(found - expected).max() < 4.5 * 0.5 / np.sqrt(4000)
    assert len(np.unique(expected.round(3))) > 3


# -- rivals ------------------------------------------------------------------------------------------------
@given(cases(max_states=1, max_length=5, max_runs=4), st.integers(0, 99))
def test_markov_expectations_are_the_sum_over_response_paths(case, seed):
    log = design_of(case.runs, case.protocol)
    p = case.protocol
    table = np.random.default_rng(seed).dirichlet(
        np.ones(p.n_responses), size=(1, len(p.emission_actions), p.n_responses + 1)
    )
    value = value_of_response(p)
    wanted = np.zeros(log.n_events)
    event = 0
    for run in case.runs:
        recorded = [k for k, (_, o) in enumerate(run) if o >= 0]
        for path in itertools.product(range(p.n_responses), repeat=len(recorded)):
            probability, last = 1.0, 0
            for k, o in zip(recorded, path, strict=True):
                probability *= table[0, p.emission_index[run[k][0]], last, o]
                last = o + 1
            for k, o in zip(recorded, path, strict=True):
                wanted[event + k] += probability * value[o]
        event += len(run)
    rival = CountingForecaster(None, None, log, table)
    assert np.allclose(rival.expected(log), wanted, atol=1e-12)


def signal_only(people, helped, condition, rounds=1, first=0):
    """People who respond to signals; the first `helped` responses are help."""
    answers = iter([True] * helped + [False] * (people * rounds - helped))
    return [
        (first + i, 0, condition, [("signal", "help" if next(answers) else "no_help") for _ in range(rounds)])
        for i in range(people)
    ]


def test_the_constant_rival_predicts_the_beta_binomial():
    log = log_of(signal_only(30, 21, "learn") + signal_only(25, 10, "other", first=100))
    n, a, b = 25, 1 + 21, 1 + 9
    made = held_out(log, [rivals(1.0, 4000, 1)[0]], draws=4000)
    row = made.overall[made.overall["cell"] == "other"].iloc[0]
    assert row["expected"] == pytest.approx(a / (a + b), abs=0.006)
    assert (row["expected_low"], row["expected_high"]) == pytest.approx(
        tuple(stats.beta(a, b).ppf([0.05, 0.95])), abs=0.012
    )
    law = stats.betabinom(n, a, b)
    for side, level in (("low", 0.05), ("high", 0.95)):
        # A quantile of the simulated counts lies where the exact distribution crosses the level, within noise.
        count = row[side] * n
        below, upto = law.cdf(np.ceil(count - 1e-9) - 1), law.cdf(np.floor(count + 1e-9))
        assert below - 0.02 < level < upto + 0.02
    k = np.arange(n + 1)
    law_of_rate = law.pmf(k)
    exact = law_of_rate @ np.abs(k / n - 10 / n) - 0.5 * law_of_rate @ np.abs(k[:, None] - k) / n @ law_of_rate
    assert row["crps"] == pytest.approx(exact, abs=0.005)
    score = made.scores[made.scores["cell"] == "other"].iloc[0]
    exact_score = law.logpmf(10) - np.log(stats.binom(25, 0.5).pmf(10) * 2.0**25)
    assert score["log_score"] == pytest.approx(exact_score)
    assert score["log_score_error"] == 0
    assert not row["inside"]


def test_predictive_intervals_know_that_rounds_of_a_person_hang_together():
    """A static mixture of two opposite types: the rate over rounds is as uncertain as that of one round."""
    runs = signal_only(40, 80, "a", rounds=4) + signal_only(40, 80, "b", rounds=4, first=100)
    extreme = LatentStatePOMDP(
        np.array([0.5, 0.5]), np.stack([np.eye(2)] * 4), np.array([[[1.0, 0.0], [0.0, 1.0]]] * 2), PUBLISHED
    )
    cell = cells_of(log_of(runs), "condition")[0][0]
    frame = predicted(cell, forecaster_of([extreme], cell.rest), 0, 0.9, 1000, 1)
    wanted = stats.binom(40, 0.5).ppf([0.05, 0.95]) / 40
    assert np.allclose(frame[["low", "high"]].to_numpy(), wanted, atol=0.026)
    assert np.allclose(frame[["expected_low", "expected", "expected_high"]], 0.5)


# -- what is the prior -------------------------------------------------------------------------------------
def gaps_study():
    """Signals and help are in one condition each; in the others people are never signalled to or helped."""
    rng = np.random.default_rng(5)

    def answer():
        return "help" if rng.random() < 0.7 else "no_help"

    designs = {
        "plain": ("no_help", "no_signal"), "signalled": ("no_help", "signal"), "helped": ("help", "no_signal")
    }  # fmt: skip
    return log_of(
        [
            (i, 0, name, [(asked, answer()), (given, "none"), (asked, answer())])
            for i in range(60)
            for name in (list(designs)[i % 3],)
            for given, asked in (designs[name],)
        ]
    )


def test_an_action_never_seen_in_the_rest_is_flagged_and_is_the_prior():
    made = held_out(gaps_study(), standard_contenders(gaps_study(), (2,), sampler=SHORT, draws=300), draws=300)
    flags = made.rates.set_index(["cell", "contender", "part", "at"])["prior"]
    never_signal = "action signal was never seen in the rest: its table is the prior"
    never_help = "action help was never seen in the rest: its table is the prior"
    for contender in made.contenders:
        for part in (("overall", "all"), ("round", "0"), ("round", "2")):
            assert flags["signalled", contender, *part] == never_signal
            assert flags["plain", contender, *part] == ""
    # Help happens between the two responses: it matters to the second, and to a model in which it moves people.
    assert flags["helped", "2 states", "round", "0"] == ""
    assert flags["helped", "2 states", "round", "2"] == flags["helped", "2 states", "overall", "all"] == never_help
    assert set(flags["helped"].drop("2 states", level="contender")) == {""}
    row = made.overall[(made.overall["cell"] == "signalled") & (made.overall["contender"] == "constant")].iloc[0]
    assert row["expected"] == pytest.approx(0.5, abs=0.05)
    assert row["expected_low"] < 0.1 < 0.9 < row["expected_high"]
    assert never_signal in made.sentence
    assert f"signalled, constant: {never_signal}" in made.warnings
    assert made.ranking.set_index("contender")["prior"].to_dict() == {
        "constant": 1, "first-order Markov": 1, "2 types": 1, "2 states": 2
    }  # fmt: skip


def test_tables_that_are_held_are_no_gap_and_half_known_actions_are_told_apart():
    log = gaps_study()
    rest, held = (log.select(conditions=c) for c in (["plain", "signalled"], ["helped"]))
    model = random_model(np.random.default_rng(1))
    assert forecaster_of([model], rest, {"help": None}).gaps(held) == []
    short = log_of(
        [(1, 0, "a", [("signal", "missing"), ("no_signal", "help")]), (2, 0, "b", [("no_signal", "help")])]
    )
    later = log_of([(3, 0, "c", [("signal", "help"), ("no_signal", "help"), ("no_signal", "help")])])
    (text, mask), *others = forecaster_of([model], short).gaps(later)
    in_the_rest = "action no_signal: in the rest it was never followed by another event"
    assert text == f"{in_the_rest}, so its transition table is the prior"
    assert mask.tolist() == [False, False, True]
    ((text, mask),) = others
    assert text == "action signal: in the rest no response to it was recorded, so its response table is the prior"
    assert mask.tolist() == [True, False, False]


def test_a_cell_of_the_markov_rival_that_was_never_filled_is_flagged():
    rest = log_of([(1, 0, "a", [("signal", "help"), ("signal", "help")]), (2, 0, "a", [("signal", "help")])])
    held = log_of([(3, 0, "b", [("signal", "no_help"), ("help", "none"), ("signal", "help")])])
    ((text, mask),) = learned(rest, "markov", 10).gaps(held)
    assert text == "no response to action signal after no_help was recorded in the rest: it is the prior"
    assert mask.tolist() == [False, False, True]
    assert learned(rest, "constant", 10).gaps(held) == []
