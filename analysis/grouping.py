"""Groups of people from the command line: by condition, or by a column of a file about people."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from models.errors import InputError, Phrase, located
from models.event_rules import one_of
from models.events import EventLog
from models.groups import MANY_GROUPS, Groups
from models.text_files import limited_bytes

BY_CONDITION = "condition"

MOST_GROUPS = 100
"""Groups by a covariate above which it is refused, whatever the number of people."""

PEOPLE_A_GROUP = 10
"""People there must be for each group by a covariate, on average, where there are more than a few groups."""


def groups_from(text: str, differ: str, log: EventLog) -> Groups:
    """Read ``--group``.

    Parameters
    ----------
    text : str
        ``condition``, or ``FILE.csv:COLUMN`` with columns ``participant`` and COLUMN.
    differ : str
        Tables that differ, separated by commas.
    log : EventLog

    Raises
    ------
    InputError
        On a file that cannot be read, a column that is not there or is no category, people without a value or with
        two.
    """
    tables = tuple(part.strip() for part in differ.split(",") if part.strip())
    if text == BY_CONDITION:
        return Groups.by_condition(log, tables)
    name, _, column = text.rpartition(":")
    if not name or not column:
        raise located("--group", text, "condition, or FILE.csv:COLUMN with columns participant and COLUMN")
    return from_file(Path(name), column, tables, log)


def from_file(path: Path, column: str, differ: Sequence[str], log: EventLog) -> Groups:
    """Groups by a column of a CSV file with one row a participant.

    Raises
    ------
    InputError
        Also if the column has so many values that it is a number rather than a category.
    """
    if not path.is_file():
        raise InputError(f"--group: {path}: no such file")
    try:
        frame = pd.read_csv(io.BytesIO(limited_bytes(path)), dtype=str, keep_default_na=False)
    except (OSError, ValueError, pd.errors.ParserError, pd.errors.EmptyDataError) as error:
        if isinstance(error, InputError):
            raise
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"--group: {path}: not a CSV file that can be read ({reason})") from None
    for wanted in ("participant", column):
        if wanted not in frame.columns:
            raise located(f"{path}, column", wanted, one_of([str(c) for c in frame.columns]))
    value: dict[int, str] = {}
    for row, (who, what) in enumerate(zip(frame["participant"], frame[column], strict=True), start=2):
        try:
            participant = int(who)
        except ValueError:
            raise located(f"{path}, line {row}, participant", who, "an integer") from None
        if not isinstance(what, str):
            raise located(f"{path}, line {row}", Phrase("fewer fields than the header"), "as many")
        if not what.strip():
            continue  # no value: an error only if this participant is in the log
        if value.setdefault(participant, what.strip()) != what.strip():
            raise located(
                f"{path}, line {row}, {column} of participant {participant}", what,
                f"{value[participant]!r}, as in an earlier line",
            )  # fmt: skip
    try:
        groups = Groups.by_person(log, value, column, differ)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    people = len(np.unique(log.participant))
    most = min(MOST_GROUPS, max(MANY_GROUPS, people // PEOPLE_A_GROUP))
    if groups.n > most:
        raise located(
            f"{path}, {column}, different values", groups.n,
            f"at most {most} for {people} people: every value is a group, so cut numbers into a few classes first",
        )  # fmt: skip
    return groups
