"""The likelihood kernels on a handful of small fixed cases: quick also where kernels are interpreted.

Every number has an oracle that shares no code with the kernels: the plain recursions, a derivative by a complex
step, EM and its extrapolation written out on whole vectors.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from models.draw_kernels import constrained, history_log_likelihoods, person_log_likelihoods
from models.em_kernel import _extrapolate, em, objective_and_step
from models.forward_backward import TINY, decode, log_likelihood_and_gradient, smooth
from models.forward_backward import history_log_likelihoods as plain_history_log_likelihoods
from models.histories import HistoryTree
from models.hmm_density import HmmDensity, log_density
from models.parameters import Layout
from models.people_kernel import PeopleArrays
from models.person_offset import distinct_people, each_person, quadrature
from models.protocol import PUBLISHED
from tests.random_cases import make_protocol, random_run, random_tables, tree_of
from tests.reference import people as people_reference
from tests.reference import recursions, squarem
from tests.reference.expectation_maximisation import em_step

THREE = make_protocol([True, False, True], [2, 1, 1], 3)
"""Two modes that show one of three responses, and a silent one."""


@cache
def case(seed, n_states=3, protocol=PUBLISHED, zeros=0.0):
    """A few runs, some of them alike, and tables."""
    rng = np.random.default_rng(seed)
    runs = [random_run(rng, protocol, int(length), 0.2) for length in (1, 4, 3, 4, 2)]
    runs += [runs[1], runs[2][:2]]
    return runs, random_tables(rng, protocol, n_states, zeros), np.array(protocol.emission_index)


CASES = [(0, 3, PUBLISHED, 0.0), (1, 2, THREE, 0.0), (2, 3, THREE, 0.2), (3, 1, PUBLISHED, 0.0)]


# -- forward and backward ------------------------------------------------------------------------------
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


# -- expectation-maximisation --------------------------------------------------------------------------
def flat(tables):
    return np.concatenate([np.ravel(table) for table in tables])


class Search:
    """A case as the loop takes it and as its twin does."""

    def __init__(self, seed, n_states=3, protocol=PUBLISHED, *, extra=0.0, pinned=0.0, zeros=0.0):
        runs, self.tables, self.index = case(seed, n_states, protocol, zeros)
        self.runs = [runs[i] for i in range(len(runs)) if np.isfinite(self.plain(runs[i]))]
        self.tree = tree_of(self.runs, protocol)
        rng = np.random.default_rng(seed)
        self.pseudo = tuple(extra * rng.uniform(0.5, 1.5, t.shape) for t in self.tables)
        kept = tuple(rng.random(t.shape[:-1]) >= pinned for t in self.tables)
        self.free = tuple(np.ones(t.shape, bool) & k[..., None] for t, k in zip(self.tables, kept, strict=True))
        self.sizes = (n_states, protocol.n_actions, *self.tables[2].shape[::2])
        self.rows = Layout(protocol, n_states).rows

    def plain(self, run, tables=None):
        return recursions.log_likelihood(run, *(tables or self.tables), self.index)

    def unflat(self, theta):
        cuts = np.cumsum([t.size for t in self.tables])[:-1]
        return tuple(p.reshape(t.shape) for p, t in zip(np.split(theta, cuts), self.tables, strict=True))

    def step(self, theta):
        """F(theta) and the objective at theta, by the specification."""
        tables, ones = self.unflat(theta), np.ones(len(self.runs))
        stepped = flat(em_step(self.runs, ones, tables, self.index, self.pseudo, self.free))
        value = sum(self.plain(run, tables) for run in self.runs)
        for table, extra, free in zip(tables, self.pseudo, self.free, strict=True):
            counted = free & (extra != 0)
            value += np.sum(extra[counted] * np.log(table[counted]))
        return stepped, value

    def run(self, *, stop=0, **options):
        given = {"cap": 12, "tolerance": 0.0, "patience": 10**6, "accelerate": False, **options}
        return em(
            flat(self.tables), self.tree.arrays, self.sizes, self.index, flat(self.pseudo),
            flat(self.free).astype(bool), given["cap"], given["tolerance"], given["patience"], given["accelerate"],
            np.full(1, stop, np.uint8),
        )  # fmt: skip

    def twin(self, **options):
        given = {"cap": 12, "tolerance": 0.0, "patience": 10**6, "accelerate": False, **options}
        return squarem.climb(flat(self.tables), self.step, self.rows, flat(self.free).astype(bool), **given)


SEARCHES = [
    {"seed": 0, "n_states": 2},
    {"seed": 11, "n_states": 2, "extra": 0.3},
    {"seed": 10, "n_states": 2},
    {"seed": 2, "n_states": 3, "pinned": 0.4, "extra": 0.2},
    {"seed": 4, "n_states": 2, "protocol": THREE, "zeros": 0.2},
]


@pytest.mark.parametrize("accelerate", [False, True])
@pytest.mark.parametrize("given", SEARCHES)
def test_the_loop_is_em_and_squarem_written_out(given, accelerate):
    search = Search(**given)
    for cap in (1, 2, 3, 12):
        theta, trace, value, gradient, maps, converged = search.run(cap=cap, accelerate=accelerate)
        wanted, objectives, count, _ = search.twin(cap=cap, accelerate=accelerate)
        assert maps == count
        assert not converged
        np.testing.assert_allclose(trace, objectives, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(theta, wanted, rtol=1e-6, atol=1e-9)
        there = log_likelihood_and_gradient(search.tree, *search.unflat(theta), search.index)
        assert value == there.log_likelihood
        np.testing.assert_array_equal(gradient, flat(there[1:]))
        # Pinned rows keep every bit.
        held = ~flat(search.free).astype(bool)
        np.testing.assert_array_equal(theta[held], flat(search.tables)[held])


def test_every_way_of_extrapolating_occurs():
    """Otherwise the test above would not be one: steps taken, refused, of plain length, and pulled back inside."""
    seen = set()
    for given in SEARCHES:
        search = Search(**given)
        free = flat(search.free).astype(bool)
        theta = flat(search.tables)
        for _ in range(6):
            one, here = search.step(theta)
            two, _ = search.step(one)
            far = squarem.extrapolated(theta, one, two, search.rows, free)
            if far is None:
                seen.add("plain")
                theta = one
                continue
            r, v = one - theta, two - 2 * one + theta
            length = np.sqrt((r @ r) / (v @ v))
            seen.add(
                "inside" if np.all((theta + 2 * length * r + length**2 * v)[free & (theta > 0)] > 0) else "pulled"
            )
            better = search.step(far)[1] >= search.step(one)[1] >= here
            seen.add("taken" if better else "refused")
            theta = far if better else one
    assert {"inside", "pulled", "taken", "refused"} <= seen


@pytest.mark.parametrize(("tolerance", "patience"), [(1e-1, 1), (1e-2, 2), (3e-3, 3), (1e9, 1), (1e9, 3)])
def test_it_stops_after_so_many_quiet_iterates(tolerance, patience):
    search = Search(1, 2, extra=0.3)
    options = {"cap": 60, "tolerance": tolerance, "patience": patience}
    _, trace, _, _, maps, converged = search.run(**options)
    _, objectives, count, settled = search.twin(**options)
    assert converged
    assert settled
    assert (len(trace), maps) == (len(objectives), count)


def test_where_nothing_may_move_nothing_is_extrapolated():
    search = Search(0, 2)
    search.free = tuple(np.zeros_like(f) for f in search.free)
    theta, trace, _, _, maps, converged = search.run(cap=7, accelerate=True, patience=2)
    assert (maps, len(trace)) == (7, 8)
    assert not converged  # no gain is not less than a tolerance of none
    np.testing.assert_array_equal(theta, flat(search.tables))


def test_it_stops_when_it_is_told_to():
    _, trace, *_, maps, converged = Search(0, 2).run(stop=1)
    assert (len(trace), maps, converged) == (1, 0, False)


def test_more_states_than_actions_and_no_way_on():
    search = Search(6, 5)
    theta, trace, *_ = search.run(cap=2, accelerate=True)
    wanted, objectives, *_ = search.twin(cap=2, accelerate=True)
    np.testing.assert_allclose(trace, objectives, rtol=1e-10)
    np.testing.assert_allclose(theta, wanted, rtol=1e-8, atol=1e-12)
    search.tables[2][:, :, 0] = 1.0
    search.tables[2][:, :, 1] = 0.0
    _, trace, value, _, maps, converged = search.run()
    assert (trace.tolist(), value, maps, converged) == ([-np.inf], -np.inf, 0, False)


@pytest.mark.parametrize("seed", range(8))
def test_one_extrapolation_with_zeros_and_pinned_rows(seed):
    """Short rows, some pinned, some with zeros that stay, iterates that point out of the simplexes."""
    rng = np.random.default_rng(seed)
    sizes, rows = (3, 2, 2, 2), Layout(PUBLISHED, 3).rows[:7] + [slice(21 + 2 * k, 23 + 2 * k) for k in range(6)]
    seen = 0
    for _ in range(20):
        theta, one, two, free = np.zeros(33), np.zeros(33), np.zeros(33), np.ones(33, bool)
        for row in rows:
            width = row.stop - row.start
            support = np.arange(width) < (width - 1 if width > 2 and rng.random() < 0.4 else width)
            start, toward = (support * (1e-9 + rng.dirichlet(np.full(width, a))) for a in (1.0, 0.3))
            start, toward = start / start.sum(), toward / toward.sum()
            rate = rng.uniform(0.1, 0.5)
            free[row] = rng.random() < 0.7
            if rng.random() < 0.3:
                free[row] = rng.random(width) < 0.5
                rate = 0.0 if not free[row].all() else rate
            theta[row] = start
            one[row] = start + rate * (toward - start) * free[row].all()
            two[row] = one[row] + rng.uniform(0.6, 0.98) * (one[row] - start)
        out = np.full(33, np.nan)
        found = _extrapolate(theta, one, two, out, sizes, free)
        wanted = squarem.extrapolated(theta, one, two, rows, free)
        assert found == (wanted is not None)
        if found:
            np.testing.assert_allclose(out, wanted, rtol=1e-9, atol=1e-15)
            still = np.concatenate([np.full(r.stop - r.start, (one[r] == theta[r]).all()) for r in rows])
            np.testing.assert_array_equal(out[still], theta[still])
            r, v = one - theta, two - 2 * one + theta
            length = np.sqrt((r @ r) / (v @ v))
            seen += np.any((theta + 2 * length * r + length**2 * v < 0) & free)
    assert seen > 0


def test_entries_of_a_row_may_be_pinned_one_by_one():
    """At zero, with a prior that would fill them: they count neither as evidence nor in the prior."""
    search = Search(0, 2, extra=0.5)
    search.tables = tuple(t.copy() for t in search.tables)
    search.tables[1][2, 0] = [1.0, 0.0]
    search.free[1][2, 0, 1] = False
    theta = flat(search.tables)
    new, gradient = np.empty_like(theta), np.empty_like(theta)
    work, scale = np.empty((2, search.tree.n_nodes, 2)), np.empty((2, search.tree.n_nodes))
    value, prior = objective_and_step(
        theta, new, search.tree.arrays, search.sizes, search.index, flat(search.pseudo),
        flat(search.free).astype(bool), gradient, work, scale,
    )  # fmt: skip
    assert value == pytest.approx(sum(search.plain(run) for run in search.runs))
    counted = flat(search.free).astype(bool)
    assert prior == pytest.approx(np.sum((flat(search.pseudo) * np.log(np.where(counted, theta, 1.0)))[counted]))
    np.testing.assert_array_equal(search.unflat(new)[1][2, 0], [1.0, 0.0])


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
