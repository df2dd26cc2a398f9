"""The store of fits, listed and cleaned: what is never found again goes, the rest only when told."""

import json
import os
import shutil
import time
from dataclasses import replace

import h5py
import numpy as np
import pytest

from analysis import fits
from analysis.cli import main
from analysis.datasets import log_digest
from analysis.fits_inventory import DAY, StoreEntry, entries, to_clear
from analysis.kept_chains import ABOUT
from models.chains import STATS, Chain
from models.nuts import NutsSettings
from models.parameters import DirichletPrior
from models.simulation import simulate_responses
from tests.models.test_recovery import truth, varied_design

SHORT = NutsSettings(40, 60, 2)


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(2)
    return simulate_responses(truth(), varied_design(60, 4, rng), rng)[0]


@pytest.fixture
def store(tmp_path, monkeypatch):
    monkeypatch.setattr(fits, "store_folder", lambda: tmp_path / "fits")
    return tmp_path / "fits"


def coordinates(states):
    """Of the plain model: initial shares, four transition tables, two helping probabilities a state."""
    return states - 1 + 4 * states * (states - 1) + 2 * states


def interrupt(log, states):
    """Begin a fit and stop it after one chain."""

    def stop(*args, finished, **options):
        finished(1, Chain(np.zeros((40, coordinates(states))), {name: np.zeros(40) for name in STATS}))
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fits, "fit", stop)
        with pytest.raises(KeyboardInterrupt):
            fits.stored_fit(log, log_digest(log), states, sampler=SHORT)


@pytest.fixture(scope="module")
def filled(log, tmp_path_factory):
    """One of each: a fit, outdated ones, chains of an interrupted run, something damaged, left over, foreign."""
    store = tmp_path_factory.mktemp("filled")
    digest = log_digest(log)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(fits, "store_folder", lambda: store)
        fit = fits.stored_fit(log, digest, 2, prior=DirichletPrior(stay=5.0), pins={"help": None}, sampler=SHORT)
        interrupt(log, 3)
        patch.setattr(fits, "source_digest", lambda *modules: "of other code")
        old = fits.stored_fit(log, digest, 1, sampler=SHORT)
        interrupt(log, 4)
    (store / "damaged.nc").write_bytes(fit.path.read_bytes()[:2000])
    (store / ".dead.nc.x1.nc").write_bytes(b"half")
    os.utime(store / ".dead.nc.x1.nc", (time.time() - DAY,) * 2)
    (store / ".alive.nc.x2.nc").write_bytes(b"being written")
    (store / "notes.txt").write_text("mine")
    (store / "link.nc").symlink_to("notes.txt")
    return store, fit, old


@pytest.fixture
def full(store, filled):
    """A copy of its own for each test, which may clear it."""
    folder, *made = filled
    shutil.copytree(folder, store, symlinks=True)
    return [replace(fit, path=store / fit.path.name) for fit in made]


def run(capsys, *arguments):
    try:
        main(["fits", *map(str, arguments)])
        status = 0
    except SystemExit as stop:
        status = stop.code or 0
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def test_what_is_in_the_store(full):
    fit, old = full
    statuses = sorted(entry.status for entry in entries())
    assert statuses == ["damaged", "interrupted", "left over", "outdated", "outdated", "ready"]
    found = {entry.status: entry for entry in entries() if entry.path.suffix != ".chains"}
    found |= {"interrupted": next(entry for entry in entries() if entry.status == "interrupted")}
    ready = found["ready"]
    assert ready.key == fit.key
    assert ready.bytes == fit.path.stat().st_size
    gate = fit.posterior.gate
    assert ready.about == {
        "study": "simulated_recovery", "states": 2, "kappa": 5.0, "engine": "direct", "pins": ["help"],
        "hierarchical": False, "draws": 40, "tune": 60, "chains": 2, "seed": 1, "gate": gate.passed,
        "divergences": gate.divergences, "max_rhat": pytest.approx(gate.max_rhat),
    }  # fmt: skip
    assert found["outdated"].key == old.key
    waiting = found["interrupted"].about
    assert (waiting["study"], waiting["states"], waiting["chains_done"]) == ("simulated_recovery", 3, 1)
    assert found["left over"].key == "dead"


def test_other_versions_make_a_fit_outdated(full, monkeypatch):
    monkeypatch.setattr(fits, "versions", lambda: {"numpy": "0"})
    assert {entry.status for entry in entries()} == {"outdated", "damaged", "left over"}


def test_list_and_its_json(full, store, capsys):
    status, out, err = run(capsys, "list", "--json", "-")
    assert status == 0
    content = json.loads(out)
    assert content["folder"] == str(store)
    assert {entry["status"] for entry in content["fits"]} >= {"ready", "interrupted"}
    ready = next(e for e in content["fits"] if e["status"] == "ready")
    assert {"key", "study", "states", "kappa", "engine", "draws", "gate", "bytes", "modified"} <= set(ready)
    assert content["bytes"] == sum(entry["bytes"] for entry in content["fits"])
    assert "simulated_recovery, 2 states  kappa 5  held help  direct, 2 x 40 draws, seed 1  gate " in err
    assert "1 of 2 chains done" in err
    assert "6 entries" in err


def test_an_empty_store_is_said_to_be_empty(store, capsys):
    status, out, _ = run(capsys, "list")
    assert status == 0
    assert "0 entries, 0.0 MB" in out
    assert run(capsys, "clean")[0] == 0


def test_clean_removes_what_is_never_found_again(full, store, capsys):
    fit, old = full
    status, out, _ = run(capsys, "clean", "--dry-run")
    assert status == 0
    assert "would remove" in out
    assert old.path.exists()
    status, out, _ = run(capsys, "clean", "--json", "-")
    assert status == 0
    assert {entry["status"] for entry in json.loads(out)["removed"]} == {"outdated", "damaged", "left over"}
    assert json.loads(out)["kept"] == 2
    left = sorted(path.name for path in store.iterdir())
    (waiting,) = store.glob("*.chains")
    assert json.loads((waiting / ABOUT).read_text())["states"] == 3
    assert left == sorted([".alive.nc.x2.nc", fit.path.name, "link.nc", "notes.txt", waiting.name])


def test_clean_all_leaves_only_what_is_not_the_stores(full, store, capsys):
    assert run(capsys, "clean", "--all", "--quiet")[0] == 0
    assert sorted(path.name for path in store.iterdir()) == [".alive.nc.x2.nc", "link.nc", "notes.txt"]
    assert (store / "notes.txt").read_text() == "mine"


def test_clean_by_age(full, store, capsys):
    fit, _ = full
    os.utime(fit.path, (time.time() - 40 * DAY,) * 2)
    status, out, _ = run(capsys, "clean", "--older-than", "30", "--json", "-")
    assert status == 0
    assert [entry["key"] for entry in json.loads(out)["removed"]] == [fit.key]
    assert len(list(store.glob("*.chains"))) == 2


def test_age_and_everything_exclude_each_other(store, capsys):
    status, _, err = run(capsys, "clean", "--all", "--older-than", "3")
    assert status == 2
    assert "--older-than: found 3.0, wanted nothing beside --all" in err


def test_what_is_cleared(tmp_path):
    now = time.time()
    some = [
        StoreEntry(tmp_path / name, name, status, 1, now - age * DAY)
        for name, status, age in (("a", "ready", 10), ("b", "outdated", 1), ("c", "interrupted", 50))
    ]
    assert [e.key for e in to_clear(some)] == ["b"]
    assert [e.key for e in to_clear(some, older_than=5)] == ["a", "c"]
    assert [e.key for e in to_clear(some, everything=True)] == ["a", "b", "c"]


def test_an_interrupted_run_that_goes_on_leaves_nothing(store, log, monkeypatch):
    original = fits.fit
    interrupt(log, 3)
    assert [entry.status for entry in entries()] == ["interrupted"]
    # The chain above is no chain of this model: it stands for one.
    monkeypatch.setattr(fits, "fit", lambda *args, done, **rest: original(*args, **rest))
    fits.stored_fit(log, log_digest(log), 3, sampler=SHORT)
    assert [entry.status for entry in entries()] == ["ready"]
    assert not list(store.glob("*.chains"))


def test_chains_that_no_run_goes_on_with_are_cleared_away(store, log, capsys):
    """Of other code or versions, saying nothing usable, saying nothing at all, of a fit that is complete."""
    for states in (1, 2, 3, 4):
        interrupt(log, states)
    folders = {json.loads((f / ABOUT).read_text())["states"]: f for f in store.glob("*.chains")}
    about = json.loads((folders[1] / ABOUT).read_text())
    about["made_by"]["versions"]["nutpie"] = "0.1"
    (folders[1] / ABOUT).write_text(json.dumps(about))
    (folders[2] / ABOUT).write_text("{")
    (folders[3] / ABOUT).unlink()
    (folders[4].with_suffix(".nc")).write_bytes(b"somebody completed it")
    (store / "empty.chains").mkdir()
    found = {entry.path.stem: entry.status for entry in entries() if entry.path.suffix == ".chains"}
    # A folder that says nothing may be one that is just beginning.
    assert found == {folders[1].stem: "outdated", folders[2].stem: "damaged", folders[4].stem: "left over"}
    for folder in (folders[3], store / "empty.chains"):
        for path in (*folder.iterdir(), folder):
            os.utime(path, (time.time() - DAY,) * 2)
    assert run(capsys, "clean", "--quiet")[0] == 0
    assert list(store.iterdir()) == []


def test_chains_kept_before_their_maker_was_recorded_are_outdated(store, log):
    interrupt(log, 3)
    (folder,) = store.glob("*.chains")
    about = json.loads((folder / ABOUT).read_text())
    del about["made_by"]
    (folder / ABOUT).write_text(json.dumps(about))
    assert [entry.status for entry in entries()] == ["outdated"]


def changed_attribute(path, name, content):
    with h5py.File(path, "r+") as file:
        if content is None:
            del file.attrs[name]
        else:
            file.attrs[name] = content


def test_fits_of_unexpected_content_do_not_hide_the_others(full, store, capsys):
    fit, old = full
    names = ("settings", "gate", "provenance", "versions")
    contents = (None, "{", "[]", "7", [1.0], '{"states": "two"}', '{"max_rhat": "low"}')
    for i, name in enumerate(names):
        for j, content in enumerate(contents):
            (store / f"{name}{i}{j}.nc").write_bytes(fit.path.read_bytes())
            changed_attribute(store / f"{name}{i}{j}.nc", name, content)
    (store / "shape.nc").write_bytes(fit.path.read_bytes())
    with h5py.File(store / "shape.nc", "r+") as file:
        del file["posterior/transition"]
        file["posterior/transition"] = 1.0
    status, out, _ = run(capsys, "list", "--json", "-")
    assert status == 0
    found = {entry["key"]: entry["status"] for entry in json.loads(out)["fits"]}
    assert (found[fit.key], found[old.key], found["shape"]) == ("ready", "outdated", "damaged")
    for i, name in enumerate(names):
        for j, content in enumerate(contents):
            # Any JSON may stand in versions, any object in provenance: it is then another version.
            free = name == "versions" or (name == "provenance" and str(content).startswith("{"))
            readable = isinstance(content, str) and content != "{"
            wanted = ("outdated", "damaged") if free and readable else ("damaged",)
            assert found[f"{name}{i}{j}"] in wanted, (name, content)


def test_an_interrupted_run_that_says_nothing_usable_is_listed(store, log, capsys):
    interrupt(log, 3)
    (folder,) = store.glob("*.chains")
    for content in ("[]", "{", '{"states": 2, "engine": "direct"}', '{"states": "two"}'):
        (folder / ABOUT).write_text(content)
        assert run(capsys, "list")[0] == 0
        (entry,) = entries()
        assert (entry.status, entry.about) == ("damaged", {"chains_done": 1})


def test_what_a_killed_write_leaves_is_left_over(store):
    store.mkdir()
    (store / ".key.nc.ab12_x").write_bytes(b"half")
    assert entries() == []
    os.utime(store / ".key.nc.ab12_x", (time.time() - DAY,) * 2)
    assert [(entry.key, entry.status) for entry in entries()] == [("key", "left over")]
