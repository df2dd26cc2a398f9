"""Histories counted by condition, in parts of any size: the tree and the counts of the log that is all there."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.compressed_log import LogTally
from models.condition_trees import ConditionTrees
from models.errors import InputError
from models.growing_tree import merged, merged_with_places
from models.histories import HistoryTree
from models.study_density import ModelSpec, StudyDensity
from models.unseen import evidence_of_actions
from tests.models.test_design_facts import logs


def in_parts(log, size, **options):
    """The log compressed, given in parts of so many events."""
    tally = LogTally(log.protocol, **options)
    person, condition = log.participant[log.run_of_event], log.condition[log.run_of_event]
    starts = log.offsets[:-1]
    for low in range(0, log.n_events, size):
        part = slice(low, low + size)
        own = starts[(starts >= low) & (starts < low + size)] - low
        tally.add(own, person[part], condition[part], log.conditions, log.action[part], log.response[part])
    return tally.finish("s")


def same(one, other):
    return all(np.array_equal(a, b) for a, b in zip(one.arrays, other.arrays, strict=True)) and np.array_equal(
        one.terminals, other.terminals
    )


@given(logs(), st.integers(1, 7), st.data())
def test_tree_and_counts_are_those_of_the_log(log, size, data):
    chosen = data.draw(st.sampled_from([None, *((name,) for name in log.conditions)]))
    own = log if chosen is None else log.select(conditions=chosen)
    found = in_parts(log, size, conditions=chosen, by_condition=True)
    assert same(found.tree(), own.tree())
    assert found.tree().n_runs == own.n_runs
    if own.n_responses_recorded:
        whole, parts = (StudyDensity(study, ModelSpec(2)).history_counts for study in (own, found))
        assert np.array_equal(whole, parts)
    # The same, run by run.
    tree = own.tree()
    wanted = np.zeros((len(own.conditions), tree.n_histories))
    for run, node in enumerate(tree.run_node):
        wanted[own.condition[run], tree.terminals.tolist().index(node)] += 1
    assert np.array_equal(found.counts_by_condition, wanted)


@given(logs(), st.integers(1, 7), st.data())
def test_evidence_is_that_of_the_events(log, size, data):
    pins = data.draw(st.sets(st.sampled_from(log.protocol.action_names)))
    assert evidence_of_actions(in_parts(log, size), pins) == evidence_of_actions(log, pins)


@given(logs(), st.integers(1, 8))
def test_places_in_a_merged_tree_are_those_of_the_same_histories(log, cut):
    cut = min(cut, log.n_runs)
    pieces = [np.arange(cut), np.arange(cut, log.n_runs)]
    trees = [log.select(runs=runs).tree() for runs in pieces if len(runs)]
    whole, places = merged_with_places(trees)
    assert same(whole, merged(trees))

    def events(tree: HistoryTree, node):
        path = tree.path(node)
        return tree.arrays.action[path].tolist(), tree.arrays.response[path].tolist()

    for tree, place in zip(trees, places, strict=True):
        assert [events(whole, int(node)) for node in place] == [events(tree, n) for n in range(tree.n_nodes)]


def test_trees_of_all_conditions_share_the_room():
    def grown(conditions):
        """Runs of eight events that differ, one in so many conditions each."""
        rng = np.random.default_rng(1)
        runs, trees = 4_000, ConditionTrees(4, 2, 30_000)
        action = rng.integers(0, 4, 8 * runs).astype(np.int8)
        starts, every = np.arange(0, 8 * runs, 8), np.ones(runs, dtype=bool)
        trees.add(starts, np.arange(runs) % conditions, every, action, np.full(8 * runs, -1, np.int8))
        return trees

    assert grown(1).n_nodes < 20_000
    with pytest.raises(InputError, match="prefix trees, nodes: found more than 20,000, wanted at most 20,000"):
        grown(8)
    with pytest.raises(InputError, match="event log, runs: found 0"):
        ConditionTrees(4, 2).finish()
