"""The one decorator for compiled kernels.

numba's on-disk cache does not notice when a kernel *called by* a cached kernel changes: the caller keeps
the old machine code. So the cache folder carries a digest of every compiled source file; editing any kernel
starts a fresh cache.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numba

_HERE = Path(__file__).resolve().parent


@cache
def kernel_digest() -> str:
    """Digest of all sources that use `kernel`; part of the cache folder's name and of stored evidence."""
    digest = hashlib.sha256()
    for path in sorted(_HERE.rglob("*.py")):
        text = path.read_bytes()
        if b"models.compiled" in text or path.name == "compiled.py":
            digest.update(path.relative_to(_HERE).as_posix().encode() + b"\0" + text + b"\0")
    return digest.hexdigest()[:16]


@cache
def cache_folder() -> Path:
    """Folder of compiled kernels: below `PROSOCIAL_CACHE`, or `.cache/` in the checkout."""
    root = os.environ.get("PROSOCIAL_CACHE")
    base = Path(root) if root else _HERE.parent / ".cache"
    return base / "numba" / kernel_digest()


def kernel(function: Callable[..., Any] | None = None, **options: Any) -> Any:
    """`numba.njit` with the house's settings: cached, GIL released, numpy's error model.

    Fast-math is off: sums keep their order, so results are reproducible bit for bit.
    """
    settings: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy", **options}

    return _cached(numba.njit(**settings), function)


def kernel_callback(signature: Any) -> Any:
    """`numba.cfunc` with the house's cache: a C function pointer for libraries that call back."""
    return _cached(numba.cfunc(signature, cache=True), None)


def _cached(compile_with: Callable[..., Any], function: Callable[..., Any] | None) -> Any:
    def decorate(target: Callable[..., Any]) -> Any:
        # numba reads the folder while decorating; other users of numba in the process keep theirs.
        before = numba.config.CACHE_DIR  # type: ignore[attr-defined]
        numba.config.CACHE_DIR = str(cache_folder())  # type: ignore[attr-defined]
        try:
            return compile_with(target)
        finally:
            numba.config.CACHE_DIR = before  # type: ignore[attr-defined]

    return decorate if function is None else decorate(function)
