"""Fits on disk: exact round trip, damage found, nothing half written."""

import errno
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from models import posterior_files
from models.bayesian_fit import fit
from models.errors import InputError
from models.nuts import NutsSettings
from models.posterior import TABLES
from models.posterior_files import read_posterior, write_posterior
from tests.models.test_recovery import truth, varied_design


@pytest.fixture(scope="module")
def small():
    rng = np.random.default_rng(2)
    from models.simulation import simulate_responses

    log, _ = simulate_responses(truth(), varied_design(60, 4, rng), rng)
    return fit(log, 2, pins={"no_signal": None}, sampler=NutsSettings(60, 60, 2))


@pytest.fixture
def stored(small, tmp_path):
    path = tmp_path / "fit.nc"
    write_posterior(small, path, {"data": "made here"})
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
    assert [p.name for p in stored.parent.iterdir()] == ["fit.nc"]


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
    with pytest.raises(InputError, match=r"other\.nc, schema: found 'None', wanted 'prosocial-posterior/1'"):
        read_posterior(other)


def test_other_versions_warn_and_are_read(stored, monkeypatch):
    monkeypatch.setattr(posterior_files, "versions", lambda: {"numpy": "99.0"})
    with pytest.warns(UserWarning, match=r"made with other versions: numpy .* \(here 99\.0\)"):
        read_posterior(stored)


def test_a_full_disk_leaves_nothing_behind(small, tmp_path, monkeypatch):
    def full(*args, **kwargs):
        Path(args[1]).write_bytes(b"half")
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(xr.DataTree, "to_netcdf", full)
    with pytest.raises(InputError, match=r"fit\.nc: the fit cannot be written: No space left on device"):
        write_posterior(small, tmp_path / "fit.nc")
    assert list(tmp_path.iterdir()) == []


def test_a_fit_of_a_failed_gate_says_so_after_reading(small, tmp_path):
    failed = replace(small, gate=replace(small.gate, divergences=3))
    write_posterior(failed, tmp_path / "bad.nc")
    gate = read_posterior(tmp_path / "bad.nc").gate
    assert not gate.passed
    assert gate.reasons[0] == "3 divergent transitions, none allowed"
