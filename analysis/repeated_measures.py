"""Repeated measures as a matrix: every person once, in one group, measured at every time.

A table with one row a person and time becomes ``score[person, time]``. What cannot become one is refused: two rows
for the same person and time, a person in two groups, a value that is no number. A person without a value at some
time cannot enter a mixed ANOVA: he or she is left out and named, or the table is refused.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.wording import counted
from models.errors import Phrase, located

Array = NDArray[np.float64]
Missing = Literal["drop", "refuse"]
TimesBy = Literal["asked", "value", "category", "appearance"]

ABSENT = ("", "NA", "NaN", "nan")
"""Spellings of a missing value in text."""

LARGEST = 1e140
"""Largest absolute value of a measure: the squares of sums of more would overflow."""

NAMED = 10
"""People named one by one when they are left out; the rest are counted."""


@dataclass(frozen=True)
class RepeatedMeasures:
    """People by times, and the group of each person.

    Attributes
    ----------
    score : float64[person, time]
    group : int64[person]
        Index into `groups`.
    people, groups, times : tuple of str
        Labels. Groups and times are in ascending order where all are numbers, else in order of appearance (or of
        their categories, or as asked for).
    times_by : {"asked", "value", "category", "appearance"}
        Which of these gave the order of the times.
    left_out : tuple of str
        People left out because a time is missing.
    unused_rows : int
        Rows at times that were not asked for.
    dv, between, within, subject : str
        Names of the columns.
    """

    score: Array
    group: NDArray[np.int64]
    people: tuple[str, ...]
    groups: tuple[str, ...]
    times: tuple[str, ...]
    left_out: tuple[str, ...] = ()
    unused_rows: int = 0
    dv: str = "score"
    between: str = "group"
    within: str = "time"
    subject: str = "person"
    times_by: TimesBy = "value"

    @property
    def group_sizes(self) -> NDArray[np.int64]:
        """People in each group, ``[group]``."""
        return np.bincount(self.group, minlength=len(self.groups))

    @property
    def balanced(self) -> bool:
        """Whether all groups have the same size."""
        return len(set(self.group_sizes.tolist())) == 1

    @property
    def binary(self) -> bool:
        """Whether every value is 0 or 1."""
        return bool(np.isin(self.score, (0.0, 1.0)).all())

    @property
    def notes(self) -> tuple[str, ...]:
        """What was left out, and how times are ordered."""
        out = []
        if self.left_out:
            shown = ", ".join(self.left_out[:NAMED])
            more = f" and {len(self.left_out) - NAMED} more" if len(self.left_out) > NAMED else ""
            left = counted(len(self.left_out), "person", "people")
            out.append(f"Left out: {left} without a value at some time ({shown}{more}).")
        if self.unused_rows:
            out.append(f"{counted(self.unused_rows, 'row')} at other times not used.")
        if self.times_by == "appearance":
            out.append(
                f"Values of {self.within} are words and were taken in the order in which they first appear: "
                f"{', '.join(self.times)}. Where that is not their order in time, name them in order (times=..., "
                "--times at the command line)."
            )
        return tuple(out)

    @classmethod
    def from_frame(
        cls,
        frame: pd.DataFrame,
        *,
        dv: str,
        between: str,
        within: str,
        subject: str,
        times: Sequence[str] | None = None,
        missing: Missing = "drop",
        place: str = "table",
    ) -> RepeatedMeasures:
        """Bring a table with one row a person and time into this form.

        Parameters
        ----------
        frame : DataFrame
        dv, between, within, subject : str
            Different columns: the measure, the group, the time, the person.
        times : sequence of str, optional
            Which times are used, in this order; all by default.
        missing : {"drop", "refuse"}
            What happens where a person has no value at a time: the person is left out and named in `left_out`, or
            the table is refused.
        place : str
            Name of the table in messages.

        Raises
        ------
        InputError
            For unknown columns, values that are no numbers, a person in two groups, two rows for a person and time,
            a factor with one level, the same value everywhere, or too few people.
        """
        if missing not in ("drop", "refuse"):
            raise located("missing", missing, "'drop' or 'refuse'")
        roles = {"dv": dv, "between": between, "within": within, "subject": subject}
        check_columns(frame, roles, place)
        when, time_labels = labels(frame[within], place)
        times_by = _order_of(frame[within], time_labels)
        keep = np.ones(len(frame), bool)
        if times is not None:
            times_by = "asked"
            when, time_labels = _chosen(when, time_labels, [str(t).strip() for t in times], within, place)
            keep = when >= 0
        used = frame[keep]
        when = when[keep]
        who, people = labels(used[subject], place)
        group, groups = labels(used[between], place)
        for name, found in ((between, groups), (within, time_labels)):
            if len(found) < 2:
                raise located(f"{place}, column {name}", Phrase(f"one level ({found[0]})"), "at least two levels")
        group_of = _group_of_people(used, who, group, people, groups, place, subject, between)
        _refuse_repeats(who * len(time_labels) + when, used, place, (subject, within))
        score = np.full((len(people), len(time_labels)), np.nan)
        score[who, when] = numbers(used[dv], place)
        gaps = np.isnan(score)
        gone = gaps.any(axis=1)
        left_out = tuple(p for p, out in zip(people, gone, strict=True) if out)
        if gone.any() and missing == "refuse":
            person = int(np.argmax(gone))
            time = time_labels[int(np.argmax(gaps[person]))]
            raise located(
                f"{place}, {subject} {people[person]}", Phrase(f"no {dv} at {within} {time}"),
                f"a value at each of the {len(time_labels)} times ({len(left_out)} people lack one)",
            )  # fmt: skip
        data = cls(
            score[~gone], group_of[~gone], tuple(p for p, out in zip(people, gone, strict=True) if not out), groups,
            time_labels, left_out, int((~keep).sum()), dv, between, within, subject, times_by,
        )  # fmt: skip
        _check_usable(data, place)
        return data


def check_columns(frame: pd.DataFrame, roles: dict[str, str], place: str) -> None:
    """Refuse columns that are absent or have two roles."""
    seen: dict[str, str] = {}
    for role, name in roles.items():
        if name not in frame.columns:
            shown = Phrase(", ".join(map(str, frame.columns)))
            raise located(f"{place}, columns", shown, f"also {name!r} ({role})")
        if name in seen:
            raise located(f"{place}, {role}", name, f"another column than {seen[name]}")
        seen[name] = role
    if not len(frame):
        raise located(place, Phrase("no rows"), "at least one")


def row_name(frame: pd.DataFrame | pd.Series, position: int, place: str) -> str:
    """Where a row is: the file's line, or the row of the table."""
    return f"{place}, {frame.index.name or 'row'} {frame.index[position]}"


def labels(column: pd.Series, place: str) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    """Codes and labels of a factor; numbers are ordered by value, anything else as it appears.

    Raises
    ------
    InputError
        Where a label is missing.
    """
    categories = column.cat.categories if isinstance(column.dtype, pd.CategoricalDtype) else None
    absent = column.isna().to_numpy()
    text = column.astype(object).map(lambda value: "" if value is None else str(value).strip())
    absent = absent | text.isin(ABSENT).to_numpy()
    if absent.any():
        i = int(np.argmax(absent))
        raise located(f"{row_name(column, i, place)}, column {column.name}", Phrase("no value"), "a label")
    code, unique = pd.factorize(text)
    if categories is not None:
        order = [str(c).strip() for c in categories if str(c).strip() in set(unique)]
    else:
        value = _values_of(unique)
        order = list(unique if value is None else unique[np.argsort(value, kind="stable")])
    position = {label: i for i, label in enumerate(order)}
    rank = np.array([position[label] for label in unique], dtype=np.int64)
    return rank[code], tuple(str(label) for label in order)


def _values_of(text: Sequence[str]) -> Array | None:
    """Labels as numbers, None unless all are."""
    value = pd.to_numeric(pd.Series(list(text)), errors="coerce").to_numpy(dtype=float)
    return value if np.isfinite(value).all() else None


def _order_of(column: pd.Series, found: tuple[str, ...]) -> TimesBy:
    """What `labels` ordered a factor by."""
    if isinstance(column.dtype, pd.CategoricalDtype):
        return "category"
    return "appearance" if _values_of(found) is None else "value"


def numbers(column: pd.Series, place: str) -> Array:
    """Values of the measure; NaN where there is none.

    Raises
    ------
    InputError
        For text that is no number, and for infinity.
    """
    if pd.api.types.is_numeric_dtype(column.dtype):
        value = column.to_numpy(dtype=np.float64, na_value=np.nan)
        wrong = np.isinf(value)
    else:
        text = column.astype(object).map(lambda v: "" if v is None or v is pd.NA else str(v).strip())
        value = pd.to_numeric(text, errors="coerce").to_numpy(dtype=np.float64)
        wrong = (np.isnan(value) & ~text.isin(ABSENT).to_numpy()) | np.isinf(value)
    if wrong.any():
        i = int(np.argmax(wrong))
        raise located(f"{row_name(column, i, place)}, column {column.name}", column.iloc[i], "a finite number")
    return value


def _chosen(
    when: NDArray[np.int64], known: tuple[str, ...], wanted: list[str], within: str, place: str
) -> tuple[NDArray[np.int64], tuple[str, ...]]:
    for label in wanted:
        if label not in known:
            raise located(f"{place}, column {within}", Phrase(", ".join(known)), f"also {label!r}, as asked for")
    if len(set(wanted)) < len(wanted):
        raise located("times", Phrase(", ".join(wanted)), "different times")
    position = np.array([wanted.index(label) if label in wanted else -1 for label in known], dtype=np.int64)
    return position[when], tuple(wanted)


def _group_of_people(
    frame: pd.DataFrame,
    who: NDArray[np.int64],
    group: NDArray[np.int64],
    people: tuple[str, ...],
    groups: tuple[str, ...],
    place: str,
    subject: str,
    between: str,
) -> NDArray[np.int64]:
    first = np.zeros(len(people), dtype=np.int64)
    first[who[::-1]] = group[::-1]
    wrong = group != first[who]
    if wrong.any():
        i = int(np.argmax(wrong))
        raise located(
            f"{row_name(frame, i, place)}, column {between}", groups[group[i]],
            f"{groups[first[who[i]]]!r}, as before for {subject} {people[who[i]]}: a person is in one group",
        )  # fmt: skip
    return first


def _refuse_repeats(key: NDArray[np.int64], frame: pd.DataFrame, place: str, columns: tuple[str, str]) -> None:
    again = pd.Series(key).duplicated().to_numpy()
    if not again.any():
        return
    i = int(np.argmax(again))
    earlier = int(np.argmax(key == key[i]))
    subject, within = columns
    raise located(
        row_name(frame, i, place),
        Phrase(f"{subject} {frame[subject].iloc[i]} at {within} {frame[within].iloc[i]} again"),
        f"one row a {subject} and {within} (the first is {frame.index.name or 'row'} {frame.index[earlier]})",
    )


def _check_usable(data: RepeatedMeasures, place: str) -> None:
    for name, size in zip(data.groups, data.group_sizes, strict=True):
        if size == 0:
            found = Phrase("nobody with a value at every time")
            raise located(f"{place}, {data.between} {name}", found, "at least one person")
    if len(data.people) <= len(data.groups):
        raise located(
            place, Phrase(f"{len(data.people)} people in {len(data.groups)} groups"), "more people than groups"
        )
    if np.ptp(data.score) == 0:
        raise located(
            f"{place}, column {data.dv}", Phrase(f"{data.score[0, 0]:g} in every row"), "values that differ"
        )
    if np.abs(data.score).max() > LARGEST:
        largest = float(np.abs(data.score).max())
        raise located(f"{place}, column {data.dv}", largest, "smaller values: squares would overflow")
