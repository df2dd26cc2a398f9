"""Data sets by name: a card that says what each is and is not, and the checked log behind it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis import frd2012
from analysis.design import DATA_FOLDER
from models.errors import located
from models.events import EventLog
from models.notebook_view import NotebookView, View
from models.protocol import PUBLISHED, Protocol

REGISTRY = DATA_FOLDER / "registry.json"
PRINTED = DATA_FOLDER / "published.json"


@dataclass(frozen=True)
class Card(NotebookView):
    """What a data set is, what it is not, and how to begin with it.

    Attributes
    ----------
    name, title : str
    kind : str
        ``real``, ``simulated``, or ``unstated`` for a file somebody supplied.
    source, licence : str
    what : str
    what_not : tuple of str
        Conclusions the data cannot carry.
    references : tuple of str
    defaults : mapping
        `condition`, `pins` (actions whose transition table is fixed to the identity), `states`: used and
        printed by every command that learns, unless told otherwise.
    run_length : str
        ``fixed``, or ``random`` where chance ended the runs, so that a short run is not somebody who left;
        ``unstated`` where nobody said.
    columns : mapping of str to str
        What each column means in this data set.
    stakes : str
        What people played for, where it was something else than the tokens of the paper's game; empty otherwise.
    rows, participants, sequences : int, optional
        Sizes of the log, checked when it is loaded.
    digest : str
        `log_digest` under the published protocol, checked when it is loaded; empty if not pinned.
    """

    name: str
    title: str
    kind: str = "unstated"
    source: str = "a file the user supplied"
    licence: str = "unstated"
    what: str = ""
    what_not: tuple[str, ...] = ()
    references: tuple[str, ...] = ()
    defaults: Mapping[str, Any] = field(default_factory=dict)
    run_length: str = "unstated"
    stakes: str = ""
    columns: Mapping[str, str] = field(default_factory=dict)
    rows: int | None = None
    participants: int | None = None
    sequences: int | None = None
    digest: str = ""

    def text(self) -> str:
        """The card for a terminal."""
        lines = [f"{self.title}", f"  name: {self.name} ({self.kind})", f"  source: {self.source}"]
        lines += [f"  licence: {self.licence}", f"  what it is: {self.what}"]
        lines += [f"  what it is not: {item}" for item in self.what_not]
        lines += [f"  what people played for: {self.stakes}"] * bool(self.stakes)
        lines += [f"  reference: {item}" for item in self.references]
        lines += [f"  default {key}: {_shown(value)}" for key, value in self.defaults.items()]
        lines += [f"  column {key}: {value}" for key, value in self.columns.items()]
        if self.rows is not None:
            lines.append(
                f"  size: {self.rows:,} events, {self.participants:,} people, {self.sequences:,} sequences"
            )
        return "\n".join(lines)

    def _view(self) -> View:
        return View(self.title, self.kind, (), (), tuple(line.strip() for line in self.text().splitlines()[1:]))


@dataclass(frozen=True)
class DataSet(NotebookView):
    """A checked log with its card.

    Attributes
    ----------
    log : EventLog
    card : Card
    notes : tuple of str
        What was met while reading.
    digest : str
        `log_digest` of the log.
    """

    log: EventLog
    card: Card
    notes: tuple[str, ...]
    digest: str

    def _view(self) -> View:
        card, log = self.card, self.log._view()
        said = (card.what, *log.sentences) if card.what else log.sentences
        notes = (*(f"what it is not: {text}" for text in card.what_not), *log.notes, *self.notes)
        tables = tuple(replace(rows, where=f".log{rows.where}") for rows in log.tables)
        return View(card.title, card.kind, (), notes, said, tables)


def names() -> tuple[str, ...]:
    """Names of the registered data sets."""
    return tuple(_registry())


def card(name: str) -> Card:
    """Card of a registered data set.

    Raises
    ------
    InputError
        On an unknown name.
    """
    if name not in _registry():
        raise located("data set", name, f"one of {', '.join(names())}")
    content = json.loads((DATA_FOLDER / _registry()[name]["card"]).read_text(encoding="utf-8"))
    for key in ("what_not", "references"):
        content[key] = tuple(content[key])
    return Card(**content)


def files() -> tuple[Path, ...]:
    """Files that belong to the registry, as far as they are on this machine: no command may write over them."""
    paths = [REGISTRY, PRINTED, DATA_FOLDER / "simulated" / "calibrated_truth.json"]
    paths += [
        DATA_FOLDER / entry[key] for entry in _registry().values() for key in ("card", "file") if key in entry
    ]
    return tuple(path for path in (*paths, *frd2012.local_files()) if path.is_file())


def load(name_or_path: str | Path, protocol: Protocol = PUBLISHED) -> DataSet:
    """Load a registered data set, or an event file (CSV or Parquet, optionally gzipped).

    Raises
    ------
    InputError
        If there is neither such a name nor such a file, the data cannot be had, or they break a rule; also if
        a registered data set is not what its card says.
    """
    from analysis.event_files import read_events  # loads pyarrow, which `--help` should not wait for

    name = str(name_or_path)
    notes: tuple[str, ...] = ()
    if name not in _registry():
        if not Path(name).exists() and not Path(name).suffix:
            wanted = f"a file, or a registered data set: {', '.join(names())}"
            raise located("data", name, wanted)
        file = read_events(name_or_path, protocol)
        return DataSet(file.log, Card(name, Path(name).name), file.notes, log_digest(file.log))
    entry = _registry()[name]
    path = DATA_FOLDER / entry["file"] if "file" in entry else frd2012.find_file()
    if path.name == frd2012.FILE_NAME:
        log = frd2012.read_frd2012(path, protocol)
    else:
        file = read_events(path, protocol)
        log, notes = file.log, file.notes
    found = log_digest(log)
    own = card(name)
    if own.digest and protocol == PUBLISHED and found != own.digest:
        raise located(f"{path}, digest of its events", found, f"{own.digest}: this is not {name}, see its card")
    return DataSet(log, own, notes, found)


def log_digest(log: EventLog) -> str:
    """SHA-256 of a log's content: the same for every file format and order of rows.

    It covers study, names and codes, run by run; fits are stored under it.
    """
    digest = LogHash(log.study, log.conditions, log.protocol)
    arrays: dict[str, NDArray] = {
        "offsets": log.offsets, "participant": log.participant, "sequence": log.sequence,
        "condition": log.condition, "action": log.action, "response": log.response, **log.tokens,
    }  # fmt: skip
    for name, values in sorted(arrays.items()):
        digest.begin(name, values.dtype, len(values))
        digest.add(values)
    return digest.hexdigest()


class LogHash:
    """`log_digest` under way: names first, then every array in turn, whole or in parts."""

    def __init__(self, study: str, conditions: Sequence[str], protocol: Protocol) -> None:
        labels = [study, list(conditions), protocol.action_names, protocol.response_names]
        self._digest = hashlib.sha256(json.dumps(labels).encode())

    def begin(self, name: str, kind: np.dtype, length: int) -> None:
        """Begin with an array of so many values."""
        self._digest.update(f"{name} {kind.newbyteorder('<').str} {length}\n".encode())

    def add(self, values: NDArray) -> None:
        """Go on with the next values of the array."""
        little = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
        self._digest.update(little.tobytes())

    def hexdigest(self) -> str:
        """The digest."""
        return self._digest.hexdigest()


@cache
def _registry() -> dict[str, dict[str, str]]:
    content: dict[str, dict[str, str]] = json.loads(REGISTRY.read_text(encoding="utf-8"))
    return content


def _shown(value: Any) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
