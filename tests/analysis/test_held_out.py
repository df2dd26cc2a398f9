"""Prediction of what was left out: its cells, its numbers, its words, and whether intervals cover."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from analysis.forecasters import Contender
from analysis.held_out import HeldOut, held_out, predicted
from analysis.held_out_cells import (
    MOST_CELLS,
    averaging,
    cells_of,
    distinct_designs,
    earlier,
    observed_rates,
    parts_of,
)
from analysis.held_out_contenders import standard_contenders
from analysis.held_out_latent import LatentForecaster
from analysis.held_out_rivals import rivals
from analysis.held_out_scores import crps
from analysis.predictive_checks import prior_draws
from analysis.response_rates import value_of_response
from analysis.simulate import simulate_study1
from models.bayesian_fit import fit
from models.errors import InputError
from models.histories import UNSEEN
from models.joint_predictive import LogPredictive
from models.nuts import NutsSettings
from models.parameters import STICKY, Layout
from models.protocol import PUBLISHED
from models.rivals import constant, first_order_markov
from tests.analysis.held_out_cases import SHORT, study
from tests.analysis.report_cases import CORRIDOR, few_particles, log_of, random_log
from tests.models.test_simulation import design_of
from tests.random_cases import cases


@cache
def result(by):
    """By schedule, which takes six refits of every model, log predictives are rough: nothing looks at them."""
    with pytest.MonkeyPatch.context() as patch:
        sampler = SHORT
        if by == "schedule":
            few_particles(patch)
            sampler = replace(SHORT, draws=100, tune=100)
        return held_out(study(), standard_contenders(study(), (2,), sampler=sampler, draws=200), by, draws=200)


@pytest.fixture
def rough(monkeypatch):
    few_particles(monkeypatch)


# -- cells -------------------------------------------------------------------------------------------------
def test_every_run_is_left_out_once_and_nobody_is_on_both_sides():
    log = study()
    for by, n in (("condition", 4), ("schedule", 6), ("condition+schedule", 24)):
        cells, skipped = cells_of(log, by)
        assert len(cells) == n
        assert not skipped
        assert sum(c.held.n_runs for c in cells) == log.n_runs
        for cell in cells:
            assert not set(cell.held.participant) & set(cell.rest.participant)
            assert cell.held.n_runs + cell.rest.n_runs == log.n_runs
            assert cell.unused == 0


def two_conditions_a_person():
    a, b = [("signal", "help")], [("no_signal", "no_help"), ("signal", "help")]
    runs = [(i, 0, "first", a) for i in range(6)] + [(i, 1, "second", b) for i in range(3)]
    return log_of([*runs, (9, 0, "second", b)])


def test_other_runs_of_people_left_out_are_used_for_nothing():
    cells, _ = cells_of(two_conditions_a_person(), "condition")
    first, second = cells
    assert (first.held.n_runs, first.rest.n_runs, first.unused) == (6, 1, 3)
    assert (second.held.n_runs, second.rest.n_runs, second.unused) == (4, 3, 3)
    made = held_out(two_conditions_a_person(), rivals(1.0, 50, 1), draws=50)
    assert any("first: 3 runs of its people under other designs are used neither" in w for w in made.warnings)
    assert made.scores["people_learned"].tolist() == [1, 1, 3, 3]


def test_what_cannot_be_left_out_is_said():
    runs = [(i, 0, "a", [("signal", "help")]) for i in range(3)] + [(5, 0, "b", [("signal", "missing")])]
    runs += [(7, 0, "c", [("help", "none"), ("no_signal", "help")])]
    cells, skipped = cells_of(log_of(runs), "condition")
    assert [c.name for c in cells] == ["a", "c"]
    assert skipped == [("b", "no response is recorded in it")]
    made = held_out(log_of(runs), rivals(1.0, 50, 1), draws=50)
    assert "b was not left out: no response is recorded in it" in made.warnings
    everywhere = [(i, j, name, [("signal", "help")]) for i in range(3) for j, name in enumerate("ab")]
    with pytest.raises(InputError, match="a: everybody has a run in it, so nobody is left to learn from"):
        cells_of(log_of(everywhere), "condition")
    lonely = [(1, 0, "a", [("signal", "help")]), (2, 0, "b", [("signal", "missing")])]
    with pytest.raises(
        InputError, match="a: no response is recorded in the rest; b: no response is recorded in it"
    ):
        cells_of(log_of(lonely), "condition")


def test_unusable_input_is_refused():
    log, some = study(), rivals(1.0, 50, 1)
    with pytest.raises(InputError, match="held out: found 'person', wanted one of condition, schedule"):
        held_out(log, some, "person")
    one = log.select(conditions=["help+signal"])
    with pytest.raises(InputError, match="by condition, number of them: found 1, wanted at least 2: without help"):
        held_out(one, some)
    with pytest.raises(InputError, match=rf"by schedule, number of them: found \d+, wanted at most {MOST_CELLS}"):
        held_out(random_log(PUBLISHED, people=60), some, "schedule")
    with pytest.raises(InputError, match=r"held out, level: found 1\.5"):
        held_out(log, some, level=1.5)
    with pytest.raises(InputError, match="held out, draws: found 3, wanted an integer of at least 20"):
        held_out(log, some, draws=3)
    for wrong in ([], [*some, some[0]]):
        with pytest.raises(InputError, match="held out, contenders"):
            held_out(log, wrong)


@settings(max_examples=15)
@given(cases(max_paths=10**9))
def test_distinct_designs_stand_for_all_runs(case):
    """Any function of the design has the same mean over distinct designs, weighted, as over all runs."""
    log = design_of(case.runs, case.protocol)
    if not (log.response != UNSEEN).any():
        return
    parts = parts_of(log)
    design, times = distinct_designs(log)
    assert times.sum() == log.n_runs

    def value(x):
        before = np.cumsum((x.action + 1) * np.sqrt(x.k + 2.0) * (1 + (x.response != UNSEEN)))
        start = np.append(0, before)[x.offsets[:-1]]
        return before - start[x.run_of_event]

    assert np.allclose(value(design) @ averaging(design, parts, times), value(log) @ averaging(log, parts))
    seen = log.response != UNSEEN
    observed = value_of_response(case.protocol)[log.response[seen]] @ averaging(log, parts)[seen]
    assert np.allclose(observed, observed_rates(log, parts, 0.9)["rate"])


@given(cases(max_paths=10**9), st.integers(0, 5))
def test_what_came_earlier_in_a_run(case, seed):
    log = design_of(case.runs, case.protocol)
    marked = np.random.default_rng(seed).random(log.n_events) < 0.3
    wanted = [
        marked[a:k].any() for a, b in itertools.pairwise(log.offsets) for k in range(a, b)
    ]  # fmt: skip
    assert earlier(log, marked).tolist() == wanted


# -- the result --------------------------------------------------------------------------------------------
@pytest.mark.parametrize("by", ["condition", "schedule"])
def test_rows_are_what_they_say(by):
    made = result(by)
    rows = made.rates
    assert made.contenders == ["constant", "first-order Markov", "2 types", "mixed model", "2 states"]
    assert (rows["low"] <= rows["expected_low"] + 0.02).all()
    assert (rows["high"] >= rows["expected_high"] - 0.02).all()
    assert np.allclose(rows["error"], rows["expected"] - rows["observed"])
    beyond = np.maximum(rows["low"] - rows["observed"], rows["observed"] - rows["high"])
    assert np.array_equal(beyond < 1e-9, rows["inside"])
    whole, rounds = made.overall, made.by_round
    for cell in made.cells:
        one = rounds[(rounds["cell"] == cell) & (rounds["contender"] == "2 states")]
        mean = np.average(one["expected"], weights=one["responses"])
        row = whole[(whole["cell"] == cell) & (whole["contender"] == "2 states")].iloc[0]
        assert mean == pytest.approx(row["expected"])
        assert one["responses"].sum() == row["responses"]
    assert set(rows["part"]) == {"overall", "round"} | ({"condition"} if by == "schedule" else set())
    assert rows[["responses", "people"]].dtypes.tolist() == [np.dtype(np.int64)] * 2


def test_log_scores_are_those_of_the_rivals():
    log, made = study(), result("condition")
    for name, count in (("constant", constant), ("first-order Markov", first_order_markov)):
        score = made.scores.set_index(["contender", "cell"]).loc[name]
        for cell in made.cells:
            held = log.select(conditions=[cell])
            inside = np.isin(np.unique(log.participant), held.participant)
            whole = count(log)
            without = type(whole)("rest", whole.cells, whole.counts[~inside])
            joint = whole.log_marginal_likelihood - without.log_marginal_likelihood
            assert score.loc[cell, "log_score"] == pytest.approx(joint)
            assert score.loc[cell, "by_person"] == pytest.approx(whole.log_predictive(inside).sum())
    assert all(len(values) == log.n_participants for values in made.person_scores.values())
    table = made.ranking
    assert table["log_score"].is_monotonic_decreasing
    assert table["log_score_diff"].iloc[0] == table["dse"].iloc[0] == 0
    assert table["contender"].iloc[0] == "2 states"


@pytest.mark.usefixtures("rough")
def test_the_same_seed_gives_the_same_numbers_and_other_contenders_change_none():
    log = study().select(conditions=["help+signal", "no-help+no-signal"])
    some = standard_contenders(log, (2,), types=(), sampler=NutsSettings(50, 60, 2), draws=50)
    one, two = (held_out(log, some, draws=50) for _ in range(2))
    pd.testing.assert_frame_equal(one.rates, two.rates)
    pd.testing.assert_frame_equal(one.scores, two.scores)
    alone = held_out(log, some[1:2], draws=50)
    mine = one.rates[one.rates["contender"] == alone.contenders[0]].reset_index(drop=True)
    pd.testing.assert_frame_equal(mine, alone.rates)
    other = held_out(log, rivals(1.0, 50, 2)[1:], draws=50, seed=2)
    assert not np.allclose(other.rates["low"], alone.rates["low"])


@dataclass(frozen=True)
class Coin:
    """A contender of somebody else: everybody helps with a probability of its own choice."""

    rest: object
    n_draws: int = 1
    gate: str = "exact"
    doubts: tuple[str, ...] = ()

    def expected(self, design):
        return np.full((1, design.n_events), 0.5)

    def responses(self, design, draw, rng):
        tossed = (rng.random(design.n_events) < 0.5).astype(np.int8)
        return np.where(design.response == UNSEEN, np.int8(UNSEEN), tossed)

    def log_predictive(self, held):
        by_person = np.bincount(np.unique(held.participant, return_inverse=True)[1][held.run_of_event],
                                (held.response != UNSEEN) * np.log(0.5))  # fmt: skip
        return LogPredictive(float(by_person.sum()), 0.0, by_person)

    def gaps(self, design):
        return []


def test_any_model_may_join():
    made = held_out(study(), [*rivals(1.0, 100, 1), Contender("coin", "coin", Coin)], draws=100)
    assert made.ranking["contender"].tolist()[-1] == "coin"
    coin = made.overall[made.overall["contender"] == "coin"]
    assert np.allclose(coin["expected"], 0.5)
    assert made.scores.loc[made.scores["contender"] == "coin", "log_score"].sum() == pytest.approx(
        study().n_responses_recorded * np.log(0.5)
    )
    assert "coin by" in made.sentence


def test_words_follow_the_numbers():
    made = result("condition")
    text = made.sentence
    best = made.ranking.iloc[0]
    assert text.startswith("Each of 4 conditions was left out in turn and predicted from the rest")
    assert f"{best['contender']} is best; in nats it leads" in text
    assert f"2 states {best['inside']} of 4 and {best['rounds_inside']} of 20" in text
    assert "tells contenders apart on this study, not on the next" in text
    assert "simulated" not in text
    assert "say" not in made.sentence.split("The largest error")[0]
    simulated = HeldOut(**{**{k: getattr(made, k) for k in HeldOut.__dataclass_fields__}, "kind": "simulated"})
    assert simulated.sentence.endswith("The data are simulated, so this says nothing about people.")
    failed = made.scores.assign(gate="failed", doubts="the posterior sample missed the convergence gate")
    bad = HeldOut(**{**{k: getattr(made, k) for k in HeldOut.__dataclass_fields__}, "scores": failed})
    assert "help+signal, 2 states: the posterior sample missed the convergence gate" in bad.warnings
    assert bad.ranking["gate"].tolist() == ["failed (4)"] * 5
    assert "Intervals that are right hold about 3.6 of 4 and 18 of 20." in text
    assert not made.answering
    assert "NOT BLIND" not in text
    single = held_out(study(), rivals(1.0, 50, 1)[:1], draws=50).sentence
    assert "log score" not in single


@pytest.mark.usefixtures("rough")
def test_other_protocols_speak_of_scores():
    log = random_log(CORRIDOR, people=40)
    made = held_out(log, standard_contenders(log, (2,), pins={"hold": None}, sampler=SHORT, draws=60), draws=60)
    assert made.cells == ["other", "plain"]
    assert made.measure == "mean response score"
    assert "points" not in made.sentence
    assert made.answering  # their actions are drawn anew in every round
    assert "NOT BLIND: actions vary within a condition" in made.sentence
    assert made.rates["expected"].between(0, 1).all()


# -- scores ------------------------------------------------------------------------------------------------
def test_crps_is_the_definition_and_the_normal_one():
    rng = np.random.default_rng(1)
    x, y = rng.normal(size=(7, 3)), rng.normal(size=3)
    for j in range(3):
        pairs = [abs(a - b) for a, b in itertools.permutations(x[:, j], 2)]
        assert crps(x, y)[j] == pytest.approx(np.abs(x[:, j] - y[j]).mean() - 0.5 * np.mean(pairs))
    z = 0.7
    exact = z * (2 * stats.norm.cdf(z) - 1) + 2 * stats.norm.pdf(z) - 1 / np.sqrt(np.pi)
    assert crps(rng.normal(size=(200_000, 1)), np.array([z]))[0] == pytest.approx(exact, abs=0.005)


# -- calibration -------------------------------------------------------------------------------------------
@pytest.mark.slow
def test_intervals_cover_what_was_left_out():
    """Truths drawn from the prior of two states: what was left out is covered as often as the intervals say.

    Those of whole cells at 90% and at 50%, within binomial error at 1 in 1,000 each; rates are discrete, which adds
    at most a few percent to both.
    """
    replicates, covered = 100, {0.9: 0, 0.5: 0}
    truths = prior_draws(Layout(PUBLISHED, 2), STICKY, replicates, np.random.default_rng(11))
    for i, truth in enumerate(truths):
        log = simulate_study1(truth, participants=300, seed=100 + i)
        cell = cells_of(log, "condition")[0][i % 4]
        posterior = fit(cell.rest, 2, sampler=NutsSettings(200, 200, 2, seed=i + 1))
        forecaster = LatentForecaster(posterior, cell.rest, posterior.draws(), STICKY, {})
        for level in covered:
            frame = predicted(cell, forecaster, 0, level, 500, i)
            covered[level] += bool(frame["inside"].iloc[0])
    for level, count in covered.items():
        low = stats.binom(replicates, level).ppf(0.0005)
        high = stats.binom(replicates, level + 0.04).ppf(0.9995)
        assert low <= count <= high, covered
