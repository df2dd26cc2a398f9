"""Runs of thousands of rounds: no underflow, no recursion, work and memory in proportion to the rounds."""

import math
from collections import Counter

import numpy as np
import pytest
from scipy.special import logsumexp

from models.baum_welch import BaumWelch
from models.em_kernel import em
from models.forward_backward import decode, history_log_likelihoods, log_likelihood_and_gradient, smooth
from models.growing_tree import GrowingTree, merged
from models.hmm_density import HmmDensity
from models.identification import identification
from models.lspomdp import LatentStatePOMDP
from models.parameters import STICKY, Layout
from models.people_kernel import PeopleArrays
from models.person_offset import distinct_people, quadrature
from models.planning.belief_model import BeliefModel
from models.planning.belief_policy import Myopic
from models.protocol import PUBLISHED
from models.runtime import Session
from models.simulation import simulate_responses
from models.study_density import ModelSpec, StudyDensity
from tests.models.test_simulation import design_of
from tests.random_cases import random_run, random_tables, tree_of
from tests.reference import log_space, people, recursions, simulation

INDEX = np.array(PUBLISHED.emission_index, dtype=np.int64)
ROUNDS = 20_000


def study(seed=1, lengths=(ROUNDS, 5_000), states=3):
    """Runs simulated from random tables, so that responses are neither certain nor all alike."""
    rng = np.random.default_rng(seed)
    tables = random_tables(rng, PUBLISHED, states)
    design = design_of([random_run(rng, PUBLISHED, n, 0.05) for n in lengths])
    log, _ = simulate_responses(LatentStatePOMDP(*tables, PUBLISHED), design, rng)
    events = list(zip(log.action.tolist(), log.response.tolist(), strict=True))
    runs = [events[a:b] for a, b in zip(log.offsets[:-1], log.offsets[1:], strict=True)]
    return log, runs, tables


@pytest.fixture(scope="module")
def long():
    log, runs, tables = study()
    return log, runs, tables, [log_space.forward_backward(run, *tables, INDEX) for run in runs]


def test_likelihood_and_expected_counts_equal_those_in_log_space(long):
    log, _, tables, wanted = long
    found = log_likelihood_and_gradient(log.tree(), *tables, INDEX)
    assert found.log_likelihood < -2_000  # its exponential is zero
    assert found.log_likelihood == pytest.approx(sum(total for total, *_ in wanted), rel=1e-11)
    for table, gradient, *counts in zip(tables, found[1:], *(c for *_, c in wanted), strict=True):
        np.testing.assert_allclose(table * gradient, sum(counts), rtol=1e-8, atol=1e-9)


def test_smoothed_states_and_best_paths_equal_those_in_log_space(long):
    log, runs, tables, wanted = long
    tree = log.tree()
    rows, best = smooth(tree, *tables, INDEX), decode(tree, *tables, INDEX)
    for run, node, (_, gamma, _) in zip(runs, tree.run_node, wanted, strict=True):
        h = int(np.searchsorted(tree.terminals, node))
        own = slice(rows.offsets[h], rows.offsets[h + 1])
        np.testing.assert_allclose(rows.probability[own], gamma, rtol=1e-7, atol=1e-12)
        path, value = recursions.viterbi(run, *tables, INDEX)
        assert best.log_probability[h] == pytest.approx(value, rel=1e-12)
        assert np.array_equal(best.state[own], path)


def test_one_em_map_equals_the_one_in_log_space(long):
    log, _, tables, wanted = long
    layout = Layout(PUBLISHED, 3)
    zeros, free = np.zeros(layout.size), np.ones(layout.size, dtype=bool)
    theta, trace, *_ = em(
        layout.pack(*tables), log.tree().arrays, layout.sizes, layout.emission_index, zeros, free, 1, 0.0, 9, False,
        np.zeros(1, np.uint8),
    )  # fmt: skip
    counts = [sum(parts) for parts in zip(*(c for *_, c in wanted), strict=True)]
    for found, count in zip(layout.unpack(theta), counts, strict=True):
        np.testing.assert_allclose(found, count / count.sum(axis=-1, keepdims=True), rtol=1e-8)
    assert trace[1] > trace[0]


def test_a_fit_of_long_runs_climbs_and_is_examined(long):
    log = long[0]
    settings = BaumWelch(3, restarts=2, finalists=1, rounds=1, screening_maps=10, max_maps=60)
    fit = settings.fit(log)
    assert np.all(np.diff(fit.trace) >= 0)
    assert fit.transition_count.sum() == pytest.approx(log.n_events - log.n_runs, rel=1e-9)
    assert fit.emission_count.sum() == pytest.approx(log.n_responses_recorded, rel=1e-9)
    found = identification(fit, log)
    # Two histories have two scores: that is how many directions they can tell apart.
    assert found.rank == 2
    assert found.n_missing == log.n_missing


def test_density_and_gradient_equal_those_in_log_space(long):
    log, runs, _, _ = long
    density = StudyDensity(log, ModelSpec(3)).density
    layout = density.layout
    rng = np.random.default_rng(3)
    x, way = rng.normal(size=(2, density.dimension))

    def value(point):
        theta = density.theta(point)
        tables = layout.unpack(theta)
        prior = density(point)[0] - log_likelihood_and_gradient(density.tree, *tables, INDEX).log_likelihood
        return prior + sum(recursions.log_space_likelihood(run, *tables, INDEX) for run in runs)

    found, gradient = density(x)
    assert found == pytest.approx(value(x), rel=1e-12)
    step = 1e-4
    slope = (value(x + step * way) - value(x - step * way)) / (2 * step)
    assert gradient @ way == pytest.approx(slope, rel=1e-6)


def test_people_who_differ_over_long_runs():
    log, runs, tables = study(lengths=(6_000, 3_000, 200), states=2)
    layout, person = Layout(PUBLISHED, 2), np.array([0, 0, 1])
    z, log_weight = quadrature(5)
    scores = np.asarray(PUBLISHED.scores, dtype=float)
    offsets = PeopleArrays(*distinct_people(log.tree(), person), z, log_weight, scores, np.ones(1))
    density = HmmDensity(log.tree(), layout, 1.0 + STICKY.pseudo_counts(layout), {}, offsets)
    theta = np.append(layout.pack(*tables), 0.7)

    def likelihood(spread):
        total = 0.0
        for own in (runs[:2], runs[2:]):
            by_node = [
                lw + sum(recursions.log_space_likelihood(
                    run, tables[0], tables[1], people.tilted(tables[2], scores, spread * q), INDEX) for run in own)
                for q, lw in zip(z, log_weight, strict=True)
            ]  # fmt: skip
            total += logsumexp(by_node)
        return total

    x = density.unconstrained(theta)
    found, gradient = density(x)
    assert np.isfinite(gradient).all()
    # What does not depend on sigma through the responses: priors and Jacobians, from a tree without any run.
    prior = replaced(density)(x)[0]
    assert found - prior == pytest.approx(likelihood(0.7), rel=1e-11)
    step = 1e-5
    slope = (likelihood(0.7 * math.exp(step)) - likelihood(0.7 * math.exp(-step))) / (2 * step)
    assert gradient[-1] - replaced(density)(x)[1][-1] == pytest.approx(slope, rel=1e-5, abs=1e-6)


def replaced(density):
    """The same density of nobody: priors and Jacobians alone."""
    people_of = density.people._replace(weight=np.zeros_like(density.people.weight))
    empty = density.tree.with_counts(np.zeros(density.tree.n_nodes))
    return HmmDensity(empty, density.layout, density.alpha, density.pins, people_of)


def test_the_belief_filter_keeps_its_digits(long):
    _, runs, tables, _ = long
    model = LatentStatePOMDP(*tables, PUBLISHED)
    wanted = log_space.filtered(runs[1], *tables, INDEX)
    belief = model.initial
    for (a, o), before in zip(runs[1], wanted, strict=False):
        np.testing.assert_allclose(belief, before, rtol=1e-9)
        response = PUBLISHED.response_names[o] if o >= 0 else None
        belief = model.update(belief, PUBLISHED.action_names[a], response)
    np.testing.assert_allclose(belief, wanted[-1], rtol=1e-9)


def test_simulated_responses_of_long_runs_equal_the_specification(long):
    log, runs, tables, _ = long
    model = LatentStatePOMDP(*tables, PUBLISHED)
    found, states = simulate_responses(model, log, np.random.default_rng(5))
    uniform = np.random.default_rng(5).random((log.n_events, 2))
    wanted_states, wanted = simulation.simulate(runs, *tables, INDEX, uniform)
    assert np.array_equal(states, wanted_states)
    assert np.array_equal(found.response, wanted)


@pytest.mark.parametrize("exponent", [40, 140, 280])
def test_types_that_evidence_first_speaks_against(exponent):
    """Two types that nobody leaves: the evidence turns round in the middle of the run, within what doubles hold."""
    initial, transition = np.array([0.5, 0.5]), np.tile(np.eye(2), (4, 1, 1))
    emission = np.array([[[0.1, 0.9], [0.9, 0.1]]] * 2)
    once = exponent
    run = [(2, 0)] * once + [(2, 1)] * (2 * once + 5)
    tables = (initial, transition, emission)
    total, gamma, counts = log_space.forward_backward(run, *tables, INDEX)
    found = log_likelihood_and_gradient(tree_of([run], PUBLISHED), *tables, INDEX)
    assert found.log_likelihood == pytest.approx(total, rel=1e-12)
    np.testing.assert_allclose(emission * found.emission, counts[2], rtol=1e-9, atol=1e-9)
    assert gamma[-1, 0] > 0.99


def test_trees_of_long_runs_grow_in_parts_and_are_put_together():
    rng = np.random.default_rng(2)
    first = random_run(rng, PUBLISHED, ROUNDS, 0.1)
    runs = [first, first[:9_000] + random_run(rng, PUBLISHED, 9_000, 0.1), first[:15_000]]
    wanted = tree_of(runs, PUBLISHED)
    assert ROUNDS + 8_900 < wanted.n_nodes <= 1 + ROUNDS + 9_000
    grown = GrowingTree(PUBLISHED.n_actions, PUBLISHED.n_responses, keep_runs=True)
    codes = np.array([event for run in runs for event in run], dtype=np.int8)
    starts = np.cumsum([0, *map(len, runs[:-1])])
    for low in range(0, len(codes), 777):
        part = codes[low : low + 777]
        own = starts[(starts >= low) & (starts < low + 777)] - low
        action, response = np.ascontiguousarray(part.T)
        grown.add(own, np.ones(len(own), dtype=bool), action, response)
    together = merged([tree_of(runs[:2], PUBLISHED), tree_of(runs[2:], PUBLISHED)])
    for found in (grown.finish(), together):
        assert all(np.array_equal(a, b) for a, b in zip(found.arrays, wanted.arrays, strict=True))
        assert np.array_equal(found.parent, wanted.parent)
        assert np.array_equal(found.run_node, wanted.run_node)
    assert wanted.path(int(wanted.run_node[0])).tolist() == wanted.path(int(together.run_node[0])).tolist()
    tables = random_tables(rng, PUBLISHED, 2)
    values = history_log_likelihoods(wanted, *tables, INDEX)
    for run, node in zip(runs, wanted.run_node, strict=True):
        own = values[np.searchsorted(wanted.terminals, node)]
        assert own == pytest.approx(recursions.log_space_likelihood(run, *tables, INDEX), rel=1e-11)


def test_a_session_of_thousands_of_rounds():
    model = LatentStatePOMDP(*random_tables(np.random.default_rng(4), PUBLISHED, 3), PUBLISHED)
    rng = np.random.default_rng(8)
    met = Counter()
    belief = model.initial
    with Session(Myopic(BeliefModel.of_latent(model), np.arange(3.0))) as session:
        for _ in range(5_000):
            mode = int(rng.integers(2))
            decision = session.act(mode)
            np.testing.assert_allclose(session.memory.belief, belief, rtol=1e-9)
            possible = session.possible_responses(mode) or (None,)
            response = possible[int(rng.integers(len(possible)))]
            seen = response if response in PUBLISHED.response_names else None
            belief = model.update(belief, decision.action, seen)
            met[decision.action] += 1
            session.observe(response)
    assert sum(met.values()) == 5_000
