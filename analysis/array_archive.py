"""Archives of arrays as `numpy.savez` writes them, read strictly: plain numbers only, nothing unpacked or run.

`numpy.load` follows whatever the head of an array promises: memory for any shape, archives that unpack to any size,
members that are no arrays. Here every member lies in the archive as it is, and is as long as its head says.
"""

from __future__ import annotations

import io
import struct
import tokenize
import zipfile
import zlib
from collections.abc import Collection
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

_HEADS = {(1, 0): np.lib.format.read_array_header_1_0, (2, 0): np.lib.format.read_array_header_2_0}
_DAMAGE = (
    zipfile.BadZipFile, zlib.error, struct.error, tokenize.TokenError, SyntaxError, LookupError, TypeError,
    AttributeError, EOFError, NotImplementedError, OverflowError, RecursionError, MemoryError, RuntimeError,
)  # fmt: skip


def read_arrays(path: str | Path, only: Collection[str] | None = None) -> dict[str, NDArray]:
    """Arrays of an archive, by name.

    Parameters
    ----------
    path : path
    only : collection of str, optional
        Names of those that are read; all by default.

    Raises
    ------
    OSError
        If it cannot be read.
    ValueError
        If it is no such archive: compressed or damaged members, other members than arrays, arrays of objects,
        heads that promise what is not there.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            out = {}
            for member in archive.infolist():
                if member.compress_type != zipfile.ZIP_STORED or member.file_size != member.compress_size:
                    raise ValueError(f"{member.filename[:80]!r} is compressed")
                name = member.filename.removesuffix(".npy")
                if name == member.filename or name in out:
                    raise ValueError(f"{member.filename[:80]!r} is no array, or there twice")
                if only is None or name in only:
                    out[name] = _array(archive.read(member))
            return out
    except _DAMAGE as error:
        raise ValueError(f"no archive of arrays ({type(error).__name__}: {str(error)[:80]})") from None


def _array(content: bytes) -> NDArray:
    stream = io.BytesIO(content)
    version = np.lib.format.read_magic(stream)
    if version not in _HEADS:
        raise ValueError(f"an array of format {version}")
    shape, by_column, dtype = _HEADS[version](stream)
    if dtype.hasobject:
        raise ValueError("an array of objects")
    body = content[stream.tell() :]
    count = 1
    for size in shape:
        count *= size
    if min(shape, default=0) < 0 or dtype.itemsize == 0 or count * dtype.itemsize != len(body):
        raise ValueError(f"an array of {len(body)} bytes, which is not what its head says")
    return np.frombuffer(bytearray(body), dtype=dtype).reshape(shape, order="F" if by_column else "C")
