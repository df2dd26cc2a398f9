"""Chains of an interrupted run: kept as they complete, believed only if the same run may have made them."""

from __future__ import annotations

import io
import json
import shutil
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from analysis.array_archive import read_arrays
from models.chains import Chain, unusable
from models.model_files import write_bytes, write_text

ABOUT = "about.json"
"""In the folder of an interrupted run: study, settings and maker, for whoever lists and clears the store."""

UNREADABLE = (OSError, ValueError, KeyError, TypeError, EOFError, BadZipFile)
"""What reading a damaged chain raises."""


class NotKeptWarning(UserWarning):
    """Something could not be written into the store, or what lay there could not be used: nothing else is lost."""


@dataclass
class KeptChains:
    """The folder of one run.

    Attributes
    ----------
    folder : Path
    about : mapping
        Settings of the run; ``sampler`` says how many chains of how many draws.
    columns : callable, optional
        Gives the columns of a draw; only asked if there are chains.
    """

    folder: Path
    about: Mapping[str, Any]
    columns: Callable[[], int] | None = None
    _warned: bool = field(default=False, init=False)

    def found(self) -> dict[int, Chain]:
        """Chains to go on with, by number; others are discarded with a warning and sampled again."""
        done: dict[int, Chain] = {}
        paths = sorted(self.folder.glob("*.npz")) if self.folder.is_dir() else []
        columns = self.columns() if paths and self.columns is not None else None
        for path in paths:
            chain = read_chain(path, self.about, columns)
            if isinstance(chain, str):
                warnings.warn(
                    f"{path}: not used, this chain is sampled again: {chain}", NotKeptWarning, stacklevel=3
                )
                with suppress(OSError):
                    discard(path)
            else:
                done[int(path.stem)] = chain
        return done

    def keep(self, number: int, chain: Chain) -> None:
        """Write a chain; a warning, once, if that cannot be done."""
        content = io.BytesIO()
        arrays = {"x": chain.x, "cpu_seconds": np.float64(chain.cpu_seconds), **chain.stats}
        np.savez(content, **arrays)  # type: ignore[arg-type]
        try:
            if not (self.folder / ABOUT).is_file():
                write_text(self.folder / ABOUT, json.dumps(self.about))
            write_bytes(self.folder / f"{number}.npz", content.getbuffer())
        except OSError as error:
            # The chain is still in memory: a full disk must not end the run that could do without it.
            if not self._warned:
                self._warned = True
                reason = f"{self.folder}: {error.strerror or error}; an interruption would lose it"
                warnings.warn(f"chain {number} could not be kept: {reason}", NotKeptWarning, stacklevel=2)

    def forget(self) -> None:
        """Clear the folder away; another run of the same fit may be doing so too, or writing into it."""
        with suppress(OSError):
            for path in self.folder.iterdir():
                discard(path)
            self.folder.rmdir()


def read_chain(path: Path, about: Mapping[str, Any], columns: int | None = None) -> Chain | str:
    """Read a chain, or say in words why a run of these settings cannot go on with it.

    Parameters
    ----------
    path : Path
    about : mapping
        With ``sampler``.
    columns : int, optional
        Columns of a draw, where they are known.
    """
    try:
        number, sampler = int(path.stem), about["sampler"]
        if not 0 <= number < sampler["chains"]:
            return f"chain {number} of a run of {sampler['chains']}"
        content = read_arrays(path)
        stats = {k: v for k, v in content.items() if k not in ("x", "cpu_seconds")}
        chain = Chain(content["x"], stats, float(content["cpu_seconds"]))
        return unusable(chain, sampler["draws"], columns) or chain
    except UNREADABLE as error:
        return f"cannot be read ({str(error).splitlines()[0][:120] if str(error) else type(error).__name__})"


def discard(path: Path) -> None:
    """Remove a file, or a folder that is in its place; a symbolic link goes, what it leads to stays."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)
