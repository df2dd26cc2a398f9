"""Simulated studies from many models: the design kept, frequencies right, people differing as told."""

import numpy as np
import pytest

from models.bayesian_fit import fit
from models.errors import InputError
from models.groups import Groups
from models.nuts import NutsSettings
from models.person_offset import PersonOffset
from models.population import offsets, population
from models.predictive import FullTables, predictive_responses
from models.protocol import PUBLISHED
from models.simulation import simulate_responses
from tests.models.test_simulation import design_of
from tests.random_cases import random_tables
from tests.reference.people import tilted

STREAMS = [np.random.SeedSequence(1, spawn_key=(d,)) for d in range(2)]
RUN = [(2, 1), (0, -1), (2, -1), (3, 0)]
EVENT = 4


def tables(*models, spread=None):
    return FullTables(
        np.stack([np.stack([m[0] for m in models])] * 2), np.stack([np.concatenate([m[1] for m in models])] * 2),
        np.stack([np.concatenate([m[2] for m in models])] * 2), spread,
    )  # fmt: skip


def test_the_design_is_kept_and_draws_have_their_own_streams():
    model = random_tables(np.random.default_rng(1), PUBLISHED, 3)
    design = design_of([RUN] * 200, PUBLISHED)
    both = predictive_responses(tables(model), design, STREAMS)
    np.testing.assert_array_equal(both < 0, np.tile(design.response < 0, (2, 1)))
    assert np.any(both[0] != both[1])
    one = predictive_responses(tables(model), design, STREAMS[1:])
    np.testing.assert_array_equal(one[0], both[1])


def test_without_groups_and_offsets_it_is_the_plain_simulation():
    from models.lspomdp import LatentStatePOMDP

    model = random_tables(np.random.default_rng(1), PUBLISHED, 3)
    design = design_of([RUN] * 50, PUBLISHED)
    wanted, _ = simulate_responses(LatentStatePOMDP(*model, PUBLISHED), design, np.random.default_rng(STREAMS[0]))
    np.testing.assert_array_equal(predictive_responses(tables(model), design, STREAMS[:1])[0], wanted.response)


def test_groups_respond_by_their_own_tables():
    """One group always helps, the other never does."""
    design = design_of([RUN] * 10, PUBLISHED)
    never = [np.ones(1), np.ones((4, 1, 1)), np.tile([[1.0, 0.0]], (2, 1, 1))]
    always = [*never[:2], never[2][..., ::-1]]
    groups = Groups("age", ("a", "b"), np.repeat([0, 1], 5), ("emission",))
    drawn = predictive_responses(tables(never, always), design, STREAMS, groups)[0].reshape(10, EVENT)
    assert np.all(drawn[:5][drawn[:5] >= 0] == 0)
    assert np.all(drawn[5:][drawn[5:] >= 0] == 1)


def test_offsets_make_people_alike_within_and_unlike_between():
    """One state, help probability one half: two responses of a person correlate as the offset says."""
    model = [np.ones(1), np.ones((4, 1, 1)), np.full((2, 1, 2), 0.5)]
    design = design_of([RUN] * 20_000, PUBLISHED)
    spread = 2.0
    drawn = predictive_responses(tables(model, spread=np.full(2, spread)), design, STREAMS)[0].reshape(-1, EVENT)
    z = np.linspace(-8, 8, 4001)
    weight = np.exp(-0.5 * z * z)
    weight /= weight.sum()
    both = weight @ (1 / (1 + np.exp(-spread * z))) ** 2
    found = np.mean((drawn[:, 0] == 1) & (drawn[:, 3] == 1))
    assert found == pytest.approx(both, abs=4 * np.sqrt(both * (1 - both) / 20_000))
    assert np.mean(drawn[:, 0]) == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(20_000))


# -- populations -----------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def hierarchical():
    from analysis.simulate import simulate_study1

    return fit(
        simulate_study1(participants=80), 2, people=PersonOffset(),
        sampler=NutsSettings(draws=100, tune=200, chains=2),
    )  # fmt: skip


def test_a_population_starts_moves_and_responds_as_its_people(hierarchical):
    draws = population(hierarchical, 3)
    z, weight = offsets(3)
    median = hierarchical.draws(person=0.0)
    assert draws.n_states == 6
    np.testing.assert_allclose(draws.initial.reshape(-1, 3, 2), weight[:, None] * median.initial[:, None])
    for k in range(3):
        kind = slice(2 * k, 2 * k + 2)
        np.testing.assert_array_equal(draws.transition[:, :, kind, kind], median.transition)
        one = hierarchical.draws(person=float(z[k]))
        np.testing.assert_allclose(draws.emission[:, :, kind], one.emission)
    spread = hierarchical.table("person_sd")
    wanted = tilted(median.emission[7], PUBLISHED.scores, spread[7] * z[2])
    np.testing.assert_allclose(draws.emission[7, :, 4:], wanted)


@pytest.mark.parametrize("kinds", [1, 2, 7, 21])
def test_offsets_are_standardised(kinds):
    z, weight = offsets(kinds)
    assert weight.sum() == pytest.approx(1)
    assert weight @ z == pytest.approx(0, abs=1e-12)
    if kinds > 1:
        assert weight @ z**2 == pytest.approx(1, abs=1e-4)


def test_a_person_must_be_named_where_people_differ_and_only_there(hierarchical):
    with pytest.raises(InputError, match="name a person"):
        hierarchical.draws()
    with pytest.raises(InputError, match="kinds of people: found 0"):
        population(hierarchical, 0)
    assert "person_sd" in hierarchical.summary().index
    assert hierarchical.settings["node_check"] < 0.1
    assert hierarchical.people_differ
