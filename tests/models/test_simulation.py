"""Simulated responses: the specification number by number, frequencies, and what must be kept."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.events import EventLog
from models.histories import UNSEEN
from models.lspomdp import LatentStatePOMDP
from models.protocol import PUBLISHED
from models.simulation import simulate_responses
from tests.models.test_protocol import THREE
from tests.random_cases import cases, random_run, random_tables
from tests.reference import simulation


def design_of(runs, protocol=PUBLISHED):
    """An event log with these runs, one participant each."""
    events = np.array([event for run in runs for event in run], dtype=np.int8)
    n = len(runs)
    return EventLog(
        protocol, "simulated", np.cumsum([0, *map(len, runs)]).astype(np.int64), np.arange(n),
        np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int32), ("all",),
        np.ascontiguousarray(events[:, 0]), np.ascontiguousarray(events[:, 1]),
    )  # fmt: skip


@given(cases(max_paths=10**9, zeros=0.2), st.integers(0, 2**32 - 1))
def test_draws_equal_the_specification(case, seed):
    model = LatentStatePOMDP(*case.tables, case.protocol)
    design = design_of(case.runs, case.protocol)
    log, states = simulate_responses(model, design, np.random.default_rng(seed))
    uniform = np.random.default_rng(seed).random((design.n_events, 2))
    wanted_states, wanted = simulation.simulate(case.runs, *case.tables, case.index, uniform)
    assert np.array_equal(states, wanted_states)
    assert np.array_equal(log.response, wanted)


@given(cases(max_paths=10**9), st.integers(0, 100))
def test_design_and_missing_records_are_kept(case, seed):
    model = LatentStatePOMDP(*case.tables, case.protocol)
    design = design_of(case.runs, case.protocol)
    log, _ = simulate_responses(model, design, np.random.default_rng(seed))
    assert np.array_equal(log.response == UNSEEN, design.response == UNSEEN)
    assert log.n_missing == design.n_missing
    for name in ("offsets", "participant", "sequence", "condition", "action"):
        assert np.array_equal(getattr(log, name), getattr(design, name))


def test_the_same_seed_gives_the_same_study_and_another_one_another():
    rng = np.random.default_rng(0)
    design = design_of([random_run(rng, PUBLISHED, 5, 0.1) for _ in range(200)])
    model = LatentStatePOMDP(*random_tables(rng, PUBLISHED, 3))
    one, two, three = (simulate_responses(model, design, np.random.default_rng(s)) for s in (4, 4, 5))
    assert np.array_equal(one[0].response, two[0].response)
    assert np.array_equal(one[1], two[1])
    assert not np.array_equal(one[0].response, three[0].response)


def assert_within_binomial_error(successes, trials, probability):
    assert trials > 0
    error = math.sqrt(probability * (1 - probability) / trials)
    assert abs(successes / trials - probability) <= 4 * error + 1e-12, (successes, trials, probability)


@pytest.mark.parametrize("protocol", [PUBLISHED, THREE])
def test_frequencies_are_the_models_probabilities(protocol):
    rng = np.random.default_rng(12)
    design = design_of([random_run(rng, protocol, 6, 0.1) for _ in range(20_000)], protocol)
    model = LatentStatePOMDP(*random_tables(rng, protocol, 3), protocol)
    log, states = simulate_responses(model, design, rng)
    first = states[design.offsets[:-1]]
    for s in range(3):
        assert_within_binomial_error(np.sum(first == s), len(first), model.initial[s])
    before = np.flatnonzero(log.run_of_event[1:] == log.run_of_event[:-1])
    for a in range(protocol.n_actions):
        for s in range(3):
            here = before[(design.action[before] == a) & (states[before] == s)]
            for t in range(3):
                assert_within_binomial_error(np.sum(states[here + 1] == t), len(here), model.transition[a, s, t])
            row = protocol.emission_index[a]
            if row < 0:
                continue
            seen = log.response[(design.action == a) & (states == s) & (log.response >= 0)]
            for o in range(protocol.n_responses):
                assert_within_binomial_error(np.sum(seen == o), len(seen), model.emission[row, s, o])


def test_impossible_states_and_responses_are_never_drawn():
    """Also where the probabilities add up to a little less than one."""
    initial = np.array([0.6, 0.3, 0.1, 0.0])  # 0.9999999999999999
    transition = np.tile(np.roll(np.eye(4), 1, axis=1), (4, 1, 1))
    emission = np.tile(np.array([1.0, 0.0]), (2, 4, 1))
    model = LatentStatePOMDP(initial, transition, emission)

    class NearlyOne:
        def random(self, shape):
            return np.full(shape, np.nextafter(1.0, 0.0))

    log, states = simulate_responses(model, design_of([[(2, 0), (3, 0)]]), NearlyOne())
    assert states.tolist() == [2, 3]
    assert log.response.tolist() == [0, 0]


def test_a_design_under_another_protocol_is_refused():
    model = LatentStatePOMDP(*random_tables(np.random.default_rng(1), PUBLISHED, 2))
    with pytest.raises(InputError, match="simulation, protocol of the model: found 'published', wanted"):
        simulate_responses(model, design_of([[(0, -1)]], THREE), np.random.default_rng(1))
