"""The one decorator for compiled kernels.

numba's on-disk cache does not notice when a kernel *called by* a cached kernel changes: the caller keeps
the old machine code. So the cache folder of a file carries a digest of every compiled source that the file
reaches through imports: editing a kernel starts a fresh cache for it and for all that may call it, and leaves
the others alone. The same digest says whether stored evidence was made by the present kernels.

A cache saves time and is no reason to fail: where it cannot be written (disk full, no permission) kernels, and what
PyTensor compiles with numba, run as they are, and one warning a process says so.
"""

from __future__ import annotations

import errno
import hashlib
import os
import re
import stat
import tempfile
import threading
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import cache, wraps
from pathlib import Path
from typing import Any

import numba
from numba.core.caching import Cache

_HERE = Path(__file__).resolve().parent

_FOLDER_LOCK = threading.RLock()

SETTINGS: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
"""How every kernel is compiled; fast-math is off, so sums keep their order and results are the same bit for bit."""

# Every import statement of the house is absolute (a test sees to it), so lines of text are enough: parsing all
# sources would cost each command more than the rest of its start.
_IMPORT = re.compile(r"^[ \t]*(?:from[ \t]+([\w.]+)[ \t]+)?import[ \t]+(\([^)]*\)|[^\n#]*)", re.MULTILINE)
_KERNEL = re.compile(r"^from models\.compiled import [^\n]*\bkernel(_callback)?\b", re.MULTILINE)


class UncachedWarning(UserWarning):
    """Compiled code cannot be kept: every process compiles it anew."""


@cache
def kernel_digest(*modules: str) -> str:
    """Digest of the kernel sources that modules reach through imports; part of cache folders and stored evidence.

    Parameters
    ----------
    *modules : str
        Dotted names in this checkout, such as ``models.bayesian_fit``; all of `models` if none is named.

    Raises
    ------
    ModuleNotFoundError
        If a module is not in this checkout.
    """
    digest = hashlib.sha256(repr(SETTINGS).encode())
    for path in kernel_sources(*modules):
        digest.update(path.relative_to(_HERE.parent).as_posix().encode() + b"\0" + _text(path).encode() + b"\0")
    return digest.hexdigest()[:16]


def kernel_sources(*modules: str) -> list[Path]:
    """Files with kernels that modules reach through imports, those inside functions included."""
    if not modules:
        found = set(_HERE.rglob("*.py"))
    else:
        found, left = set(), list(modules)
        for module in modules:
            if _source(module) is None:
                raise ModuleNotFoundError(f"{module} is not in this checkout", name=module)
        while left:
            path = _source(left.pop())
            if path is not None and path not in found:
                found.add(path)
                left += _imported(path)
    return sorted(path for path in found if _KERNEL.search(_text(path)))


@cache
def _text(path: Path) -> str:
    """As it was when first read, so that a digest tells of the kernels that run and not of later edits."""
    return path.read_text(encoding="utf-8")


@cache
def _source(module: str) -> Path | None:
    """File of a dotted name; None if it is no module of this checkout."""
    base = _HERE.parent.joinpath(*module.split("."))
    return next((p for p in (base.with_name(f"{base.name}.py"), base / "__init__.py") if p.is_file()), None)


@cache
def _imported(path: Path) -> list[str]:
    """Dotted names that a file imports, and names in them, which may be modules too."""
    out: list[str] = []
    for origin, names in _IMPORT.findall(_text(path)):
        if origin:
            out += [origin, *(f"{origin}.{name}" for name in re.findall(r"\w+", names))]
        else:
            out += re.findall(r"[\w.]+", names)
    return out


@cache
def cache_folder(*modules: str) -> Path:
    """Folder for what modules compile: below `PROSOCIAL_CACHE`, or `.cache/` in the checkout."""
    root = os.environ.get("PROSOCIAL_CACHE")
    base = Path(root) if root else _HERE.parent / ".cache"
    return base / "numba" / kernel_digest(*modules)


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """`numba.njit` with the house's `SETTINGS`: cached, GIL released, numpy's error model."""
    return _cached(lambda **kept: numba.njit(**{**SETTINGS, **options, **kept}), function)


def kernel_callback(signature: Any) -> Any:
    """`numba.cfunc` with the house's cache: a C function pointer for libraries that call back."""
    return _cached(lambda **kept: numba.cfunc(signature, **{"cache": True, **kept}), None)


def _cached(decorator: Callable[..., Any], function: Callable[..., Any] | None) -> Any:
    def decorate(target: Callable[..., Any]) -> Any:
        # A kernel of a script or notebook has no file in the checkout: it may call any other.
        known = (target.__module__,) if _source(target.__module__) else ()
        folder = cache_folder(*known)
        if not _writable(folder):
            # Left to itself numba would keep it beside the source, where no digest tells of changed callees.
            return decorator(cache=False)(target)
        # numba reads the folder while decorating; other users of numba in the process keep theirs. One thread at a
        # time: another one would take our folder for theirs, and leave it behind.
        with _FOLDER_LOCK:
            before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
            numba.config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
            try:
                return decorator()(target)
            finally:
                numba.config.CACHE_DIR = before  # type: ignore[attr-defined]

    return decorate if function is None else decorate(function)


@cache
def _writable(folder: Path) -> bool:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _refuse_open_folder(folder)
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        _not_kept(error)
        return False
    return True


def _refuse_open_folder(folder: Path) -> None:
    """Compiled code is run as it lies there: nobody may put it there but who runs it, or whose checkout this is.

    Raises
    ------
    PermissionError
    """
    if os.name != "posix":
        return
    found, trusted = folder.stat(), (os.getuid(), 0, _HERE.stat().st_uid)
    if found.st_uid not in trusted or found.st_mode & stat.S_IWOTH:
        raise PermissionError(errno.EPERM, "others may write there, and code from it is run", str(folder))


_TOLD = threading.Event()


def _not_kept(error: OSError) -> None:
    """Say once a process that compiled code is not kept, and why."""
    if not _TOLD.is_set():
        _TOLD.set()
        warnings.warn(
            f"{error.filename or cache_folder()}: compiled code cannot be kept ({error.strerror or error}); "
            "every run compiles it anew",
            UncachedWarning, stacklevel=2,
        )  # fmt: skip


def _guard_saving() -> None:
    """Let numba go on when what it compiled cannot be saved.

    For all of numba in the process: PyTensor's functions and C callbacks are compiled where no decorator of the
    house is near, some of them while the sampler's threads wait for a starting point.
    """
    save = Cache.save_overload
    if getattr(save, "guarded", False):
        return

    @wraps(save)
    def saved(self: Any, signature: Any, data: Any) -> None:
        try:
            save(self, signature, data)
        except OSError as error:
            # The index is written before the data: it must not name data that another version left there.
            with suppress(OSError):
                Path(self._cache_file._index_path).unlink(missing_ok=True)
            _not_kept(error)

    saved.guarded = True  # type: ignore[attr-defined]
    Cache.save_overload = saved  # type: ignore[method-assign]


_guard_saving()
