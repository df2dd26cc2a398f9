"""The compiled EM loop: one step against its specification, and what must hold on the way."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.em_kernel import em, objective_and_step
from models.forward_backward import log_likelihood_and_gradient
from models.histories import UNSEEN
from models.protocol import PUBLISHED
from tests.random_cases import Case, cases, random_tables, tree_of
from tests.reference import recursions, simulation
from tests.reference.expectation_maximisation import em_step


@dataclass(frozen=True)
class Problem:
    """A case in the flat layout of the kernel."""

    case: Case
    pseudo: tuple
    free: tuple

    @property
    def sizes(self):
        return (self.case.n_states, *self.case.transition.shape[:1], *self.case.emission.shape[::2])

    def flat(self, tables):
        return np.concatenate([np.ravel(table) for table in tables])

    def unflat(self, theta):
        shapes = [table.shape for table in self.case.tables]
        cuts = np.cumsum([np.prod(shape) for shape in shapes])[:-1]
        return [part.reshape(shape) for part, shape in zip(np.split(theta, cuts), shapes, strict=True)]

    def step(self, tree=None):
        """One application of F by the kernel: stepped tables, log-likelihood, log-prior."""
        tree = tree or self.case.tree()
        theta = self.flat(self.case.tables)
        new, gradient = np.empty_like(theta), np.empty_like(theta)
        work, scale = np.empty((2, tree.n_nodes, self.case.n_states)), np.empty((2, tree.n_nodes))
        value, prior = objective_and_step(
            theta, new, tree.arrays, self.sizes, self.case.index,
            self.flat(self.pseudo), self.flat(self.free), gradient, work, scale,
        )  # fmt: skip
        return self.unflat(new), value, prior

    def run(self, tree=None, *, cap=60, tolerance=0.0, patience=10**6, accelerate=False, start=None):
        theta = self.flat(self.case.tables if start is None else start)
        out = em(
            theta, (tree or self.case.tree()).arrays, self.sizes, self.case.index, self.flat(self.pseudo),
            self.flat(self.free), cap, tolerance, patience, accelerate, np.zeros(1, np.uint8),
        )  # fmt: skip
        return self.unflat(out[0]), *out[1:]


def plain_problem(case, extra=0.0):
    return Problem(
        case,
        tuple(np.full_like(table, extra) for table in case.tables),
        tuple(np.ones(table.shape, dtype=bool) for table in case.tables),
    )


@st.composite
def problems(draw, **options):
    """Random cases with none, equal or uneven pseudo-counts and some rows pinned."""
    case = draw(cases(max_paths=10**9, max_states=4, max_runs=25, **options))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    extra = draw(st.sampled_from(["none", "equal", "uneven"]))
    pinned = draw(st.sampled_from([0.0, 0.3]))
    pseudo, free = [], []
    for table in case.tables:
        size = {"none": np.zeros, "equal": lambda n: np.full(n, 0.5), "uneven": lambda n: rng.gamma(1.0, size=n)}
        pseudo.append(size[extra](table.shape))
        row = rng.random(table.shape[:-1]) >= pinned
        free.append(np.ones(table.shape, dtype=bool) & row[..., None])
    return Problem(case, tuple(pseudo), tuple(free))


def assert_on_simplex(tables):
    for table in tables:
        assert np.all(table >= 0)
        np.testing.assert_allclose(table.sum(axis=-1), 1, atol=1e-12)


def log_prior(problem, tables):
    total = 0.0
    for table, extra, free in zip(tables, problem.pseudo, problem.free, strict=True):
        counts = free & (extra != 0)
        with np.errstate(divide="ignore"):
            total += (extra[counts] * np.log(table[counts])).sum()
    return total


def rows_with_counts(problem):
    """Which rows the data or the prior say something about."""
    value = log_likelihood_and_gradient(problem.case.tree(), *problem.case.tables, problem.case.index)
    return [
        (table * gradient + extra).sum(axis=-1) > 0
        for table, gradient, extra in zip(problem.case.tables, value[1:], problem.pseudo, strict=True)
    ]


# -- one step ------------------------------------------------------------------------------------------
@given(problems(zeros=0.1), st.data())
def test_one_step_equals_the_specification(problem, data):
    case = problem.case
    n = len(case.runs)
    weights = np.array(data.draw(st.lists(st.integers(0, 3), min_size=n, max_size=n)), dtype=float)
    found, value, prior = problem.step(case.tree().with_runs(weights))
    logs = [recursions.log_likelihood(run, *case.tables, case.index) for run in case.runs]
    expected = sum(w * v for w, v in zip(weights, logs, strict=True) if w > 0)
    assert value == pytest.approx(expected, rel=1e-12, abs=1e-12)
    if not np.isfinite(value):
        return
    wanted = em_step(case.runs, weights, case.tables, case.index, problem.pseudo, problem.free)
    for table, twin in zip(found, wanted, strict=True):
        np.testing.assert_allclose(table, twin, rtol=1e-10, atol=1e-13)
    assert prior == pytest.approx(log_prior(problem, case.tables), rel=1e-12, abs=1e-12)


@given(problems())
def test_the_loop_with_a_cap_of_one_is_one_step(problem):
    stepped, value, prior = problem.step()
    tables, trace, after, gradient, maps, converged = problem.run(cap=1)
    for table, twin in zip(tables, stepped, strict=True):
        assert np.array_equal(table, twin)
    assert maps == 1
    assert not converged
    assert len(trace) == 2
    assert trace[0] == value + prior
    there = log_likelihood_and_gradient(problem.case.tree(), *tables, problem.case.index)
    assert after == there.log_likelihood
    assert np.array_equal(gradient, problem.flat(there[1:]))


# -- along the way ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("accelerate", [False, True])
@given(problem=problems())
def test_the_objective_never_decreases(accelerate, problem):
    tables, trace, value, _, maps, _ = problem.run(cap=80, accelerate=accelerate)
    assert np.all(np.diff(trace) >= -1e-11 * np.maximum(1.0, np.abs(trace[1:])))
    assert maps <= 80
    assert_on_simplex(tables)
    there = log_likelihood_and_gradient(problem.case.tree(), *tables, problem.case.index)
    assert value == there.log_likelihood
    assert trace[-1] == pytest.approx(value + log_prior(problem, tables), rel=1e-10, abs=1e-10)


@pytest.mark.parametrize("accelerate", [False, True])
@given(problem=problems())
def test_pinned_rows_and_rows_without_evidence_stay_bit_for_bit(accelerate, problem):
    tables, *_ = problem.run(cap=40, accelerate=accelerate)
    counted = rows_with_counts(problem)
    for table, start, free, known in zip(tables, problem.case.tables, problem.free, counted, strict=True):
        assert np.array_equal(table[~free], start[~free])
        assert np.array_equal(table[~known], start[~known])


def test_rows_that_stay_do_so_although_they_do_not_sum_to_one_in_floating_point():
    """Normalising them again after an extrapolation would change their last digits."""
    row = np.array([0.6, 0.3, 0.1])
    assert (row[0] + row[1]) + row[2] != 1.0
    rng = np.random.default_rng(4)
    initial, transition, emission = random_tables(rng, PUBLISHED, 3)
    transition[:2] = row  # action 1 is never taken: free but without evidence
    runs = [[(2, int(o)) for o in rng.integers(2, size=5)] + [(0, UNSEEN), (2, 1)] for _ in range(30)]
    problem = plain_problem(Case(PUBLISHED, runs, initial, transition, emission))
    problem.free[1][0] = False
    tables, trace, *_ = problem.run(cap=100, accelerate=True)
    assert len(trace) < 80  # extrapolated steps were taken
    assert np.all(tables[1][:2] == row)
    assert not np.array_equal(tables[1][2], transition[2])


@pytest.mark.parametrize("accelerate", [False, True])
def test_zeros_stay_zero(accelerate):
    """A structural zero has no expected count, so EM cannot leave it: neither may the extrapolation."""
    rng = np.random.default_rng(8)
    initial, transition, emission = random_tables(rng, PUBLISHED, 3)
    transition[2] = [[0.5, 0.5, 0.0], [0.0, 0.3, 0.7], [0.0, 0.0, 1.0]]
    runs = [[(2, int(o)) for o in rng.integers(2, size=6)] for _ in range(20)]
    problem = plain_problem(Case(PUBLISHED, runs, initial, transition, emission))
    tables, *_ = problem.run(cap=100, accelerate=accelerate)
    assert np.all(tables[1][2][transition[2] == 0] == 0)
    assert_on_simplex(tables)


@pytest.mark.parametrize("accelerate", [False, True])
def test_single_entries_may_be_pinned_at_zero_although_the_prior_would_fill_them(accelerate):
    rng = np.random.default_rng(8)
    initial, transition, emission = random_tables(rng, PUBLISHED, 3)
    transition[2] = [[0.5, 0.5, 0.0], [0.0, 0.3, 0.7], [0.0, 0.0, 1.0]]
    runs = [[(2, int(o)) for o in rng.integers(2, size=6)] for _ in range(20)]
    problem = plain_problem(Case(PUBLISHED, runs, initial, transition, emission), 0.5)
    problem.free[1][transition == 0] = False
    tables, trace, *_ = problem.run(cap=100, accelerate=accelerate)
    assert np.array_equal(tables[1] == 0, transition == 0)
    assert_on_simplex(tables)
    assert np.all(np.diff(trace) >= -1e-11 * np.abs(trace[1:]))


def test_an_impossible_start_returns_at_once():
    initial, transition, emission = random_tables(np.random.default_rng(1), PUBLISHED, 2)
    emission[0] = [[1, 0], [1, 0]]
    problem = plain_problem(Case(PUBLISHED, [[(2, 1)]], initial, transition, emission))
    tables, trace, value, _, maps, converged = problem.run()
    assert trace.tolist() == [-np.inf]
    assert value == -np.inf
    assert maps == 0
    assert not converged
    assert all(np.array_equal(a, b) for a, b in zip(tables, problem.case.tables, strict=True))


# -- the optimum -----------------------------------------------------------------------------------------
def easy_problem(extra=0.0):
    """Two well separated sticky states, 150 runs of 12 events: one clear optimum."""
    rng = np.random.default_rng(21)
    truth = (
        np.array([0.7, 0.3]),
        np.array([[[0.9, 0.1], [0.1, 0.9]], [[0.7, 0.3], [0.05, 0.95]]] * 2),
        np.array([[[0.9, 0.1], [0.2, 0.8]], [[0.8, 0.2], [0.1, 0.9]]]),
    )
    design = [[(int(a), UNSEEN if a < 2 else 0) for a in rng.integers(4, size=12)] for _ in range(150)]
    index = np.array(PUBLISHED.emission_index)
    _, drawn = simulation.simulate(design, *truth, index, rng.random((150 * 12, 2)))
    responses = iter(drawn.tolist())
    runs = [[(a, next(responses)) for a, _ in run] for run in design]
    return truth, plain_problem(Case(PUBLISHED, runs, *truth), extra)


@pytest.mark.parametrize("extra", [0.0, 1.0])
def test_accelerated_and_plain_reach_the_same_optimum(extra):
    _, problem = easy_problem(extra)
    options = {"cap": 20_000, "tolerance": 1e-12, "patience": 5}
    plain = problem.run(**options)
    fast = problem.run(**options, accelerate=True)
    assert plain[5]
    assert fast[5]
    assert fast[4] < plain[4] / 2  # what the acceleration is for
    assert fast[1][-1] == pytest.approx(plain[1][-1], abs=1e-7)
    for table, twin in zip(plain[0], fast[0], strict=True):
        np.testing.assert_allclose(table, twin, atol=1e-4)


def test_at_an_optimum_the_gradient_is_level_within_rows():
    """Stationarity (KKT): theta * gradient is proportional to theta in every row, with no prior."""
    _, problem = easy_problem()
    tables, _, _, gradient, _, converged = problem.run(cap=20_000, tolerance=1e-13, patience=5, accelerate=True)
    assert converged
    for table, slope in zip(tables, problem.unflat(gradient), strict=True):
        count = (table * slope).sum(axis=-1, keepdims=True)
        np.testing.assert_allclose(table * slope, table * count, atol=1e-3 * max(1.0, count.max()))


def test_patience_counts_quiet_iterates_in_a_row():
    _, problem = easy_problem()
    short = problem.run(cap=5000, tolerance=1e-3, patience=1)
    longer = problem.run(cap=5000, tolerance=1e-3, patience=4)
    assert short[5]
    assert longer[5]
    assert np.all(np.diff(longer[1])[-4:] < 1e-3)
    assert np.diff(short[1])[-1] < 1e-3
    assert np.all(np.diff(short[1])[:-1] >= 1e-3)
    assert len(longer[1]) >= len(short[1]) + 3


def quiet_from(gains, tolerance, patience):
    """Number of iterates after which `patience` gains in a row were below the tolerance."""
    quiet = 0
    for i, gain in enumerate(gains):
        quiet = quiet + 1 if gain < tolerance else 0
        if quiet == patience:
            return i + 1
    return None


def test_a_gain_in_between_starts_the_count_again():
    """Extrapolated steps gain unevenly, so quiet iterates need not come in a row."""
    _, problem = easy_problem()
    rng = np.random.default_rng(6)
    interrupted = 0
    for _ in range(8):
        start = random_tables(rng, PUBLISHED, 2)
        gains = np.diff(problem.run(cap=400, accelerate=True, start=start)[1])
        for tolerance, patience in ((1e-1, 3), (1e-2, 3), (1e-3, 4), (1e-4, 5)):
            wanted = quiet_from(gains, tolerance, patience)
            _, trace, *_, converged = problem.run(
                cap=400, tolerance=tolerance, patience=patience, accelerate=True, start=start
            )
            assert converged == (wanted is not None)
            if wanted is not None:
                assert len(trace) == wanted + 1
                interrupted += np.sum(gains[:wanted] < tolerance) > patience
    assert interrupted > 0


def test_equal_runs_in_another_order_give_the_same_bits():
    _, problem = easy_problem()
    shuffled = tree_of(problem.case.runs[::-1], PUBLISHED)
    one, two = problem.run(cap=50), problem.run(shuffled, cap=50)
    assert np.array_equal(one[1], two[1])


@settings(max_examples=15)
@given(problems())
def test_more_iterations_start_where_fewer_stopped(problem):
    first, *_ = problem.run(cap=5)
    both, *_ = problem.run(cap=9)
    rest, *_ = problem.run(cap=4, start=first)
    for table, twin in zip(both, rest, strict=True):
        assert np.array_equal(table, twin)
