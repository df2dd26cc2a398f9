"""People who differ: the vectorised kernel against plain numpy, integration by scipy, and a bigger plain model."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.draw_kernels import person_log_likelihoods
from models.errors import InputError
from models.hmm_density import HmmDensity
from models.parameters import Layout
from models.people_kernel import NOBODY, PeopleArrays
from models.person_offset import PersonOffset, distinct_people, each_person, person_of_run, quadrature, reweighted
from models.protocol import PUBLISHED
from tests.models.test_simulation import design_of
from tests.random_cases import cases, random_run, random_tables
from tests.reference import people as reference
from tests.reference import recursions


def people_of(tree, person, protocol, nodes=7):
    z, log_weight = quadrature(nodes)
    scores = np.asarray(protocol.scores, dtype=float)
    return PeopleArrays(*distinct_people(tree, person), z, log_weight, scores, np.ones(1))


@st.composite
def hierarchies(draw, zeros=0.0):
    """A case, the person of each of its runs, sigma."""
    case = draw(cases(max_states=4, zeros=zeros))
    person = np.array(draw(st.lists(st.integers(0, 3), min_size=len(case.runs), max_size=len(case.runs))))
    return case, np.unique(person, return_inverse=True)[1], draw(st.sampled_from([0.0, 0.4, 1.5, 4.0]))


def density_of(case, person, nodes=7):
    tree, layout = case.tree(), Layout(case.protocol, case.n_states)
    return HmmDensity(tree, layout, np.ones(layout.size), {}, people_of(tree, person, case.protocol, nodes))


def runs_of(case, person):
    return [[case.runs[r] for r in np.flatnonzero(person == p)] for p in range(person.max() + 1)]


@given(hierarchies(zeros=0.2))
def test_equals_person_by_person_and_node_by_node(hierarchy):
    case, person, spread = hierarchy
    density = density_of(case, person)
    p = density.people
    theta = np.append(density.layout.pack(*case.tables), spread)
    found = person_log_likelihoods(density, theta, person, each_person(p, density.tree, person))
    with np.errstate(divide="ignore"):
        wanted = [
            reference.person_log_likelihood(
                runs, *case.tables, case.index, case.protocol.scores, spread, p.z, p.log_weight
            )
            for runs in runs_of(case, person)
        ]
    np.testing.assert_allclose(found, wanted, rtol=1e-10, atol=1e-10)


@given(hierarchies())
def test_the_sum_is_that_of_the_density_and_its_gradient_is_exact(hierarchy):
    """Uniform priors, so that the density is the likelihood but for Jacobians and the prior of sigma."""
    case, person, spread = hierarchy
    density = density_of(case, person)
    rng = np.random.default_rng(1)
    x = density.unconstrained(np.append(density.layout.pack(*case.tables), max(spread, 0.1)))
    value, gradient = density(x)
    plain = replace(density, people=NOBODY)
    by_person = person_log_likelihoods(
        density, density.theta(x), person, each_person(density.people, density.tree, person)
    )
    prior = plain(x[:-1])[0] - sum(recursions.log_likelihood(r, *case.tables, case.index) for r in case.runs)
    sigma = np.exp(x[-1])
    half_normal = np.log(2) - 0.5 * np.log(2 * np.pi) - 0.5 * sigma**2 + x[-1]
    assert value == pytest.approx(by_person.sum() + prior + half_normal, rel=1e-9, abs=1e-8)
    for i in {0, len(x) - 1, int(rng.integers(len(x)))}:
        step = np.zeros(len(x))
        step[i] = 1e-5
        # Five points: the error of the difference is of fourth order.
        slope = (8 * (density(x + step)[0] - density(x - step)[0])
                 - (density(x + 2 * step)[0] - density(x - 2 * step)[0])) / 12e-5  # fmt: skip
        assert gradient[i] == pytest.approx(slope, rel=1e-6, abs=1e-6)


def test_many_nodes_equal_integration_by_somebody_else():
    rng = np.random.default_rng(2)
    tables = random_tables(rng, PUBLISHED, 3)
    runs = [random_run(rng, PUBLISHED, 6, 0.1) for _ in range(6)]
    person = np.array([0, 0, 0, 1, 2, 2])
    log = design_of(runs, PUBLISHED)
    layout, tree = Layout(PUBLISHED, 3), log.tree()
    density = HmmDensity(tree, layout, np.ones(layout.size), {}, people_of(tree, person, PUBLISHED, 61))
    found = person_log_likelihoods(
        density, np.append(layout.pack(*tables), 1.3), person, each_person(density.people, tree, person)
    )
    for p in range(3):
        mine = [runs[r] for r in np.flatnonzero(person == p)]
        wanted = reference.person_log_likelihood_by_integration(
            mine, tables, layout.emission_index, PUBLISHED.scores, 1.3
        )
        assert found[p] == pytest.approx(wanted, abs=2e-6)  # what lies beyond five standard deviations


def test_people_with_one_run_are_a_plain_model_with_a_state_for_every_node():
    """(node, state) as the state: it starts by the weights, and the node never changes."""
    rng = np.random.default_rng(4)
    initial, transition, emission = random_tables(rng, PUBLISHED, 2)
    runs = [random_run(rng, PUBLISHED, 5, 0.2) for _ in range(20)]
    log = design_of(runs, PUBLISHED)
    z, log_weight = quadrature(5)
    spread = 0.9
    big = (
        np.kron(np.exp(log_weight), initial),
        np.stack([np.kron(np.eye(5), table) for table in transition]),
        np.concatenate([reference.tilted(emission, PUBLISHED.scores, spread * q) for q in z], axis=1),
    )
    layout = Layout(PUBLISHED, 2)
    wanted = [recursions.log_likelihood(run, *big, layout.emission_index) for run in runs]
    density = HmmDensity(
        log.tree(), layout, np.ones(layout.size), {}, people_of(log.tree(), np.arange(20), PUBLISHED, 5)
    )
    found = person_log_likelihoods(
        density, np.append(layout.pack(initial, transition, emission), spread), np.arange(20),
        each_person(density.people, log.tree(), np.arange(20)),
    )  # fmt: skip
    np.testing.assert_allclose(found, wanted, rtol=1e-12)


@given(hierarchies())
@settings(max_examples=30)
def test_without_spread_people_do_not_differ(hierarchy):
    case, person, _ = hierarchy
    density = density_of(case, person)
    theta = np.append(density.layout.pack(*case.tables), 0.0)
    found = person_log_likelihoods(density, theta, person, each_person(density.people, density.tree, person))
    plain = replace(density, people=NOBODY)
    np.testing.assert_allclose(found, person_log_likelihoods(plain, theta[:-1], person), rtol=1e-10, atol=1e-10)


@given(hierarchies(), st.integers(0, 2**32 - 1))
@settings(max_examples=30)
def test_reweighting_people_is_repeating_them(hierarchy, seed):
    case, person, spread = hierarchy
    weight = np.random.default_rng(seed).integers(0, 3, size=person.max() + 1).astype(float)
    density = density_of(case, person)
    x = density.unconstrained(np.append(density.layout.pack(*case.tables), spread + 0.1))
    prior = reweighted(density, person, np.zeros_like(weight))(x)[0]
    each = [reweighted(density, person, np.eye(len(weight))[p])(x)[0] - prior for p in range(len(weight))]
    assert reweighted(density, person, weight)(x)[0] == pytest.approx(prior + weight @ each, rel=1e-9, abs=1e-8)


def test_an_impossible_person_is_minus_infinity():
    log = design_of([[(2, 1)]], PUBLISHED)
    layout = Layout(PUBLISHED, 1)
    density = HmmDensity(
        log.tree(), layout, np.ones(layout.size), {}, people_of(log.tree(), np.zeros(1, int), PUBLISHED)
    )
    tables = np.ones(1), np.ones((4, 1, 1)), np.tile([[1.0, 0.0]], (2, 1, 1))
    theta = np.append(layout.pack(*tables), 1.0)
    each = each_person(density.people, log.tree(), np.zeros(1, int))
    assert person_log_likelihoods(density, theta, np.zeros(1, int), each)[0] == -np.inf


def test_long_runs_neither_underflow_nor_drift():
    rng = np.random.default_rng(6)
    tables = random_tables(rng, PUBLISHED, 2)
    run = random_run(rng, PUBLISHED, 3000, 0.0)
    log = design_of([run], PUBLISHED)
    layout, tree = Layout(PUBLISHED, 2), log.tree()
    density = HmmDensity(tree, layout, np.ones(layout.size), {}, people_of(tree, np.zeros(1, int), PUBLISHED, 9))
    found = person_log_likelihoods(
        density, np.append(layout.pack(*tables), 0.7), np.zeros(1, int),
        each_person(density.people, tree, np.zeros(1, int)),
    )  # fmt: skip
    p = density.people
    wanted = reference.person_log_likelihood(
        [run], *tables, layout.emission_index, PUBLISHED.scores, 0.7, p.z, p.log_weight
    )
    assert found[0] == pytest.approx(wanted, rel=1e-11)


# -- quadrature and settings -----------------------------------------------------------------------------
def test_the_rule_integrates_moments_of_the_normal():
    z, log_weight = quadrature(31)
    moments = [float(np.exp(log_weight) @ z**k) for k in range(6)]
    np.testing.assert_allclose(moments, [1, 0, 1, 0, 3, 0], atol=1e-3)


def test_nodes_grow_with_the_responses_of_a_person():
    short = design_of([[(2, 1)]] * 4, PUBLISHED)
    long = design_of([[(2, 1)] * 60] * 4, PUBLISHED)
    assert PersonOffset().points(short) < PersonOffset().points(long)
    assert PersonOffset(nodes=9).points(long) == 9


@pytest.mark.parametrize(("arguments", "found"), [
    ({"scale": 0}, "scale of the prior: found 0"), ({"scale": np.nan}, "nan"), ({"nodes": 2}, "nodes: found 2"),
    ({"nodes": 7.5}, "7.5"),
])  # fmt: skip
def test_settings_that_make_no_sense_are_refused(arguments, found):
    with pytest.raises(InputError, match=found):
        PersonOffset(**arguments)


def test_people_are_numbered_by_id():
    log = design_of([[(2, 1)]] * 3, PUBLISHED)
    np.testing.assert_array_equal(person_of_run(log), np.arange(3))
