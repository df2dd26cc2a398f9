"""Kernels that are told to come back do so at once, and leave everything sound."""

import threading
import time

import numpy as np
import pytest

from models.planning.arrays import arrays_of
from models.planning.grid_search import GridSearch
from models.planning.solver import solve
from models.planning.time_watch import TimeWatch
from models.planning.trial_search import TrialSearch
from models.planning.vectors import best_vector
from models.work_clock import WorkClock
from tests.planning_cases import CASES, dense_problem, modal_problem, sparse_problem, start_arrays
from tests.reference import planning_numpy as reference


class Nudging:
    """Sets and clears a flag at odd moments while a block runs."""

    def __init__(self, halt, seed):
        self.halt, self.rng, self.over = halt, np.random.default_rng(seed), threading.Event()
        self.thread = threading.Thread(target=self.nudge)

    def nudge(self):
        while not self.over.wait(self.rng.uniform(0, 2e-3)):
            self.halt[0] = 1 - self.halt[0]

    def __enter__(self):
        self.thread.start()

    def __exit__(self, *_):
        self.over.set()
        self.thread.join()
        self.halt[0] = 0


@pytest.mark.parametrize("kind", [GridSearch, TrialSearch])
@pytest.mark.parametrize("name", sorted(CASES))
def test_broken_off_at_any_moment_bounds_hold(kind, name):
    problem = CASES[name]
    arrays = arrays_of(problem)
    kind(arrays, *start_arrays(problem), 10**9).step(1e-3, True)  # kernels are loaded
    low, high = reference.line_interval(problem) if problem.n_states <= 2 else reference.tree_interval(problem, 4)
    for seed in range(2):
        with Nudging(arrays.halt, seed):
            search = kind(arrays, *start_arrays(problem), 10**9)
            bounds = [(search.lower, search.upper)]
            for _ in range(25):
                search.step(1e-3, True)
                bounds.append((search.lower, search.upper))
        lower, upper = np.array(bounds[1:]).T
        assert (np.diff(lower) >= -1e-8).all()
        assert (np.diff(upper) <= 1e-8).all()
        assert lower[-1] <= high + 1e-8
        assert upper[-1] >= low - 1e-8
        assert (lower <= upper + 1e-9).all()
        n = int(search.vectors.counts[0])
        mode = search.vectors.mode[:n]
        choice = search.vectors.choice[:n] - arrays.mode_choice[mode]
        values = reference.controller_values(problem, mode, choice, search.vectors.follow)
        for alpha, value in zip(search.vectors.alpha, values, strict=False):
            assert (alpha[: len(value)] <= value + 1e-7).all()
        # Nothing is lost for good: it goes on where it was.
        for _ in range(60):
            if search.step(1e-2, True):
                break
        assert search.upper - search.lower <= 0.3 * max(abs(search.lower), abs(search.upper))


@pytest.mark.parametrize("kind", [GridSearch, TrialSearch])
def test_told_before_it_begins(kind):
    problem = dense_problem(3, 6, 4, 4, 0.99)
    arrays = arrays_of(problem)
    kind(arrays, *start_arrays(problem), 10**9).step(1e-3, True)
    arrays.halt[0] = 1
    search = kind(arrays, *start_arrays(problem), 10**9)
    for _ in range(5):
        search.step(1e-9, True)
    low, high = reference.tree_interval(problem, 4)
    assert search.lower <= high
    assert search.upper >= low
    x, belief = start_arrays(problem)[0][0], start_arrays(problem)[1][0]
    assert best_vector(search.vectors, int(x), belief, 6)[0] >= 0


LARGE = {
    "many outcomes": lambda: dense_problem(1, 12, 20, 60, 0.95),
    "long horizon": lambda: dense_problem(2, 8, 4, 10, 0.999),
    "nearly no discount": lambda: dense_problem(4, 12, 3, 3, 0.9999),
    "many states": lambda: sparse_problem(1, 400, 8, 40, 0.99),
    "modes": lambda: modal_problem(3, (12, 8, 10, 12), 0.9999),
}


@pytest.mark.parametrize("name", sorted(LARGE))
def test_time_limits_are_kept(name):
    """Rounds of these take a second and more. What is left over is for a machine that has other work to do."""
    problem = LARGE[name]()
    solve(problem, 1e-9, time_limit=0.01)
    solution = solve(problem, 1e-9, time_limit=0.3)
    assert solution.status == "time limit"
    assert 0.3 <= solution.seconds < 1.0
    assert solution.lower <= solution.upper


def test_a_flag_follows_the_clock_that_was_ahead_of_itself(monkeypatch):
    """While kernels are compiled the clock shows too much, and then goes back."""
    clock, halt = WorkClock(), np.zeros(1, dtype=np.int64)
    shown = [10.0]
    monkeypatch.setattr(clock, "wall", lambda: shown[0])
    with TimeWatch(clock, 1.0, halt):
        wait_for(lambda: halt[0] == 1)
        shown[0] = 0.5
        wait_for(lambda: halt[0] == 0)
        shown[0] = 1.5
        wait_for(lambda: halt[0] == 1)
    assert halt[0] == 0


def test_no_time_is_up_while_kernels_are_made_ready():
    clock, halt = WorkClock(), np.zeros(1, dtype=np.int64)
    with TimeWatch(clock, 0.2, halt) as watch:
        with watch.preparing():
            time.sleep(0.5)
            assert halt[0] == 0
        assert clock.compile_seconds >= 0.5
        wait_for(lambda: halt[0] == 1)


def wait_for(happened):
    until = time.monotonic() + 20
    while not happened():
        assert time.monotonic() < until
        time.sleep(0.001)
