"""The density on unconstrained coordinates, and many draws at once, on a handful of small fixed cases.

Oracles share no code with the kernels: the plain recursions, derivatives by a complex step.
"""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from models import hmm_density
from models.draw_kernels import constrained, history_log_likelihoods, person_log_likelihoods
from models.errors import InputError
from models.hmm_density import START_MAPS, START_TRIES, HmmDensity, log_density
from models.parameters import Layout
from models.people_kernel import PeopleArrays
from models.person_offset import distinct_people, each_person, quadrature
from models.protocol import PUBLISHED
from tests.models.by_hand_cases import THREE, case
from tests.random_cases import random_tables, tree_of
from tests.reference import people as people_reference
from tests.reference import recursions


# -- the density on unconstrained coordinates ----------------------------------------------------------
def density_of(seed, n_states, protocol, *, turned=False, pins=None):
    if turned:
        protocol = replace(protocol, responses=tuple(replace(r, score=-r.score) for r in protocol.responses))
    runs, _, _ = case(seed, n_states, protocol)
    layout = Layout(protocol, n_states)
    alpha = np.random.default_rng(seed).uniform(0.4, 3.0, layout.size)
    return HmmDensity(tree_of(runs, protocol), layout, alpha, pins or {}), runs


DENSITIES = [
    (0, 3, PUBLISHED, {}),
    (1, 2, PUBLISHED, {"turned": True}),
    (2, 2, THREE, {"pins": {THREE.action_names[1]: np.array([[0.3, 0.7], [0.6, 0.4]])}}),
    (3, 1, PUBLISHED, {}),
]


def spelled_out(density, runs, x, temperature=1.0):
    """Likelihood to the power of the temperature, and alpha times log p of every sampled row; x may be complex."""
    layout, theta, at, prior = density.layout, density.template.astype(complex), 0, 0.0
    free = layout.free_entries(density.pins)
    top = int(np.argmax(layout.protocol.scores))
    for kind, row in zip(layout.row_kinds, layout.rows, strict=True):
        width = row.stop - row.start
        if width == 1 or not free[row.start]:
            continue
        z = np.append(x[at : at + width - 1], -x[at : at + width - 1].sum())
        if kind == "emission" and width == 2:
            z = np.array([x[at], 0.0]) if top == 0 else np.array([0.0, x[at]])
        logs = z - z.real.max() - np.log(np.exp(z - z.real.max()).sum())
        theta[row] = np.exp(logs)
        prior += density.alpha[row] @ logs
        at += width - 1
    if temperature == 0.0:
        return prior, theta
    tables = layout.unpack(theta)
    value = sum(recursions.log_likelihood(run, *tables, layout.emission_index) for run in runs)
    return temperature * value + prior, theta


@pytest.mark.parametrize("spread", [1.0, 6.0, 25.0])
@pytest.mark.parametrize(("seed", "n_states", "protocol", "options"), DENSITIES)
def test_density_gradient_and_map(seed, n_states, protocol, options, spread):
    density, runs = density_of(seed, n_states, protocol, **options)
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.3, 1.0, density.dimension) * rng.choice([-spread, spread], density.dimension)
    _, theta = spelled_out(density, runs, x)
    np.testing.assert_allclose(density.theta(x), theta.real, rtol=1e-12, atol=1e-300)
    np.testing.assert_allclose(constrained(density, np.array([[x, -x]])), [[density.theta(x), density.theta(-x)]])
    for temperature in (1.0, 0.3, 0.0):
        gradient = np.full(density.dimension, np.nan)
        value = log_density(x, gradient, density.arrays, temperature)
        assert value == pytest.approx(spelled_out(density, runs, x, temperature)[0].real, rel=1e-10)
        for i in range(density.dimension):
            moved = x.astype(complex)
            moved[i] += 1e-200j
            slope = spelled_out(density, runs, moved, temperature)[0].imag / 1e-200
            assert gradient[i] == pytest.approx(slope, rel=1e-8, abs=1e-9)


@pytest.mark.parametrize("far", [800.0, -800.0])
def test_the_prior_far_out_neither_overflows_nor_is_lost(far):
    density, runs = density_of(0, 3, PUBLISHED)
    for i in range(density.dimension):
        x = np.full(density.dimension, 0.3)
        x[i] = far
        gradient = np.full(len(x), np.nan)
        value = log_density(x, gradient, density.arrays, 0.0)
        wanted = spelled_out(density, runs, x, 0.0)[0].real
        assert value == pytest.approx(wanted, rel=1e-12)
        assert np.isfinite(gradient).all()
    # Even where the likelihood, which does not count, would be zero.
    x = np.full(density.dimension, far)
    assert log_density(x, gradient, density.arrays, 1.0) == -np.inf
    assert log_density(x, gradient, density.arrays, 0.0) == pytest.approx(
        spelled_out(density, runs, x, 0.0)[0].real, rel=1e-12
    )


# -- where chains start --------------------------------------------------------------------------------
@pytest.mark.parametrize("winner", [0, 4, START_TRIES - 1])
def test_a_chain_starts_from_the_best_of_several_short_searches(monkeypatch, winner):
    density, _ = density_of(0, 3, PUBLISHED)
    points = []

    def search(point, tree, sizes, index, pseudo, free, cap, tolerance, patience, accelerate, stop):
        assert (sizes, cap, tolerance, patience, accelerate) == (
            density.layout.sizes, START_MAPS, 0.0, START_MAPS + 1, True
        )  # fmt: skip
        np.testing.assert_array_equal(pseudo, np.maximum(density.alpha - 1, 0))
        assert free.all()
        np.testing.assert_array_equal(tree.action, density.tree.arrays.action)
        assert tree.action[0] == -1
        assert stop.tolist() == [0]
        points.append(point)
        return point, np.array([1e9, -1.0 if len(points) - 1 == winner else -2.0 - len(points)])

    monkeypatch.setattr(hmm_density, "em", search)
    start = density.starting_point(4)
    assert len(points) == START_TRIES
    assert len({point.tobytes() for point in points}) == START_TRIES
    for row in density.layout.rows:
        assert points[winner][row].sum() == pytest.approx(1.0)
    inside = 0.9 * points[winner] + 0.1 * density.layout.uniform
    np.testing.assert_allclose(density.theta(start), inside, rtol=1e-12)


def hierarchy_of(seed, scale=1.4, points=3):
    density, _ = density_of(seed, 2, PUBLISHED)
    person = distinct_people(density.tree, np.array([2, 0, 1, 0, 2, 2, 1]))
    scores = np.asarray(PUBLISHED.scores, dtype=float)
    people = PeopleArrays(*person, *quadrature(points), scores, np.full(1, scale))
    return density, replace(density, people=people)


def test_spreads_of_people_are_drawn_from_their_prior():
    _, hierarchy = hierarchy_of(1)
    rng = np.random.default_rng(3)
    spreads = np.exp([hierarchy.prior_point(rng)[-1] for _ in range(300)])
    assert stats.kstest(spreads, stats.halfnorm(scale=1.4).cdf).pvalue > 0.01


def test_chains_start_away_from_people_who_are_all_alike(monkeypatch):
    """A fifth of the prior's scale and more."""
    _, hierarchy = hierarchy_of(1)
    monkeypatch.setattr(hmm_density, "em", lambda point, *_: (point, np.zeros(1)))
    rng = np.random.default_rng(3)
    spreads = np.exp([hierarchy.starting_point(rng)[-1] for _ in range(100)])
    assert stats.kstest(spreads, stats.halfnorm(loc=0.2 * 1.4, scale=1.4).cdf).pvalue > 0.01


def test_the_spread_there_and_back_and_its_normalising_constant():
    density, hierarchy = hierarchy_of(1)
    x = np.random.default_rng(2).normal(size=hierarchy.dimension)
    np.testing.assert_allclose(hierarchy.unconstrained(hierarchy.theta(x)), x, rtol=1e-12)
    half_normal = stats.halfnorm.logpdf(0.0, scale=1.4)
    assert hierarchy.constant - density.constant == pytest.approx(half_normal, rel=1e-12)
    theta = hierarchy.theta(x)
    theta[-1] = -2.5
    with pytest.raises(InputError, match=r"sigma.*-2\.5"):
        hierarchy.unconstrained(theta)


def test_a_prior_whose_draws_are_zeros_still_gives_points_inside():
    density = replace(density_of(0, 3, PUBLISHED)[0], alpha=np.full(Layout(PUBLISHED, 3).size, 1e-4))
    assert np.random.default_rng(0).gamma(1e-4) == 0.0
    for seed in range(5):
        for point in (density.prior_point(seed), density.starting_point(seed)):
            assert np.isfinite(point).all()


# -- many draws ----------------------------------------------------------------------------------------
def test_histories_and_people_under_every_draw():
    density, runs = density_of(0, 3, PUBLISHED)
    x = np.random.default_rng(1).normal(size=(2, 3, density.dimension))
    theta = constrained(density, x)
    assert theta.shape == (2, 3, density.layout.size)
    own = history_log_likelihoods(density.tree, density.layout, theta)
    of_run = np.searchsorted(density.tree.terminals, density.tree.run_node)
    person = np.array([2, 0, 1, 0, 2, 2, 1])
    people = person_log_likelihoods(density, theta, person)
    for draw in np.ndindex(2, 3):
        tables = density.layout.unpack(theta[draw])
        logs = np.array([recursions.log_likelihood(run, *tables, density.layout.emission_index) for run in runs])
        np.testing.assert_allclose(own[draw][of_run], logs, rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(people[draw], np.bincount(person, logs), rtol=1e-12, atol=1e-14)


def test_people_who_differ_under_every_draw():
    density, runs = density_of(1, 2, PUBLISHED)
    person = np.array([2, 0, 1, 0, 2, 2, 1])
    z, log_weight = quadrature(7)
    scores = np.asarray(PUBLISHED.scores, dtype=float)
    people = PeopleArrays(*distinct_people(density.tree, person), z, log_weight, scores, np.full(1, 1.4))
    hierarchy = replace(density, people=people)
    x = np.random.default_rng(2).normal(size=(3, hierarchy.dimension))
    theta = constrained(hierarchy, x)
    np.testing.assert_allclose(theta[:, -1], np.exp(x[:, -1]), rtol=1e-14)
    np.testing.assert_allclose(theta[:, :-1], constrained(density, x[:, :-1]), rtol=1e-14)
    found = person_log_likelihoods(hierarchy, theta, person, each_person(people, density.tree, person))
    wanted = np.array([
        [
            people_reference.person_log_likelihood(
                [runs[r] for r in np.flatnonzero(person == p)], *density.layout.unpack(draw[:-1]),
                density.layout.emission_index, scores, draw[-1], z, log_weight,
            )
            for p in range(3)
        ]
        for draw in theta
    ])  # fmt: skip
    np.testing.assert_allclose(found, wanted, rtol=1e-11, atol=1e-14)
    # The density: people's likelihood, the plain priors, and a half-normal prior of sigma in log sigma.
    for point, of_people in zip(x, wanted, strict=True):
        for temperature in (1.0, 0.4, 0.0):
            gradient, plain = np.full(len(point), np.nan), np.full(len(point) - 1, np.nan)
            value = log_density(point, gradient, hierarchy.arrays, temperature)
            prior = log_density(point[:-1], plain, density.arrays, 0.0)
            half_normal = point[-1] - 0.5 * (np.exp(point[-1]) / 1.4) ** 2
            assert value == pytest.approx(temperature * of_people.sum() + prior + half_normal, rel=1e-10)
            for i in range(len(point)):
                step = 1e-5 * np.eye(len(point))[i]
                scratch = np.empty(len(point))
                up = log_density(point + step, scratch, hierarchy.arrays, temperature)
                down = log_density(point - step, scratch, hierarchy.arrays, temperature)
                assert gradient[i] == pytest.approx((up - down) / 2e-5, rel=1e-6, abs=1e-7)


@pytest.mark.parametrize("n_states", [1, 3, 5])
def test_every_draw_by_every_run_and_person(n_states):
    """More states than actions or responses, and fewer; draws in a grid; nobody's runs are without an answer."""
    rng = np.random.default_rng(n_states)
    runs = [[(2, 1)], [(3, 0), (2, 1)], [(2, 0), (2, 0)], [(3, 1)], [(2, 1), (3, 1), (2, 0)]]
    person = np.array([1, 0, 2, 0, 1])
    layout = Layout(PUBLISHED, n_states)
    density = HmmDensity(tree_of(runs, PUBLISHED), layout, np.ones(layout.size), {})
    tables = [random_tables(rng, PUBLISHED, n_states) for _ in range(6)]
    theta = np.array([layout.pack(*drawn) for drawn in tables]).reshape(2, 3, -1)
    own = history_log_likelihoods(density.tree, layout, theta)
    people = person_log_likelihoods(density, theta, person)
    z, log_weight = quadrature(3)
    scores = np.asarray(PUBLISHED.scores, dtype=float)
    differ = PeopleArrays(*distinct_people(density.tree, person), z, log_weight, scores, np.full(1, 1.0))
    spread = rng.uniform(0.2, 2.0, size=(2, 3, 1))
    offset = person_log_likelihoods(
        replace(density, people=differ), np.concatenate([theta, spread], axis=-1), person,
        each_person(differ, density.tree, person),
    )  # fmt: skip
    assert (own.shape, people.shape, offset.shape) == ((2, 3, 5), (2, 3, 3), (2, 3, 3))
    of_run = np.searchsorted(density.tree.terminals, density.tree.run_node)
    for draw, drawn in zip(np.ndindex(2, 3), tables, strict=True):
        logs = np.array([recursions.log_likelihood(run, *drawn, layout.emission_index) for run in runs])
        assert (logs < 0).all()
        np.testing.assert_allclose(own[draw][of_run], logs, rtol=1e-12)
        np.testing.assert_allclose(people[draw], np.bincount(person, logs), rtol=1e-12)
        wanted = [
            people_reference.person_log_likelihood(
                [runs[r] for r in np.flatnonzero(person == p)], *drawn, layout.emission_index, scores,
                float(spread[draw][0]), z, log_weight,
            )
            for p in range(3)
        ]  # fmt: skip
        np.testing.assert_allclose(offset[draw], wanted, rtol=1e-11)
