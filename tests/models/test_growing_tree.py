"""Trees that grow in parts and trees put together: the canonical tree, bit for bit."""

from dataclasses import fields
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.growing_tree import CountedTree, GrowingTree, merged
from models.histories import HistoryTree
from models.protocol import PUBLISHED
from tests.random_cases import protocols, random_run, tree_of


def equal(found: HistoryTree, wanted: HistoryTree) -> bool:
    arrays = zip(found.arrays, wanted.arrays, strict=True)
    return (
        all(np.array_equal(a, b) and a.dtype == b.dtype for a, b in arrays)
        and np.array_equal(found.parent, wanted.parent)
        and np.array_equal(found.terminals, wanted.terminals)
        and found.n_runs == wanted.n_runs
    )


@st.composite
def studies(draw):
    protocol = draw(protocols())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n = draw(st.integers(1, 12))
    return protocol, [random_run(rng, protocol, int(rng.integers(1, 7)), 0.2) for _ in range(n)]


@given(studies(), st.integers(1, 9), st.booleans(), st.integers(0, 2**12 - 1))
def test_grown_in_parts_with_some_runs_passed_over(study, size, keep, chosen):
    protocol, runs = study
    wanted_runs = np.array([chosen >> i & 1 for i in range(len(runs))], dtype=bool)
    tree = GrowingTree(protocol.n_actions, protocol.n_responses, keep_runs=keep)
    codes = np.array([event for run in runs for event in run], dtype=np.int8)
    starts = np.cumsum([0, *map(len, runs[:-1])])
    for low in range(0, len(codes), size):
        here = (starts >= low) & (starts < low + size)
        action, response = np.ascontiguousarray(codes[low : low + size].T)
        tree.add(starts[here] - low, wanted_runs[here], action, response)
    if not wanted_runs.any():
        with pytest.raises(InputError, match="at least one run"):
            tree.finish()
        return
    found = tree.finish()
    wanted = tree_of([run for run, own in zip(runs, wanted_runs, strict=True) if own], protocol)
    assert equal(found, wanted)
    assert isinstance(found, CountedTree) != keep
    if keep:
        assert np.array_equal(found.run_node, wanted.run_node)


@given(studies(), st.lists(st.integers(0, 12), max_size=3), st.booleans())
def test_trees_put_together_are_the_tree_of_all_runs(study, cuts, counted):
    protocol, runs = study
    edges = sorted({0, *(min(c, len(runs)) for c in cuts), len(runs)})
    trees = [tree_of(runs[a:b], protocol) for a, b in pairwise(edges)]
    if counted:
        trees[0] = as_counted(trees[0])
    found, wanted = merged(trees), tree_of(runs, protocol)
    assert equal(found, wanted)
    if not counted:
        assert np.array_equal(found.run_node, wanted.run_node)
    # Weights are summed, and a history whose weight became zero is still one of the histories.
    none = merged([tree.with_counts(0.0 * tree.arrays.ends) for tree in trees])
    assert not none.arrays.ends.any()
    assert np.array_equal(none.terminals, wanted.terminals)


def as_counted(tree: HistoryTree) -> CountedTree:
    own = {f.name: getattr(tree, f.name) for f in fields(HistoryTree)}
    return CountedTree(**own | {"run_node": np.empty(0, np.int64)}, ended=tree.terminals, runs=tree.n_runs)


def test_trees_of_different_protocols_are_not_put_together():
    tree = tree_of([[(0, -1)]], PUBLISHED)
    other = HistoryTree.build(np.array([0, 1]), np.zeros(1, np.int8), np.zeros(1, np.int8), 5, 2)
    with pytest.raises(InputError, match="found 5 actions and 2 responses, wanted 4 and 2, as in the first"):
        merged([tree, other])
    with pytest.raises(InputError, match="at least one"):
        merged([])
