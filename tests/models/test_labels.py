"""Expected scores, canonical order, permutation, stationary distribution and dwell times."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.labels import (
    canonical_order,
    dwell_time,
    expected_score,
    permute,
    stationary_distribution,
    stationary_is_unique,
)

EMISSION = np.array([[[0.7, 0.3], [0.4, 0.6]], [[0.05, 0.95], [0.95, 0.05]]])


def test_expected_score_weighs_the_arms():
    np.testing.assert_allclose(expected_score(EMISSION, (0, 1)), [0.625, 0.325])
    np.testing.assert_allclose(expected_score(EMISSION, (0, 1), np.array([3.0, 1.0])), [0.4625, 0.4625])
    np.testing.assert_allclose(expected_score(EMISSION, (-1, 3), np.array([5.0, 0.0])), [0.2, 1.4])


def test_all_weights_zero_counts_as_equal_weights():
    np.testing.assert_allclose(expected_score(EMISSION, (0, 1), np.zeros(2)), expected_score(EMISSION, (0, 1)))


@pytest.mark.parametrize("weights", [[1.0], [1.0, -1.0], [1.0, 1.0, 1.0]])
def test_unusable_weights_are_refused(weights):
    with pytest.raises(InputError, match=r"label weights: found \[.*\], wanted 2 non-negative numbers"):
        expected_score(EMISSION, (0, 1), np.array(weights))


def test_many_draws_are_ordered_one_by_one():
    draws = np.stack([EMISSION, EMISSION[:, ::-1]])
    order = canonical_order(draws, (0, 1), np.array([1.0, 0.0]))
    assert order.tolist() == [[0, 1], [1, 0]]


def test_ties_keep_their_order():
    assert canonical_order(np.full((1, 4, 2), 0.5), (0, 1)).tolist() == [0, 1, 2, 3]


def test_permute_moves_rows_and_columns_together():
    initial, transition = np.array([0.1, 0.2, 0.7]), np.arange(9.0).reshape(1, 3, 3)
    emission = np.arange(6.0).reshape(1, 3, 2)
    new = permute(np.array([2, 0, 1]), initial, transition, emission)
    assert new[0].tolist() == [0.7, 0.1, 0.2]
    assert new[1].tolist() == [[[8, 6, 7], [2, 0, 1], [5, 3, 4]]]
    assert new[2].tolist() == [[[4, 5], [0, 1], [2, 3]]]
    assert all(array.flags.c_contiguous for array in new)


@given(st.integers(1, 6), st.integers(0, 2**32 - 1))
def test_the_stationary_distribution_is_stationary(n, seed):
    table = np.random.default_rng(seed).dirichlet(np.ones(n), size=n)
    probability = stationary_distribution(table)
    assert probability.sum() == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(probability @ table, probability, atol=1e-12)


def test_stationary_distribution_by_hand():
    """Two states: the odds are the ratio of the rates, .1 against .3."""
    np.testing.assert_allclose(stationary_distribution(np.array([[0.9, 0.1], [0.3, 0.7]])), [0.75, 0.25])


def test_stationary_distributions_of_many_tables_at_once():
    tables = np.random.default_rng(2).dirichlet(np.ones(3), size=(2, 4, 3))
    many = stationary_distribution(tables)
    for i in np.ndindex(2, 4):
        np.testing.assert_allclose(many[i], stationary_distribution(tables[i]), rtol=1e-13)


def test_stationary_distribution_of_special_chains():
    np.testing.assert_allclose(stationary_distribution(np.eye(3)), np.full(3, 1 / 3))
    np.testing.assert_allclose(stationary_distribution(np.array([[0.0, 1.0], [1.0, 0.0]])), [0.5, 0.5])  # periodic
    absorbing = np.array([[0.99, 0.005, 0.005], [0, 1, 0], [0, 0, 1]])
    np.testing.assert_allclose(stationary_distribution(absorbing), [0, 0.5, 0.5], atol=1e-12)


def test_a_chain_that_falls_apart_has_no_unique_stationary_distribution():
    assert stationary_is_unique(np.array([[0.9, 0.1], [0.3, 0.7]]))
    assert stationary_is_unique(np.array([[0.0, 1.0], [1.0, 0.0]]))  # periodic, yet unique
    assert stationary_is_unique(np.array([[0.5, 0.5], [0.0, 1.0]]))  # one absorbing state
    assert stationary_is_unique(np.ones((1, 1)))
    assert not stationary_is_unique(np.eye(3))
    assert not stationary_is_unique(np.array([[0.99, 0.005, 0.005], [0, 1, 0], [0, 0, 1]]))
    assert not stationary_is_unique(np.array([[1 - 1e-8, 1e-8], [1e-8, 1 - 1e-8]]))  # apart within any study


def test_a_very_slow_chain_still_reaches_its_limit():
    slow = np.array([[1 - 1e-9, 1e-9], [3e-9, 1 - 3e-9]])
    np.testing.assert_allclose(stationary_distribution(slow), [0.75, 0.25], rtol=1e-6)


def test_dwell_times():
    table = np.array([[0.9, 0.1, 0.0], [0.5, 0.5, 0.0], [0.0, 0.0, 1.0]])
    np.testing.assert_allclose(dwell_time(table), [10, 2, np.inf])
    assert dwell_time(np.array([[0.0, 1.0], [1.0, 0.0]])).tolist() == [1, 1]
