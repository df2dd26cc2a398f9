"""Posterior files: one netCDF a fit, checked for content and schema when read.

Only data are read back: no pickle, no code. A file written by other package versions is read with a warning;
a file whose content does not match its digest is refused.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
import warnings
from collections.abc import Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from models.errors import InputError, located
from models.gate import Gate
from models.posterior import TABLES, Posterior
from models.protocol import Protocol

SCHEMA = "prosocial-posterior/1"
PACKAGES = ("numpy", "numba", "pymc", "nutpie", "arviz", "xarray")


def versions() -> dict[str, str]:
    """Versions of the packages a fit depends on."""
    return {name: metadata.version(name) for name in PACKAGES}


def content_digest(data: xr.DataTree) -> str:
    """SHA-256 over the arrays of every group, by name, shape and bytes."""
    digest = hashlib.sha256()
    for group in sorted(data.children):
        dataset = data[group].to_dataset()
        for name in sorted(str(v) for v in dataset.data_vars):
            values = np.ascontiguousarray(dataset[name].to_numpy())
            little = values.astype(values.dtype.newbyteorder("<"), copy=False)
            digest.update(f"{group}/{name} {little.dtype.str} {little.shape}\n".encode() + little.tobytes())
    return digest.hexdigest()


def write_posterior(fit: Posterior, path: str | Path, provenance: Mapping[str, Any] | None = None) -> None:
    """Write a fit beside its place and rename it, so that a full disk or an interruption leaves no half file.

    Raises
    ------
    InputError
        If the file cannot be written (no such folder allowed, disk full, no permission).
    """
    path = Path(path)
    attributes = {
        "schema": SCHEMA,
        "content_digest": content_digest(fit.data),
        "protocol": json.dumps(fit.protocol.to_dict()),
        "gate": json.dumps(vars(fit.gate)),
        "settings": json.dumps(dict(fit.settings)),
        "emission_weights": json.dumps(fit.emission_weights.tolist()),
        "cpu_seconds": float(fit.cpu_seconds),
        "sampling_seconds": float(fit.sampling_seconds),
        "versions": json.dumps(versions()),
        "provenance": json.dumps(dict(provenance or {})),
    }
    beside = ""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, beside = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.", suffix=".nc")
        os.close(handle)
        data = fit.data.copy()
        data.attrs.update(attributes)
        encoding = {
            f"/{group}": {str(v): {"zlib": True, "complevel": 1} for v in data[group].to_dataset().data_vars}
            for group in data.children
        }
        data.to_netcdf(beside, engine="h5netcdf", encoding=encoding)
        Path(beside).chmod(0o644)
        Path(beside).replace(path)
    except OSError as error:
        raise InputError(f"{path}: the fit cannot be written: {error.strerror or error}") from None
    finally:
        if beside:
            Path(beside).unlink(missing_ok=True)


def read_posterior(path: str | Path) -> Posterior:
    """Read a fit back.

    Raises
    ------
    InputError
        If there is no such file, it is not a fit of this schema, or its content was changed or damaged.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such fit")
    try:
        with xr.open_datatree(path, engine="h5netcdf") as stored:
            data = stored.load()
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        raise InputError(f"{path}: not a readable netCDF file ({_short(error)})") from None
    attributes = data.attrs
    if attributes.get("schema") != SCHEMA:
        raise located(f"{path}, schema", str(attributes.get("schema")), f"{SCHEMA!r}: a fit of `prosocial bayes`")
    try:
        found = content_digest(data)
        missing = [name for name in TABLES if name not in data["posterior"].to_dataset()]
    except (KeyError, OSError) as error:
        raise InputError(f"{path}: damaged, a group is missing ({_short(error)})") from None
    if missing or found != attributes["content_digest"]:
        raise InputError(f"{path}: damaged or changed: its content does not match its digest")
    own, stored_versions = versions(), json.loads(attributes["versions"])
    other = [f"{k} {stored_versions.get(k)} (here {v})" for k, v in own.items() if stored_versions.get(k) != v]
    if other:
        warnings.warn(f"{path} was made with other versions: {', '.join(other)}", stacklevel=2)
    return Posterior(
        data,
        Protocol.from_dict(json.loads(attributes["protocol"]), f"{path}, protocol"),
        Gate(**json.loads(attributes["gate"])),
        {**json.loads(attributes["settings"]), "provenance": json.loads(attributes["provenance"])},
        np.array(json.loads(attributes["emission_weights"])),
        float(attributes["cpu_seconds"]),
        float(attributes["sampling_seconds"]),
    )


def _short(error: Exception) -> str:
    return str(error).splitlines()[0][:120] if str(error) else type(error).__name__
