"""Clocks of the work itself: compilation is counted apart, in any thread, and once."""

import threading
import time

import numba
import pytest

from models import work_clock
from models.work_clock import WorkClock


def busy(seconds):
    end = time.process_time() + seconds
    while time.process_time() < end:
        pass


def test_compilation_by_numba_is_counted_apart():
    clock = WorkClock()

    @numba.njit
    def f(x):
        return x + 1.0

    f(1.0)
    assert clock.compile_seconds > 0.005
    before = clock.compile_seconds
    busy(0.2)
    assert clock.compile_seconds == before
    assert 0.15 < clock.cpu() < 1.0
    assert clock.wall() >= 0.15


def test_a_block_counts_once_whatever_is_compiled_in_it():
    clock = WorkClock()
    start = time.perf_counter()
    with clock.preparing(), clock.preparing():
        numba.njit(lambda x: x * 2.0)(3.0)
        busy(0.1)
    took = time.perf_counter() - start
    assert 0.1 <= clock.compile_seconds <= took
    assert clock.wall() < 0.05
    assert clock.cpu() < 0.05


def test_threads_that_prepare_at_the_same_time_count_once():
    clock = WorkClock()

    def prepare():
        with clock.preparing():
            time.sleep(0.2)

    threads = [threading.Thread(target=prepare) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert clock.compile_seconds == pytest.approx(0.2, abs=0.1)


def test_an_interrupted_block_is_closed():
    clock = WorkClock()
    with pytest.raises(KeyboardInterrupt), clock.preparing():
        raise KeyboardInterrupt
    clock._of.begin()  # as an interruption between numba's event and its lock leaves it
    again = WorkClock()
    busy(0.05)
    assert again.compile_seconds == 0


def test_an_end_without_a_beginning_counts_nothing():
    """A thread may hold the compiler's lock already when the first clock is made."""
    clock = WorkClock()
    found = []

    def other():
        work_clock._PREPARATION.end()
        with clock.preparing():
            found.append(work_clock._PREPARATION._threads)

    thread = threading.Thread(target=other)
    thread.start()
    thread.join()
    assert found == [1]
    assert work_clock._PREPARATION._threads == 0
