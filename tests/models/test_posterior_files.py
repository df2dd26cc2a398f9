"""Fits on disk: exact round trip, damage found, nothing half written."""

import errno
import io
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from models import model_files, posterior_files
from models.bayesian_fit import fit
from models.errors import InputError
from models.nuts import NutsSettings
from models.posterior import TABLES
from models.posterior_files import SEALED, read_posterior, write_posterior
from tests.models.test_recovery import truth, varied_design

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def small():
    rng = np.random.default_rng(2)
    from models.simulation import simulate_responses

    log, _ = simulate_responses(truth(), varied_design(60, 4, rng), rng)
    return fit(log, 2, pins={"no_signal": None}, sampler=NutsSettings(60, 60, 2))


@pytest.fixture(scope="module")
def content(small, tmp_path_factory):
    path = tmp_path_factory.mktemp("written") / "fit.nc"
    write_posterior(small, path, {"data": "made here"})
    assert [p.name for p in path.parent.iterdir()] == ["fit.nc"]
    return path.read_bytes()


@pytest.fixture
def stored(content, tmp_path):
    path = tmp_path / "fit.nc"
    path.write_bytes(content)
    return path


def test_round_trip_keeps_every_bit(small, stored):
    back = read_posterior(stored)
    for group in ("posterior", "prior"):
        for name in TABLES:
            assert np.array_equal(back.table(name, group), small.table(name, group))
    assert back.gate == small.gate
    assert back.protocol == small.protocol
    assert back.settings["pins"] == {"no_signal": [[1.0, 0.0], [0.0, 1.0]]}
    assert back.settings["provenance"] == {"data": "made here"}
    assert back.summary().equals(small.summary())


def test_what_is_read_is_what_xarray_reads(stored):
    """Every array with its name, dimensions, order, type and labels; every attribute."""
    back = read_posterior(stored).data
    with xr.open_datatree(stored, engine="h5netcdf") as opened:
        data = opened.load()
    assert back.identical(data)
    assert list(back.children) == list(data.children)
    kinds = set()
    for group in data.children:
        own, other = back[group].to_dataset(), data[group].to_dataset()
        assert list(own.variables) == list(other.variables)
        assert list(own.indexes) == list(other.indexes)
        assert list(own.sizes.items()) == list(other.sizes.items())
        for name, variable in other.variables.items():
            kinds.add(variable.dtype.kind)
            assert own[name].dtype == variable.dtype
            assert own[name].to_numpy().tobytes() == variable.to_numpy().tobytes()
    assert kinds >= set("fiubU")
    assert {k: type(v) for k, v in back.attrs.items()} == {k: type(v) for k, v in data.attrs.items()}


def test_dimensions_without_labels_and_encoded_numbers_are_read_as_xarray_does(tmp_path):
    data = xr.Dataset(
        {"x": (("i", "j"), [[1.0, np.nan], [2.0, 3.0]], {"of": "x", "two": [1, 2]}), "n": ((), 7)},
        coords={"c": ("i", ["é", ""]), "t": ("j", np.array(["2026-01-31", "2026-02-01"], "datetime64[ns]"))},
    )
    tree = xr.DataTree.from_dict(
        {"/": xr.Dataset(attrs={"a": 1.5}), "/g": data, "/g/h": xr.Dataset({"y": ("k", [1])})}
    )
    packed = {"dtype": "int16", "scale_factor": 0.5, "_FillValue": -1}
    tree.to_netcdf(path := tmp_path / "own.nc", engine="h5netcdf", encoding={"/g": {"x": packed}})
    with xr.open_datatree(path, engine="h5netcdf") as opened:
        back = posterior_files._stored(path)
        assert back.identical(opened.load())
        assert back["g"]["x"].dtype == opened["g"]["x"].dtype
    assert np.array_equal(back["g"]["x"], data["x"], equal_nan=True)


def test_an_array_without_dimensions_is_told(stored):
    with h5py.File(stored, "r+") as file:
        file["posterior/plain"] = np.zeros(3)
    with pytest.raises(InputError, match=r"fit\.nc: not a readable netCDF file"):
        read_posterior(stored)


def test_any_changed_value_is_found(stored):
    with xr.open_datatree(stored, engine="h5netcdf") as opened:
        data = opened.load()
    data["posterior"]["initial"].values[0, 3, 0] += 1e-12
    data.to_netcdf(stored, engine="h5netcdf")
    with pytest.raises(InputError, match=r"fit\.nc: damaged or changed: its content does not match its digest"):
        read_posterior(stored)


@pytest.mark.parametrize("cut", [0, 100, 5_000, -1])
def test_a_truncated_file_is_refused(stored, cut):
    stored.write_bytes(stored.read_bytes()[:cut])
    with pytest.raises(InputError, match=r"fit\.nc: (not a readable netCDF file|damaged)"):
        read_posterior(stored)


def test_a_missing_file_and_another_kind_of_netcdf_are_named(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.nc: no such fit"):
        read_posterior(tmp_path / "nowhere.nc")
    other = tmp_path / "other.nc"
    xr.Dataset({"x": ("i", [1.0])}).to_netcdf(other, engine="h5netcdf")
    with pytest.raises(InputError, match=r"other\.nc, schema: found 'None', wanted 'prosocial-posterior/3'"):
        read_posterior(other)


def test_a_file_of_an_older_form_is_refused_and_told_what_to_do(stored):
    with h5py.File(stored, "r+") as file:
        file.attrs["schema"] = "prosocial-posterior/2"
    with pytest.raises(InputError, match=r"schema: found 'prosocial-posterior/2', wanted .*made anew"):
        read_posterior(stored)


def test_times_come_back(small, stored):
    back = read_posterior(stored)
    for name in ("cpu_seconds", "sampling_seconds", "compile_seconds"):
        assert getattr(back, name) == getattr(small, name) >= 0


def test_other_versions_warn_and_are_read(stored, monkeypatch):
    monkeypatch.setattr(posterior_files, "versions", lambda: {"numpy": "99.0"})
    with pytest.warns(UserWarning, match=r"made with other versions: numpy .* \(here 99\.0\)"):
        read_posterior(stored)


def test_a_full_disk_leaves_nothing_behind(small, tmp_path, monkeypatch):
    class Full(io.FileIO):
        def write(self, content):
            super().write(content[:1000])
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(model_files.os, "fdopen", lambda handle, mode: Full(handle, mode))
    with pytest.raises(InputError, match=r"fit\.nc: the fit cannot be written: No space left on device"):
        write_posterior(small, tmp_path / "fit.nc")
    assert list(tmp_path.iterdir()) == []


CUT_SHORT = """
import resource, signal, sys
from pathlib import Path
from models.errors import InputError
from models.posterior_files import read_posterior, write_posterior
fit = read_posterior(sys.argv[1])
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[3]), resource.RLIM_INFINITY))
try:
    write_posterior(fit, Path(sys.argv[2]) / "fit.nc")
except InputError as error:
    print(error)
"""


@pytest.mark.parametrize("before", [None, b"an older fit"])
def test_a_write_the_system_cuts_short_is_told_and_leaves_what_was_there(stored, tmp_path, before):
    folder = tmp_path / "full"
    folder.mkdir()
    if before is not None:
        (folder / "fit.nc").write_bytes(before)
    arguments = [str(stored), str(folder), str(stored.stat().st_size // 2)]
    done = subprocess.run(
        [sys.executable, "-c", CUT_SHORT, *arguments], cwd=ROOT, capture_output=True, text=True, timeout=120
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"{folder / 'fit.nc'}: the fit cannot be written: {os.strerror(errno.EFBIG)}\n"
    assert {p.name: p.read_bytes() for p in folder.iterdir()} == ({} if before is None else {"fit.nc": before})


def test_a_folder_that_cannot_be_made_is_told(small, tmp_path):
    (tmp_path / "taken").write_text("a file")
    with pytest.raises(InputError, match=r"fit\.nc: the fit cannot be written: (File exists|Not a directory)"):
        write_posterior(small, tmp_path / "taken" / "fit.nc")


def test_a_changed_text_label_dimension_or_order_is_found(stored):
    for change in (
        lambda data: data["posterior"].to_dataset().rename(state="row"),
        lambda data: data["posterior"].to_dataset().transpose(..., "chain", "draw"),
        lambda data: data["posterior"].to_dataset().rename(initial="emission", emission="initial"),
    ):
        with xr.open_datatree(stored, engine="h5netcdf") as opened:
            data = opened.load()
        groups = {name: node.to_dataset() for name, node in data.children.items()} | {"posterior": change(data)}
        forged = xr.DataTree.from_dict(groups)
        forged.attrs.update(data.attrs)
        forged.to_netcdf(other := stored.with_name("forged.nc"), engine="h5netcdf")
        with pytest.raises(InputError, match=r"forged\.nc: damaged"):
            read_posterior(other)


def coordinates(data):
    return [(g, str(c)) for g in data.children for c in data[g].to_dataset().coords]


@pytest.mark.slow
def test_every_coordinate_is_covered(stored, small):
    """Two labels of any coordinate swapped: nothing else differs, and the file is refused."""
    wanted = {("posterior", name) for name in ("action", "emission_action")} & set(coordinates(small.data))
    assert wanted, "the tables have named actions"
    for group, name in coordinates(small.data):
        with xr.open_datatree(stored, engine="h5netcdf") as opened:
            data = opened.load()
        dataset = data[group].to_dataset()
        values = dataset[name].to_numpy().copy()
        values[[0, -1]] = values[[-1, 0]]
        if np.array_equal(values, dataset[name].to_numpy()):
            continue
        data[group] = xr.DataTree(dataset.assign_coords({name: (dataset[name].dims, values)}))
        data.to_netcdf(other := stored.with_name("swapped.nc"), engine="h5netcdf")
        with pytest.raises(InputError, match="does not match its digest"):
            read_posterior(other)


def test_an_unchanged_copy_is_accepted(stored):
    """The way the tests above forge files does not by itself break them."""
    with xr.open_datatree(stored, engine="h5netcdf") as opened:
        data = opened.load()
    dataset = data["posterior"].to_dataset()
    data["posterior"] = xr.DataTree(
        dataset.assign_coords({c: (dataset[c].dims, dataset[c].to_numpy()) for c in dataset.coords})
    )
    data.to_netcdf(other := stored.with_name("copy.nc"), engine="h5netcdf")
    read_posterior(other)


ATTRIBUTES = (*SEALED, "versions", "provenance", "content_digest")


@pytest.mark.parametrize("name", ATTRIBUTES)
def test_a_removed_attribute_is_named(stored, name):
    with h5py.File(stored, "r+") as file:
        del file.attrs[name]
    with pytest.raises(InputError, match=rf"fit\.nc: damaged: attribute {name} is missing"):
        read_posterior(stored)


@pytest.mark.parametrize("text", ["{", "7", "[1, {}]", [1.0, 2.0]])
@pytest.mark.parametrize("name", ATTRIBUTES)
def test_a_malformed_attribute_is_damage(stored, name, text):
    with h5py.File(stored, "r+") as file:
        file.attrs[name] = text
    with pytest.raises(InputError, match=rf"fit\.nc: damaged(: attribute {name} cannot| or changed)"):
        read_posterior(stored)


@pytest.mark.parametrize(
    ("name", "key", "value"),
    [("gate", "divergences", 17), ("gate", "max_rhat", 1.0), ("settings", "engine", "other"),
     ("settings", "states", 3), ("protocol", "name", "another")],
)  # fmt: skip
def test_a_forged_attribute_is_found(stored, name, key, value):
    with h5py.File(stored, "r+") as file:
        file.attrs[name] = json.dumps({**json.loads(file.attrs[name]), key: value})
    with pytest.raises(InputError, match="damaged or changed: its content does not match its digest"):
        read_posterior(stored)


@pytest.mark.parametrize("name", ["cpu_seconds", "sampling_seconds", "compile_seconds"])
def test_a_forged_time_is_found(stored, name):
    with h5py.File(stored, "r+") as file:
        file.attrs[name] = file.attrs[name] / 2
    with pytest.raises(InputError, match="does not match its digest"):
        read_posterior(stored)


def test_provenance_is_not_sealed(stored):
    with h5py.File(stored, "r+") as file:
        file.attrs["provenance"] = json.dumps({"data": "renamed"})
    assert read_posterior(stored).settings["provenance"] == {"data": "renamed"}


def test_settings_of_another_number_of_states_are_refused(small, tmp_path):
    """A consistent digest does not make three states of two."""
    write_posterior(replace(small, settings={**small.settings, "states": 3}), tmp_path / "odd.nc")
    with pytest.raises(InputError, match=r"odd\.nc: damaged: attribute settings, states: found 3, wanted 2"):
        read_posterior(tmp_path / "odd.nc")
    without = {k: v for k, v in small.settings.items() if k != "states"}
    write_posterior(replace(small, settings=without), tmp_path / "odd.nc")
    with pytest.raises(InputError, match=r"odd\.nc: damaged: attribute settings lacks 'states'"):
        read_posterior(tmp_path / "odd.nc")


@pytest.mark.parametrize("group", ["posterior", "prior"])
def test_tables_of_text_are_refused(small, tmp_path, group):
    """A consistent digest does not make numbers of text."""
    data = small.data.copy()
    own = data[group].to_dataset()
    data[group] = xr.DataTree(own.assign(emission=own["emission"].astype(str)))
    write_posterior(replace(small, data=data), tmp_path / "odd.nc")
    with pytest.raises(InputError, match=rf"odd\.nc: damaged: {group}, emission: found '<U\d+', wanted numbers"):
        read_posterior(tmp_path / "odd.nc")


def test_a_fit_of_a_failed_gate_says_so_after_reading(small, tmp_path):
    failed = replace(small, gate=replace(small.gate, divergences=3))
    write_posterior(failed, tmp_path / "bad.nc")
    gate = read_posterior(tmp_path / "bad.nc").gate
    assert not gate.passed
    assert gate.reasons[0] == "3 divergent transitions, none allowed"


def test_a_package_that_is_absent_is_said_to_be(small, tmp_path, monkeypatch):
    found = posterior_files.metadata.version

    def without(name):
        if name == "nutpie":
            raise posterior_files.metadata.PackageNotFoundError(name)
        return found(name)

    with_it = posterior_files.versions()
    monkeypatch.setattr(posterior_files.metadata, "version", without)
    assert posterior_files.versions() == {**with_it, "nutpie": "not installed"}
    write_posterior(small, tmp_path / "fit.nc")
    read_posterior(tmp_path / "fit.nc")
    monkeypatch.undo()
    with pytest.warns(UserWarning, match="made with other versions: nutpie not installed"):
        read_posterior(tmp_path / "fit.nc")
