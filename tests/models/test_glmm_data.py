"""Compression of rows and groups changes nothing but the work."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.glmm_data import Likelihood, Patterns, Rule
from tests.models.test_glmm_kernel import Rows

seeds = st.integers(0, 10**6)


def value_and_gradient(patterns, theta):
    return np.append(*reversed(Likelihood(patterns, Rule.hermite(7))(theta)))


@given(seeds)
def test_equal_rows_and_equal_groups_share_one_likelihood(seed):
    rng = np.random.default_rng(seed)
    rows = Rows.random(rng, n_groups=60, continuous=False)
    theta = np.append(rng.normal(size=3), 1.1)
    small, large = rows.patterns(), rows.patterns(compress=False)
    assert small.n_patterns <= large.n_patterns == 60
    assert small.multiplicity.sum() == small.n_groups == 60
    assert value_and_gradient(small, theta) == pytest.approx(value_and_gradient(large, theta), rel=1e-10, abs=1e-10)
    ours, theirs = Likelihood(small, Rule.hermite(7)), Likelihood(large, Rule.hermite(7))
    ours(theta), theirs(theta)
    assert ours.values[small.of_group] == pytest.approx(theirs.values, rel=1e-12)


@given(seeds)
def test_patterns_differ_where_groups_differ(seed):
    rows = Rows.random(np.random.default_rng(seed), n_groups=40, continuous=False)
    patterns = rows.patterns()

    def content(group):
        mine = rows.group == group
        keys, at = np.unique(np.column_stack([rows.design, rows.offset])[mine], axis=0, return_inverse=True)
        y, m = (np.bincount(at, column[mine]) for column in (rows.successes, rows.trials))
        return tuple(map(tuple, np.column_stack([keys, y, m])))

    contents = [content(g) for g in range(40)]
    for g in range(40):
        for other in range(g):
            same = contents[g] == contents[other]
            assert same == (patterns.of_group[g] == patterns.of_group[other])


@given(seeds)
def test_the_order_of_rows_and_labels_is_nothing(seed):
    rng = np.random.default_rng(seed)
    rows = Rows.random(rng, n_groups=20)
    shuffled = rng.permutation(len(rows.group))
    relabelled = rng.permutation(20)[rows.group]
    other = Patterns.from_rows(
        *(x[shuffled] for x in (rows.design, rows.offset, rows.successes, rows.trials, rows.weights, relabelled))
    )
    theta = np.append(rng.normal(size=3), 0.8)
    assert value_and_gradient(other, theta) == pytest.approx(
        value_and_gradient(rows.patterns(), theta), rel=1e-10, abs=1e-10
    )


@given(seeds)
def test_frequency_weights_are_repeated_rows(seed):
    rng = np.random.default_rng(seed)
    rows = Rows.random(rng, n_groups=10)
    weights = rng.integers(0, 4, len(rows.group)).astype(float)
    weights[np.unique(rows.group, return_index=True)[1]] = 1.0  # no group vanishes
    weighted = Patterns.from_rows(rows.design, rows.offset, rows.successes, rows.trials, weights, rows.group)
    again = np.repeat(np.arange(len(weights)), weights.astype(int))
    repeated = Patterns.from_rows(
        *(x[again] for x in (rows.design, rows.offset, rows.successes, rows.trials, rows.weights, rows.group))
    )
    theta = np.append(rng.normal(size=3), 0.8)
    assert value_and_gradient(weighted, theta) == pytest.approx(value_and_gradient(repeated, theta), rel=1e-11)
    assert weighted.constant == pytest.approx(repeated.constant)


def test_cells_count_everything_once():
    rows = Rows.random(np.random.default_rng(4), n_groups=200, continuous=False)
    patterns = rows.patterns()
    design, offset, y, m = patterns.cells
    assert (y.sum(), m.sum()) == (rows.successes.sum(), rows.trials.sum())
    assert len(np.unique(np.column_stack([design, offset]), axis=0)) == len(design) == 8


def test_a_part_stands_for_all():
    rows = Rows.random(np.random.default_rng(4), n_groups=400)
    patterns = rows.patterns()
    part = patterns.part(100)
    assert (part.n_patterns, part.multiplicity.sum()) == (100, 400)
    theta = np.array([0.1, 0.2, 0.3, 1.0])
    whole, some = (Likelihood(p, Rule.hermite(5)) for p in (patterns, part))
    whole(theta), some(theta)
    chosen = np.linspace(0, patterns.n_patterns - 1, 100).astype(int)
    assert np.array_equal(some.values, whole.values[chosen])
