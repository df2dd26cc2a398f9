"""A study's responses as repeated measures: every person's first and last recorded response, by condition.

It is the smallest mixed design in a study that records several responses a person: the condition between people,
first and last within. With several runs a person the values are means over runs.
"""

from __future__ import annotations

import numpy as np
import pandas as pd

from analysis import response_rates as rates
from analysis.randomised_arms import arms
from analysis.repeated_measures import RepeatedMeasures
from models.events import EventLog
from models.histories import UNSEEN

TIMES = ("first", "last")


def first_and_last(log: EventLog) -> RepeatedMeasures:
    """First and last response of every person, averaged over runs that recorded at least two.

    Raises
    ------
    InputError
        With one condition, people in several conditions, or too little variation to analyse.

    Examples
    --------
    >>> from analysis.datasets import load
    >>> first_and_last(load("simulated_study1").log).score.shape
    (540, 2)
    """
    seen = np.flatnonzero(log.response != UNSEEN)
    run = log.run_of_event[seen]
    value = rates.value_of_response(log.protocol)[log.response[seen]]
    found, start, count = np.unique(run, return_index=True, return_counts=True)
    person, condition = log.participant[found], np.asarray(log.conditions)[log.condition[found]]
    first, last = value[start], np.where(count > 1, value[start + count - 1], np.nan)
    first = np.where(count > 1, first, np.nan)
    measure = rates.high_response(log.protocol) if rates.is_share(log.protocol) else "score"
    frame = pd.concat(
        pd.DataFrame({"participant": person, "condition": condition, "response": name, measure: column})
        for name, column in zip(TIMES, (first, last), strict=True)
    )
    means = frame.groupby(["participant", "condition", "response"], sort=False)[measure].mean().reset_index()
    return RepeatedMeasures.from_frame(
        means, dv=measure, between="condition", within="response", subject="participant", times=TIMES,
        place="responses",
    )  # fmt: skip


def plain_condition(log: EventLog) -> str | None:
    """The condition in which the robot never does more than nothing, if there is one.

    Examples
    --------
    >>> from analysis.datasets import load
    >>> plain_condition(load("simulated_study1").log)
    'no-help+no-signal'
    """
    nothing = [log.protocol.action(mode.null_action) for mode in log.protocol.modes]
    table = arms(log)
    plain = [name for name, row in zip(log.conditions, table, strict=True) if list(row) == nothing]
    return plain[0] if len(plain) == 1 else None
