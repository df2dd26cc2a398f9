"""Work over executors: order, progress, errors that name the piece, dead workers, cancellation, nested work."""

import os
import re
import signal
import threading
import time
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from multiprocessing import get_context

import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.spread_out import OtherWorkerError, WorkersLostError, chunks, spread_out, threads_here, what_runs_here
from models.worker_processes import WorkerProcesses
from tests.executors import Pickling, dies, dies_once, drawn, fails_at, slow


def room(index):
    return threads_here()


class Backwards(Executor):
    """Does what was submitted only when nothing more comes, last first; `lost` submissions never."""

    def __init__(self, count, lost=()):
        self.count, self.lost, self.jobs = count, lost, []

    def submit(self, fn, /, *args, **kwargs):
        self.jobs.append((Future(), fn, args))
        if len(self.jobs) == self.count:
            threading.Thread(target=self.work).start()
        return self.jobs[-1][0]

    def work(self):
        for i, (promise, fn, args) in reversed(list(enumerate(self.jobs))):
            if i in self.lost:
                promise.cancel()
                promise.set_running_or_notify_cancel()
            else:
                promise.set_result(fn(*args))


SERIAL = [drawn(1, i) for i in range(23)]


@given(st.integers(1, 30), st.integers(0, 23))
def test_no_result_depends_on_portions_or_on_who_is_first(together, n):
    told = []
    pool = Backwards(-(-n // together) if n else -1)
    work = partial(drawn, 1)
    found = spread_out(pool, work, range(n), lambda *now: told.append(now), together=together)
    assert found == SERIAL[:n]
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert n == 0 or told[-1] == (n, n)


@pytest.mark.parametrize("executor", [None, Pickling()])
def test_results_come_in_order(executor):
    assert spread_out(executor, partial(drawn, 1), range(23), together=4) == SERIAL
    with ThreadPoolExecutor(3) as pool:
        assert spread_out(pool, partial(drawn, 1), range(23)) == SERIAL


@pytest.mark.parametrize("executor", [None, Pickling()])
@pytest.mark.parametrize("pieces", [range(1, 9), [5]])
def test_an_error_stays_what_it_was_and_names_the_piece(executor, pieces):
    def name(i):
        return f"study {pieces[i]} (seed 1)"

    with pytest.raises(InputError, match=r"file.csv, line 3: found 5") as caught:
        spread_out(executor, partial(fails_at, 5), pieces, together=3, names=name)
    assert caught.value.__notes__ == ["This happened in study 5 (seed 1)."]


def test_an_interruption_stops_what_is_under_way_and_begins_nothing_new():
    begun, stopped = [], threading.Event()

    def work(index):
        begun.append(index)
        assert stopped.wait(20)

    def progress(done, total):
        raise AssertionError("nothing was done")

    def interrupt():
        while len(begun) < 2:
            time.sleep(0.01)
        signal.pthread_kill(threading.main_thread().ident, signal.SIGINT)

    threading.Thread(target=interrupt).start()
    with ThreadPoolExecutor(2) as pool, pytest.raises(KeyboardInterrupt):
        spread_out(pool, work, range(50), progress, stop=stopped.set)
    assert stopped.is_set()
    assert len(begun) <= 4  # those under way, and what a thread took before it was told


def test_a_part_of_work_that_is_no_longer_wanted_gives_up(monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    inner, ended = [], threading.Semaphore(0)

    def outer(index):
        if index == 0:
            while not inner:
                time.sleep(0.01)
            raise ZeroDivisionError
        try:
            spread_out(None, lambda i: (inner.append(i), time.sleep(0.05)), range(10_000))
        finally:
            ended.release()

    with pytest.raises(ZeroDivisionError):
        spread_out(None, outer, range(2))
    assert ended.acquire(timeout=20)
    assert len(inner) < 1000


def test_nested_work_shares_the_processors(monkeypatch):
    monkeypatch.setattr("os.cpu_count", lambda: 8)
    assert threads_here() == 8
    assert spread_out(None, room, range(3)) == [2, 2, 2]
    assert spread_out(None, room, range(30)) == [1] * 30
    assert spread_out(None, room, [0]) == [8]
    with ThreadPoolExecutor(1) as pool:
        assert spread_out(pool, room, range(2)) == [1, 1]  # whoever gave the executor decides how much runs
    assert threads_here() == 8


# -- workers -------------------------------------------------------------------------------------------------
def test_a_worker_that_runs_something_else_is_refused(monkeypatch):
    here = dict(what_runs_here(__name__))
    assert set(here) == {"Python", "numpy", "numba", "scipy", "pandas", "compiled code"}

    class Elsewhere(Pickling):
        def submit(self, fn, /, work, pieces, names, sender):
            return super().submit(fn, work, pieces, names, sender | {"numpy": "1.0"})

    with pytest.raises(OtherWorkerError, match=rf"found numpy {re.escape(here['numpy'])}, wanted 1\.0 \(install"):
        spread_out(Elsewhere(), partial(drawn, 1), range(3))


def test_work_that_an_executor_gave_up_is_named():
    words = r"gave up work; 4 of 6 pieces were done, without replicate 0, replicate 1$"
    with pytest.raises(WorkersLostError, match=words):
        spread_out(Backwards(3, {0}), partial(drawn, 1), range(6), together=2, names=lambda i: f"replicate {i}")


def test_a_plain_pool_says_what_is_missing_and_what_would_have_lived_on(tmp_path):
    words = r"a worker process died .*WorkerProcesses does; \d of 6 pieces were done, without .*piece 3 of 6"
    with (
        ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool,
        pytest.raises(WorkersLostError, match=words),
    ):
        spread_out(pool, partial(dies_once, tmp_path), range(6))


def test_worker_processes_outlive_a_death_and_lose_nothing(tmp_path, monkeypatch):
    monkeypatch.setattr("models.worker_processes.MOST_DEATHS", 1)
    told = []
    with WorkerProcesses(1) as pool:
        found = spread_out(pool, partial(dies_once, tmp_path), range(8), lambda *now: told.append(now))
        assert pool.deaths == 1
        assert (tmp_path / "died").exists()
        assert [value for value, _ in found] == SERIAL[:8]
        assert told[-1] == (8, 8)
        assert not {pid for _, pid in found} & {os.getpid()}
        # Work that kills whoever does it ends in an error, and the next work finds workers again.
        with pytest.raises(WorkersLostError, match="1 pieces were done") as caught:
            spread_out(pool, dies, [0])
        assert isinstance(caught.value.__cause__, BrokenExecutor)
        assert pool.deaths == 3
        assert pool.submit(drawn, 1, 4).result() == SERIAL[4]
    with pytest.raises(RuntimeError, match="closed"):
        pool.submit(drawn, 1, 4)


def test_worker_processes_are_left_at_once_after_an_error():
    with WorkerProcesses(1) as pool:
        later = pool.submit(slow, 3)
    assert later.result() == 3  # without an error everything is waited for
    began = time.perf_counter()
    futures = []

    def interrupted():
        with WorkerProcesses(1) as pool:
            futures.extend(pool.submit(slow, i) for i in range(200))
            futures[0].result()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert all(future.done() for future in futures)
    assert time.perf_counter() - began < 30
    with pytest.raises(InputError, match="worker processes: found 0, wanted at least 1"):
        WorkerProcesses(0)


def test_chunks_cover_everything():
    assert [list(range(7))[span] for span in chunks(7, 3)] == [[0, 1, 2], [3, 4, 5], [6]]
    assert list(chunks(0, 3)) == []
