"""Damage to files whose bytes are a library's: Parquet, netCDF, archives of arrays, sealed JSON lines."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import xarray as xr

from models.game.record import content_digest as record_digest
from models.posterior_files import content_digest
from models.safeguards.audit import ROOT, sealed
from tests.fuzz.mutations import VALUES, changed, some_bytes

_COLUMNS: tuple[Any, ...] = (
    pa.int8(), pa.uint64(), pa.float16(), pa.float64(), pa.bool_(), pa.string(), pa.large_string(), pa.binary(),
    pa.null(), pa.date32(), pa.timestamp("ns", "UTC"), pa.decimal128(20, 3), pa.list_(pa.int64()),
    pa.struct([("a", pa.int64())]), pa.dictionary(pa.int8(), pa.string()), pa.dictionary(pa.int32(), pa.int64()),
    pa.string_view(), pa.duration("s"), pa.time64("us"),
)  # fmt: skip


def some_parquet(content: bytes, others: Sequence[bytes], rng: Random) -> bytes:
    """Another type, other values, other names; or other bytes."""
    if rng.random() < 0.35:
        return some_bytes(content, others, rng)
    try:
        table = pq.read_table(pa.BufferReader(content))
    except (pa.ArrowException, OSError):
        return some_bytes(content, others, rng)
    for _ in range(rng.choice((1, 1, 2))):
        at = rng.randrange(table.num_columns)
        name, column = table.column_names[at], table.column(at)
        match rng.randrange(6):
            case 0:
                table = table.append_column(rng.choice((name, "", "x", "\x1b[2J")), column)
            case 1 if table.num_columns > 1:
                table = table.remove_column(at)
            case 2:
                table = table.slice(0, rng.choice((0, 1)))
            case 3:
                table = pa.concat_tables([table] * 3)
            case _:
                kind = rng.choice(_COLUMNS)
                own = _cast(column, kind, rng)
                table = table.set_column(at, name, own)
    sink = io.BytesIO()
    try:
        settings = {
            "compression": rng.choice(("none", "zstd", "gzip", "snappy")),
            "use_dictionary": rng.random() < 0.5,
        }
        pq.write_table(table, sink, row_group_size=rng.choice((1, 1000)), **settings)
    except (pa.ArrowException, OSError, ValueError):
        return some_bytes(content, others, rng)
    return sink.getvalue()


def _cast(column: Any, kind: Any, rng: Random) -> Any:
    rows = len(column)
    if rng.random() < 0.5:
        try:
            return column.cast(kind)
        except (pa.ArrowException, ValueError):
            pass
    for values in ([rng.choice((None, -1, 2**40, "\x1b[2J", float("nan")))] * rows, [None] * rows):
        try:
            return pa.array(values, type=kind)
        except (pa.ArrowException, TypeError, ValueError, OverflowError):
            continue
    return pa.nulls(rows)


def some_netcdf(content: bytes, others: Sequence[bytes], rng: Random) -> bytes:
    """What a fit says of itself changed, its arrays changed, with a digest that fits again; or other bytes."""
    how = rng.randrange(10)
    if how < 3:
        return some_bytes(content, others, rng)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "own.nc"
        path.write_bytes(rng.choice(others) if rng.random() < 0.1 else content)
        try:
            if how < 8:
                _fit_changed(path, rng)
            else:
                _file_changed(path, rng)
        except Exception:
            return some_bytes(content, others, rng)
        return path.read_bytes()


def _fit_changed(path: Path, rng: Random) -> None:
    with xr.open_datatree(path, engine="h5netcdf") as stored:
        data = stored.load()
    attributes = dict(data.attrs)
    name = rng.choice([k for k in attributes if k != "content_digest"])
    value = attributes[name]
    if rng.random() < 0.3:
        groups = [g for g in data.children if data[g].to_dataset().data_vars]
        group = rng.choice(groups)
        own = data[group].to_dataset().copy(deep=True)
        variable = rng.choice([str(v) for v in own.data_vars])
        match rng.randrange(5):
            case 0:
                own = own.drop_vars(variable)
            case 1:
                own = own.isel({rng.choice([str(d) for d in own.dims]): slice(0, rng.choice((0, 1)))})
            case 2 if own[variable].dtype.kind == "f":
                own[variable] = own[variable] * rng.choice((np.nan, np.inf, -1.0, 1e300, 2.0))
            case 3:
                own[variable] = own[variable].astype(rng.choice(("int8", "float32", "str", "bool")))
            case _:
                own = own.rename({variable: rng.choice(("x", "initial", "transition"))})
        data[group] = xr.DataTree(own)
    elif isinstance(value, str):
        try:
            attributes[name] = json.dumps(changed(json.loads(value), rng))
        except ValueError:
            attributes[name] = rng.choice(("", "x", "[" * 2000))
    else:
        attributes[name] = rng.choice((0, -1.0, float("nan"), "x", np.array([1, 2]), np.array([], dtype=float)))
    with suppress(TypeError, ValueError, KeyError):
        attributes["content_digest"] = content_digest(data, attributes)
    data.attrs.update(attributes)
    data.to_netcdf(path, engine="h5netcdf")


def _file_changed(path: Path, rng: Random) -> None:
    with h5py.File(path, "r+") as file:
        match rng.randrange(7):
            case 0:
                file[rng.choice(("extra", "posterior/extra"))] = h5py.ExternalLink("/etc/passwd", "/x")
            case 1:
                file["again"] = h5py.SoftLink(rng.choice(("/", "/nowhere", "/again")))
            case 2:
                file["round"] = file["/"]  # a group within itself
            case 3:
                file.create_dataset("posterior/large", shape=(10**6, 10**6), dtype="f8", chunks=(1000, 1000))
            case 4:
                del file[rng.choice(list(file))]
            case 5:
                file.create_dataset("posterior/text", data=np.array([b"\xff\xfe"], dtype="S2"))
            case _:
                del file.attrs[rng.choice(list(file.attrs))]


def some_arrays(content: bytes, others: Sequence[bytes], rng: Random) -> bytes:
    """Members of an archive of arrays changed, dropped, doubled or with another head; or other bytes."""
    if rng.random() < 0.4:
        return some_bytes(content, others, rng)
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            members = {name: archive.read(name) for name in archive.namelist()}
    except Exception:
        return some_bytes(content, others, rng)
    name = rng.choice(list(members))
    match rng.randrange(5):
        case 0:
            del members[name]
        case 1:
            members[name] = _head(rng)
        case 2:
            members[name] = members[rng.choice(list(members))]
        case 3:
            members["../../x.npy"] = members[name]
        case _:
            members[name] = some_bytes(members[name], list(members.values()), rng)
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", rng.choice((zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED))) as archive:
        for own, bytes_ in members.items():
            archive.writestr(own, bytes_)
    return sink.getvalue()


def _head(rng: Random) -> bytes:
    """An array's file with a head that promises anything."""
    shape = rng.choice(("()", "(1,)", "(10**15,)", "(1000000000000,)", "(-1,)", "(0,)", "(3, 3)"))
    kind = rng.choice(("'<f8'", "'|O'", "'<U5'", "'|V8'", "[('a', '<f8')]", "'<i8'"))
    head = f"{{'descr': {kind}, 'fortran_order': False, 'shape': {shape}, }}".ljust(117) + "\n"
    return b"\x93NUMPY\x01\x00" + len(head).to_bytes(2, "little") + head.encode() + b"\0" * rng.choice((0, 8, 64))


def some_record(content: bytes, others: Sequence[bytes], rng: Random) -> bytes:
    """A round's record changed in one place, sometimes with a digest that fits again."""
    try:
        value = changed(json.loads(content), rng)
        if isinstance(value, dict) and rng.random() < 0.8:
            value["digest"] = record_digest(value)
        return json.dumps(value).encode()
    except (ValueError, RecursionError):
        return content


def some_log(content: bytes, others: Sequence[bytes], rng: Random) -> bytes:
    """A session's log changed in one place, with hashes that fit again."""
    if rng.random() < 0.2:
        return some_bytes(content, others, rng)
    try:
        entries = [json.loads(line) for line in content.splitlines()]
        for _ in range(rng.choice((1, 1, 2))):
            at = rng.randrange(len(entries))
            match rng.randrange(6):
                case 0:
                    del entries[at]
                case 1:
                    entries.insert(at, dict(entries[at]))
                case 2:
                    entries[at]["time"] = rng.choice(VALUES)
                case _:
                    entries[at] = changed(entries[at], rng)
        previous, out = ROOT, b""
        for n, entry in enumerate(entries):
            own = {"n": n, **{k: v for k, v in entry.items() if k not in ("n", "hash")}}
            line, previous = sealed(previous, own)
            out += line
        return out
    except (ValueError, TypeError, AttributeError, KeyError, IndexError, RecursionError):
        return some_bytes(content, others, rng)
