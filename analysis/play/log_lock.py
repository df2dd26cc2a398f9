"""Keeping a log to one server: the lock in the folder next to it, taken before anything that takes long."""

from __future__ import annotations

import contextlib
import os
from pathlib import Path
from typing import BinaryIO

from models.errors import Phrase, located
from models.file_lock import hold

LOCK_FILE = ".lock"


class LogLock:
    """The right to write a log and its folder, for as long as this process lives, however it ends.

    Parameters
    ----------
    out : path
        The event log; the folder that it is in has to be there, so that a slip of the pen does not put a study
        where nobody looks for it.

    Attributes
    ----------
    folder : Path
        `folder_of` the log, made if it was not there; taken away again by `close` if nothing was written.

    Raises
    ------
    InputError
        If another server writes there, or nothing can be written.
    """

    def __init__(self, out: str | Path) -> None:
        self.folder = folder_of(out)
        if not self.folder.parent.is_dir():
            raise located(str(out), Phrase(f"no folder {self.folder.parent}"), "a log in a folder that is there")
        self._path, self._made = self.folder / LOCK_FILE, not self.folder.exists()
        try:
            self.folder.mkdir(exist_ok=True)
            self._file: BinaryIO = self._path.open("ab")
        except OSError as error:
            raise located(
                str(self.folder), Phrase(error.strerror or "no folder"), "a folder to write into"
            ) from None
        try:
            self._hold()
        except BaseException:
            self._file.close()
            raise

    def close(self) -> None:
        """Let another server write; a second call does nothing."""
        if self._file.closed:
            return
        if self._made and os.listdir(self.folder) == [LOCK_FILE]:
            # Nobody agreed, so there is nothing to keep. Still locked: whoever waits for it sees that it is gone.
            with contextlib.suppress(OSError):
                self._path.unlink()
                self.folder.rmdir()
        self._file.close()

    def _hold(self) -> None:
        hold(
            self._file, self._path,
            f"{self.folder}: another server is writing there; wanted a log of its own for each",
        )  # fmt: skip


def folder_of(out: str | Path) -> Path:
    """The folder next to a log.

    Examples
    --------
    >>> folder_of("study.csv").name
    'study_rounds'
    """
    out = Path(out)
    return out.with_name(f"{out.name.removesuffix('.csv')}_rounds")
