"""Column maps: a TOML file that says how a raw export becomes an event log (`data/maps/` has an example)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from models.errors import InputError, located
from models.events import COLUMNS, TOKEN_COLUMNS
from models.protocol import MISSING, Protocol
from models.text_files import toml_of

_KEYS = ("study", "sequence", "separator", "first_round", "join", "missing", "columns", "values")
_FROM_COLUMNS = tuple(c for c in (*COLUMNS, *TOKEN_COLUMNS) if c != "study")
_VALUE_COLUMNS = ("mode", "action", "observation", "condition")
LETTERS = "letters"
"""Instead of a table of values for `mode`: the raw values are the published letters."""


@dataclass(frozen=True)
class ColumnMap:
    """How raw columns become the schema's.

    Attributes
    ----------
    study : str
        Constant study name.
    columns : mapping of str to tuple of str
        Raw columns behind a schema column; more than one are joined with `join`.
    action_columns : mapping of str to str
        Raw column of the action in each mode, where the export has one a mode instead of one in all.
    values : mapping of str to mapping
        Raw value to schema value, for mode, action, observation and condition; a value of a column without
        an entry here is taken as it is. Actions may have one table a mode, under ``action.MODE``.
    letters : bool
        Whether raw modes are schedule letters.
    missing : tuple of str
        Raw observations that mean "not recorded".
    first_round : int
        The raw number of a run's first round.
    sequence : int
        Sequence id where the export has no such column.
    separator, join : str
    """

    study: str
    columns: Mapping[str, tuple[str, ...]]
    action_columns: Mapping[str, str] = field(default_factory=dict)
    values: Mapping[str, Mapping[str, str]] = field(default_factory=dict)
    letters: bool = False
    missing: tuple[str, ...] = ("",)
    first_round: int = 0
    sequence: int = 0
    separator: str = ","
    join: str = "+"

    def raw_columns(self) -> tuple[str, ...]:
        """Every raw column the map needs, each once."""
        named = [raw for several in self.columns.values() for raw in several]
        return tuple(dict.fromkeys([*named, *self.action_columns.values()]))


def read_map(path: str | Path, protocol: Protocol) -> ColumnMap:
    """Read and check a column map.

    Raises
    ------
    InputError
        If the file cannot be read, on an unknown or missing key, on an entry of the wrong kind, and on a
        target value that the protocol does not have.
    """
    content = toml_of(path, "map file")
    place = str(path)
    _known(place, content, _KEYS)
    study = _entry(place, content, "study", str, "text: the name of the study")
    if not study.strip():
        raise located(f"{place}, key study", study, "the name of the study")
    table = _entry(place, content, "columns", dict, "a table: schema column = raw column")
    _known(f"{place}, [columns]", table, _FROM_COLUMNS)
    columns, action_columns = _columns(place, table, protocol)
    values, letters = _values(place, content.get("values", {}), protocol)
    missing = _entry(place, content, "missing", list, "a list of texts", ["", "NA"])
    if not all(isinstance(value, str) for value in missing):
        raise located(f"{place}, key missing", missing, "a list of texts")
    separator = _entry(place, content, "separator", str, "one character", ",")
    if len(separator) != 1:
        raise located(f"{place}, key separator", separator, "one character")
    return ColumnMap(
        study,
        columns,
        action_columns,
        values,
        letters,
        tuple(missing),
        _entry(place, content, "first_round", int, "an integer", 0),
        _entry(place, content, "sequence", int, "an integer", 0),
        separator,
        _entry(place, content, "join", str, "text", "+"),
    )


def _columns(
    place: str, table: Mapping[str, Any], protocol: Protocol
) -> tuple[dict[str, tuple[str, ...]], dict[str, str]]:
    columns: dict[str, tuple[str, ...]] = {}
    action_columns: dict[str, str] = {}
    for name, raw in table.items():
        where = f"{place}, [columns], key {name}"
        if name == "action" and isinstance(raw, Mapping):
            _known(where, raw, protocol.mode_names)
            for mode in protocol.mode_names:
                action_columns[mode] = _entry(where, raw, mode, str, "the name of a raw column")
        elif isinstance(raw, str):
            columns[name] = (raw,)
        elif name == "condition" and isinstance(raw, list) and raw and all(isinstance(r, str) for r in raw):
            columns[name] = tuple(raw)
        else:
            raise located(where, raw, "the name of a raw column")
    for name in ("participant", "condition", "k", "mode", "action", "observation"):
        if name not in columns and not (name == "action" and action_columns):
            raise InputError(f"{place}, [columns]: found no entry for {name}, wanted the raw column it comes from")
    return columns, action_columns


def _values(place: str, table: Any, protocol: Protocol) -> tuple[dict[str, dict[str, str]], bool]:
    if not isinstance(table, Mapping):
        raise located(f"{place}, key values", table, "a table")
    _known(f"{place}, [values]", table, _VALUE_COLUMNS)
    permitted = {
        "mode": protocol.mode_names,
        "action": protocol.action_names,
        "observation": (MISSING, *protocol.response_names),
    }
    values: dict[str, dict[str, str]] = {}
    letters = False
    for name, entry in table.items():
        where = f"{place}, [values.{name}]"
        if name == "mode" and entry == LETTERS:
            letters = True
        elif not isinstance(entry, Mapping):
            kind = "a table: raw value = schema value" + (f', or "{LETTERS}"' if name == "mode" else "")
            raise located(where, entry, kind)
        elif name == "action" and any(isinstance(v, Mapping) for v in entry.values()):
            _known(where, entry, protocol.mode_names)
            for mode in entry:
                one = _entry(where, entry, mode, dict, "a table: raw value = action")
                own = [a.name for a in protocol.mode(mode).actions]
                values[f"action.{mode}"] = _targets(f"{place}, [values.action.{mode}]", one, own)
        else:
            values[name] = _targets(where, entry, permitted.get(name))
    return values, letters


def _targets(where: str, entry: Mapping[str, Any], permitted: Iterable[str] | None) -> dict[str, str]:
    names = None if permitted is None else tuple(permitted)
    for raw, target in entry.items():
        if not isinstance(target, str):
            raise located(f"{where}, key {raw}", target, "text")
        if names is not None and target not in names:
            raise located(f"{where}, key {raw}", target, f"one of {', '.join(names)}")
    return dict(entry)


def _known(where: str, table: Mapping[str, Any], keys: Iterable[str]) -> None:
    keys = tuple(keys)
    for key in table:
        if key not in keys:
            raise located(f"{where}, key", key, f"one of {', '.join(keys)}")


def _entry(where: str, table: Mapping[str, Any], key: str, kind: type, wanted: str, default: Any = None) -> Any:
    value = table.get(key, default)
    if not isinstance(value, kind) or isinstance(value, bool):
        raise located(f"{where}, key {key}", value, wanted)
    return value
