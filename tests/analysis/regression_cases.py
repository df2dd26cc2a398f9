"""Studies for the tests of the regression: drawn from a mixed model, or lme4's data as an event log."""

from __future__ import annotations

from functools import cache

import numpy as np
import pandas as pd
from scipy.special import expit

from tests.analysis.report_cases import log_of

LETTERS = {"H": "robot_needs_help", "R": "human_needs_help"}


def log_of_rows(frame):
    """Event log of rows ``Subject, sequence (letters), round (from 1), signal, robot_help, help``."""
    runs = []
    for person, rows in frame.groupby("Subject", sort=True):
        first = rows.iloc[0]
        helped = {row.round: row.help for row in rows.itertuples()}
        events = []
        for k, letter in enumerate(first.sequence, start=1):
            if letter == "R":
                events.append(("help" if first.robot_help else "no_help", "none"))
            else:
                seen = "missing" if k not in helped else "help" if helped[k] else "no_help"
                events.append(("signal" if first.signal else "no_signal", seen))
        condition = f"{'help' if first.robot_help else 'no-help'}+{'signal' if first.signal else 'no-signal'}"
        runs.append((int(person), 0, condition, events))
    return log_of(runs)


@cache
def mixed_study(people=200, intercept=0.5, signal=0.4, robot_help=1.5, sd=1.2, interaction=0.0, seed=1):
    """A study drawn from the mixed model itself, on four schedules and the four conditions."""
    rng = np.random.default_rng(seed)
    schedules = ("RRHHH", "HRRHH", "RHRHH", "HRHRH")
    rows = []
    for person in range(1, people + 1):
        a, b, letters = person % 2, person // 2 % 2, schedules[person // 4 % 4]
        eta = intercept + signal * a + robot_help * b + interaction * a * b + sd * rng.standard_normal()
        for k, letter in enumerate(letters, start=1):
            if letter == "H":
                rows.append((person, letters, k, a, b, int(rng.random() < expit(eta))))
    columns = ["Subject", "sequence", "round", "signal", "robot_help", "help"]
    return log_of_rows(pd.DataFrame(rows, columns=columns))
