"""The analysis plan: which results were planned before anybody looked at the data; all others are exploratory.

A small TOML file::

    title = "Helping and signalling, study 3"
    date = 2026-03-01
    where = "https://osf.io/abcde"          # optional: where it is registered

    [[planned]]
    results = ["regression", "criteria"]    # keys of sections, parts, tables or figures
    why = "H1: people help more after they were helped."

Keys are the anchors of the report's page, and the column `key` of ``parts/index.csv``.
"""

from __future__ import annotations

import datetime
import difflib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from models.errors import Phrase, located
from models.text_files import toml_of

PLANNED, EXPLORATORY = "planned", "exploratory"
_KEYS = ("title", "date", "where", "planned")
_ENTRY = ("results", "why")


@dataclass(frozen=True)
class Planned:
    """Results planned for one reason.

    Attributes
    ----------
    results : tuple of str
        Keys of sections, parts, tables or figures.
    why : str
    """

    results: tuple[str, ...]
    why: str


@dataclass(frozen=True)
class AnalysisPlan:
    """What was planned.

    Attributes
    ----------
    path, title, date, where : str
        `where` may be empty.
    planned : tuple of Planned
    """

    path: str
    title: str
    date: str
    where: str
    planned: tuple[Planned, ...]

    @property
    def results(self) -> tuple[str, ...]:
        """Keys of everything planned, in order."""
        return tuple(dict.fromkeys(key for entry in self.planned for key in entry.results))

    def status(self, keys: Iterable[str]) -> str:
        """`PLANNED` if any of the keys is: an output's own, those of the parts and the section it stands in."""
        return PLANNED if set(keys) & set(self.results) else EXPLORATORY

    def check(self, known: Iterable[str]) -> None:
        """Refuse a planned result that the report does not have.

        Raises
        ------
        InputError
            Names the entry, and the keys that look most like it.
        """
        names = list(known)
        for i, entry in enumerate(self.planned, start=1):
            for key in entry.results:
                if key not in names:
                    near = difflib.get_close_matches(key, names, n=3, cutoff=0.4)
                    wanted = "a key of a section, part, table or figure of this report"
                    wanted += f" ({', '.join(near)}?)" if near else " (parts/index.csv lists them)"
                    raise located(f"{self.path}, planned entry {i}, results", key, wanted)

    def rows(self) -> list[dict[str, str]]:
        """One row a reason: what was planned, and why."""
        return [{"planned": ", ".join(e.results), "why": e.why} for e in self.planned]


def read_analysis_plan(path: str | Path) -> AnalysisPlan:
    """Read and check an analysis plan.

    Raises
    ------
    InputError
        If the file cannot be read; on an unknown or missing key, an entry of the wrong kind, or a result twice.
    """
    place = str(path)
    content = toml_of(path, "analysis plan")
    _known(place, content, _KEYS)
    date = content.get("date")
    if not isinstance(date, datetime.date | str):
        raise located(f"{place}, date", date, "the day it was written, as 2026-03-01")
    if isinstance(date, str):
        try:
            date = datetime.date.fromisoformat(date)
        except ValueError:
            raise located(f"{place}, date", date, "a day, as 2026-03-01") from None
    entries = content.get("planned")
    if not isinstance(entries, list) or not entries:
        raise located(f"{place}, planned", entries, "at least one [[planned]] entry with results and why")
    planned = tuple(_entry(f"{place}, planned entry {i}", e) for i, e in enumerate(entries, start=1))
    seen: set[str] = set()
    for i, entry in enumerate(planned, start=1):
        for key in entry.results:
            if key in seen:
                raise located(f"{place}, planned entry {i}, results", key, "every result once")
            seen.add(key)
    where = _text(place, content, "where") if "where" in content else ""
    return AnalysisPlan(place, _text(place, content, "title"), date.isoformat()[:10], where, planned)


def _entry(place: str, content: Any) -> Planned:
    if not isinstance(content, Mapping):
        wanted = 'a [[planned]] table with results and why: results = ["criteria"], why = "H1: ..."'
        raise located(place, Phrase(type(content).__name__), wanted)
    _known(place, content, _ENTRY)
    results = content.get("results")
    if not isinstance(results, list) or not results or not all(isinstance(r, str) and r for r in results):
        raise located(f"{place}, results", results, "a list of keys")
    return Planned(tuple(results), _text(place, content, "why"))


def _known(place: str, content: Mapping[str, Any], keys: tuple[str, ...]) -> None:
    for key in content:
        if key not in keys:
            raise located(f"{place}, key", key, f"one of {', '.join(keys)}")


def _text(place: str, content: Mapping[str, Any], key: str) -> str:
    value = content.get(key)
    if not isinstance(value, str) or not value.strip():
        raise located(f"{place}, {key}", value, "text")
    return value.strip()
