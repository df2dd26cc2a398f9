"""How people responded, by any grouping: shares or mean scores with intervals that know people repeat.

With two responses the measure is the share of the one with the higher score (published protocol: the help rate);
with more it is the mean response score. One person usually gives several responses, which are not independent, so
the intervals use the spread *between people*, not the number of responses.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy import stats

from models.errors import located
from models.events import EventLog
from models.histories import UNSEEN
from models.protocol import Protocol

Array = NDArray[np.float64]

LEVEL = 0.95
"""Level of every interval of a response rate."""


def is_share(protocol: Protocol) -> bool:
    """Whether responses are summarised as a share (two responses) rather than a mean score."""
    return protocol.n_responses == 2


def high_response(protocol: Protocol) -> str:
    """Name of the response with the highest score (the last declared among equals)."""
    best = max(range(protocol.n_responses), key=lambda i: (protocol.scores[i], i))
    return protocol.response_names[best]


def measure_name(protocol: Protocol) -> str:
    """What `rate` columns hold, for axes and headings.

    Examples
    --------
    >>> from models.protocol import PUBLISHED
    >>> measure_name(PUBLISHED)
    'help rate'
    """
    return f"{high_response(protocol).replace('_', ' ')} rate" if is_share(protocol) else "mean response score"


def measure_range(protocol: Protocol) -> tuple[float, float]:
    """Smallest and largest value the measure can take."""
    return (0.0, 1.0) if is_share(protocol) else (min(protocol.scores), max(protocol.scores))


def value_of_response(protocol: Protocol) -> Array:
    """Number each response counts as in the measure; shape ``[o]``."""
    if is_share(protocol):
        return np.array([float(name == high_response(protocol)) for name in protocol.response_names])
    return np.asarray(protocol.scores, dtype=np.float64)


def response_rates(log: EventLog, by: Mapping[str, NDArray[Any]], level: float = LEVEL) -> pd.DataFrame:
    r"""Share or mean score of the recorded responses in every group.

    Parameters
    ----------
    log : EventLog
    by : mapping of str to array[events]
        Grouping columns; empty for one row over everything.
    level : float
        Of the interval.

    Returns
    -------
    DataFrame
        One row a group that has a recorded response, sorted, with the columns of `by` and

        ``responses``, ``people`` : recorded responses, and people who gave them.
        ``rate`` : share or mean score (`measure_name`).
        ``low``, ``high`` : for a share the Wilson interval with :math:`\hat p (1 - \hat p) / v` in place of the
        sample size and the t quantile in place of the normal one, where :math:`v` is the variance of
        :math:`\hat p` between people (plain Wilson where each person gave one response, and on the number of
        people where everybody gave the same); for a score a t interval with :math:`v`. Both with one degree of
        freedom less than people. Not to be trusted for a handful of people.
    """
    if not 0 < level < 1:
        raise located("response rates, level", level, "between 0 and 1")
    seen = log.response != UNSEEN
    keys = list(by)
    frame = pd.DataFrame({key: np.asarray(values)[seen] for key, values in by.items()})
    frame["person"] = log.participant[log.run_of_event][seen]
    frame["value"] = value_of_response(log.protocol)[log.response[seen]]
    grouped = keys or ["everything"]
    if not keys:
        frame["everything"] = "all"
    people = frame.groupby([*grouped, "person"], observed=True, sort=True)["value"].agg(["sum", "count"])
    people = people.reset_index()
    totals = people.groupby(grouped, observed=True, sort=True)[["sum", "count"]].transform("sum")
    people["square"] = (people["sum"] - people["count"] * totals["sum"] / totals["count"]) ** 2
    table = people.groupby(grouped, observed=True, sort=True).agg(
        responses=("count", "sum"), people=("person", "size"), total=("sum", "sum"), square=("square", "sum")
    )
    table = table.reset_index()
    n = table["responses"].to_numpy(dtype=np.float64)
    persons = table["people"].to_numpy(dtype=np.float64)
    rate = table["total"].to_numpy(dtype=np.float64) / n
    variance = table["square"].to_numpy(dtype=np.float64) / n**2
    variance *= persons / np.maximum(persons - 1, 1)  # the rate itself was estimated from these people
    if is_share(log.protocol):
        low, high = _wilson(rate, *_effective_size(rate, n, persons, variance, level))
    else:
        low, high = _t_interval(rate, persons, variance, level)
    table = table.assign(rate=rate, low=low, high=high)
    return table[[*keys, "responses", "people", "rate", "low", "high"]]


def _effective_size(rate: Array, n: Array, people: Array, variance: Array, level: float) -> tuple[Array, Array]:
    """Number of independent responses that would be as certain, and the quantile to use with it."""
    spread = (variance > 0) & (people < n)
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.where(variance > 0, rate * (1 - rate) / variance, people)
    # Never more than the responses themselves: a chance negative correlation within people is not information.
    size = np.where(people == n, n, np.minimum(size, n))
    normal = stats.norm.ppf(0.5 + level / 2)
    return size, np.where(spread, stats.t.ppf(0.5 + level / 2, np.maximum(people - 1, 1)), normal)


def _wilson(rate: Array, n: Array, z: Array) -> tuple[Array, Array]:
    centre = (rate + z**2 / (2 * n)) / (1 + z**2 / n)
    half = z / (1 + z**2 / n) * np.sqrt(rate * (1 - rate) / n + z**2 / (4 * n**2))
    return np.clip(centre - half, 0, rate), np.clip(centre + half, rate, 1)


def _t_interval(rate: Array, people: Array, variance: Array, level: float) -> tuple[Array, Array]:
    half = stats.t.ppf(0.5 + level / 2, np.maximum(people - 1, 1)) * np.sqrt(np.where(people > 1, variance, np.nan))
    return rate - half, rate + half
