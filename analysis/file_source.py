"""Bytes of a data file, decompressed on the way if it is gzipped, with errors that name the file."""

from __future__ import annotations

import gzip
import io
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, cast

from models.errors import InputError, located

DECOMPRESSED_LIMIT = 8 << 30
"""Bytes a gzipped file may unpack to unless the caller allows more: a guard against zip bombs."""

_GZIP_MAGIC = b"\x1f\x8b"
_SNIFFED = 1 << 16


@dataclass(frozen=True)
class FileSource:
    """A readable file whose compression is told by its first bytes, not by its name.

    Attributes
    ----------
    path : Path
    gzipped : bool
    limit : int
        Most bytes it may unpack to.
    head : bytes
        The first 64 KiB, decompressed.
    """

    path: Path
    gzipped: bool
    limit: int
    head: bytes

    @classmethod
    def of(cls, path: str | Path, limit: int = DECOMPRESSED_LIMIT) -> FileSource:
        """Look at a file.

        Raises
        ------
        InputError
            If there is no such file, it is a folder, it cannot be read, or it is empty.
        """
        path = Path(path)
        try:
            with path.open("rb") as stream:
                magic = stream.read(len(_GZIP_MAGIC))
        except FileNotFoundError:
            raise InputError(f"{path}: no such file") from None
        except IsADirectoryError:
            raise InputError(f"{path}: is a folder, a data file was wanted") from None
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror}") from None
        except ValueError:
            raise located("file name", str(path), "a path without null characters") from None
        if not magic:
            raise InputError(f"{path}: the file is empty")
        source = cls(path, magic == _GZIP_MAGIC, limit, b"")
        with source.open() as stream:
            head = stream.read(_SNIFFED)
        if not head:
            raise InputError(f"{path}: the gzipped file holds nothing")
        return cls(path, source.gzipped, limit, head)

    def open(self) -> BinaryIO:
        """Stream the decompressed bytes; damage met on the way raises an InputError."""
        if self.gzipped:
            return cast(BinaryIO, _GuardedGzip(self.path, self.limit))
        return self.path.open("rb")

    @staticmethod
    def consumed(stream: BinaryIO) -> int:
        """Bytes of the file behind an open stream that were read so far, compressed as they are."""
        return cast(Any, stream).consumed if isinstance(stream, _GuardedGzip) else stream.tell()


class _GuardedGzip(io.RawIOBase):
    """Decompressing stream that counts what it gives out and explains what breaks."""

    def __init__(self, path: Path, limit: int) -> None:
        self._path, self._limit, self._given = path, limit, 0
        self._stream = gzip.open(path, "rb")  # noqa: SIM115 - closed with this object

    def readable(self) -> bool:
        return True

    def read(self, size: int | None = -1) -> bytes:
        if size is None or size < 0:
            size = self._limit + 1
        parts: list[bytes] = []
        while size > 0:
            part = self._some(min(size, 1 << 22))
            if not part:
                break
            parts.append(part)
            size -= len(part)
        return b"".join(parts)

    def readinto(self, buffer: Any) -> int:
        part = self._some(len(buffer))
        buffer[: len(part)] = part
        return len(part)

    def _some(self, size: int) -> bytes:
        try:
            part = self._stream.read(size)
        except EOFError:
            raise InputError(f"{self._path}: truncated gzip file: it ends in the middle of the data") from None
        except (gzip.BadGzipFile, zlib.error) as error:
            raise InputError(f"{self._path}: corrupt gzip file: {error}") from None
        self._given += len(part)
        if self._given > self._limit:
            raise InputError(
                f"{self._path}: decompressed size: found more than {self._limit} bytes, wanted at most that many; "
                "raise the limit if you trust the file"
            )
        return part

    @property
    def consumed(self) -> int:
        """Compressed bytes read so far."""
        return int(cast(Any, self._stream.fileobj).tell())

    def close(self) -> None:
        self._stream.close()
        super().close()
