"""The command `em`: what it refuses before it fits, and what it writes."""

import json
from functools import partial

import pytest

from analysis import datasets, frd2012
from tests.analysis.command import run as status_of
from tests.analysis.event_text import text

run = partial(status_of, "em")


def test_data_and_protocol_are_never_overwritten(tmp_path, capsys):
    path = tmp_path / "two.csv"
    path.write_text(text())
    assert run(path, "--json", path) == 2
    assert capsys.readouterr().err == f"prosocial: --json: found '{path}', wanted another file than DATA\n"
    assert run("simulated_study1", "--protocol", path, "--json", path) == 2
    assert "wanted another file than --protocol" in capsys.readouterr().err
    assert path.read_text() == text()


def test_files_of_the_data_registry_are_never_overwritten(tmp_path, capsys, monkeypatch):
    own = [path for path in datasets.files() if path.is_relative_to(datasets.DATA_FOLDER)]
    names = {path.name for path in own}
    assert {"registry.json", "published.json", "calibrated_truth.json", "simulated_study1.csv.gz"} <= names
    assert {"simulated_study1.json", "frd2012.json"} <= names
    link = tmp_path / "link.json"
    for path in own:
        before = path.read_bytes()
        link.symlink_to(path)
        for given in (path, link):
            assert run("simulated_study1", "--json", given) == 2
            told = capsys.readouterr().err
            assert told.startswith(f"prosocial: --json {given}: found a file of the workbench's own data, wanted")
        link.unlink()
        assert path.read_bytes() == before
    # Fetched data are protected where they were put.
    fetched = tmp_path / frd2012.FILE_NAME
    fetched.write_text("data")
    monkeypatch.setenv("PROSOCIAL_DATA", str(tmp_path))
    assert run("simulated_study1", "--json", fetched) == 2
    assert fetched.read_text() == "data"


def test_model_files_and_json_are_kept_apart(tmp_path, capsys):
    out = tmp_path / "model_2_states.json"
    assert run("simulated_study1", "--states", "2", "--out", tmp_path, "--json", out) == 2
    assert "--out, model_2_states.json: found" in capsys.readouterr().err
    assert run("simulated_study1", "--states", "2", "--out", tmp_path / "new", "--json", tmp_path / "new") == 2
    assert "wanted another file than --out" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--out", ""), "--out: found '', wanted the name of a folder"),
        (("--out", "/proc/models"), "/proc, where no file can be made"),
        (("--states", ""), "--states: found '', wanted a number such as 4"),
        (("--states", "4-2"), "the smaller number first"),
        (("--states", "1-999999999999"), "--states: found '1-999999999999', wanted a number such as 4"),
    ],
)
def test_unusable_arguments_are_refused_before_the_fit(arguments, message, capsys):
    assert run("simulated_study1", *arguments) == 2
    assert message in capsys.readouterr().err


def test_model_files_are_written(tmp_path):
    json_path = tmp_path / "em.json"
    assert run("simulated_study1", "--states", "1", "--out", tmp_path, "--json", json_path, "--quiet") == 0
    (fit,) = json.loads(json_path.read_text())["fits"]
    assert fit["model_file"] == str(tmp_path / "model_1_states.json")
    assert json.loads((tmp_path / "model_1_states.json").read_text())["what"].startswith(
        "Baum-Welch estimate with 1 state;"
    )


def test_worker_processes_learn_the_same(tmp_path):
    told = []
    for name, words in (("threads.json", ()), ("processes.json", ("--workers", "2"))):
        path = tmp_path / name
        assert run("simulated_study1", "--states", "2", "--restarts", "4", *words, "--json", path, "--quiet") == 0
        (fit,) = json.loads(path.read_text())["fits"]
        told.append({k: v for k, v in fit.items() if k != "seconds"})
    assert told[0] == told[1]
    assert told[0]["log_likelihood"] < 0
