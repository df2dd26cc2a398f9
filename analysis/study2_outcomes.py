"""What study 2 measures: outcomes by round, means with intervals, first and last as repeated measures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import special

from analysis.posthoc import PersonValues
from analysis.power_curves import wilson_interval
from analysis.printed_anova import MEASURES
from analysis.repeated_measures import RepeatedMeasures
from analysis.study2 import Study2
from analysis.study2_policies import NEVER
from models.errors import Phrase, located

Array = NDArray[np.float64]

LEVEL = 0.95
TIMES = ("first", "last")


@dataclass(frozen=True)
class Outcome:
    """One measure of the study.

    Attributes
    ----------
    key : str
        As in the printed numbers, where it is printed.
    name : str
    unit : str
        What an axis says.
    values : callable
        From a study to ``[person, round measured]``.
    summary : {"mean", "last"}
        The one value a person that policies are compared by: the mean over rounds, or the last.
    shown_only : bool
        Measured only in rounds that show a response.
    """

    key: str
    name: str
    unit: str
    values: Callable[[Study2], Array]
    summary: str = "mean"
    shown_only: bool = False

    def rounds(self, study: Study2) -> NDArray[np.int64]:
        """Rounds at which it is measured, from 0."""
        return study.shows if self.shown_only else np.arange(study.n_rounds)

    def of_person(self, study: Study2) -> Array:
        """One value a person."""
        values = self.values(study)
        return np.asarray(values[:, -1] if self.summary == "last" else values.mean(axis=1))

    @property
    def summary_words(self) -> str:
        """What that value is."""
        return f"{self.name} at the end" if self.summary == "last" else f"mean {self.name}"


TEAM, OBSERVED, CUMULATIVE = MEASURES
BELIEF = "belief"

OUTCOMES = {
    o.key: o
    for o in (
        Outcome(TEAM, MEASURES[TEAM], "tokens of both in a round", lambda s: s.team),
        Outcome(CUMULATIVE, MEASURES[CUMULATIVE], "tokens of both so far", lambda s: s.cumulative, "last"),
        Outcome(BELIEF, "believed state", "expected index of the state", lambda s: s.believed_state),
        Outcome(OBSERVED, MEASURES[OBSERVED], "share of people who help", lambda s: s.helped, shown_only=True),
    )
}
"""The paper's four outcomes, in the order of its text."""

SHORT = {TEAM: "tokens a round", CUMULATIVE: "tokens in all", BELIEF: "believed state", OBSERVED: "observed help"}
"""The outcomes in narrow columns: one value a person."""


def outcome(key: str) -> Outcome:
    """An outcome by its key.

    Raises
    ------
    InputError
        If there is none.
    """
    if key not in OUTCOMES:
        raise located("outcome", key, f"one of {', '.join(OUTCOMES)}")
    return OUTCOMES[key]


def first_and_last(study: Study2, key: str) -> RepeatedMeasures:
    """An outcome at its first and last round, policy between people.

    Raises
    ------
    InputError
        On an unknown outcome, or a study in which it is measured once only.
    """
    own = outcome(key)
    values = own.values(study)
    if values.shape[1] < 2:
        raise located(f"{own.name}, rounds", Phrase(study.letters), "at least two at which it is measured")
    return RepeatedMeasures(
        np.ascontiguousarray(values[:, [0, -1]]), study.policy, tuple(map(str, range(1, study.n_people + 1))),
        study.policies, TIMES, dv=own.name, between="policy", within="time", subject="participant",
        times_by="asked",
    )  # fmt: skip


def person_values(study: Study2, key: str, at: str | None = None) -> PersonValues:
    """One value a person.

    Parameters
    ----------
    study : Study2
    key : str
    at : {"first", "last"}, optional
        The value at that round instead of the outcome's own summary.
    """
    own = outcome(key)
    if at is not None:
        return PersonValues.at(first_and_last(study, key), at)
    return PersonValues(own.of_person(study), study.policy, study.policies, own.summary_words, "policy")


def by_round(study: Study2, key: str, level: float = LEVEL) -> pd.DataFrame:
    """An outcome round by round.

    Returns
    -------
    DataFrame
        ``policy, round`` (from 1), ``n, mean, low, high``: t intervals of each policy's mean, but Wilson's for a
        share, whose t interval is empty where everybody does the same.
    """
    own = outcome(key)
    values, rounds = own.values(study), own.rounds(study)
    rows = []
    for policy in study.policies:
        part = values[study.of(policy)]
        for k, column in zip(rounds, part.T, strict=True):
            low, high = _wilson(column, level) if own.shown_only else _t(column, level)
            row = {"policy": policy, "round": int(k) + 1, "n": len(column), "mean": float(column.mean())}
            rows.append({**row, "low": low, "high": high})
    return pd.DataFrame(rows)


def relative_to(study: Study2, key: str, reference: str = NEVER, level: float = LEVEL) -> pd.DataFrame:
    """An outcome less its mean under a reference policy, round by round, as the paper draws cumulative tokens.

    Returns
    -------
    DataFrame
        As `by_round`; intervals of the difference of two means (Welch). The reference has zero and no interval.

    Raises
    ------
    InputError
        If the reference is not among the study's policies.
    """
    if reference not in study.policies:
        raise located("reference policy", reference, f"one of {', '.join(study.policies)}")
    own = outcome(key)
    values = own.values(study)
    base = values[study.of(reference)]
    rows = []
    for policy in study.policies:
        part = values[study.of(policy)]
        for j, k in enumerate(own.rounds(study)):
            a, b = part[:, j], base[:, j]
            mean = float(a.mean() - b.mean())
            half = 0.0 if policy == reference else _welch(a, b, level)
            row = {"policy": policy, "round": int(k) + 1, "n": len(a), "mean": mean}
            rows.append({**row, "low": mean - half, "high": mean + half})
    return pd.DataFrame(rows)


def means(study: Study2, level: float = LEVEL) -> pd.DataFrame:
    """Every outcome under every policy, one value a person, and what the robot did.

    Returns
    -------
    DataFrame
        ``outcome, policy, n, mean, sd, low, high`` (t intervals), ``first, last``: means of the first and the last
        round at which it is measured, NaN for costly actions and reward.
    """
    rows = []
    columns: list[tuple[str, Array, Array | None]] = [
        (o.key, o.of_person(study), o.values(study)) for o in OUTCOMES.values()
    ]
    columns += [
        ("top_state_probability", study.believed_top.mean(axis=1), study.believed_top),
        ("costly_actions", study.costly, None), ("reward", study.reward, None),
    ]  # fmt: skip
    for name, values, rounds in columns:
        for policy in study.policies:
            own = study.of(policy)
            v = values[own]
            low, high = _t(v, level)
            ends: dict[str, Any] = {"first": np.nan, "last": np.nan}
            if rounds is not None:
                ends = {"first": float(rounds[own, 0].mean()), "last": float(rounds[own, -1].mean())}
            rows.append(
                {
                    "outcome": name, "policy": policy, "n": len(own), "mean": float(v.mean()),
                    "sd": float(v.std(ddof=1)), "low": low, "high": high, **ends,
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def _t(values: Array, level: float) -> tuple[float, float]:
    n, mean = len(values), float(values.mean())
    half = float(special.stdtrit(n - 1, (1 + level) / 2)) * float(values.std(ddof=1)) / np.sqrt(n)
    return mean - half, mean + half


def _wilson(values: Array, level: float) -> tuple[float, float]:
    low, high = wilson_interval(np.array([values.sum()]), len(values), level)
    return float(low[0]), float(high[0])


def _welch(a: Array, b: Array, level: float) -> float:
    """Half the width of the interval of a difference of means."""
    va, vb = a.var(ddof=1) / len(a), b.var(ddof=1) / len(b)
    if va + vb == 0:
        return 0.0
    df = (va + vb) ** 2 / (va**2 / (len(a) - 1) + vb**2 / (len(b) - 1))
    return float(special.stdtrit(df, (1 + level) / 2)) * float(np.sqrt(va + vb))
