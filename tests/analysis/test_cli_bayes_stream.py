"""`bayes` reads a file in parts: the same posterior bit for bit, what is kept of it instead, what is refused."""

import json

import numpy as np
import pytest

from analysis import cli_stream_options
from analysis.datasets import log_digest
from analysis.event_files import write_events
from analysis.event_stream import Sizes, compress_events
from analysis.fits import stored_fit
from analysis.model_criteria import alike, loo_by_person
from analysis.simulate import simulate_study1
from models import bayesian_fit, fit_tree
from models.bayesian_fit import fit
from models.errors import InputError
from models.events import EventLog
from models.groups import Groups
from models.nuts import NutsSettings
from models.person_offset import PersonOffset
from models.posterior_files import read_posterior
from models.study_density import BY_HISTORY
from tests.analysis.command import result_of, run_captured
from tests.reference import recursions

FAST = ("--states", "2", "--draws", "40", "--tune", "60", "--chains", "2")
SHORT = NutsSettings(40, 60, 2)
SAMPLED = ("posterior", "prior", "sample_stats")


@pytest.fixture(scope="module")
def log():
    """People with several runs, some in two conditions."""
    frame = simulate_study1(participants=120).to_frame()
    frame["sequence"] = frame["participant"] % 3
    frame["participant"] = (frame["participant"] - 1) // 3 + 1
    return EventLog.from_frame(frame)


@pytest.fixture(scope="module")
def file(log, tmp_path_factory):
    path = tmp_path_factory.mktemp("logs") / "study.parquet"
    write_events(log, path)
    return path


@pytest.fixture(scope="module")
def small(log, file):
    """The fit of the file in parts, and that of all of it."""
    parts = compress_events(file, by_condition=True, sizes=Sizes(rows=41)).log
    return fit(parts, 2, sampler=SHORT), fit(log, 2, sampler=SHORT)


def without_times(result):
    """Everything but seconds, how the file was read, and where the fit lies."""
    return {k: v for k, v in result.items() if k not in ("in_parts", "stored") and "seconds" not in k}


@pytest.mark.parametrize("more", [(), ("--condition", "help+signal"), ("--pin", "no_signal")])
def test_the_numbers_are_the_same_in_parts(file, capsys, more):
    parts = result_of(capsys, "bayes", file, *FAST, *more, "--stream")
    whole = result_of(capsys, "bayes", file, *FAST, *more, "--no-stream")
    assert (parts["in_parts"], whole["in_parts"]) == (True, False)
    assert parts["stored"] != whole["stored"]
    assert json.dumps(without_times(parts)) == json.dumps(without_times(whole))
    one, other = (read_posterior(result["stored"]) for result in (parts, whole))
    for group in SAMPLED:
        assert one.data[group].to_dataset().identical(other.data[group].to_dataset())
    assert one.gate == other.gate
    assert np.array_equal(one.emission_weights, other.emission_weights)
    assert one.settings.pop(BY_HISTORY) == "by history"
    for posterior in (one, other):
        assert posterior.settings["provenance"].pop("key")
    assert one.settings == other.settings


def test_a_fit_in_parts_is_found_again_and_never_taken_for_that_of_the_whole(log, file):
    parts = compress_events(file, by_condition=True).log
    first = stored_fit(parts, parts.digest, 2, sampler=NutsSettings(20, 60, 1))
    assert parts.digest == log_digest(log)
    assert not first.reused
    assert stored_fit(parts, parts.digest, 2, sampler=NutsSettings(20, 60, 1)).reused
    whole = stored_fit(log, parts.digest, 2, sampler=NutsSettings(20, 60, 1))
    assert not whole.reused
    assert whole.posterior.person_log_likelihoods().shape == (1, 20, 40)


def test_log_likelihoods_are_those_of_histories(log, small):
    parts, whole = small
    kept = parts.data["log_likelihood"].to_dataset()
    assert kept["runs"].sum() == log.n_runs
    assert set(parts.data.children) == {*SAMPLED, "log_likelihood"}
    np.testing.assert_allclose(parts.log_likelihood(), whole.log_likelihood(), rtol=1e-12)
    # People are sums of the histories of their runs.
    tree = log.tree()
    history = np.searchsorted(tree.terminals, tree.run_node)
    person = np.unique(log.participant, return_inverse=True)[1]
    by_person = np.zeros(whole.person_log_likelihoods().shape)
    np.add.at(by_person, (..., person), kept["history"].to_numpy()[..., history])
    np.testing.assert_allclose(by_person, whole.person_log_likelihoods(), rtol=1e-12)


def test_of_many_histories_some_draws_are_kept(log, file, small, monkeypatch):
    parts = compress_events(file, by_condition=True).log
    monkeypatch.setattr(fit_tree, "MOST_VALUES", 2 * 10 * parts.tree().n_histories)
    some = fit(parts, 2, sampler=SHORT)
    kept = some.data["log_likelihood"].to_dataset()
    assert kept.sizes["draw"] == 10
    every = small[0].data["log_likelihood"].to_dataset()
    assert kept.identical(every.sel(draw=kept["draw"]))
    assert some.gate == small[0].gate


def test_conditions_in_the_gate_are_sums_of_their_runs(log, monkeypatch):
    """Of a person in two conditions each run counts in its own."""
    seen, gate = {}, bayesian_fit.convergence_gate

    def examined(draws, names, divergences):
        seen.update(zip(names, np.moveaxis(draws, -1, 0), strict=True))
        return gate(draws, names, divergences)

    monkeypatch.setattr(bayesian_fit, "convergence_gate", examined)
    whole = fit(log, 2, sampler=SHORT)
    tables = [whole.data["posterior"][n].to_numpy()[1, 3] for n in ("initial", "transition", "emission")]
    totals = dict.fromkeys(log.conditions, 0.0)
    for run in range(log.n_runs):
        own = slice(log.offsets[run], log.offsets[run + 1])
        pairs = list(zip(log.action[own].tolist(), log.response[own].tolist(), strict=True))
        index = np.asarray(log.protocol.emission_index)
        totals[log.conditions[log.condition[run]]] += recursions.log_likelihood(pairs, *tables, index)
    for name, total in totals.items():
        assert seen[f"log-likelihood of condition {name}"][1, 3] == pytest.approx(total, rel=1e-12)
    assert seen["log-likelihood"][1, 3] == pytest.approx(sum(totals.values()), rel=1e-12)


def test_what_needs_people_is_refused(log, file, small):
    parts = compress_events(file, by_condition=True).log
    groups = Groups("half", ("a", "b"), np.arange(log.n_runs) % 2, ("initial",))
    for more in ({"groups": groups}, {"people": PersonOffset()}):
        with pytest.raises(
            InputError, match="found a compressed log, without its people, wanted an event log: groups"
        ):
            fit(parts, 2, sampler=SHORT, **more)
    with pytest.raises(InputError, match="found histories counted over all conditions, wanted counts by condition"):
        fit(compress_events(file).log, 2, sampler=SHORT)
    with pytest.raises(InputError, match="log-likelihoods of people: found a fit of a log that was read in parts"):
        loo_by_person(small[0].person_log_likelihoods(), alike(log))
    with pytest.raises(InputError, match="keep_runs: found True, wanted False"):
        compress_events(file, by_condition=True, keep_runs=True)


def test_how_it_was_read_and_what_is_kept_is_said(log, file, capsys, monkeypatch):
    monkeypatch.setattr(cli_stream_options, "LARGE", log.n_events)
    status, out, _ = run_captured(capsys, "bayes", file, *FAST)
    assert status == 0
    assert "read in parts, in bounded memory (since it is large; --no-stream reads it at once)" in out
    assert "distinct histories under every draw, and how many runs have each" in out
    # Groups need every run: they decide, unless --stream was asked for.
    whole = result_of(capsys, "bayes", file, *FAST, "--group", "condition")
    assert whole["in_parts"] is False
    for option in (("--group", "condition"), ("--people-differ",)):
        status, _, err = run_captured(capsys, "bayes", file, *FAST, *option, "--stream")
        assert status == 2
        assert f"--stream: found {option[0]} beside it, which needs every run of the log" in err
    status, _, err = run_captured(capsys, "bayes", "simulated_study1", *FAST, "--stream")
    assert status == 2
    assert "--stream: found the registered data set simulated_study1, wanted a file" in err


@pytest.mark.parametrize("words", [("compare",), ("report", "--out", "REPORT", "--data")])
def test_commands_that_hold_a_file_say_so_of_a_large_one(log, file, tmp_path, capsys, monkeypatch, words):
    command = words[0]
    assert cli_stream_options.held_sentence("simulated_study1", command) == ""
    assert cli_stream_options.held_sentence(str(file), command) == ""
    monkeypatch.setattr(cli_stream_options, "MANY", log.n_events)
    told = cli_stream_options.held_sentence(str(file), command)
    assert f"some {log.n_events:,} events, read at once and held; besides, {command} keeps log-likelihoods" in told
    monkeypatch.setattr(cli_stream_options, "machine_memory", lambda: 1e4)
    words = [str(tmp_path) if word == "REPORT" else word for word in words]
    status, _, err = run_captured(capsys, *words, file, "--quiet")
    assert status == 2
    assert f"wanted a file that fits into 0.0 GB of memory: {command} reads it at once; em, bayes and" in err
