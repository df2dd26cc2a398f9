"""Forward and backward on a handful of small fixed cases: quick also where kernels are interpreted.

Every number has an oracle that shares no code with the kernels: the plain recursions, run by run, and their
derivatives by a complex step.
"""

import numpy as np
import pytest

from models.draw_kernels import history_log_likelihoods
from models.em_kernel import objective_and_step
from models.forward_backward import TINY, decode, log_likelihood_and_gradient, smooth
from models.forward_backward import history_log_likelihoods as plain_history_log_likelihoods
from models.histories import HistoryTree
from models.parameters import Layout
from models.protocol import PUBLISHED
from tests.models.by_hand_cases import THREE, case
from tests.random_cases import random_run, random_tables, tree_of
from tests.reference import recursions

CASES = [(0, 3, PUBLISHED, 0.0), (1, 2, THREE, 0.0), (2, 3, THREE, 0.2), (3, 1, PUBLISHED, 0.0)]


@pytest.mark.parametrize("given", CASES)
def test_likelihood_gradient_states_and_paths(given):
    runs, tables, index = case(*given)
    tree = tree_of(runs, given[2])
    weights = np.arange(len(runs)) % 3 + 0.5
    found = log_likelihood_and_gradient(tree.with_runs(weights), *tables, index)
    logs = np.array([recursions.log_likelihood(run, *tables, index) for run in runs])
    if np.isfinite(logs).all():
        assert found.log_likelihood == pytest.approx(weights @ logs, rel=1e-12)
        for which, gradient in enumerate(found[1:]):
            for position in np.ndindex(gradient.shape):
                slope = recursions.gradient_entry(runs, weights, tables, index, which, position)
                assert gradient[position] == pytest.approx(slope, rel=1e-10, abs=1e-12)
    else:
        assert found.log_likelihood == -np.inf
    of_run = np.searchsorted(tree.terminals, tree.run_node)
    own = plain_history_log_likelihoods(tree, *tables, index)
    np.testing.assert_allclose(own[of_run], logs, rtol=1e-12)
    smoothed, decoded = smooth(tree, *tables, index), decode(tree, *tables, index)
    for run, h, value in zip(runs, of_run, logs, strict=True):
        rows = slice(smoothed.offsets[h], smoothed.offsets[h + 1])
        assert rows.stop - rows.start == len(run)
        if np.isfinite(value):
            np.testing.assert_allclose(
                smoothed.probability[rows], recursions.smoothed(run, *tables, index)[0], atol=1e-12
            )
            path, best = recursions.viterbi(run, *tables, index)
            assert decoded.state[rows].tolist() == path
            assert decoded.log_probability[h] == pytest.approx(best, rel=1e-12)


@pytest.mark.parametrize("tiny", [1e-15, 1e-30, 1e-80])
def test_improbable_responses_are_rescaled_out_of_harm(tiny):
    """So improbable that forward vectors would underflow; the same in logarithms is no trouble."""
    rng = np.random.default_rng(5)
    initial, transition, emission = random_tables(rng, PUBLISHED, 2)
    emission[:, :, 1] = tiny * rng.uniform(1, 3, emission.shape[:2])
    emission[:, :, 0] = 1 - emission[:, :, 1]
    # Rescaled and not, one after the other, and two ways on from a node that was.
    runs = [[(2, 1), (3, 1), (2, 0), (3, 1)], [(2, 1), (3, 1), (2, 0), (3, 0), (2, 1)], [(2, 1)] * 7]
    tables, index = (initial, transition, emission), np.array(PUBLISHED.emission_index)
    tree = tree_of(runs, PUBLISHED)
    found = log_likelihood_and_gradient(tree, *tables, index)
    logs = [recursions.log_space_likelihood(run, *tables, index) for run in runs]
    assert found.log_likelihood == pytest.approx(sum(logs), rel=1e-12)
    own = plain_history_log_likelihoods(tree, *tables, index)
    np.testing.assert_allclose(own[np.searchsorted(tree.terminals, tree.run_node)], logs, rtol=1e-12)
    layout = Layout(PUBLISHED, 2)
    many = history_log_likelihoods(tree, layout, np.stack([layout.pack(*tables), layout.uniform]))
    np.testing.assert_allclose(many[0], own, rtol=1e-12)
    for which, gradient in enumerate(found[1:]):
        for position in np.ndindex(gradient.shape):
            slope = recursions.gradient_entry(runs, np.ones(3), tables, index, which, position)
            assert gradient[position] == pytest.approx(slope, rel=1e-10)
    smoothed = smooth(tree, *tables, index)
    for run, h in zip(runs, np.searchsorted(tree.terminals, tree.run_node), strict=True):
        rows = slice(smoothed.offsets[h], smoothed.offsets[h + 1])
        np.testing.assert_allclose(
            smoothed.probability[rows], recursions.smoothed(run, *tables, index)[0], atol=1e-12
        )
    assert TINY > 1e-200


def test_an_impossible_run_counts_only_with_its_weight():
    _, (initial, transition, emission), index = case(0)
    emission = emission.copy()
    emission[0] = [1.0, 0.0]
    runs = [[(2, 0), (3, 1)], [(2, 1), (3, 1)]]
    tree = tree_of(runs, PUBLISHED)
    found = log_likelihood_and_gradient(tree, initial, transition, emission, index)
    assert found.log_likelihood == -np.inf
    assert not any(table.any() for table in found[1:])
    found = log_likelihood_and_gradient(tree.with_runs(np.array([2.0, 0.0])), initial, transition, emission, index)
    assert found.log_likelihood == 2 * recursions.log_likelihood(runs[0], initial, transition, emission, index)
    alone = log_likelihood_and_gradient(tree_of(runs[:1], PUBLISHED), initial, transition, emission, index)
    for one, other in zip(found[1:], alone[1:], strict=True):
        np.testing.assert_array_equal(one, 2 * other)
    own = plain_history_log_likelihoods(tree, initial, transition, emission, index)
    assert own[np.searchsorted(tree.terminals, tree.run_node[1])] == -np.inf
    # There is no distribution of states behind what cannot happen.
    smoothed = smooth(tree, initial, transition, emission, index)
    h = int(np.searchsorted(tree.terminals, tree.run_node[1]))
    assert np.isnan(smoothed.probability[smoothed.offsets[h] : smoothed.offsets[h + 1]]).all()


def test_a_run_of_one_event_at_the_first_node():
    _, (initial, transition, emission), index = case(0)
    found = log_likelihood_and_gradient(
        tree_of([[(2, 0)], [(2, 1), (3, 0)]], PUBLISHED), initial, transition, emission, index
    )
    logs = [
        recursions.log_likelihood(run, initial, transition, emission, index) for run in ([(2, 0)], [(2, 1), (3, 0)])
    ]
    assert found.log_likelihood == pytest.approx(sum(logs), rel=1e-13)


def test_the_first_of_equally_probable_paths():
    runs, index = [[(2, 1), (3, 0), (2, 1)]], np.array(PUBLISHED.emission_index)
    even = np.full(2, 0.5), np.full((4, 2, 2), 0.5), np.full((2, 2, 2), 0.5)
    assert decode(tree_of(runs, PUBLISHED), *even, index).state.tolist() == [0, 0, 0]


def test_every_group_of_people_starts_from_its_own_distribution():
    """Actions are coded by group; tables and starting distributions of two groups side by side."""
    rng = np.random.default_rng(9)
    n = PUBLISHED.n_actions
    one, other = (random_tables(rng, PUBLISHED, 3) for _ in range(2))
    initial = np.stack([one[0], other[0]])
    transition, emission = (np.concatenate([a, b]) for a, b in zip(one[1:], other[1:], strict=True))
    plain = np.array(PUBLISHED.emission_index)
    index = np.concatenate([plain, np.where(plain >= 0, plain + len(one[2]), -1)])
    runs = [random_run(rng, PUBLISHED, 4, 0.2) for _ in range(6)]
    coded = [[(a + n * (r % 2), o) for a, o in run] for r, run in enumerate(runs)]
    events = np.array([event for run in coded for event in run], dtype=np.int8)
    offsets = np.cumsum([0, *map(len, coded)]).astype(np.int64)
    tree = HistoryTree.build(offsets, events[:, 0].copy(), events[:, 1].copy(), 2 * n, PUBLISHED.n_responses)
    found = log_likelihood_and_gradient(tree, initial, transition, emission, index)
    parts = [
        log_likelihood_and_gradient(tree_of(runs[g::2], PUBLISHED), *tables, plain)
        for g, tables in enumerate((one, other))
    ]
    assert found.log_likelihood == pytest.approx(sum(part.log_likelihood for part in parts), rel=1e-13)
    np.testing.assert_allclose(found.initial, [part.initial for part in parts], rtol=1e-12)
    for name in ("transition", "emission"):
        both = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_allclose(getattr(found, name), both, rtol=1e-12)


def test_what_was_in_the_arrays_before_does_not_show():
    """Loops keep their work arrays; two evaluations in the same ones must not see each other."""
    runs, tables, index = case(0)
    theta = np.concatenate([t.ravel() for t in tables])
    tree = tree_of(runs, PUBLISHED)
    sizes = (3, 4, 2, 2)
    results = []
    for rubbish in (0.0, np.nan):
        work, scale = np.full((2, tree.n_nodes, 3), rubbish), np.full((2, tree.n_nodes), rubbish)
        new, gradient = np.full(len(theta), rubbish), np.full(len(theta), rubbish)
        pseudo, free = np.full(len(theta), 0.5), np.ones(len(theta), bool)
        out = objective_and_step(theta, new, tree.arrays, sizes, index, pseudo, free, gradient, work, scale)
        results.append((out, new, gradient))
    assert results[0][0] == results[1][0]
    for one, other in zip(results[0][1:], results[1][1:], strict=True):
        np.testing.assert_array_equal(one, other)
