"""What is in the store of fits and results, and clearing it away.

A fit is found again only by the hash of everything that determined it, so one made by other code or other versions
is never used again; neither is a damaged file or what a killed process left half written. An interrupted run's
chains wait for the same command of the same code and versions. Results and drawings (`analysis.stored_results`) lie
beside the fits and are told and cleared in the same way.
"""

from __future__ import annotations

import json
import time
from collections.abc import Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import h5py

from analysis import fits
from analysis.kept_chains import ABOUT, discard, read_chain
from analysis.stored_results import SUFFIX, made_by, read_about
from analysis.stored_results import UNREADABLE as RESULT_UNREADABLE
from models.bayesian_fit import EDITED
from models.gate import Gate

DAY = 86_400.0

STATUS = {
    "ready": "found again by the same command",
    "kept": "made from an edited model: found again with the same model, or read by its path",
    "outdated": "made by other code or versions: never found again",
    "interrupted": "chains of a run that was interrupted: the same command goes on with them",
    "damaged": "cannot be read, or made by no run of its settings",
    "left over": "half written by a process that was killed, or chains of a fit that was completed",
}
"""What an entry's status means."""

USELESS = ("outdated", "damaged", "left over")

UNREADABLE = (
    OSError, KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError, RuntimeError
)  # fmt: skip
"""What reading a file of unexpected content raises; one such file must not hide the others."""

LEFT_OVER_AFTER = 3600.0
"""Seconds after which a half-written file counts as left over: nobody writes that long."""


@dataclass(frozen=True)
class StoreEntry:
    """One fit, the chains of an interrupted run, a result or a drawing.

    Attributes
    ----------
    path : Path
    key : str
    status : str
        A key of `STATUS`.
    bytes : int
    modified : float
        Seconds since 1970.
    about : mapping
        As far as they are known: ``study, states, kappa, engine, draws, tune, chains, seed, pins``, ``groups``
        (what tables differ by), ``hierarchical``, ``gate`` (whether passed), ``divergences``, ``max_rhat``; for an
        interrupted run ``chains_done``; for a result or a drawing ``what, function``.
    kind : str
        ``fit``, ``result`` or ``drawing``.
    """

    path: Path
    key: str
    status: str
    bytes: int
    modified: float
    about: dict[str, Any] = field(default_factory=dict)
    kind: str = "fit"

    @property
    def age_days(self) -> float:
        """Days since it was written."""
        return max(0.0, time.time() - self.modified) / DAY


def entries() -> list[StoreEntry]:
    """Everything in the store, newest first; an empty list where there is no store."""
    folder = fits.store_folder()
    if not folder.is_dir():
        return []
    found = []
    for path in folder.iterdir():
        with suppress(FileNotFoundError):  # somebody else is done with it
            entry = _entry(path)
            if entry is not None:
                found.append(entry)
    return sorted(found, key=lambda entry: (-entry.modified, entry.key))


def _entry(path: Path) -> StoreEntry | None:
    """What a path in the store is; None for what is not the store's."""
    if path.is_symlink():
        return None
    stat = path.stat()
    if path.is_dir() and path.suffix == ".chains":
        return _chains_entry(path, stat.st_mtime)
    hidden = path.name.startswith(".")
    if SUFFIX in path.suffixes and path.is_file():
        return _result_entry(path, stat.st_size, stat.st_mtime, hidden)
    if not path.is_file() or (".nc" not in path.suffixes if hidden else path.suffix != ".nc"):
        return None
    if hidden:
        if time.time() - stat.st_mtime < LEFT_OVER_AFTER:
            return None
        return StoreEntry(path, path.name.split(".")[1], "left over", stat.st_size, stat.st_mtime)
    try:
        with h5py.File(path, "r") as file:  # attributes only: the draws stay on disk
            attributes = {name: file.attrs[name] for name in file.attrs}
            sampled = file["posterior/transition"].shape[:2]
        settings, provenance = json.loads(attributes["settings"]), json.loads(attributes["provenance"])
        gate, made_with = json.loads(attributes["gate"]), json.loads(attributes["versions"])
        about = _described({**settings, **provenance}) | {
            "gate": Gate(**gate).passed, "divergences": gate["divergences"], "max_rhat": gate["max_rhat"],
            "chains": int(sampled[0]), "draws": int(sampled[1]),
        }  # fmt: skip
        maker = {"schema": attributes["schema"], "versions": made_with, "sources": provenance.get("sources")}
        status = "ready" if maker == fits.maker() else "outdated"
        if (settings.get("prior") or {}).get("class") == EDITED:
            status = "kept"  # nobody can make it again without the analyst's model
    except UNREADABLE:
        return StoreEntry(path, path.stem, "damaged", stat.st_size, stat.st_mtime)
    return StoreEntry(path, path.stem, status, stat.st_size, stat.st_mtime, about)


def _result_entry(path: Path, size: int, modified: float, hidden: bool) -> StoreEntry | None:
    """A result or drawing: whether it would be found again."""
    if hidden:
        if time.time() - modified < LEFT_OVER_AFTER:
            return None
        return StoreEntry(path, path.name.split(".")[1], "left over", size, modified, kind="result")
    try:
        said = read_about(path)
        maker = said["made_by"]
        status = "ready" if maker == made_by(*maker["modules"]) else "outdated"
    except ModuleNotFoundError:
        status = "outdated"  # made by code that is no longer there
    except (*UNREADABLE, *RESULT_UNREADABLE):
        return StoreEntry(path, path.stem, "damaged", size, modified, kind="result")
    about = {"what": said["what"], "function": said["function"]}
    return StoreEntry(path, path.stem, status, size, modified, about, said["kind"])


def _chains_entry(folder: Path, changed: float) -> StoreEntry | None:
    """Chains of a run that was interrupted: whether any run would go on with them."""
    parts = [p.stat() for p in folder.iterdir()]
    latest = max((p.st_mtime for p in parts), default=changed)
    chains = sorted(folder.glob("*.npz"))
    about: dict[str, Any] = {"chains_done": len(chains)}
    try:
        settings = json.loads((folder / ABOUT).read_text(encoding="utf-8"))
        usable = [path for path in chains if not isinstance(read_chain(path, settings), str)]
        about = _described(settings) | {"chains_done": len(usable)}
        status = "interrupted" if settings.get("made_by") == fits.maker() else "outdated"
        if (not usable and time.time() - latest >= LEFT_OVER_AFTER) or (chains and not usable):
            status = "damaged"
    except FileNotFoundError:
        if time.time() - latest < LEFT_OVER_AFTER:
            return None  # a run that is just beginning to keep its chains
        status = "damaged"
    except UNREADABLE:
        status = "damaged"
    if folder.with_suffix(".nc").is_file():
        status = "left over"
    return StoreEntry(folder, folder.stem, status, sum(p.st_size for p in parts), latest, about)


KINDS: dict[str, Any] = {
    "study": str | None, "engine": str, "kappa": int | float | None, "pins": list, "groups": str | None,
    "differ": list | None, "hierarchical": bool,
    **dict.fromkeys(("states", "draws", "tune", "chains", "seed"), int),
}  # fmt: skip


def _described(settings: dict[str, Any]) -> dict[str, Any]:
    """The settings of a fit as they are listed; TypeError where one is of another kind than a fit's."""
    sampler, prior = settings.get("sampler") or {}, settings.get("prior") or {}
    known = {
        "study": settings.get("study"), "states": settings.get("states"), "kappa": prior.get("stay"),
        "engine": settings.get("engine"), "pins": sorted(settings.get("pins") or {}),
        "groups": (settings.get("groups") or {}).get("by"),
        "differ": (settings.get("groups") or {}).get("differ"), "hierarchical": bool(settings.get("people")),
        **{name: sampler.get(name) for name in ("draws", "tune", "chains", "seed")},
    }  # fmt: skip
    for name, value in known.items():
        if not isinstance(value, KINDS[name]):
            raise TypeError(f"{name}: {type(value).__name__}")
    return {name: value for name, value in known.items() if value is not None}


def to_clear(
    found: Iterable[StoreEntry], *, older_than: float | None = None, everything: bool = False
) -> list[StoreEntry]:
    """Choose what to remove.

    Parameters
    ----------
    found : iterable of StoreEntry
    older_than : float, optional
        Days: whatever was written longer ago.
    everything : bool
        All of it. With neither, what can never be used again (`USELESS`).
    """
    if everything:
        return list(found)
    if older_than is not None:
        return [entry for entry in found if entry.age_days > older_than]
    return [entry for entry in found if entry.status in USELESS]


def remove(entry: StoreEntry) -> None:
    """Remove an entry; nothing below a symbolic link or outside the store is touched."""
    with suppress(FileNotFoundError):
        if entry.path.is_dir():
            for path in entry.path.iterdir():
                discard(path)
            entry.path.rmdir()
        else:
            entry.path.unlink()
