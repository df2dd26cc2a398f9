"""Comparing groups two by two: Tukey's honest differences, and Dunnett's comparisons with one reference.

Both take **one value a person**. Rows of the same person are not independent, and a test that is fed all of them
finds differences that are not there; so a table with a person in two rows is refused.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.stats import studentized_range

from analysis.anova import LEVEL
from analysis.dunnett import dunnett_critical, dunnett_tail
from analysis.repeated_measures import RepeatedMeasures, check_columns, labels, numbers, row_name
from models.errors import InputError, Phrase, located
from models.notebook_view import NotebookView

Array = NDArray[np.float64]


@dataclass(frozen=True)
class PersonValues:
    """One value a person, and the person's group.

    Attributes
    ----------
    value : float64[person]
    group : int64[person]
        Index into `groups`.
    groups : tuple of str
    what : str
        What the value is, for sentences.
    between : str
        Name of the factor.
    """

    value: Array
    group: NDArray[np.int64]
    groups: tuple[str, ...]
    what: str
    between: str = "group"

    @classmethod
    def at(cls, data: RepeatedMeasures, time: str | None = None) -> PersonValues:
        """The values at one time, the last by default."""
        time = data.times[-1] if time is None else time
        if time not in data.times:
            raise located(f"column {data.within}", Phrase(", ".join(data.times)), f"also {time!r}, as asked for")
        value = data.score[:, data.times.index(time)]
        return cls(value, data.group, data.groups, f"{data.dv} at {data.within} {time}", data.between)

    @classmethod
    def mean(cls, data: RepeatedMeasures) -> PersonValues:
        """Everybody's mean over the times."""
        what = f"mean {data.dv} over {len(data.times)} values of {data.within}"
        return cls(data.score.mean(axis=1), data.group, data.groups, what, data.between)

    @classmethod
    def from_frame(
        cls, frame: pd.DataFrame, *, dv: str, between: str, subject: str, place: str = "table"
    ) -> PersonValues:
        """Take a table with one row a person.

        Raises
        ------
        InputError
            For unknown columns, a person in several rows, missing values, or one group only.
        """
        check_columns(frame, {"dv": dv, "between": between, "subject": subject}, place)
        who, people = labels(frame[subject], place)
        again = pd.Series(who).duplicated().to_numpy()
        if again.any():
            i = int(np.argmax(again))
            raise located(
                row_name(frame, i, place), Phrase(f"{subject} {people[who[i]]} again"),
                "one row a person: rows of the same person are not independent, and comparing groups as if they "
                "were gives p values that are too small; choose the final time or everybody's mean",
            )  # fmt: skip
        value = numbers(frame[dv], place)
        if np.isnan(value).any():
            i = int(np.argmax(np.isnan(value)))
            raise located(f"{row_name(frame, i, place)}, column {dv}", Phrase("no value"), "a number")
        group, groups = labels(frame[between], place)
        if len(groups) < 2:
            raise located(f"{place}, column {between}", Phrase(f"one level ({groups[0]})"), "at least two levels")
        return cls(value, group, groups, dv, between)

    def summary(self) -> tuple[Array, Array, float, int]:
        """Sizes and means of the groups, pooled variance within them, its degrees of freedom.

        Raises
        ------
        InputError
            Where nobody differs from others of the same group.
        """
        size = np.bincount(self.group, minlength=len(self.groups)).astype(np.float64)
        df = len(self.value) - len(size)
        if df < 1:
            raise located(self.what, Phrase(f"{len(self.value)} people in {len(size)} groups"), "more people")
        centre = float(self.value.mean())
        y = self.value - centre
        mean = np.bincount(self.group, y, minlength=len(size)) / size
        squares = float(np.square(y - mean[self.group]).sum())
        if squares <= 1e-22 * float(np.square(self.value).sum()):
            raise InputError(
                f"{self.what}: found one value for all people of the same {self.between}, wanted some that differ"
            )
        return size, mean + centre, squares / df, df


@dataclass(frozen=True)
class Comparisons(NotebookView):
    """Groups compared two by two.

    Attributes
    ----------
    table : DataFrame
        One row a comparison: ``group, reference, difference`` (mean of group minus mean of reference),
        ``standard_error, df, t``, ``low, high`` (simultaneous intervals), ``p`` (adjusted).
    method : {"Tukey", "Dunnett"}
    what : str
    level : float
    """

    table: pd.DataFrame
    method: str
    what: str
    level: float

    @property
    def sentence(self) -> str:
        """Which comparisons differ."""
        alpha = 1 - self.level
        sure = self.table[self.table["p"] < alpha]
        told = [
            f"{r.group} - {r.reference} {r.difference:+.3g} ({r.low:.3g} to {r.high:.3g})"
            for r in sure.itertuples()
        ]
        found = f"{len(sure)} of {len(self.table)} comparisons differ at {alpha:.2g}"
        return f"{self.method}, {self.what}, one value a person: {found}{': ' + '; '.join(told) if told else ''}."


def tukey(people: PersonValues, level: float = LEVEL) -> Comparisons:
    """Compare all pairs of groups (Tukey; with unequal sizes Tukey and Kramer).

    Parameters
    ----------
    people : PersonValues
    level : float
        Of all intervals together.
    """
    _check_level(level)
    size, mean, variance, df = people.summary()
    k = len(size)
    critical = float(studentized_range.ppf(level, k, df)) / np.sqrt(2)
    pairs = [(j, i) for i, j in combinations(range(k), 2)]
    rows = [_row(people, pair, (size, mean, variance, df), critical) for pair in pairs]
    table = pd.DataFrame(rows)
    table["p"] = np.clip(studentized_range.sf(np.abs(table["t"]) * np.sqrt(2), k, df), 0.0, 1.0)
    return Comparisons(table, "Tukey", people.what, level)


def dunnett(people: PersonValues, reference: str, level: float = LEVEL) -> Comparisons:
    """Compare every group with one reference (Dunnett, two-sided, groups of any sizes).

    Parameters
    ----------
    people : PersonValues
    reference : str
        One of the groups.
    level : float
        Of all intervals together.

    Raises
    ------
    InputError
        For an unknown reference.
    """
    _check_level(level)
    if reference not in people.groups:
        raise located(f"reference level of {people.between}", reference, f"one of {', '.join(people.groups)}")
    size, mean, variance, df = people.summary()
    r = people.groups.index(reference)
    others = [g for g in range(len(size)) if g != r]
    critical = dunnett_critical(level, size[others], float(size[r]), df)
    table = pd.DataFrame([_row(people, (g, r), (size, mean, variance, df), critical) for g in others])
    table["p"] = [dunnett_tail(abs(t), size[others], float(size[r]), df) for t in table["t"]]
    return Comparisons(table, "Dunnett", people.what, level)


def _row(
    people: PersonValues, pair: tuple[int, int], summary: tuple[Array, Array, float, int], critical: float
) -> dict[str, object]:
    size, mean, variance, df = summary
    a, b = pair
    difference = float(mean[a] - mean[b])
    error = float(np.sqrt(variance * (1 / size[a] + 1 / size[b])))
    return {
        "group": people.groups[a], "reference": people.groups[b], "difference": difference, "standard_error": error,
        "df": df, "t": difference / error,
        "low": difference - critical * error, "high": difference + critical * error,
    }  # fmt: skip


def _check_level(level: float) -> None:
    if not 0 < level < 1:
        raise located("level", level, "between 0 and 1")
