"""Draws, restarts and replicates on a cluster of processes, workers killed in the middle: as serial, bit for bit.

Also what stands on the page about clusters: every block of code is run.
"""

from __future__ import annotations

import json
import logging
import os
import re
import runpy
import shlex
import signal
import socket
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from analysis.cli import main
from analysis.power_simulation import STUDY1_SD, STUDY1_TRUTH, MixedModelPower, mixed_model_power, study1_rows
from analysis.simulate import simulate_study1
from models.baum_welch import BaumWelch
from models.bootstrap import bootstrap_fit
from models.planning import batch as planning_batch
from models.planning.batch import solve_draws
from models.planning.latent import LatentBatch
from tests.planning_cases import mode_processes, sticky_draws

distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed (the extra 'cluster')")

PAGE = Path(__file__).resolve().parents[2] / "reports" / "docs" / "pages" / "cluster.md"

POWER = MixedModelPower(study1_rows(), STUDY1_TRUTH, STUDY1_SD, ("signal",), (60,), studies=10)
SEARCH = BaumWelch(2, restarts=6, finalists=2, rounds=1)

LOOPBACK = {
    "threads_per_worker": 1, "processes": True, "memory_limit": None, "host": "127.0.0.1",
    "dashboard_address": "127.0.0.1:0", "silence_logs": logging.CRITICAL + 1,
}  # fmt: skip


def started(workers):
    """A cluster of processes on the loopback, patient with machines that are busy."""
    import dask

    with dask.config.set({"distributed.comm.timeouts.connect": "180s", "distributed.comm.timeouts.tcp": "180s"}):
        return distributed.LocalCluster(n_workers=workers, **LOOPBACK)


@pytest.fixture(scope="module")
def cluster():
    with started(2) as own:
        yield own


@pytest.fixture
def client(cluster):
    with distributed.Client(cluster, set_as_default=False) as own:
        own.wait_for_workers(2, timeout=180)
        yield own


class Killer:
    """Progress that kills a worker as soon as the first results are in, one that has work at that moment."""

    def __init__(self, client):
        self.client, self.pids = client, client.run(os.getpid)
        self.killed, self.seen = 0, []

    def __call__(self, *told):
        self.seen.append(told[-2:])
        busy = [address for address, keys in self.client.processing().items() if keys and address in self.pids]
        if not self.killed and busy:
            self.killed = self.pids[busy[0]]
            os.kill(self.killed, signal.SIGKILL)

    def check(self, total):
        """A worker with work was killed, before everything was done, and is replaced."""
        assert self.killed
        assert self.seen[-1] == (total, total)
        assert self.killed not in self.client.run(os.getpid).values()


def solved(executor=None, progress=None):
    draws = LatentBatch(sticky_draws(40, 11), mode_processes()["alternating"], 0.95)
    found = solve_draws(draws, 1e-3, executor=executor, progress=progress)
    assert found.certified.all()
    return [
        found.lower,
        found.upper,
        *(getattr(s, n) for s in found.solutions for n in ("alpha", "mode", "choice")),
    ]


def bootstrapped(executor=None, progress=None):
    study = simulate_study1(participants=80)
    fit = SEARCH.fit(study, executor=executor)
    assert fit.log_likelihood == SEARCH.fit(study).log_likelihood
    found = bootstrap_fit(fit, study, 48, seed=3, executor=executor, progress=progress)
    return [getattr(found, name) for name in ("initial", "transition", "emission", "log_likelihood")]


def power(executor=None, progress=None, settings=POWER):
    return [mixed_model_power(settings, executor=executor, progress=progress).table]


def assert_same(one, other):
    assert len(one) == len(other)
    for a, b in zip(one, other, strict=True):
        if isinstance(a, pd.DataFrame):
            pd.testing.assert_frame_equal(a, b, check_exact=True)
        else:
            np.testing.assert_array_equal(a, b)


def test_a_worker_killed_in_the_middle_changes_nothing(client, monkeypatch):
    killer = Killer(client)
    assert_same(power(client.get_executor(pure=False), killer), power())
    killer.check(POWER.studies)
    assert_same(bootstrapped(client.get_executor(pure=False)), bootstrapped())
    monkeypatch.setattr(planning_batch, "PORTION", 8)
    assert_same(solved(client.get_executor(pure=False)), solved())


@pytest.mark.slow
def test_everything_with_a_death_in_each_on_more_workers(monkeypatch):
    """Four workers; one is killed in each: solving, a bootstrap, power, calibration by sampling."""
    from analysis.calibration import calibrate
    from analysis.calibration_replicate import CalibrationSettings
    from models.nuts import NutsSettings

    tiny = CalibrationSettings(2, 8, participants=60, sampler=NutsSettings(draws=300, tune=200, chains=2))

    def calibrated(executor=None, progress=None):
        (run,) = calibrate([tiny], executor=executor, progress=progress).runs
        return [np.stack([r.ranks for r in run.replicates])]

    monkeypatch.setattr(planning_batch, "PORTION", 2)
    more = replace(POWER, people=(60, 200), studies=200)
    with started(4) as cluster, distributed.Client(cluster, set_as_default=False) as client:
        for work, total in (
            (solved, 20), (bootstrapped, 48), (lambda *a: power(*a, settings=more), 200), (calibrated, 8),
        ):  # fmt: skip
            client.wait_for_workers(4, timeout=300)
            killer = Killer(client)
            assert_same(work(client.get_executor(pure=False), killer), work())
            killer.check(total)


# -- the command line ------------------------------------------------------------------------------------------
def run(*words):
    with pytest.raises(SystemExit) as stopped:
        main(list(words))
    return stopped.value.code or 0


def content(path):
    """What a command wrote, without the time it took and what it was asked."""
    whole = json.loads(path.read_text(encoding="utf-8"))
    return {k: v for k, v in whole.items() if k not in ("seconds", "command")}


COMMAND = ["power", "mixed-model", "--people", "60", "--studies", "4", "--quiet", "--json"]


def test_commands_take_workers_and_schedulers_and_give_the_same(client, tmp_path):
    address = client.scheduler.address
    assert run(*COMMAND, str(tmp_path / "a.json")) == 0
    assert run(*COMMAND, str(tmp_path / "b.json"), "--scheduler", address) == 0
    assert content(tmp_path / "a.json") == content(tmp_path / "b.json")


def test_schedulers_that_cannot_be_used_are_refused_in_one_line(capsys, monkeypatch):
    with socket.socket() as closed:
        closed.bind(("127.0.0.1", 0))
        nobody = f"tcp://127.0.0.1:{closed.getsockname()[1]}"
        monkeypatch.setattr("analysis.executors.PATIENCE", 1.0)
        began = time.perf_counter()
        for words, error in (
            (("--scheduler", nobody), rf"--scheduler: found {nobody}, where nobody answers \(\w+\), wanted a dask"),
            (("--scheduler", "10.0.0.5"), r"--scheduler: found '10.0.0.5', wanted the address of a dask scheduler"),
            (("--scheduler", nobody, "--workers", "2"), "--workers: found 2, wanted nothing beside --scheduler"),
        ):
            assert run(*COMMAND, "-", *words) == 2
            caught = capsys.readouterr()
            assert re.match(f"prosocial: {error}", caught.err), caught.err
            assert caught.out == ""
            assert caught.err.count("\n") == 1
        assert time.perf_counter() - began < 60
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert run(*COMMAND, "-", "--scheduler", nobody) == 2
    assert "distributed is not installed; wanted the optional extra cluster" in capsys.readouterr().err


# -- the page --------------------------------------------------------------------------------------------------
ADDRESS = "tcp://10.0.0.5:8786"

SMALLER = {
    "participants=540": "participants=60",
    "BaumWelch(3, seed=1)": "BaumWelch(2, restarts=4, finalists=2, rounds=1)",
    "replicates=1000": "replicates=8",
    "studies=4000": "studies=4",
    "--studies 4000": "--studies 2 --people 60",
    "(200, 540)": "(60,)",
    "WorkerProcesses(8)": "WorkerProcesses(1)",
    "--workers 8": "--workers 1",
    "--nworkers 8": "--nworkers 1",
}
"""What tests do less of."""


def blocks():
    """Language, file name and text of every block of code on the page."""
    text = PAGE.read_text(encoding="utf-8")
    found = re.findall(r'^```(\w+)(?: title="([\w.]+)")?\n(.*?)^```$', text, flags=re.MULTILINE | re.DOTALL)
    assert len(found) == text.count("```") / 2
    return found


def smaller(text, address):
    for printed, less in SMALLER.items():
        text = text.replace(printed, less)
    return text.replace(ADDRESS, address)


class SLURMCluster(distributed.LocalCluster):
    """Stand-in for that of dask_jobqueue, arguments as of its documentation: a job is a process of this machine."""

    def __init__(self, *, queue, account, cores, processes, memory, walltime, job_script_prologue):
        assert cores == processes
        assert all(isinstance(line, str) for line in job_script_prologue)
        super().__init__(n_workers=0, **LOOPBACK)

    def scale(self, n=0, *, jobs=0):
        return super().scale(min(n + jobs, 1))


def test_everything_that_is_printed_is_made_smaller():
    text = PAGE.read_text(encoding="utf-8")
    assert [printed for printed in SMALLER if printed not in text] == []
    assert {language for language, _, _ in blocks()} == {"sh", "python"}


@pytest.mark.slow
def test_python_on_the_page_runs(client, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    jobqueue = ModuleType("dask_jobqueue")
    jobqueue.SLURMCluster = SLURMCluster
    monkeypatch.setitem(sys.modules, "dask_jobqueue", jobqueue)
    ran = 0
    for language, name, text in blocks():
        if language == "python":
            (tmp_path / (name or "block.py")).write_text(smaller(text, client.scheduler.address), encoding="utf-8")
            if not name:
                # Processes that are spawned read the main file again: only the block that is guarded may be it.
                guarded = 'if __name__ == "__main__"' in text
                runpy.run_path(str(tmp_path / "block.py"), run_name="__main__" if guarded else "block")
                ran += 1
    assert ran == 4
    sys.modules.pop("my_study", None)
    out = capsys.readouterr().out
    assert out.count("8 replicates, parametric bootstrap") == 2
    low, high = map(float, out.split()[-2:])
    assert 0.71 < low < 0.8 < high < 0.89  # 200 shares of 540 people of whom 80% help


@pytest.mark.slow
def test_prosocial_commands_on_the_page_run(client, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    lines = [line for language, _, text in blocks() if language == "sh" for line in text.splitlines()]
    own = [line for line in lines if line.startswith("prosocial ")]
    assert len(own) == 2
    results = []
    for line in own:
        assert run(*shlex.split(smaller(line, client.scheduler.address))[1:], "--quiet") == 0
        results.append(content(Path("power.json")))
    assert results[0] == results[1]


@pytest.mark.slow
def test_the_printed_way_to_start_a_cluster_works(tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    address = f"tcp://127.0.0.1:{port}"
    text = "".join(text for language, _, text in blocks() if language == "sh")
    lines = [line for line in text.splitlines() if line.startswith("dask ")]
    assert len(lines) == 2
    dask = Path(sys.executable).with_name("dask")
    running = []
    try:
        for line in lines:
            words = smaller(line, address).replace("10.0.0.5", "127.0.0.1").replace("8786", str(port))
            command = [str(dask), *shlex.split(words)[1:]]
            quiet = subprocess.DEVNULL
            running.append(subprocess.Popen(command, cwd=tmp_path, stdout=quiet, stderr=quiet))
        with distributed.Client(address, timeout=120, set_as_default=False) as client:
            client.wait_for_workers(1, timeout=120)
            assert_same(power(client.get_executor(pure=False)), power())
    finally:
        for process in reversed(running):
            process.terminate()
            process.wait(60)
