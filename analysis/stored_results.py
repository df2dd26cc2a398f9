"""Results found again by what determined them: everything a report computes that costs more than a second.

Beside the posteriors (`analysis.fits`), in the same folder, one file a result. Its key is a digest of the function,
of the content of all its arguments, of all source code that the function reaches, and of versions. What is returned
is always what the file holds, whether it was computed now or before, so the first run and all later ones agree.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import platform
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from analysis import fits
from analysis.array_archive import read_arrays
from analysis.kept_chains import NotKeptWarning
from analysis.result_content import Given, Node, NotContent, name_of, to_content
from analysis.result_reading import from_content
from analysis.source_digest import source_digest
from models.file_lock import alone
from models.model_files import write_bytes

SCHEMA = "prosocial-result/1"
SUFFIX = ".npz"

PACKAGES = (
    "numpy", "scipy", "pandas", "numba", "statsmodels", "xarray", "arviz", "pymc", "nutpie", "matplotlib",
)  # fmt: skip
"""Versions that a result may depend on."""

DETERMINE_NOTHING = ("progress", "executor")
"""Arguments that say how something is computed, and not what."""

MOST_BYTES = 1_500_000_000
"""Results beyond this are cleared away, those first that were not used for longest."""

UNREADABLE = (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile, UnicodeDecodeError)
"""What reading a damaged result raises."""


@dataclass(frozen=True)
class StoredResult[R]:
    """A result and where it came from.

    Attributes
    ----------
    value : object
    what : str
        In words.
    path : Path or None
        None if it cannot be kept.
    reused : bool
        Whether it was found rather than computed.
    """

    value: R
    what: str
    path: Path | None
    reused: bool


def stored_result[**P, R](
    what: str, function: Callable[P, R], *args: P.args, **keywords: P.kwargs
) -> StoredResult[R]:
    """Find what a function returns in the store, or compute and keep it.

    Parameters
    ----------
    what : str
        The result in words, for lists and progress.
    function : callable
        Of a module of this checkout, deterministic: whatever it needs besides its arguments is in the source code
        that its module reaches.
    *args, **keywords
        Its arguments; those in `DETERMINE_NOTHING` do not count.

    Warns
    -----
    NotKeptWarning
        If a result in the store is damaged (it is computed anew), the store cannot be written, or an argument or
        the result has no content (`analysis.result_content`). Warnings of the function itself are told when it
        runs, not when its result is found.
    """
    counted = {name: value for name, value in keywords.items() if name not in DETERMINE_NOTHING}
    return found_or_made(what, lambda: function(*args, **keywords), function, {"args": args, **counted})


def found_or_made[R](
    what: str,
    make: Callable[[], R],
    function: Callable[..., Any],
    given: Mapping[str, Any],
    *,
    modules: Iterable[str] = (),
    kind: str = "result",
) -> StoredResult[R]:
    """As `stored_result`, where what determines a result is not the arguments of one function.

    Parameters
    ----------
    what : str
    make : callable
        Computes it.
    function : callable
        Names the computation; all source code that its module reaches counts.
    given : mapping
        Everything else that determines the result.
    modules : iterable of str
        Further modules whose source code counts.
    kind : str
        ``result`` or ``drawing``.
    """
    try:
        source = Given(dict(given))
        named: dict[str, Any] = {"function": name_of(function, "function"), "given": source.digest, "kind": kind}
    except NotContent as error:
        return StoredResult(_not_kept(what, kind, error, make()), what, None, False)
    named["made_by"] = made_by(*sorted({function.__module__, *modules, *source.modules}))
    key = hashlib.sha256(json.dumps(named, sort_keys=True).encode()).hexdigest()[:24]
    path = fits.store_folder() / f"{key}{SUFFIX}"
    # Another process may be making it now: then it is waited for, and found.
    with nullcontext() if path.is_file() else alone(path):
        if path.is_file():
            try:
                value = read_result(path, source)
            except UNREADABLE as error:
                reason = str(error).splitlines()[0][:120] if str(error) else type(error).__name__
                warnings.warn(
                    f"{path}: damaged ({reason}); computed anew in its place", NotKeptWarning, stacklevel=3
                )
            else:
                with suppress(OSError):
                    os.utime(path)  # what is used stays longest
                return StoredResult(value, what, path, True)
        return _made(what, make(), path, source, named)


def _made[R](what: str, made: R, path: Path, source: Given, named: Mapping[str, Any]) -> StoredResult[R]:
    """Keep what was computed."""
    try:
        content, arrays = to_content(made, source)
    except NotContent as error:
        return StoredResult(_not_kept(what, named["kind"], error, made), what, None, False)
    # Not what was computed but what is written of it, so that no later run can differ from this one.
    value = from_content(json.loads(json.dumps(content)), arrays, source)
    about = {"schema": SCHEMA, "what": what, **named}
    whole = _file(about, content, arrays)
    try:
        write_bytes(path, whole)
    except OSError as error:
        warnings.warn(
            f"{path}: cannot be written ({error.strerror or error}); the result is not in the store",
            NotKeptWarning, stacklevel=4,
        )  # fmt: skip
    else:
        _make_room(len(whole))
    return StoredResult(value, what, path, False)


def _not_kept[R](what: str, kind: str, error: NotContent, made: R) -> R:
    """Tell what cannot be kept, and why: it costs time only. A drawing by a nameless function is nothing amiss."""
    if kind != "drawing":
        warnings.warn(f"{what}: cannot be kept ({error})", NotKeptWarning, stacklevel=4)
    return made


def made_by(*modules: str) -> dict[str, Any]:
    """What code and which versions make results of modules now: those of another maker are never found again."""
    return {
        "modules": list(modules), "code": source_digest(*modules), "versions": dict(_versions()), "schema": SCHEMA
    }  # fmt: skip


@cache
def _versions() -> Mapping[str, str]:
    out = {"python": platform.python_version(), "machine": platform.machine()}
    for name in PACKAGES:
        with suppress(metadata.PackageNotFoundError):
            out[name] = metadata.version(name)
    return out


def _seal(about: str, content: str, arrays: Sequence[np.ndarray]) -> str:
    digest = hashlib.sha256(json.dumps([about, content]).encode())
    for array in arrays:
        digest.update(json.dumps([array.dtype.str, list(array.shape)]).encode() + np.ascontiguousarray(array).data)
    return digest.hexdigest()


def _file(about: Mapping[str, Any], content: Node, arrays: Sequence[np.ndarray]) -> bytes:
    texts = json.dumps(about), json.dumps(content, separators=(",", ":"))
    named = dict(zip(("about", "content"), (np.frombuffer(t.encode(), np.uint8) for t in texts), strict=True))
    named["seal"] = np.frombuffer(_seal(*texts, arrays).encode(), np.uint8)
    buffer = io.BytesIO()
    np.savez(buffer, **named, **{f"array_{i}": array for i, array in enumerate(arrays)})  # type: ignore[arg-type]
    return buffer.getvalue()


def read_result(path: Path, given: Given) -> Any:
    """Read a result back.

    Raises
    ------
    OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile
        If it is damaged.
    """
    file = read_arrays(path)
    about, content, seal = (file[name].tobytes().decode() for name in ("about", "content", "seal"))
    arrays = [file[f"array_{i}"] for i in range(len(file) - 3)]
    if _seal(about, content, arrays) != seal:
        raise ValueError("its content does not match its digest")
    return from_content(json.loads(content), arrays, given)


def read_about(path: Path) -> dict[str, Any]:
    """What a stored result says of itself: ``schema, what, function, given, kind, made_by``.

    Raises
    ------
    As `read_result`.
    """
    about = json.loads(read_arrays(path, ("about",))["about"].tobytes())
    if not isinstance(about, dict) or not all(isinstance(about[k], str) for k in ("what", "kind", "function")):
        raise ValueError("it does not say what it is")
    return about


_since_cleared = MOST_BYTES


def _make_room(written: int) -> None:
    """Clear away results that were not used for longest, once in a while."""
    global _since_cleared
    _since_cleared += written
    if _since_cleared < MOST_BYTES / 20:
        return
    _since_cleared = 0
    folder, found = fits.store_folder(), []
    with suppress(OSError), os.scandir(folder) as entries:
        found = [(e.stat().st_mtime, e.stat().st_size, e.path) for e in entries if _is_result(e)]
    total = sum(size for _, size, _ in found)
    for _, size, path in sorted(found):
        if total <= MOST_BYTES:
            return
        with suppress(OSError):
            Path(path).unlink()
            total -= size


def _is_result(entry: os.DirEntry[str]) -> bool:
    return entry.name.endswith(SUFFIX) and not entry.name.startswith(".") and entry.is_file(follow_symlinks=False)
