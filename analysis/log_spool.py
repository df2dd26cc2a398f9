"""The digest of a log that is never held: its columns go to temporary files and are hashed one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType

import numpy as np
from numpy.typing import NDArray

from analysis.datasets import LogHash
from models.errors import InputError
from models.event_flow import CodedEvents
from models.protocol import Protocol

_BLOCK = 1 << 20
_TYPES = {
    "offsets": "<i8", "participant": "<i8", "sequence": "<i8", "condition": "<i4", "action": "|i1",
    "response": "|i1",
}  # fmt: skip


class LogSpool:
    """Columns of a checked log on disk, some two bytes an event and thirty a run.

    Parameters
    ----------
    folder : Path
    tokens : sequence of str
        Token columns of the log.
    place : str
        Named in errors.
    """

    def __init__(self, folder: Path, tokens: Sequence[str], place: str) -> None:
        self._types = _TYPES | dict.fromkeys(tokens, "<f8")
        self._paths = {name: folder / f"column-{name}" for name in self._types}
        self._place = place
        self._events = 0
        self._stack = ExitStack()
        self._files = {name: self._stack.enter_context(path.open("wb")) for name, path in self._paths.items()}

    def __enter__(self) -> LogSpool:
        return self

    def __exit__(self, kind: type | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self._stack.close()
        for path in self._paths.values():
            path.unlink(missing_ok=True)

    def add(self, events: CodedEvents) -> None:
        """Take the next events."""
        first = events.starts
        self._write("offsets", self._events + first)
        for name in ("participant", "sequence", "condition"):
            self._write(name, getattr(events, name)[first])
        self._write("action", events.action)
        self._write("response", events.response)
        for name, values in events.tokens.items():
            self._write(name, values)
        self._events += len(events.action)

    def digest(self, study: str, names: Sequence[str], protocol: Protocol) -> str:
        """`analysis.datasets.log_digest` of the log; `names` are the conditions by their codes here."""
        self._write("offsets", np.array([self._events]))
        for file in self._files.values():
            file.flush()
        code = np.argsort(np.argsort(np.array(names, dtype=object))).astype(np.int32)
        digest = LogHash(study, sorted(names), protocol)
        for name, kind in sorted(self._types.items()):
            size = np.dtype(kind).itemsize
            digest.begin(name, np.dtype(kind), self._paths[name].stat().st_size // size)
            with self._paths[name].open("rb") as stream:
                while block := stream.read(_BLOCK * size):
                    values = np.frombuffer(block, dtype=kind)
                    digest.add(code[values] if name == "condition" else values)
        return digest.hexdigest()

    def _write(self, name: str, values: NDArray) -> None:
        try:
            self._files[name].write(np.ascontiguousarray(values, dtype=self._types[name]).tobytes())
        except OSError as error:
            raise InputError(
                f"{self._place}: a temporary file beside {self._paths[name].parent} cannot be written: "
                f"{error.strerror}"
            ) from None
