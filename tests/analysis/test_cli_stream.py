"""Commands that read a file in parts: the same results as at once, said so, by size or as asked."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from analysis import cli_stream_options
from analysis.em_study import run_em
from analysis.event_files import log_table, write_events
from analysis.event_stream import compress_events
from analysis.simulate import simulate_study1
from models.baum_welch import BaumWelch
from models.design_facts import Study
from models.errors import InputError
from models.study_density import ModelSpec, StudyDensity
from tests.analysis.command import result_of, run_captured
from tests.analysis.event_text import text

QUICK = ("--states", "2", "--restarts", "3")


@pytest.fixture
def log():
    return simulate_study1(participants=120)


@pytest.fixture
def file(log, tmp_path):
    write_events(log, tmp_path / "study.parquet")
    return tmp_path / "study.parquet"


def without_times(result):
    """Everything but seconds and how the file was read."""
    if isinstance(result, dict):
        return {k: without_times(v) for k, v in result.items() if k != "in_parts" and "seconds" not in k}
    return [without_times(v) for v in result] if isinstance(result, list) else result


@pytest.mark.parametrize("more", [(), ("--condition", "help+signal"), ("--pin", "no_signal")])
def test_em_gives_the_same_numbers_in_parts(file, capsys, more):
    parts = result_of(capsys, "em", file, *QUICK, *more, "--stream")
    whole = result_of(capsys, "em", file, *QUICK, *more, "--no-stream")
    assert (parts["in_parts"], whole["in_parts"]) == (True, False)
    assert without_times(parts) == without_times(whole)
    assert json.dumps(without_times(parts)["fits"]) == json.dumps(without_times(whole)["fits"])


def test_data_check_finds_the_same_in_parts(log, tmp_path, capsys):
    path = tmp_path / "study.csv"
    write_events(log, path)
    parts = result_of(capsys, "data", "check", path, "--stream")
    assert without_times(parts) == without_times(result_of(capsys, "data", "check", path))
    good = path.read_text().splitlines()
    path.write_text("\n".join([*good, good[7], good[8].replace("study1", "study2"), ""]))
    told = [run_captured(capsys, "data", "check", path, *more) for more in (("--stream",), ())]
    assert told[0] == told[1]
    assert told[0][0] == 2
    assert "each event once" in told[0][2]


def test_how_a_file_was_read_is_said(log, file, tmp_path, capsys, monkeypatch):
    status, out, err = run_captured(capsys, "data", "check", file)
    assert (status, err) == (0, "")
    assert "in parts" not in out
    monkeypatch.setattr(cli_stream_options, "LARGE", log.n_events)
    for name in ("study.parquet", "mixed.parquet"):
        order = np.random.default_rng(1).permutation(log.n_events)
        pq.write_table(log_table(log).take(order), tmp_path / "mixed.parquet")
        status, out, err = run_captured(capsys, "data", "check", tmp_path / name)
        assert status == 0
        assert "read in parts, in bounded memory (since it is large; --no-stream reads it at once)" in out
        assert ("were sorted on disk" in out) == (name == "mixed.parquet")
    assert "in parts" not in run_captured(capsys, "data", "check", file, "--no-stream")[1]
    # The bootstrap needs every run: it decides, unless --stream was asked for.
    whole = result_of(capsys, "em", file, *QUICK, "--bootstrap", "2")
    assert whole["in_parts"] is False
    assert result_of(capsys, "em", file, *QUICK)["in_parts"] is True
    status, _, err = run_captured(capsys, "em", file, *QUICK, "--bootstrap", "2", "--stream")
    assert status == 2
    assert "--stream: found --bootstrap beside it, which needs every run of the log" in err
    status, _, err = run_captured(capsys, "em", "simulated_study1", *QUICK, "--stream")
    assert status == 2
    assert "--stream: found the registered data set simulated_study1, wanted a file" in err


@pytest.mark.parametrize("name", ["a.csv", "a.csv.gz", "a.parquet"])
def test_how_many_events_a_file_holds_is_guessed_well(tmp_path, name):
    log = simulate_study1(participants=2_000)
    write_events(log, tmp_path / name)
    guess = cli_stream_options._events(str(tmp_path / name))
    if name == "a.parquet":
        assert guess == log.n_events
    assert log.n_events / 5 < guess < log.n_events * 5


def test_options_are_refused_before_the_file_is_read(tmp_path, capsys):
    path = tmp_path / "a.csv"
    path.write_text(text())
    for words, wanted in (
        (("--pin", "wave"), "--pin: found 'wave'"),
        (("--states", "0"), "--states: found '0'"),
        (("--condition", "nowhere"), "condition: found 'nowhere', wanted one of help+signal, none at all"),
    ):
        status, _, err = run_captured(capsys, "em", path, "--stream", *words)
        assert status == 2
        assert wanted in err


def test_a_study_of_either_kind_is_learned_from_and_the_bootstrap_needs_all_of_it(log, file):
    found = compress_events(file).log
    assert isinstance(found, Study)
    assert isinstance(log, Study)
    settings = BaumWelch(2, restarts=2, finalists=1, rounds=1, max_maps=200)
    one, other = settings.fit(found), settings.fit(log)
    assert one.log_likelihood == other.log_likelihood
    for a, b in zip(one.model.canonical().transition, other.model.canonical().transition, strict=True):
        assert np.array_equal(a, b)
    with pytest.raises(InputError, match="bootstrap of: found a compressed log, wanted an event log"):
        run_em(found, (2,), settings=lambda k: settings, bootstrap={2: 2})


def test_the_bayesian_density_of_a_compressed_log(log, file):
    found = compress_events(file).log
    one, other = (StudyDensity(study, ModelSpec(3)) for study in (found, log))
    x = other.density.starting_point(1)
    assert np.array_equal(one.density.starting_point(1), x)
    (value, slope), (wanted, wanted_slope) = one.density(x), other.density(x)
    assert value == wanted
    assert np.array_equal(slope, wanted_slope)
    assert np.array_equal(one.emission_weights, other.emission_weights)


def test_a_compressed_log_shows_itself(log, file):
    found = compress_events(file).log
    assert f"{log.n_participants} people" in repr(found)
    view = found._view()
    assert f"{found.tree().n_histories:,} distinct histories" in view.sentences[0]
    with pytest.raises(InputError, match="runs were counted and not kept"):
        found.tree().with_runs(np.ones(log.n_runs))
    doubled = found.tree().with_counts(2 * found.tree().arrays.ends)
    assert np.array_equal(doubled.terminals, found.tree().terminals)
