"""Ctrl-C while kernels are made ready: it is answered, and does no damage."""

import _thread
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time

import numba
import pytest

from models.planning import loading
from models.planning.arrays import arrays_of
from models.planning.at_once import at_once
from models.planning.loading import load_kernels
from models.planning.solver import solve
from tests.planning_cases import CASES
from tests.reference import planning_numpy as reference


@pytest.fixture
def unloaded(monkeypatch):
    monkeypatch.setattr(loading, "_READY", set())


def interrupted_in(steps, monkeypatch):
    monkeypatch.setitem(loading._STEPS, "grid", steps)
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        load_kernels("grid")
    return time.monotonic() - began


def test_an_interruption_waits_for_the_step_it_falls_into(unloaded, monkeypatch):
    went = []

    def steps():
        went.append(threading.current_thread())
        yield
        _thread.interrupt_main()
        time.sleep(0.3)
        went.append("first")
        yield
        went.append("second")
        yield

    assert 0.3 <= interrupted_in(steps, monkeypatch) < 20
    assert went[0] is not threading.main_thread()
    assert went[1:] == ["first"]
    assert not loading._READY


def test_the_compiler_does_not_begin_with_another_function(unloaded, monkeypatch):
    inner = numba.njit(lambda x: x + 1)
    outer = numba.njit(lambda x: inner(x) + 1)

    def steps():
        _thread.interrupt_main()
        time.sleep(0.3)
        outer(1)
        yield

    interrupted_in(steps, monkeypatch)
    assert not inner.overloads
    assert not outer.overloads
    assert outer(1) == 3  # and it can still be had


def test_once_is_enough(unloaded, monkeypatch):
    calls = []

    def steps():
        calls.append(1)
        yield

    monkeypatch.setitem(loading._STEPS, "grid", steps)
    load_kernels("grid")
    load_kernels("grid")
    assert calls == [1]


def test_what_goes_wrong_is_told(unloaded, monkeypatch):
    def steps():
        raise RuntimeError("no compiler")
        yield

    monkeypatch.setitem(loading._STEPS, "grid", steps)
    with pytest.raises(RuntimeError, match="no compiler"):
        load_kernels("grid")
    assert not loading._READY


@pytest.mark.parametrize("kind", sorted(loading._STEPS))
def test_every_kernel_can_be_loaded(unloaded, kind):
    load_kernels(kind)
    assert {kind} == loading._READY


@pytest.mark.parametrize("name", sorted(CASES))
def test_what_is_known_without_kernels(name):
    problem = CASES[name]
    lower, upper, (alpha, mode, choice, follow) = at_once(arrays_of(problem))
    low, high = reference.tree_interval(problem, 4)
    assert lower <= high
    assert upper >= low
    values = reference.controller_values(problem, mode, choice, follow)
    for x, value in enumerate(values):
        assert (alpha[x, : len(value)] == lower).all()
        assert (value >= lower - 1e-9).all()
        assert not alpha[x, len(value) :].any()


def test_interrupted_while_kernels_are_loaded(unloaded, monkeypatch):
    def steps():
        _thread.interrupt_main()
        time.sleep(0.2)
        yield

    monkeypatch.setitem(loading._STEPS, "grid", steps)
    solution = solve(CASES["dense 2"])
    assert solution.status == "interrupted"
    assert solution.alpha_vectors == 1
    assert solution.policy.value(solution.problem.initial[0], "always") == pytest.approx(solution.lower)
    monkeypatch.undo()
    assert solve(CASES["dense 2"]).status == "converged"


COLD = """
    from models.planning.problems import problem
    from models.planning.solver import solve

    chosen = problem("tiger")
    print("ready", flush=True)
    print(solve(chosen).status, flush=True)
    print(solve(chosen, time_limit=20).status)
"""


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="signals of a terminal")
@pytest.mark.parametrize("after", [0.05, 3.0])
def test_a_real_ctrl_c_in_the_compiler(checkout, tmp_path, after):
    """With an empty cache; the same process then compiles the rest and solves the problem."""
    with subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(COLD)], stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, cwd=checkout, env=os.environ | {"PROSOCIAL_CACHE": str(tmp_path)},
    ) as process:  # fmt: skip
        try:
            assert process.stdout.readline() == "ready\n"
            time.sleep(after)
            process.send_signal(signal.SIGINT)
            out, problems = process.communicate(timeout=600)
        finally:
            process.kill()
    assert problems == ""
    assert out.split() == ["interrupted", "converged"]
