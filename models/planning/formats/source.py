"""Opening problem files: plain or compressed, never more than a set size, every failure an `InputError`."""

from __future__ import annotations

import gzip
import io
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from models.errors import InputError, Phrase, located

LARGEST = 1 << 30
"""Bytes of a file, after decompression, that are read at most: a small archive can hold a very large file."""


class _Limited(io.RawIOBase):
    """A stream that refuses to go on after `limit` bytes."""

    def __init__(self, stream: io.BufferedIOBase, path: Path, limit: int) -> None:
        self._stream = stream
        self._path = path
        self._left = limit
        self._limit = limit

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: bytearray | memoryview) -> int:  # type: ignore[override]
        block = self._stream.read(len(buffer))
        self._left -= len(block)
        if self._left < 0:
            raise located(str(self._path), Phrase(f"more than {self._limit} bytes"), f"at most {self._limit}")
        buffer[: len(block)] = block
        return len(block)


@contextmanager
def opened(path: str | Path, limit: int | None = None) -> Iterator[io.BufferedReader]:
    """A file as a stream of bytes, decompressed if its name ends in ``.gz``.

    Parameters
    ----------
    path : path
    limit : int, optional
        Bytes after decompression, `LARGEST` by default.

    Raises
    ------
    InputError
        If the file is absent, unreadable, damaged or longer than `limit`.
    """
    path = Path(path)
    limit = LARGEST if limit is None else limit
    try:
        with path.open("rb") as raw:
            if path.suffix == ".gz":
                with gzip.GzipFile(fileobj=raw) as unpacked:
                    yield io.BufferedReader(_Limited(unpacked, path, limit), 1 << 20)
            else:
                yield io.BufferedReader(_Limited(raw, path, limit), 1 << 20)
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise InputError(f"{path}: is a folder, a problem file was wanted") from None
    except (gzip.BadGzipFile, EOFError, zlib.error) as error:
        raise InputError(f"{path}: not a readable gzip archive ({error})") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None


def problem_name(path: str | Path) -> str:
    """Name of the problem in a file: the file's, without its endings."""
    name = Path(path).name.removesuffix(".gz")
    return name.removesuffix(".pomdpx").removesuffix(".pomdp") or "problem"
