"""The loop of expectation-maximisation on small fixed cases, against EM and its extrapolation written out.

Quick also where kernels are interpreted.
"""

import numpy as np
import pytest

from models.em_kernel import _extrapolate, em, objective_and_step
from models.forward_backward import log_likelihood_and_gradient
from models.parameters import Layout
from models.protocol import PUBLISHED
from tests.models.by_hand_cases import THREE, case
from tests.random_cases import tree_of
from tests.reference import recursions, squarem
from tests.reference.expectation_maximisation import em_step


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
