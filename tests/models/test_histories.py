"""The prefix tree against its dict-of-tuples specification."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.forward_backward import log_likelihood_and_gradient
from models.histories import DENSE, UNSEEN, HistoryTree
from models.protocol import PUBLISHED
from tests.random_cases import cases, random_run, random_tables, tree_of
from tests.reference.compression import compress


def assert_same_tree(one: HistoryTree, other: HistoryTree) -> None:
    for name, array, twin in zip(one.arrays._fields, one.arrays, other.arrays, strict=True):
        assert np.array_equal(array, twin), name
        assert array.dtype == twin.dtype, name
    assert np.array_equal(one.parent, other.parent)
    assert np.array_equal(one.terminals, other.terminals)
    assert np.array_equal(one.depth, other.depth)


def events_of(tree: HistoryTree, node: int) -> tuple:
    return tuple((int(tree.arrays.action[i]), int(tree.arrays.response[i])) for i in tree.path(node))


@given(cases(max_runs=30, max_paths=10**9))
def test_tree_is_the_sorted_dict_of_beginnings(case):
    tree = case.tree()
    beginnings, ends = compress(case.runs)
    assert [events_of(tree, node) for node in range(tree.n_nodes)] == beginnings
    assert tree.arrays.ends.tolist() == ends
    assert tree.parent[0] == -1
    assert [beginnings[p] for p in tree.parent[1:]] == [b[:-1] for b in beginnings[1:]]
    for node, beginning in enumerate(beginnings):
        first, count = tree.arrays.first_child[node], tree.arrays.n_children[node]
        children = [i for i, b in enumerate(beginnings) if len(b) and b[:-1] == beginning and i > 0]
        assert list(range(first, first + count)) == children
    assert tree.depth.tolist() == [len(b) for b in beginnings]
    assert tree.n_runs == len(case.runs)
    assert tree.n_histories == len({tuple(run) for run in case.runs})
    assert [beginnings[t] for t in tree.terminals] == [b for b, n in zip(beginnings, ends, strict=True) if n]


@given(cases(max_runs=30, max_paths=10**9))
def test_run_node_is_where_each_run_ends(case):
    tree = case.tree()
    assert [events_of(tree, node) for node in tree.run_node] == [tuple(run) for run in case.runs]


@given(cases(max_runs=20, max_paths=10**9), st.randoms(use_true_random=False))
def test_order_of_runs_changes_no_bit(case, random):
    shuffled = random.sample(case.runs, len(case.runs))
    tree, other = case.tree(), case.tree(shuffled)
    assert_same_tree(tree, other)
    one = log_likelihood_and_gradient(tree, *case.tables, case.index)
    two = log_likelihood_and_gradient(other, *case.tables, case.index)
    assert one.log_likelihood == two.log_likelihood
    for gradient, twin in zip(one[1:], two[1:], strict=True):
        assert np.array_equal(gradient, twin)


@given(cases(max_paths=10**9), st.integers(2, 5))
def test_counts_equal_repetition(case, times):
    tree, repeated = case.tree(), case.tree(case.runs * times)
    assert_same_tree(tree.with_counts(tree.arrays.ends * times), repeated)
    once = log_likelihood_and_gradient(tree, *case.tables, case.index)
    many = log_likelihood_and_gradient(repeated, *case.tables, case.index)
    assert many.log_likelihood == pytest.approx(times * once.log_likelihood, rel=1e-13)
    for gradient, twin in zip(once[1:], many[1:], strict=True):
        np.testing.assert_allclose(twin, times * gradient, rtol=1e-12)


@given(cases(max_paths=10**9), st.data())
def test_run_weights_equal_repetition(case, data):
    weights = data.draw(st.lists(st.integers(0, 3), min_size=len(case.runs), max_size=len(case.runs)).filter(any))
    tree = case.tree().with_runs(np.array(weights, dtype=float))
    repeated = case.tree([run for run, w in zip(case.runs, weights, strict=True) for _ in range(w)])
    value = log_likelihood_and_gradient(tree, *case.tables, case.index)
    twin = log_likelihood_and_gradient(repeated, *case.tables, case.index)
    assert value.log_likelihood == pytest.approx(twin.log_likelihood, rel=1e-12, abs=1e-12)
    for gradient, other in zip(value[1:], twin[1:], strict=True):
        np.testing.assert_allclose(gradient, other, rtol=1e-11, atol=1e-12)


def test_a_run_may_end_inside_another():
    tree = tree_of([[(0, UNSEEN), (3, 1)], [(0, UNSEEN)], [(0, UNSEEN), (3, 1), (1, UNSEEN)]], PUBLISHED)
    assert tree.n_nodes == 4
    assert tree.arrays.ends.tolist() == [0, 1, 1, 1]
    assert tree.run_node.tolist() == [2, 1, 3]
    assert tree.path(3).tolist() == [1, 2, 3]
    assert tree.path(0).tolist() == []


def test_missing_and_seen_are_different_histories():
    tree = tree_of([[(2, UNSEEN)], [(2, 0)], [(2, 1)]], PUBLISHED)
    assert tree.arrays.response.tolist() == [UNSEEN, UNSEEN, 0, 1]
    assert tree.arrays.action.tolist() == [-1, 2, 2, 2]


def test_more_nodes_than_the_table_of_children_and_the_first_allocation():
    """Beyond `DENSE` nodes children are found along lists: histories must be shared and branch there too."""
    rng = np.random.default_rng(5)
    runs = [random_run(rng, PUBLISHED, 40, 0.1) for _ in range(600)]
    late = runs[-60:]
    runs += [
        run[: rng.integers(20, 40)] + random_run(rng, PUBLISHED, 3, 0.1) for run in late for _ in range(8)
    ] + late
    tree = tree_of(runs, PUBLISHED)
    beginnings, ends = compress(runs)
    assert tree.n_nodes == len(beginnings) > DENSE + 5000
    assert tree.arrays.ends.tolist() == ends
    assert tree.arrays.ends.max() >= 2
    assert all(events_of(tree, node) == tuple(run) for node, run in zip(tree.run_node, runs, strict=True))
    shuffled = tree_of([runs[i] for i in rng.permutation(len(runs))], PUBLISHED)
    assert_same_tree(tree, shuffled)
    value = log_likelihood_and_gradient(tree, *random_tables(rng, PUBLISHED, 2), np.array(PUBLISHED.emission_index))
    assert np.isfinite(value.log_likelihood)


def test_published_design_has_at_most_192_histories():
    rng = np.random.default_rng(2)
    runs = []
    for _ in range(20_000):
        schedule = rng.choice(["RRHHH", "HRRHH", "HHRRH", "RHRHH", "HRHRH", "RHHRH"])
        helps, signals = rng.integers(2, size=2)  # the four arms
        runs.append(
            [(int(helps), UNSEEN) if m == "R" else (2 + int(signals), int(rng.integers(2))) for m in schedule]
        )
    assert tree_of(runs, PUBLISHED).n_histories == 4 * 6 * 8


@pytest.mark.parametrize(
    ("offsets", "action", "response", "message"),
    [
        ([0], [], [], "runs: found 0, wanted at least one run"),
        ([0, 1, 1], [0], [-1], "run lengths: found 0, wanted at least one event in every run"),
        ([0, 1], [4], [-1], r"action code: found 4, wanted 0\.\.3"),
        ([0, 1], [-1], [-1], r"action code: found -1, wanted 0\.\.3"),
        ([0, 1], [2], [2], r"response code: found 2, wanted -1\.\.1"),
        ([0, 1], [2], [-2], r"response code: found -2, wanted -1\.\.1"),
    ],
)
def test_unusable_codes_are_refused(offsets, action, response, message):
    with pytest.raises(InputError, match=message):
        HistoryTree.build(np.array(offsets), np.array(action, np.int8), np.array(response, np.int8), 4, 2)


def test_weights_of_the_wrong_shape_are_refused():
    tree = tree_of([[(0, UNSEEN)], [(1, UNSEEN)]], PUBLISHED)
    with pytest.raises(InputError, match=r"counts, shape: found \(2,\), wanted \(3,\)"):
        tree.with_counts(np.ones(2))
    with pytest.raises(InputError, match=r"run weights, shape: found \(3,\), wanted \(2,\)"):
        tree.with_runs(np.ones(3))


def test_counts_must_be_weights_of_histories():
    tree = HistoryTree.build(
        np.array([0, 2, 3]), np.array([2, 0, 1], np.int8), np.array([1, -1, -1], np.int8), 4, 2
    )
    ends = tree.arrays.ends.copy()
    with pytest.raises(InputError, match="counts: found -1"):
        tree.with_counts(-ends)
    inner = next(n for n in range(1, tree.n_nodes) if ends[n] == 0)
    ends[inner] = 2.0
    with pytest.raises(InputError, match=f"counts, node: found {inner}, wanted zero where no run ends"):
        tree.with_counts(ends)
