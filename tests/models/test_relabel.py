"""Many draws into canonical order at once, and when that is allowed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.labels import canonical_order, expected_score, permute
from models.parameters import DirichletPrior, Layout
from models.protocol import PUBLISHED
from models.relabel import exchangeable, exchangeable_prior, relabel_draws
from tests.random_cases import protocols, random_tables


@given(protocols(), st.integers(1, 5), st.integers(0, 2**32 - 1))
def test_equals_the_functions_for_one_model_in_a_loop(protocol, n, seed):
    rng = np.random.default_rng(seed)
    draws = [[random_tables(rng, protocol, n) for _ in range(3)] for _ in range(2)]
    stacked = [np.array([[d[i] for d in chain] for chain in draws]) for i in range(3)]
    weights = rng.random(len(protocol.emission_actions)).round(1)
    new = relabel_draws(*stacked, protocol.scores, weights)
    for c in range(2):
        for d in range(3):
            order = canonical_order(draws[c][d][2], protocol.scores, weights)
            for table, wanted in zip(new, permute(order, *draws[c][d]), strict=True):
                assert np.array_equal(table[c, d], wanted)
    scores = expected_score(new[2], protocol.scores, weights)
    assert np.all(np.diff(scores, axis=-1) >= 0)


@given(st.integers(2, 5), st.integers(0, 2**32 - 1))
def test_the_numbering_of_a_draw_does_not_matter(n, seed):
    rng = np.random.default_rng(seed)
    tables = random_tables(rng, PUBLISHED, n)
    other = permute(rng.permutation(n), *tables)
    weights = np.array([3.0, 1.0])
    for one, two in zip(
        relabel_draws(*tables, PUBLISHED.scores, weights), relabel_draws(*other, PUBLISHED.scores, weights),
        strict=True,
    ):  # fmt: skip
        np.testing.assert_allclose(one, two, rtol=0, atol=0)


@pytest.mark.parametrize(
    ("table", "alike"),
    [
        (np.eye(3), True),
        (np.full((3, 3), 1 / 3), True),
        (np.array([[0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8]]), True),
        (np.array([[0.0, 1.0], [1.0, 0.0]]), True),
        (np.eye(1), True),
        (np.array([[0.9, 0.1], [0.2, 0.8]]), False),
        (np.array([[0.8, 0.2, 0.0], [0.2, 0.8, 0.0], [0.0, 0.2, 0.8]]), False),
        (np.roll(np.eye(3), 1, axis=1), False),
    ],
)
def test_tables_that_treat_states_alike(table, alike):
    assert exchangeable({"help": table}) is alike
    assert exchangeable({"signal": np.eye(len(table)), "help": table}) is alike
    n = len(table)
    permutations = [np.random.default_rng(s).permutation(n) for s in range(20)]
    assert all(np.array_equal(table[p][:, p], table) for p in permutations) is alike


def test_nothing_held_is_exchangeable():
    assert exchangeable({})


def test_priors_that_treat_states_alike():
    layout = Layout(PUBLISHED, 3)
    alpha = 1 + DirichletPrior(2.0, 1.5, 3.0, 4.0).pseudo_counts(layout)
    assert exchangeable_prior(*layout.unpack(alpha))
    skewed = alpha.copy()
    layout.unpack(skewed)[2][..., 1] += 1  # help is likelier, in every state alike
    assert exchangeable_prior(*layout.unpack(skewed))
    for table, position in ((0, 1), (1, (2, 0, 0)), (1, (2, 0, 1)), (2, (1, 2, 0))):
        edited = alpha.copy()
        layout.unpack(edited)[table][position] += 1
        assert not exchangeable_prior(*layout.unpack(edited))
