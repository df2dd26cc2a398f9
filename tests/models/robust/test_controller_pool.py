"""The pool: criteria against a linear program by hand, orders that hold exactly, a certificate that is sound."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog

from models.errors import InputError
from models.model_draws import ModelDraws
from models.planning.batch import solve_draws
from models.planning.latent import LatentBatch
from models.planning.solver import solve
from models.robust.candidates import posterior_mean
from models.robust.controller_pool import ControllerPool, controller_pool
from models.robust.controllers import own_controllers
from models.robust.named_controllers import baseline_controllers
from models.robust.pool_mixture import best_mixture, held_out
from models.robust.risk import cvar, weighted_quantiles
from tests.models.robust.endless_cases import random_controller, solved
from tests.planning_cases import mode_processes, sticky_draws, sticky_model
from tests.reference import planning_numpy as reference

CRITERIA = ((1.0, 0.0), (0.3, 0.0), (0.1, 0.4), (0.0, 0.0))


@pytest.fixture(scope="module")
def pool():
    s = solved()
    return controller_pool(s, baseline_controllers(s.batch, posterior_mean(s.batch.draws)), size=12)


def made_pool(values, upper, weight) -> ControllerPool:
    """A pool with any numbers."""
    s = solved(len(weight))
    own = random_controller(s.batch, np.random.default_rng(0), 1)
    draws = replace(s.batch.draws, weight=weight)
    bounds = tuple(replace(one, upper=u) for one, u in zip(s.solutions, upper, strict=True))
    solution = replace(s, batch=replace(s.batch, draws=draws), solutions=bounds)
    names = tuple(replace(own, name="never" if p == 0 else f"p{p}") for p in range(len(values)))
    return ControllerPool(solution, names, values, 0.0, np.zeros(len(values)), 1)


def best_by_program(x, weight, alpha, kappa):
    """The best mixture as a primal program: variables shares, quantile, shortfalls."""
    plans, d = x.shape
    if alpha == 0:
        # max kappa w x + (1 - kappa) t, t <= x in every draw with weight.
        used = weight > 0
        cost = -np.append(kappa * (x @ weight), 1 - kappa)
        rows = np.hstack([-x[:, used].T, np.ones((used.sum(), 1))])
        total = np.append(np.ones(plans), 0)[None]
        bounds = [(0, None)] * plans + [(None, None)]
    else:
        # CVaR = max_t t - sum w (t - x)+ / alpha.
        cost = -np.concatenate([kappa * (x @ weight), [1 - kappa], -(1 - kappa) * weight / alpha])
        rows = np.hstack([-x.T, np.ones((d, 1)), -np.eye(d)])
        total = np.concatenate([np.ones(plans), [0], np.zeros(d)])[None]
        bounds = [(0, None)] * plans + [(None, None)] + [(0, None)] * d
    found = linprog(cost, rows, np.zeros(len(rows)), total, [1.0], bounds, method="highs")
    assert found.status == 0
    return -found.fun


# -- criteria --------------------------------------------------------------------------------------
@given(st.integers(0, 2**32 - 1), st.sampled_from(CRITERIA), st.sampled_from(["value", "regret", "gain"]))
def test_mixtures_are_optimal(seed, criterion, outcome):
    rng = np.random.default_rng(seed)
    plans, d = 5, 6
    values = rng.normal(size=(plans, d)) * 10
    weight = rng.dirichlet(np.ones(d)) if rng.random() < 0.7 else np.array([0.5, 0.5, 0, 0, 0, 0])
    own = made_pool(values, values.max(axis=0) + rng.random(d), weight)
    alpha, kappa = criterion
    found = best_mixture(own, alpha, mean_share=kappa, outcome=outcome)
    x = own.outcomes(outcome)
    assert found.criterion == pytest.approx(best_by_program(x, weight, alpha, kappa), abs=1e-7)
    assert -1e-12 <= found.gap <= 1e-8
    singles = [kappa * weight @ row + (1 - kappa) * cvar(row, weight, alpha) for row in x]
    assert found.single_criterion == pytest.approx(max(singles), abs=1e-9)
    assert found.single_criterion <= found.criterion + 1e-12
    assert found.criterion <= found.ceiling + 1e-9
    assert sum(found.shares.values()) == pytest.approx(1, abs=1e-12)
    np.testing.assert_allclose(found.values, found.share @ values[found.members])


@given(st.integers(0, 2**32 - 1))
def test_held_out_draws_had_no_part(seed):
    """Two halves, the best of each scored on the other: by hand for the mean."""
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(4, 6))
    weight = rng.dirichlet(np.ones(6))
    own = made_pool(values, values.max(axis=0), weight)
    got = np.empty(6)
    for mine, other in ((slice(0, 3), slice(3, 6)), (slice(3, 6), slice(0, 3))):
        got[other] = values[np.argmax(values[:, mine] @ weight[mine]), other]
    assert held_out(own, 1.0) == pytest.approx(weight @ got, abs=1e-12)
    # Worst draws of each half: whoever guards against the worst draw knows it in one half only.
    assert held_out(own, 0.0) <= values.max(axis=0).min() + 1e-12
    assert held_out(own, 1.0) <= best_mixture(own, 1.0).criterion + 1e-12
    same = made_pool(np.repeat(values[:, :1], 6, axis=1), np.full(6, 9.0), weight)
    assert held_out(same, 0.2) == pytest.approx(best_mixture(same, 0.2).criterion, abs=1e-9)


def test_held_out_needs_parts_with_weight(pool):
    with pytest.raises(InputError, match="folds: found 1, wanted 2 to 24"):
        held_out(pool, folds=1)
    empty = made_pool(np.zeros((2, 4)), np.ones(4), np.array([0.5, 0.5, 0.0, 0.0]))
    with pytest.raises(InputError, match=r"weight of draws 0 to 1: found 1\.0"):
        held_out(empty)


def test_orders(pool):
    """Worst draw, tail, mean; and the mean of all mixtures is below the ceiling."""
    mixtures = [best_mixture(pool, alpha) for alpha in (0.0, 0.05, 0.3, 1.0)]
    worth = [m.criterion for m in mixtures]
    assert worth == sorted(worth)
    assert worth[-1] == pytest.approx(pool.means.max(), abs=1e-12)
    regret = best_mixture(pool, 0.0, outcome="regret")
    assert regret.regret_bound == pytest.approx(-regret.criterion, abs=1e-9)
    for m in mixtures:
        assert m.mean <= pool.ceiling
        assert regret.regret_bound <= m.regret_bound + 1e-9
    table = pool.table(0.3)
    assert (table["worst"] <= table["cvar"] + 1e-9).all()
    assert (table["cvar"] <= table["mean"] + 1e-9).all()
    assert list(table["mean"]) == sorted(table["mean"], reverse=True)
    gain = best_mixture(pool, 0.1, outcome="gain")
    assert gain.criterion >= 0  # never itself gains nothing on itself


# -- certificate -----------------------------------------------------------------------------------
def test_no_controller_exceeds_a_bound(pool):
    assert np.all(pool.values <= pool.upper)
    assert np.all(pool.upper - pool.solution.upper <= 1e-7 * np.abs(pool.upper))
    assert pool.evpi_bound >= 0
    assert "an upper bound on EVPI, not EVPI" in pool.sentence
    assert pool.believed.max() < 1
    assert pool.number("never") == pool.names.index("never")
    with pytest.raises(InputError, match="controller: found 'nobody'"):
        pool.number("nobody")


def test_bounds_hold_the_optimum_by_brute_force(pool):
    """Depth-limited trees give an interval around each draw's optimum without any solver."""
    for d in range(0, 24, 8):
        low, high = reference.tree_interval(pool.solution.batch.problem(d), 5)
        assert pool.upper[d] >= low - 1e-9
        assert pool.values[:, d].max() <= high + 1e-9


def test_a_bound_that_is_none_is_noticed():
    s = solved()
    wrong = tuple(replace(one, upper=one.lower - 1.0) for one in s.solutions)
    with pytest.raises(ArithmeticError, match=r"worth .* more than the draw's upper bound"):
        controller_pool(replace(s, solutions=wrong))


def test_one_draw_gives_the_plain_plan():
    model = sticky_model(np.random.default_rng(8), 3)
    batch = LatentBatch(ModelDraws.from_models([model]), mode_processes()["alternating"], 0.9)
    solution = solve_draws(batch, 1e-3)
    own = controller_pool(solution)
    assert own.distinct == len(own.controllers) == 1
    assert own.believed[0] == 1
    plain = solve(batch.problem(0), 1e-3)
    assert plain.lower - 1e-3 * abs(plain.lower) <= own.means[0] <= plain.upper + 1e-9 * abs(plain.upper)
    assert own.evpi_bound <= solution.upper[0] - solution.lower[0] + 1e-9
    for outcome in ("value", "regret"):
        assert best_mixture(own, 0.2, outcome=outcome).mean == own.means[0]


def test_equal_draws_leave_nothing_to_learn():
    model = sticky_model(np.random.default_rng(8), 3)
    batch = LatentBatch(ModelDraws.from_models([model] * 5), mode_processes()["alternating"], 0.9)
    own = controller_pool(solve_draws(batch, 1e-3))
    assert own.distinct == 1
    assert own.evpi_bound <= 1e-3 * abs(own.ceiling)


# -- the choice of the pool ------------------------------------------------------------------------
def test_small_pools_are_diverse():
    s = solved(60)
    own = own_controllers(s)
    assert len(own.controllers) > 12
    whole = controller_pool(s, size=len(own.controllers))
    assert len(whole.controllers) == len(own.controllers)
    names = [f"c{i + 1}" for i in range(len(whole.controllers))]
    assert list(whole.names) == names

    def covered(chosen):
        return float(whole.weight @ whole.values[[names.index(n) for n in chosen]].max(axis=0))

    smaller, small = controller_pool(s, size=15), controller_pool(s, size=16)
    assert set(names[:8]) < set(smaller.names) < set(small.names)
    assert small.means.max() == pytest.approx(whole.means.max(), rel=1e-12)
    # The last one taken added at least as much as any that was left out would add now.
    last = covered(small.names) - covered(smaller.names)
    left = [covered([*small.names, n]) - covered(small.names) for n in names if n not in small.names]
    assert last >= max(left) > 0


def test_given_controllers_are_not_repeated():
    s = solved()
    own = own_controllers(s)
    pool = controller_pool(s, {"mine": own.controllers[0]})
    assert pool.names[0] == "mine"
    assert pool.believed[0] == pytest.approx(own.shares[0])
    assert "c1" not in pool.names
    assert len(pool.controllers) == len(own.controllers)


def test_refusals(pool):
    with pytest.raises(InputError, match="size of the pool: found 0"):
        controller_pool(pool.solution, size=0)
    with pytest.raises(InputError, match=r"alpha: found 1\.5"):
        best_mixture(pool, 1.5)
    with pytest.raises(InputError, match="outcome: found 'luck'"):
        best_mixture(pool, 0.5, outcome="luck")
    with pytest.raises(InputError, match="controller: found 'x'"):
        best_mixture(pool, 0.5, outcome="gain", against="x")


def test_weighted_quantiles():
    rng = np.random.default_rng(0)
    values = rng.normal(size=50)
    repeats = rng.integers(1, 5, size=50)
    found = weighted_quantiles(values, repeats / repeats.sum(), (0.05, 0.5, 0.95))
    expected = np.quantile(np.repeat(values, repeats), (0.05, 0.5, 0.95), method="inverted_cdf")
    np.testing.assert_array_equal(found, expected)


@pytest.mark.slow
def test_sticky_people_are_covered():
    s = solve_draws(LatentBatch(sticky_draws(300, 4, 4), mode_processes()["alternating"], 0.95), 1e-3)
    pool = controller_pool(s)
    assert float(pool.weight @ pool.values.max(axis=0)) > 0.97 * pool.ceiling
