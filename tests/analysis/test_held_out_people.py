"""The hierarchical model as a forecaster: brute force over nodes and paths, people who hang together, its words."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats
from scipy.special import expit, logit

from analysis.held_out import held_out, predicted
from analysis.held_out_cells import cells_of
from analysis.held_out_contenders import standard_contenders
from analysis.held_out_people import PeopleForecaster, averaged_emission, people_forecaster
from analysis.response_rates import value_of_response
from models.bayesian_fit import fit
from models.histories import UNSEEN
from models.joint_predictive import LETTING_IN
from models.model_draws import ModelDraws
from models.nuts import NutsSettings
from models.parameters import STICKY
from models.person_offset import PersonOffset, quadrature
from models.population import population
from models.predictive import FullTables
from models.protocol import PUBLISHED
from tests.analysis.held_out_cases import study
from tests.analysis.posterior_cases import posterior_of, random_model
from tests.analysis.report_cases import CORRIDOR, few_particles, log_of, random_log
from tests.models.test_simulation import design_of
from tests.random_cases import cases
from tests.reference.enumeration import path_probabilities
from tests.reference.people import tilted

SAMPLER = NutsSettings(200, 200, 2)


def forecaster_of(models, spread, rest=None):
    """A forecaster whose draws are given models, with standard deviations of people's offsets."""
    spread = np.asarray(spread, dtype=np.float64)
    initial, transition, emission = (np.stack([getattr(m, n) for m in models]) for n in
                                     ("initial", "transition", "emission"))  # fmt: skip
    protocol = models[0].protocol
    averaged = ModelDraws(
        protocol,
        initial,
        transition,
        averaged_emission(emission, spread, protocol),
        np.full(len(models), 1 / len(models)),
    )
    tables = FullTables(initial[:, None], transition, emission, spread)
    return PeopleForecaster(
        posterior=posterior_of(models), rest=rest, models=averaged, prior=STICKY, pins={}, tables=tables,
        people=PersonOffset(),
    )  # fmt: skip


@cache
def sampled(states):
    rest = cells_of(study(), "condition")[0][0].rest
    return rest, fit(rest, states, people=PersonOffset(), sampler=SAMPLER)


# -- expectations ------------------------------------------------------------------------------------------
@settings(max_examples=15)
@given(cases(max_states=2, max_length=4, max_runs=3), st.floats(0.1, 3.0))
def test_expectations_are_the_sum_over_offsets_and_state_paths(case, spread):
    """Enumerated over nodes of another rule and all state paths, the product along the path and all."""
    log = design_of(case.runs, case.protocol)
    model = type(random_model(np.random.default_rng(0)))(*case.tables, case.protocol)
    value = value_of_response(case.protocol)
    z = np.linspace(-8, 8, 321)
    weight = stats.norm.pdf(z) / stats.norm.pdf(z).sum()
    scores = case.protocol.scores
    wanted = []
    for run in case.runs:
        joint = path_probabilities([(a, -1) for a, _ in run], *case.tables, case.index)
        for k, (a, o) in enumerate(run):
            if o >= 0:
                total = 0.0
                for node, share in zip(z, weight, strict=True):
                    table = tilted(case.emission[case.index[a]], scores, spread * node)
                    total += share * sum(p * (table[path[k]] @ value) for path, p in joint.items())
                wanted.append(total)
    expected = forecaster_of([model], [spread], log).expected(log)
    assert np.allclose(expected[0, log.response != UNSEEN], wanted, atol=2e-6)


def test_one_state_is_the_logistic_normal_integral():
    p, sd = 0.8, 1.7
    emission = np.array([[[[1 - p, p]], [[1 - p, p]]]])
    found = averaged_emission(emission, np.array([sd]), PUBLISHED)
    exact = integrate.quad(lambda z: expit(logit(p) + sd * z) * stats.norm.pdf(z), -9, 9, epsabs=1e-12)[0]
    assert found[0, 0, 0, 1] == pytest.approx(exact, abs=1e-6)
    assert np.allclose(found.sum(axis=-1), 1)
    assert np.allclose(averaged_emission(emission, np.array([0.0]), PUBLISHED), emission)


def test_expectations_are_those_of_the_population_as_one_model():
    """`models.population` puts the offset into the state instead."""
    rest, posterior = sampled(2)
    made = people_forecaster(posterior, rest, STICKY, {}, PersonOffset(), 8, LETTING_IN)
    whole = population(posterior, 41)
    kept = np.floor((np.arange(8) + 0.5) * whole.n_draws / 8).astype(int)
    run = study().select(runs=np.array([0, 1, 2, 3]))
    belief = np.repeat(whole.initial[kept][:, None], run.n_runs, axis=1)
    value = value_of_response(PUBLISHED)
    found = made.expected(run)
    for r in range(run.n_runs):
        state = belief[:, r]
        for event in range(run.offsets[r], run.offsets[r + 1]):
            a = run.action[event]
            e = PUBLISHED.emission_index[a]
            if e >= 0:
                wanted = np.einsum("ds,dso,o->d", state, whole.emission[kept, e], value)
                assert np.allclose(found[:, event], wanted, atol=1e-6)
            state = np.einsum("ds,dst->dt", state, whole.transition[kept, a])


# -- responses ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("protocol", [PUBLISHED, CORRIDOR])
def test_simulated_responses_have_the_expected_mean(protocol):
    rng = np.random.default_rng(3)
    log = random_log(protocol, people=12, missing=0.2)
    made = forecaster_of([random_model(rng, 2, protocol) for _ in range(20)], rng.uniform(0.5, 2.5, 20), log)
    seen, n, value = log.response != UNSEEN, 3000, value_of_response(protocol)
    total = np.zeros(log.n_events)
    for i in range(n):
        response = made.responses(log, i % made.n_draws, np.random.default_rng([7, i]))
        assert np.array_equal(response == UNSEEN, ~seen)
        total[seen] += value[response[seen]]
    assert np.abs(total[seen] / n - made.expected(log)[:, seen].mean(axis=0)).max() < 4.5 * 0.5 / np.sqrt(n)


def test_an_offset_is_shared_by_all_runs_of_a_person_and_by_nobody_else():
    """With one state and a sigma of 100 nearly everybody always or never helps, independently of others."""
    answers = [("signal", "help")] * 3
    log = log_of([(i, j, "c", answers) for i in range(40) for j in range(3)])
    even = random_model(np.random.default_rng(1), 1)
    half = type(even)(even.initial, even.transition, np.full((2, 1, 2), 0.5), PUBLISHED)
    made = forecaster_of([half], [100.0], log)
    shares, agree = [], []
    for i in range(50):
        response = made.responses(log, 0, np.random.default_rng([1, i])).reshape(40, 9)
        agree.append(np.mean(response == response[:, :1]))
        shares.append(response[:, 0].mean())
    assert np.mean(agree) > 0.98
    assert np.std(shares) == pytest.approx(0.5 / np.sqrt(40), rel=0.35)
    frame = predicted(cells_of(_two(log), "condition")[0][0], made, 0, 0.9, 400, 1)
    wanted = stats.binom(40, 0.5).ppf([0.05, 0.95]) / 40
    assert np.allclose(frame[["low", "high"]].to_numpy()[0], wanted, atol=0.051)


def _two(log):
    """The same study with a second condition."""
    frame = log.to_frame()
    other = frame.assign(participant=frame["participant"] + 100, condition="d")
    return type(log).from_frame(pd.concat([frame.astype({"condition": str}), other], ignore_index=True))


# -- as contenders -----------------------------------------------------------------------------------------
def test_they_take_part_where_people_may_differ():
    log = study().select(conditions=["help+signal", "no-help+no-signal"])
    made = standard_contenders(log, (3, 2), people=PersonOffset(), sampler=SAMPLER, draws=60)
    assert [c.name for c in made] == [
        "constant", "first-order Markov", "2 types", "mixed model", "2 states", "3 states",
        "people differ, no states", "2 states, people differ",
    ]  # fmt: skip
    assert [c.kind for c in made[-2:]] == ["traits", "people"]
    plain = standard_contenders(log, (3, 2), sampler=SAMPLER, draws=60)
    assert [c.name for c in plain] == [c.name for c in made[:-2]]
    one = held_out(log, made[-2:], draws=60)
    assert one.rates["expected"].between(0, 1).all()
    assert (one.scores["log_score_error"] < 1).all()
    assert "people differ, no states" in one.sentence
    # Nobody is helped or signalled to in the rest of the first cell.
    assert "action signal was never seen in the rest" in one.overall["prior"].iloc[0]


def test_the_same_seed_gives_the_same_numbers(monkeypatch):
    few_particles(monkeypatch)
    log = study().select(conditions=["help+signal", "no-help+no-signal"])
    made = standard_contenders(log, (2,), people=PersonOffset(), sampler=NutsSettings(60, 80, 2), draws=60)[-2:]
    one, two = (held_out(log, made, draws=60) for _ in range(2))
    pd.testing.assert_frame_equal(one.rates, two.rates)
    pd.testing.assert_frame_equal(one.scores, two.scores)


def test_what_speaks_against_a_sample_is_said():
    rest, posterior = sampled(1)
    bad = replace(posterior, settings={**posterior.settings, "node_check": 3.0})
    made = people_forecaster(bad, rest, STICKY, {}, PersonOffset(), 50, LETTING_IN)
    assert any("QUADRATURE NOT FINE ENOUGH" in text for text in made.doubts)
    assert ("missed the convergence gate" in " ".join(made.doubts)) == (not posterior.gate.passed)


def test_log_predictive_by_person_is_the_mean_over_draws_and_nodes():
    """With one state a person's likelihood is a sum over nodes of a product of Bernoulli probabilities."""
    rest, posterior = sampled(1)
    held = cells_of(study(), "condition")[0][0].held
    people = PersonOffset(nodes=41)
    made = people_forecaster(posterior, rest, STICKY, {}, people, 50, LETTING_IN)
    found = made.log_predictive(held)
    z, log_weight = quadrature(41)
    emission, spread = posterior.table("emission"), posterior.table("person_sd")
    for person in (0, 5, 9):
        one = held.select(participants=np.unique(held.participant)[person : person + 1])
        likelihood = np.zeros(len(spread))
        for node, weight in zip(z, np.exp(log_weight), strict=True):
            product = np.ones(len(spread))
            for a, o in zip(one.action, one.response, strict=True):
                if o != UNSEEN:
                    p = emission[:, PUBLISHED.emission_index[a], 0, 1]
                    help_ = expit(logit(p) + spread * node)
                    product *= help_ if o == 1 else 1 - help_
            likelihood += weight * product
        assert found.by_person[person] == pytest.approx(np.log(likelihood.mean()), abs=1e-9)
