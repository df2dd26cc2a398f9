"""Posterior files: one netCDF a fit, checked for content and schema when read.

Only data are read back: no pickle, no code. A file written by other package versions is read with a warning;
a file whose content (arrays, labels, dimensions, or what it says of itself) does not match its digest is refused.
The digest is no signature: it finds damage and careless changes, not somebody who computes it anew.
"""

from __future__ import annotations

import hashlib
import json
import warnings
from collections.abc import Callable, Mapping
from importlib import metadata
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import xarray as xr

from models.errors import InputError, located
from models.gate import Gate
from models.hdf5_check import check_hdf5
from models.model_files import write_bytes
from models.posterior import TABLES, Posterior
from models.protocol import Protocol

SCHEMA = "prosocial-posterior/3"
A_FIT = "a fit of `prosocial bayes` of this version (one that an older version wrote has to be made anew)"
PACKAGES = ("numpy", "numba", "pymc", "nutpie", "arviz", "xarray")

ABSENT = "not installed"
"""In place of a version."""

SECONDS = ("cpu_seconds", "sampling_seconds", "compile_seconds")
SEALED = ("protocol", "gate", "settings", "emission_weights", *SECONDS)
"""Attributes the digest covers: all but the versions and the provenance, which determine no number."""

OF_THE_FORMAT = frozenset((
    "CLASS", "NAME", "DIMENSION_LIST", "REFERENCE_LIST", "_NCProperties", "_Netcdf4Coordinates", "_Netcdf4Dimid",
))  # fmt: skip
"""Attributes by which netCDF tells the dimensions of an array."""

NO_VARIABLE = b"This is a netCDF dimension but not a netCDF variable"
"""How the name of an array begins that is there only for the length of a dimension."""


def versions() -> dict[str, str]:
    """Versions of the packages a fit depends on; a fit can be made without some of them."""
    return {name: _version(name) for name in PACKAGES}


def _version(name: str) -> str:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return ABSENT


def content_digest(data: xr.DataTree, attributes: Mapping[str, Any]) -> str:
    """SHA-256 over the arrays and coordinates of every group and the attributes in `SEALED`.

    Parameters
    ----------
    data : xarray.DataTree
        Every variable counts with its name, dimensions, shape and values; text as UTF-8, numbers as little-endian
        bytes.
    attributes : mapping
        With the names in `SEALED`: JSON texts and numbers.
    """
    digest = hashlib.sha256()
    for group in sorted(data.children):
        dataset = data[group].to_dataset()
        for name in sorted(str(v) for v in dataset.variables):
            values = np.ascontiguousarray(dataset[name].to_numpy())
            if values.dtype.kind in "OUST":  # text comes back from a file as another type of text
                kind, content = "text", json.dumps(values.astype(str).ravel().tolist()).encode()
            else:
                little = values.astype(values.dtype.newbyteorder("<"), copy=False)
                kind, content = little.dtype.str, little.tobytes()
            head = [group, name, list(map(str, dataset[name].dims)), list(values.shape), kind]
            digest.update(f"{json.dumps(head)}\n".encode() + content)
    for name in SEALED:
        value = attributes[name]
        content = json.dumps([name, value if isinstance(value, str) else float(value)]).encode()
        digest.update(b"\n" + content)
    return digest.hexdigest()


def write_posterior(fit: Posterior, path: str | Path, provenance: Mapping[str, Any] | None = None) -> None:
    """Write a fit beside its place and rename it, so that a full disk or an interruption leaves no half file.

    The file is built in memory: the HDF5 library does not survive a disk that fills up while it writes.

    Raises
    ------
    InputError
        If the file cannot be written (no such folder allowed, disk full, no permission).
    """
    path = Path(path)
    attributes = {
        "schema": SCHEMA,
        "protocol": json.dumps(fit.protocol.to_dict()),
        "gate": json.dumps(vars(fit.gate)),
        "settings": json.dumps(dict(fit.settings)),
        "emission_weights": json.dumps(fit.emission_weights.tolist()),
        **{name: float(getattr(fit, name)) for name in SECONDS},
        "versions": json.dumps(versions()),
        "provenance": json.dumps(dict(provenance or {})),
    }
    attributes["content_digest"] = content_digest(fit.data, attributes)
    data = fit.data.copy()
    data.attrs.update(attributes)
    encoding = {
        f"/{group}": {str(v): {"zlib": True, "complevel": 1} for v in data[group].to_dataset().data_vars}
        for group in data.children
    }
    try:
        write_bytes(path, data.to_netcdf(None, engine="h5netcdf", encoding=encoding))
    except OSError as error:
        raise InputError(f"{path}: the fit cannot be written: {error.strerror or error}") from None


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
        check_hdf5(path)
        data = _stored(path)
    except InputError:
        raise
    except (OSError, ValueError, KeyError, IndexError, TypeError, AttributeError, RuntimeError) as error:
        raise InputError(f"{path}: not a readable netCDF file ({_short(error)})") from None
    attributes = {str(name): value for name, value in data.attrs.items()}
    if str(attributes.get("schema")) != SCHEMA:
        raise located(f"{path}, schema", str(attributes.get("schema")), f"{SCHEMA!r}: {A_FIT}")

    def stored_as[T](name: str, build: Callable[[Any], T]) -> T:
        """What an attribute says; whatever is wrong with it is damage, told with its name."""
        try:
            return build(attributes[name])
        except KeyError as error:
            reason = "is missing" if name not in attributes else f"lacks {_short(error)}"
        except (TypeError, ValueError, AttributeError, RecursionError) as error:
            reason = f"cannot be read ({_short(error)})"
        raise InputError(f"{path}: damaged: attribute {name} {reason}")

    protocol = stored_as("protocol", lambda text: Protocol.from_dict(json.loads(text), "protocol"))
    gate = stored_as("gate", _gate)
    settings = stored_as("settings", _mapping)
    states = stored_as("settings", lambda text: _mapping(text)["states"])
    weights = stored_as("emission_weights", lambda text: np.array(json.loads(text), dtype=np.float64))
    seconds = [stored_as(name, float) for name in SECONDS]
    provenance, stored_versions = stored_as("provenance", _mapping), stored_as("versions", _mapping)
    digest = stored_as("content_digest", str)
    try:
        found = content_digest(data, attributes)
        posterior = data["posterior"].to_dataset()
        missing = [name for name in TABLES if name not in posterior]
        held = posterior.sizes["state"]
    except (KeyError, OSError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: damaged, a group is missing ({_short(error)})") from None
    if missing or found != digest:
        raise InputError(f"{path}: damaged or changed: its content does not match its digest")
    for group, node in data.children.items():
        for name, values in node.data_vars.items():
            if values.dtype.kind not in "biuf":  # a digest that fits does not make numbers of text
                raise located(f"{path}: damaged: {group}, {name}", str(values.dtype), "numbers")
    if states != held:
        raise located(f"{path}: damaged: attribute settings, states", states, f"{held}, as many as its tables have")
    own = versions()
    other = [f"{k} {stored_versions.get(k)} (here {v})" for k, v in own.items() if stored_versions.get(k) != v]
    if other:
        warnings.warn(f"{path} was made with other versions: {', '.join(other)}", stacklevel=2)
    settings = {**settings, "provenance": provenance}
    return Posterior(data, protocol, gate, settings, weights, *seconds)


def _stored(path: Path) -> xr.DataTree:
    """Every group, in memory; what `xarray.open_datatree` finds, which looks each array up dozens of times."""
    groups, left = {}, ["/"]
    with h5py.File(path, "r") as file:
        while left:
            name = left.pop(0)
            variables = {}
            for own, found in file[name].items():
                if isinstance(found, h5py.Group):
                    left.append(f"{name.rstrip('/')}/{own}")
                elif not found.attrs.get("NAME", b"").startswith(NO_VARIABLE):
                    variables[own] = _variable(own, found)
            groups[name] = xr.decode_cf(xr.Dataset(variables, attrs=_attributes(file[name])))
    return xr.DataTree.from_dict(groups).load()


def _variable(name: str, found: h5py.Dataset) -> xr.Variable:
    """An array with its dimensions, which are named after the scales of its axes."""
    if "DIMENSION_LIST" in found.attrs:
        scales = [h5py.h5r.get_name(axis[0], found.id).decode() for axis in found.attrs["DIMENSION_LIST"]]
        dims = [scale.rsplit("/", 1)[-1] for scale in scales]
    else:
        dims = [name] if "CLASS" in found.attrs else []
    if h5py.check_string_dtype(found.dtype):
        return xr.Variable(dims, found.asstr()[()], _attributes(found), {"dtype": str})
    return xr.Variable(dims, found[()], _attributes(found))


def _attributes(found: h5py.Group | h5py.Dataset) -> dict[str, Any]:
    """Attributes without those of the format; numbers are kept as arrays of one."""
    out = {}
    for name, value in found.attrs.items():
        if name not in OF_THE_FORMAT:
            value = value.decode() if isinstance(value, bytes) else value
            out[name] = value[0] if isinstance(value, np.ndarray) and value.shape == (1,) else value
    return out


def _gate(text: Any) -> Gate:
    """Diagnostics, all numbers where numbers are wanted."""
    content = _mapping(text)
    for name, value in content.items():
        kind = str if name.startswith("worst") else int | float | None
        if not isinstance(value, kind) or isinstance(value, bool):
            raise TypeError(f"{name} of type {type(value).__name__}")
    gate = Gate(**content)
    gate.reasons  # noqa: B018 - whatever they cannot be told from is damage
    return gate


def _mapping(text: Any) -> dict[str, Any]:
    content = json.loads(text)
    if not isinstance(content, dict):
        raise TypeError(f"a JSON object was wanted, not {type(content).__name__}")
    return content


def _short(error: Exception) -> str:
    return str(error).splitlines()[0][:120] if str(error) else type(error).__name__
