"""The benchmark of the posterior: peers have our density, everyone is judged alike, rows say what is so."""

import json
import re
from dataclasses import replace

import arviz as az
import numpy as np
import pytensor
import pytest

from analysis.bench import bayes, bayes_contender
from analysis.bench.bayes_contender import IMPORTS, Outcome, Settings, examine, importable
from analysis.bench.bayes_peers import PYMC_PEERS, distinct, rectangles, unrolled
from analysis.bench.timing import Row
from analysis.simulate import simulate_study1
from models.bayesian_hmm import build_model
from models.parameters import STICKY, DirichletPrior
from tests.analysis.command import run_captured
from tests.reference import enumeration

PRIORS = {"sticky": STICKY, "another": DirichletPrior(initial=1.5, transition=1.2, emission=2.0, stay=1.0)}
OUTCOME = Outcome(10.0, 8.0, 800.0, 1.002, 0, 200_000)


@pytest.fixture(scope="module")
def log():
    return simulate_study1(participants=60)


def points(model, density, rng, scale):
    """One random point as the density's vector and as the values of a model's variables, matched by name."""
    x = scale * rng.normal(size=density.dimension)
    start, at, point = model.initial_point(), 0, {}
    for name in ("initial_simplex__", "transition_simplex__", "help_probability_logodds__"):
        point[name] = x[at : at + start[name].size].reshape(start[name].shape)
        at += start[name].size
    assert at == len(x)
    assert start.keys() == point.keys()
    return x, point


# -- the peers -------------------------------------------------------------------------------------
PYTHON = pytensor.compile.mode.Mode(linker="py", optimizer="fast_compile")
"""Evaluates a graph without compiling it, which takes a minute."""


@pytest.mark.parametrize("prior", PRIORS)
@pytest.mark.parametrize("peer", ["scan", "unrolled"])
def test_a_peer_has_our_density(log, peer, prior):
    # A scan compiles its step whatever the mode, one operation at a time: a minute where none is kept yet.
    with pytensor.config.change_flags(cxx=""):
        agrees(log, peer, 3, PRIORS[prior], PYTHON)


@pytest.mark.slow
@pytest.mark.parametrize("peer", ["scan", "unrolled", "marginalised"])
def test_a_compiled_peer_has_our_density(log, peer):
    if peer == "marginalised":
        pytest.importorskip("pymc_extras")
    agrees(log, peer, 3, STICKY, None)


def agrees(log, peer, states, prior, mode):
    model = PYMC_PEERS[peer](log, states, prior)
    density = bayes.density_of(log, states, prior)
    ours = build_model(log, states, prior).compile_logp(mode=mode)
    theirs, slope = model.compile_logp(mode=mode), model.compile_dlogp(mode=mode)
    rng = np.random.default_rng(5)
    for scale in (0.5, 2.0, 4.0):
        x, point = points(model, density, rng, scale)
        value, gradient = density(x)
        assert float(theirs(point)) == pytest.approx(value, rel=1e-9, abs=1e-9)
        assert float(theirs(point)) == pytest.approx(float(ours(point)), rel=1e-9, abs=1e-9)
        if list(model.initial_point()) == list(point):
            np.testing.assert_allclose(slope(point), gradient, rtol=1e-8, atol=1e-8)


def test_distinct_rows_are_those_of_the_log_with_their_counts(log):
    action, response, counts = distinct(log)
    every = sorted(map(tuple, np.concatenate(rectangles(log), axis=1)))
    rebuilt = [
        tuple(row) for row in np.repeat(np.concatenate([action, response], axis=1), counts.astype(int), axis=0)
    ]
    assert sorted(rebuilt) == every
    assert len(action) == log.tree().n_histories


def test_unrolled_recursion_equals_enumeration_of_state_paths(log):
    rng = np.random.default_rng(2)
    states, emission_index = 3, np.asarray(log.protocol.emission_index)
    initial = rng.dirichlet(np.ones(states))
    transition = rng.dirichlet(np.ones(states), size=(log.protocol.n_actions, states))
    emission = rng.dirichlet(np.ones(2), size=(2, states))
    action, response, _ = distinct(log)
    shown = np.ones((*action.shape, states))
    seen = response >= 0
    shown[seen] = emission[emission_index[action[seen]], :, response[seen]]
    probability = unrolled(np, initial, transition, shown, action)
    for row in range(0, len(action), 7):
        run = list(zip(action[row], response[row], strict=True))
        paths = enumeration.path_probabilities(run, initial, transition, emission, emission_index)
        wanted = enumeration.likelihood(paths)
        assert probability[row] == pytest.approx(wanted, rel=1e-12)


def test_runs_of_different_lengths_are_refused(log):
    # As many events as before, so that they would still fit into a rectangle.
    uneven = replace(log, offsets=log.offsets + np.eye(1, len(log.offsets), 1, dtype=np.int64)[0])
    with pytest.raises(ValueError, match=r"runs of \[4, 5, 6\] events"):
        rectangles(uneven)


# -- how draws are judged --------------------------------------------------------------------------
def tables(rng, chains=4, draws=300):
    """Independent draws whose states are far apart in their help probabilities."""
    high = np.array([0.1, 0.5, 0.9]) + 0.02 * rng.normal(size=(chains, draws, 2, 3))
    return (
        rng.dirichlet(np.full(3, 5.0), size=(chains, draws)),
        rng.dirichlet(np.full(3, 5.0), size=(chains, draws, 4, 3)),
        np.stack([1 - high, high], axis=-1),
    )


def test_draws_are_judged_after_relabelling(log):
    rng = np.random.default_rng(1)
    initial, transition, emission = tables(rng)
    ess, rhat = examine(log, (initial, transition, emission), 0)
    order = rng.permuted(np.tile(np.arange(3), (4, 300, 1)), axis=-1)
    order[:2] = [2, 0, 1]  # whole chains under other labels, which would look like no convergence at all
    rows = order[:, :, None, :, None]
    switched = (
        np.take_along_axis(initial, order, -1),
        np.take_along_axis(np.take_along_axis(transition, rows, -2), order[:, :, None, None, :], -1),
        np.take_along_axis(emission, rows, -2),
    )
    assert examine(log, switched, 0) == pytest.approx((ess, rhat), rel=1e-12)
    assert rhat < 1.02


def test_smallest_effective_sample_size_is_the_worst_entrys(log):
    initial, transition, emission = tables(np.random.default_rng(3))
    sticky = np.repeat(initial[:, ::10], 10, axis=1)
    ess, _ = examine(log, (sticky, transition, emission), 0)
    wanted = az.ess(az.from_dict({"posterior": {"q": sticky}}), method="bulk")["q"].to_numpy().min()
    assert ess == pytest.approx(wanted, rel=1e-12)
    assert ess < 200


# -- rows ------------------------------------------------------------------------------------------
def rows_of(**changed):
    outcomes = dict.fromkeys((*bayes.OURS, *bayes.PEERS), OUTCOME) | changed
    return list(bayes.effective_draw_rows("compile time included", outcomes, judged=True))


def test_a_row_compares_effective_draws_per_cpu_second():
    rows = rows_of(scan=replace(OUTCOME, cpu_seconds=1000.0, min_ess=400.0))
    by_pair = {(row.name.split(" engine ")[1].split(",")[0], row.peer_name): row for row in rows}
    row = by_pair["direct", bayes.PEERS["scan"]]
    assert (row.ours, row.peer, row.ratio) == (80.0, 0.4, 200.0)
    assert (row.target, row.met) == (">= 100x", True)
    assert (row.goal.sense, row.goal.number, row.measured) == (">=", 100.0, 200.0)
    assert by_pair["pymc", bayes.PEERS["unrolled"]].met is False  # equal is not ahead
    assert by_pair["direct", bayes.PEERS["unrolled"]].met is None


def test_an_absent_peer_is_a_note():
    (row,) = [r for r in rows_of(numpyro="not installed") if r.peer_name == "NumPyro" and "pymc" in r.name]
    assert (row.peer, row.ratio, row.met) == (None, None, None)
    assert "not installed" in row.note


def test_an_engine_of_ours_that_fails_is_a_failure():
    with pytest.raises(RuntimeError, match="direct: failed"):
        rows_of(direct="failed: MemoryError")


def test_nothing_is_judged_on_caches_or_few_draws():
    outcomes = dict.fromkeys((*bayes.OURS, "scan"), OUTCOME)
    rows = list(bayes.effective_draw_rows("compiled before", outcomes, judged=False))
    assert len(rows) == 2
    assert all(row.met is None and not row.target for row in rows)


def test_threads_are_judged_on_an_idle_machine_only():
    quick, slow = {1: [4.0, 4.1], 2: [2.0, 2.1]}, {1: [4.0, 4.1], 2: [3.0, 3.1]}
    cpu = {1: [4.0, 4.1], 2: [4.0, 4.1]}
    busy = {1: [2.0, 2.1], 2: [4.0, 4.1]}
    assert bayes.threads_row(quick, cpu, 2).met is True
    assert bayes.threads_row(slow, cpu, 2).met is False
    assert bayes.threads_row(slow, busy, 2).met is None
    assert bayes.threads_row(slow, cpu, 1).met is None


# -- contenders ------------------------------------------------------------------------------------
def test_every_contender_is_known_to_its_process():
    assert set(IMPORTS) == {*bayes.OURS, *bayes.PEERS}
    assert set(PYMC_PEERS) < set(IMPORTS)
    assert all(importable(name) for name in ("direct", "pymc", "scan", "unrolled"))


def test_a_missing_library_makes_a_contender_absent(monkeypatch):
    monkeypatch.setitem(bayes_contender.IMPORTS, "numpyro", ("numpy", "no_such_library.part"))
    assert not importable("numpyro")


def test_a_contender_that_fails_says_why(log, tmp_path):
    outcome = bayes.run_contender("nobody", log, Settings(), tmp_path)
    assert outcome == "failed: KeyError: 'nobody'"


@pytest.mark.slow
def test_a_contender_runs_in_its_own_process(log, tmp_path):
    outcome = bayes.run_contender("direct", log, Settings(draws=100, tune=100, chains=2), tmp_path)
    assert isinstance(outcome, Outcome)
    assert outcome.cpu_seconds > 0
    assert 10 < outcome.min_ess < 400
    assert any((tmp_path / "kernels").rglob("*.nbc"))  # compiled into its own folder


@pytest.mark.slow
def test_gradients_cost_no_more_in_a_large_study():
    (row,) = bayes._cost_of_a_gradient(5, lambda _: None)
    assert row.met


# -- command line ----------------------------------------------------------------------------------
def test_command_lists_the_suites(capsys):
    shown = re.sub(r"\x1b\[[0-9;]*m", "", run_captured(capsys, "bench", "--help")[1])
    for name in ("em", "bayes", "glmm", "planning", "robust", "game", "startup", "end_to_end", "curves", "predict"):
        assert name in shown


def test_command_runs_the_suite_and_reports_its_rows(monkeypatch, tmp_path, capsys):
    def suite(*, quick, progress):
        assert quick
        yield Row("a measurement", 2.0, None, None, "s", note="a note")

    monkeypatch.setattr(bayes, "run", suite)
    out = tmp_path / "bench.json"
    status, _, err = run_captured(capsys, "bench", "bayes", "--quick", "--json", out)
    assert status == 0, err
    (row,) = json.loads(out.read_text())["rows"]
    assert (row["suite"], row["name"], row["ours"]) == ("bayes", "a measurement", 2.0)
