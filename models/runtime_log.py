"""The log of a session while it is written: one process a log, whole lines or none, in order.

A line is handed to the system in one write to a descriptor opened for appending; it survives the process being
killed as soon as that returns, and the machine losing power only once it is forced to disk (`durable`). Anything
that goes wrong is told before the entry counts.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Mapping
from io import FileIO
from pathlib import Path
from typing import Any

from models.errors import InputError, Phrase, located
from models.file_lock import hold
from models.safeguards.audit import ROOT, Chain, read_chain, sealed


class LogWriter:
    """A log that is open for writing, and locked.

    Parameters
    ----------
    path : path
        A new file (or an empty one) unless `chain` is asked for by `reopen`. It can be read by its owner only: it
        says how a person responded.
    durable : bool
        Force every line to disk before it counts.

    Attributes
    ----------
    last_hash : str
    entries : int
        Lines written so far, those before a restart included.

    Raises
    ------
    InputError
        If there is a log already, another process writes it, or nothing can be written.
    """

    def __init__(self, path: str | Path, *, durable: bool = False) -> None:
        self.path, self.durable = Path(path), durable
        self.last_hash, self.entries, self._size = ROOT, 0, 0
        self._broken = ""
        self._file = self._open(os.O_CREAT)
        if os.fstat(self._file.fileno()).st_size:
            self._file.close()
            raise located(str(path), Phrase("a file that holds something"), "a new log, or the log to restore")

    @classmethod
    def reopen(cls, path: str | Path, *, durable: bool = False) -> tuple[LogWriter, Chain]:
        """Open a log to go on with it; nothing is written yet.

        Returns
        -------
        log : LogWriter
        chain : Chain
            What it holds. `cut` removes an unfinished last line.

        Raises
        ------
        InputError
            If it cannot be opened, another process writes it, its chain is broken, or it holds no whole line.
        """
        self = cls.__new__(cls)
        self.path, self.durable, self._broken = Path(path), durable, ""
        self._file = self._open(0)
        try:
            chain = read_chain(self.path.read_bytes())
            wrong = [f for f in chain.findings if f.kind == "chain"]
            if wrong:
                raise InputError(f"{path}, {wrong[0]}; wanted a log that nobody changed (see: audit verify)")
            if chain.last_hash is None:
                found = Phrase("no whole line, so no session had begun")
                raise located(str(path), found, "the log of a session; remove the file and begin anew")
        except BaseException:
            self._file.close()
            raise
        self.last_hash, self.entries, self._size = chain.last_hash, len(chain.entries), chain.size + chain.torn
        return self, chain

    def _open(self, flags: int) -> FileIO:
        extra = getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)

        def opener(name: str, _: int) -> int:
            return os.open(name, os.O_RDWR | os.O_APPEND | flags | extra, 0o600)

        if not self.path.parent.is_dir():
            found = Phrase(f"no folder {self.path.parent}")
            raise located(str(self.path), found, "a log in a folder that is there")
        try:
            if self.path.exists() and not self.path.is_file():
                raise located(str(self.path), Phrase("no plain file"), "the name of a file")
            file = FileIO(str(self.path), "ab", opener=opener)
        except OSError as error:
            found = Phrase(error.strerror or "no file")
            wanted = "a log that can be written" if flags else "the log of a session, which can be written"
            raise located(str(self.path), found, wanted) from None
        try:
            hold(file, self.path, f"{self.path}: another session is writing it; wanted a log for each")
        except BaseException:
            file.close()
            raise
        return file

    def append(self, entry: Mapping[str, Any]) -> None:
        """Write an entry; once this returns it is in the log.

        Parameters
        ----------
        entry : mapping
            Plain content; its number is put before it.

        Raises
        ------
        InputError
            If it could not be written whole. Then the log is as it was before; where even that could not be brought
            about, nothing more is written, and the log has to be restored.
        """
        if self._broken:
            raise InputError(f"{self.path}: {self._broken}; wanted the session restored from its log")
        self._check_unchanged()
        line, own = sealed(self.last_hash, {"n": self.entries, **entry})
        # An interruption (Ctrl-C) may come between any two instructions; what is not known to be whole is not used.
        self._broken = "was interrupted while a line was written"
        try:
            written = self._file.write(line)
            while written is not None and written < len(line):
                written += self._file.write(line[written:]) or 0
        except OSError as error:
            self._take_back(error)
        if self.durable:
            try:
                os.fsync(self._file.fileno())
                if not self.entries:
                    _flush_folder(self.path.parent)
            except OSError as error:
                # What reached the disk is unknown from here on, also to the system.
                self._broken = f"could not be forced to disk ({error.strerror})"
                raise InputError(f"{self.path}: {self._broken}; wanted a disk that keeps what is written") from None
        self._size += len(line)
        self.entries += 1
        self.last_hash = own
        self._broken = ""

    def cut(self, torn: int) -> None:
        """Remove an unfinished last line of so many bytes.

        Raises
        ------
        InputError
            If the file cannot be changed.
        """
        if torn:
            try:
                os.ftruncate(self._file.fileno(), self._size - torn)
            except OSError as error:
                raise InputError(f"{self.path}: cannot be written: {error.strerror}") from None
            self._size -= torn

    def close(self) -> None:
        """Let go of the file; a second call does nothing."""
        self._file.close()

    def __del__(self) -> None:
        # A session that was dropped is as good as one that was killed: its log can be gone on with.
        if "_file" in self.__dict__:
            self._file.close()

    def _check_unchanged(self) -> None:
        status = os.fstat(self._file.fileno())
        if status.st_nlink == 0:
            raise InputError(f"{self.path}: was deleted while the session ran; wanted it left in place")
        if status.st_size != self._size:
            found = Phrase(f"{status.st_size} bytes")
            raise located(str(self.path), found, f"{self._size}: somebody else changed the log")

    def _take_back(self, error: OSError) -> None:
        with contextlib.suppress(OSError):
            os.ftruncate(self._file.fileno(), self._size)
            if os.fstat(self._file.fileno()).st_size == self._size:
                self._broken = ""
        raise InputError(f"{self.path}: cannot be written: {error.strerror}; nothing was noted") from None


def _flush_folder(folder: Path) -> None:
    """Force the name of a new file to disk; systems that cannot open folders do without."""
    try:
        handle = os.open(folder, os.O_RDONLY)
    except OSError:
        return
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
