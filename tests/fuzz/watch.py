"""One damaged file given to a reader: within limits of time and memory, and with its answer judged."""

from __future__ import annotations

import re
import resource
import signal
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from models.errors import InputError

SECONDS = 10.0
MEMORY = 2 << 30
"""Bytes beyond what the process has already."""

ROOT = Path(__file__).resolve().parents[2]
LONGEST_MESSAGE = 4_000


class TooLong(BaseException):
    """Not an `Exception`, so that no reader takes it for damage."""


class Outcome(NamedTuple):
    """What a reader answered.

    Attributes
    ----------
    kind : {"read", "refused", "finding"}
    what : str
        The message, or for a finding what it is and where in the project: equal for equal faults.
    told : str
        Of a finding: its traceback.
    """

    kind: str
    what: str
    told: str = ""


@contextmanager
def limited(seconds: float = SECONDS, memory: int = MEMORY) -> Iterator[None]:
    """Limits while the block runs; `TooLong` or `MemoryError` where they are passed."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)

    def over(*_: Any) -> None:
        raise TooLong

    before = signal.signal(signal.SIGALRM, over)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + memory, hard))
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


def outcome(read: Any, path: Path, seconds: float = SECONDS) -> Outcome:
    """Let a reader read a file, and judge what came of it."""
    try:
        with limited(seconds), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            warnings.simplefilter("error", RuntimeWarning)
            read(path)
    except InputError as error:
        wrong = _wrong_message(str(error), path)
        return Outcome("finding", wrong, traceback.format_exc()) if wrong else Outcome("refused", str(error))
    except (Exception, TooLong) as error:
        return Outcome("finding", f"{type(error).__name__} in {_place(error)}", traceback.format_exc())
    return Outcome("read", "")


def _wrong_message(text: str, path: Path) -> str:
    """What a message of a refusal lacks."""
    if path.name not in text:
        return "no file named: " + re.sub(r"'[^']*'|\"[^\"]*\"|[0-9]+", "#", text)[:40].split(", found")[0]
    if len(text) > LONGEST_MESSAGE:
        return "message of many characters"
    return ""


def _place(error: BaseException) -> str:
    """The innermost line of the project that an exception passed."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if f.filename.startswith(str(ROOT))]
    own = [f for f in frames if "/.venv/" not in f.filename and "/tests/" not in f.filename] or frames
    if not own:
        return "?"
    return f"{Path(own[-1].filename).relative_to(ROOT)}:{own[-1].name}"
