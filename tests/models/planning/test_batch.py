"""Many draws at once: all certified, the same in any number of threads, and the same as one by one."""

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from models.errors import InputError
from models.model_draws import ModelDraws
from models.planning import batch as planning_batch
from models.planning.arrays import arrays_of
from models.planning.batch import solve_draws
from models.planning.grid_solver import DONE
from models.planning.latent import LatentBatch
from models.planning.solver import solve
from models.reward import Reward, default_x
from tests.planning_cases import mode_processes, sticky_draws, sticky_model
from tests.reference import planning_numpy as reference


@pytest.fixture(scope="module")
def batch():
    """30 people whose states last: the benchmark of the design note, where the gap is hard to close."""
    return LatentBatch(sticky_draws(30, 11), mode_processes()["alternating"], 0.95)


@pytest.fixture(scope="module")
def solved(batch):
    return solve_draws(batch, 1e-3, threads=1)


def test_every_draw_is_certified(batch, solved):
    assert len(solved.solutions) == len(batch) == 30
    assert solved.certified.all()
    assert (solved.relative_gap <= 1e-3).all()
    assert (solved.lower <= solved.upper).all()
    assert (solved.draw_seconds > 0).all()
    assert solved.sentence.startswith("30 of 30 draws solved to a relative gap of 0.001 (largest 0.00")


def test_threads_change_nothing(batch, solved):
    other = solve_draws(batch, 1e-3, threads=2)
    np.testing.assert_array_equal(solved.lower, other.lower)
    np.testing.assert_array_equal(solved.upper, other.upper)
    for one, two in zip(solved.solutions, other.solutions, strict=True):
        for name in ("alpha", "mode", "choice"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_an_executor_changes_nothing(batch, solved, monkeypatch):
    monkeypatch.setattr(planning_batch, "PORTION", 7)
    weight = np.zeros(30)
    weight[0] = 1.0
    heavy = replace(batch, draws=replace(batch.draws, weight=weight))
    told = []
    with ThreadPoolExecutor(2) as pool:
        again = solve_draws(heavy, 1e-3, executor=pool, progress=lambda done, total: told.append((done, total)))
    assert told[-1] == (5, 5)
    assert np.array_equal(again.lower, solved.lower)
    assert np.array_equal(again.upper, solved.upper)
    for a, b in zip(again.solutions, solved.solutions, strict=True):
        assert np.array_equal(a.alpha, b.alpha)


def test_one_by_one(batch, solved):
    for d in range(0, len(batch), 3):
        alone = solve(batch.problem(d), 1e-3, time_limit=10)
        assert alone.status == "converged"
        assert alone.lower <= solved.upper[d] + 1e-9
        assert solved.lower[d] <= alone.upper + 1e-9


def test_policies_are_worth_what_they_say(batch, solved):
    for d in range(0, len(batch), 5):
        problem, s = batch.problem(d), solved.solutions[d]
        values = reference.controller_values(problem, s.mode, s.choice, s.follow)
        first = problem.initial[0]
        worth = max(first @ v for v, m in zip(values, s.mode, strict=True) if m == 0)
        assert s.lower - 1e-7 * abs(s.lower) <= worth <= s.upper * (1 + 1e-9)
        low, high = reference.tree_interval(problem, 4)
        assert s.lower <= high
        assert s.upper >= low


@pytest.mark.parametrize("kind", ["alternating", "bernoulli", "table"])
def test_arrays_are_those_of_the_problem(kind):
    batch = LatentBatch(sticky_draws(4, 3, 3), mode_processes()[kind], 0.9)
    for d in range(4):
        for name, ours, theirs in zip(
            batch.template._fields, batch.arrays(d), arrays_of(batch.problem(d)), strict=True
        ):
            np.testing.assert_array_equal(ours, theirs, err_msg=name, strict=name != "discount")


def test_draws_with_zeros_in_different_places():
    """A batch stores zeros, so that entries are in the same places; the problems are the same."""
    rng = np.random.default_rng(0)
    models = []
    for d in range(3):
        base = sticky_model(rng, 3)
        t = base.transition * (rng.random(base.transition.shape) < 0.6) + 1e-3 * np.eye(3)
        e = base.emission.copy()
        e[0, d] = [1, 0]
        models.append(type(base)(base.initial, t / t.sum(axis=-1, keepdims=True), e))
    batch = LatentBatch(ModelDraws.from_models(models), mode_processes()["bernoulli"], 0.9)
    solved = solve_draws(batch, 1e-3, threads=2)
    assert solved.certified.all()
    for d in range(3):
        alone = solve(batch.problem(d), 1e-3)
        assert alone.lower <= solved.upper[d] + 1e-9
        assert solved.lower[d] <= alone.upper + 1e-9


def test_another_reward(batch):
    few = LatentBatch(batch.draws.thin(3), batch.process, 0.9)
    costly = Reward(default_x(4), costs={"signal": 1e6})
    changed = solve_draws(few.with_reward(costly), 1e-3)
    assert changed.certified.all()
    assert (changed.lower <= solve_draws(few, 1e-3).upper + 1e-9).all()


def test_starts_in_either_mode():
    batch = LatentBatch(sticky_draws(5, 8), mode_processes()["bernoulli"], 0.9)
    solved = solve_draws(batch, 1e-3)
    assert solved.certified.all()
    for d in range(5):
        problem = batch.problem(d)
        parts = []
        for x in range(2):
            start = [np.zeros(4), np.zeros(4)]
            start[x] = batch.draws.initial[d]
            parts.append(solve(problem.started(start), 1e-3))
        low = sum(w * s.lower for w, s in zip(batch.process.start, parts, strict=True))
        high = sum(w * s.upper for w, s in zip(batch.process.start, parts, strict=True))
        assert low <= solved.upper[d] + 1e-9
        assert solved.lower[d] <= high + 1e-9


def test_more_states_than_the_grid_takes():
    batch = LatentBatch(sticky_draws(2, 5, 13), mode_processes()["alternating"], 0.6)
    solved = solve_draws(batch, 0.05, threads=2, time_limit=5)
    assert np.isfinite(solved.relative_gap).all()
    assert (solved.lower <= solved.upper).all()


def test_progress_counts_every_draw(batch):
    seen = []
    few = LatentBatch(batch.draws.thin(6), batch.process, 0.9)
    solve_draws(few, 1e-2, threads=2, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(k, 6) for k in range(1, 7)]


@pytest.mark.parametrize(("options", "words"), [
    ({"precision": 0.0}, "precision: found 0.0, wanted a number above 0"),
    ({"precision": np.nan}, "precision: found nan"),
    ({"threads": 0}, "threads: found 0, wanted at least 1"),
    ({"memory_limit": 0}, "memory limit: found 0, wanted above 0 bytes"),
])  # fmt: skip
def test_settings_that_make_no_sense(batch, options, words):
    with pytest.raises(InputError, match=words):
        solve_draws(batch, **options)


def test_without_discount_there_is_no_optimum(batch):
    with pytest.raises(InputError, match="discount of the batch: found 1"):
        solve_draws(LatentBatch(batch.draws, batch.process, 1.0))


def test_whoever_stops_need_not_wait_for_the_others(monkeypatch):
    def patient(problem, precision, *, progress, **limits):
        if problem.name == "draw 0":
            return solve(problem, precision, progress=progress, **limits)
        for _ in range(200):
            time.sleep(0.1)
            progress(None)
        raise AssertionError("nobody told this thread to stop")

    def stop(done, total):
        raise KeyboardInterrupt

    monkeypatch.setattr(planning_batch, "solve", patient)
    monkeypatch.setattr(planning_batch, "GRID_STATES", 0)
    few = LatentBatch(sticky_draws(2, 11), mode_processes()["alternating"], 0.5)
    began = time.perf_counter()
    with pytest.raises(KeyboardInterrupt):
        solve_draws(few, 0.1, threads=2, time_limit=20, progress=stop)
    assert time.perf_counter() - began < 15


def test_bounds_that_cross_are_not_passed_on(batch, monkeypatch):
    def wrong(problem, run, *rest):
        run.bounds[:] = 2.0, 1.0
        return DONE

    monkeypatch.setattr(planning_batch, "solve_run", wrong)
    with pytest.raises(ArithmeticError, match="draw 0: lower bound 2 above upper bound 1"):
        solve_draws(LatentBatch(batch.draws.thin(2), batch.process, 0.5), 0.1, threads=1)


def test_rows_that_nearly_sum_to_one(batch):
    draws = replace(batch.draws, transition=batch.draws.transition * (1 + 5e-10))
    some = LatentBatch(draws, batch.process, 0.9999)
    for d in (0, 3):
        np.testing.assert_allclose(some.arrays(d).value, arrays_of(some._draw(d)).value, rtol=1e-14)
        np.testing.assert_allclose(some.arrays(d).value.sum(), batch.arrays(d).value.sum(), rtol=1e-13)


def test_memory_is_kept_to(batch, monkeypatch):
    """Whatever the number of threads; what does not fit is solved on its own, within the same limit."""
    few = LatentBatch(batch.draws.thin(6), batch.process, 0.9)
    wide = solve_draws(few, 1e-3, threads=1)
    rooms, limits = [], []
    plain, alone = planning_batch.new_run, planning_batch.solve

    def new_run(problem, points, vectors):
        rooms.append(points * planning_batch.point_bytes(problem))
        return plain(problem, points, vectors)

    def solved(problem, precision, **options):
        limits.append(options["memory_limit"])
        return alone(problem, precision, **options)

    monkeypatch.setattr(planning_batch, "new_run", new_run)
    monkeypatch.setattr(planning_batch, "solve", solved)
    for limit in (150_000, 20_000_000):
        one, two = (solve_draws(few, 1e-3, threads=n, memory_limit=limit, time_limit=0.3) for n in (1, 2))
        assert max(rooms) <= limit
        for some in (one, two):
            assert (some.lower <= wide.upper + 1e-9).all()
            assert (wide.lower <= some.upper + 1e-9).all()
        assert set(limits) == ({limit} if limit < 1_000_000 else set())
        limits.clear()
    np.testing.assert_array_equal(one.lower, two.lower)
    np.testing.assert_array_equal(one.upper, two.upper)


def test_what_counts_as_at_least_goes_by_what_a_draw_can_come_to(batch):
    """One draw is certain to begin, and to stay, in its lowest state; the others are not."""
    draws = batch.draws.thin(3)
    initial, transition = draws.initial.copy(), draws.transition.copy()
    initial[1] = np.eye(initial.shape[1])[0]
    transition[1] = np.eye(initial.shape[1])
    some = LatentBatch(replace(draws, initial=initial, transition=transition), batch.process, 0.9)
    wanted = [some.problem(d).least_size for d in range(3)]
    np.testing.assert_array_equal(some.least_size, wanted)
    assert some.least_size[1] < some.least_size[0] == some.least_size[2]
    assert [some.arrays(d).least for d in range(3)] == wanted


@pytest.mark.parametrize("cost", [15.0, 0.01, 0.0])
def test_no_draw_depends_on_what_the_first_one_comes_to(batch, cost):
    """Next to nothing is at stake in a first draw that never leaves the state where nothing is paid."""
    draws = batch.draws.some(slice(0, 9))
    initial, transition = draws.initial.copy(), draws.transition.copy()
    initial[:2], transition[:2] = np.eye(4)[[0, 3]], np.eye(4)  # the second never leaves the best one
    costs = {"help": cost, "signal": cost}
    draws = replace(draws, initial=initial, transition=transition, reward=Reward(default_x(4), costs=costs))
    some = LatentBatch(draws, batch.process, 0.95)
    rewards = [c.reward for offered in some.problem(0).choices for c in offered]
    for d in range(9):
        assert some.arrays(d).largest == np.abs(rewards).max() / (1 - 0.95)
        assert some.arrays(d).span == (np.max(rewards) - np.min(rewards)) / (1 - 0.95)
    every = solve_draws(some, 1e-3, threads=1)
    rest = solve_draws(replace(some, draws=draws.some(slice(1, 9))), 1e-3, threads=1)
    assert every.certified.all()
    np.testing.assert_array_equal(every.lower[1:], rest.lower)
    np.testing.assert_array_equal(every.upper[1:], rest.upper)
    for one, two in zip(every.solutions[1:], rest.solutions, strict=True):
        np.testing.assert_array_equal(one.alpha, two.alpha)


@pytest.mark.slow
def test_three_hundred_draws_are_all_certified():
    batch = LatentBatch(sticky_draws(300, 23), mode_processes()["alternating"], 0.95)
    assert solve_draws(batch, 1e-3).certified.all()
