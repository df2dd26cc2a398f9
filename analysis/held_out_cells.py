"""Which part of a study is left out, what is left to learn from, and over which responses rates are taken."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis import response_rates as rates
from models.errors import Phrase, located
from models.events import EventLog
from models.histories import UNSEEN, HistoryTree

Array = NDArray[np.float64]

BY = ("condition", "schedule", "condition+schedule")
"""What can be left out: a condition, a schedule (pattern of modes) in all conditions, or one in one condition."""

MOST_CELLS = 30
"""Cells beyond which nothing is left out: each is a refit of every contender."""

OVERALL, ROUND, CONDITION = "overall", "round", "condition"
"""Kinds of parts of a cell."""


@dataclass(frozen=True)
class Cell:
    """One part of a study that is left out.

    Attributes
    ----------
    name : str
    held : EventLog
        Its runs.
    rest : EventLog
        All runs of people who have no run in it: people are left out, not runs.
    unused : int
        Other runs of the people in it, which are in neither.
    """

    name: str
    held: EventLog
    rest: EventLog
    unused: int


def cell_of_run(log: EventLog, by: str) -> NDArray[np.object_]:
    """Name of the cell of each run.

    Raises
    ------
    InputError
        On an unknown `by`.
    """
    if by not in BY:
        raise located("held out", by, f"one of {', '.join(BY)}")
    condition = np.array(log.conditions, dtype=object)[log.condition]
    if by == "condition":
        return condition
    schedule = log.schedules()
    return schedule if by == "schedule" else condition + ", " + schedule


def cells_of(log: EventLog, by: str) -> tuple[list[Cell], list[tuple[str, str]]]:
    """Cells that can be left out and predicted, and those that cannot with the reason.

    Parameters
    ----------
    log : EventLog
    by : str
        One of `BY`.

    Raises
    ------
    InputError
        If there are fewer than two cells, more than `MOST_CELLS`, or none can be predicted.
    """
    cell = cell_of_run(log, by)
    names = sorted(set(cell))
    if len(names) < 2:
        raise located(
            f"held out by {by}, number of them", 1, f"at least 2: without {names[0]} nothing is left to learn from"
        )
    if len(names) > MOST_CELLS:
        raise located(
            f"held out by {by}, number of them", len(names), f"at most {MOST_CELLS}: each needs every model anew"
        )
    cells, skipped = [], []
    for name in names:
        inside = cell == name
        theirs = np.isin(log.participant, log.participant[inside])
        held = log.select(runs=inside)
        if held.n_responses_recorded == 0:
            skipped.append((name, "no response is recorded in it"))
        elif theirs.all():
            skipped.append((name, "everybody has a run in it, so nobody is left to learn from"))
        elif (rest := log.select(runs=~theirs)).n_responses_recorded == 0:
            skipped.append((name, "no response is recorded in the rest"))
        else:
            cells.append(Cell(name, held, rest, int(np.count_nonzero(theirs & ~inside))))
    if not cells:
        reasons = "; ".join(f"{name}: {reason}" for name, reason in skipped)
        raise located(f"held out by {by}", Phrase(reasons), "at least one that can be predicted from the rest")
    return cells, skipped


def distinct_designs(log: EventLog) -> tuple[EventLog, NDArray[np.int64]]:
    """One run for every distinct design, and how many runs have it.

    Runs have the same design if condition, actions and the rounds with a recorded response agree. What is expected
    of a run depends on nothing else.
    """
    recorded = np.where(log.response != UNSEEN, 0, UNSEEN).astype(np.int8)
    p = log.protocol
    tree = HistoryTree.build(log.offsets, log.action, recorded, p.n_actions, p.n_responses)
    key = log.condition.astype(np.int64) * tree.n_nodes + tree.run_node
    _, first, count = np.unique(key, return_index=True, return_counts=True)
    order = np.argsort(first)
    return log.select(runs=first[order]), count[order]


def earlier(log: EventLog, marked: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Whether an event was preceded, in its run, by a marked one."""
    upto = np.append(0, np.cumsum(marked))
    return upto[:-1] > upto[log.offsets[:-1]][log.run_of_event]


def parts_of(log: EventLog) -> list[tuple[str, str]]:
    """Kind and name of the parts of a cell: all of it, every round with responses, conditions if several."""
    seen = log.response != UNSEEN
    parts = [(OVERALL, "all")]
    parts += [(ROUND, str(k)) for k in np.unique(log.k[seen])]
    used = np.unique(log.condition[log.run_of_event[seen]])
    return parts + [(CONDITION, log.conditions[c]) for c in used if len(used) > 1]


def averaging(log: EventLog, parts: list[tuple[str, str]], weight: NDArray[np.int64] | None = None) -> Array:
    """Weights that turn values by event into means by part; ``[event, part]``, columns sum to one.

    Parameters
    ----------
    log : EventLog
    parts : list
        From `parts_of` of the same cell.
    weight : int64[runs], optional
        How often each run counts; once by default. Events without a recorded response count nothing.
    """
    counts = (log.response != UNSEEN).astype(np.float64)
    if weight is not None:
        counts *= weight[log.run_of_event]
    condition = log.condition_of_event
    masks = {
        OVERALL: lambda _: np.ones(log.n_events, dtype=bool),
        ROUND: lambda name: log.k == int(name),
        CONDITION: lambda name: condition == name,
    }
    out = np.stack([counts * masks[kind](name) for kind, name in parts], axis=1)
    return np.asarray(out / out.sum(axis=0))


def observed_rates(log: EventLog, parts: list[tuple[str, str]], level: float) -> pd.DataFrame:
    """Observed rate of every part with its own interval (`analysis.response_rates`), in the order of `parts`."""
    keys = {OVERALL: {}, ROUND: {ROUND: log.k.astype(str)}, CONDITION: {CONDITION: log.condition_of_event}}
    kinds = list(dict.fromkeys(kind for kind, _ in parts))
    tables = {kind: rates.response_rates(log, keys[kind], level) for kind in kinds}
    rows = [
        tables[kind].iloc[0] if kind == OVERALL else tables[kind].set_index(kind).loc[name] for kind, name in parts
    ]
    columns = {"responses": np.int64, "people": np.int64, "rate": float, "low": float, "high": float}
    return pd.DataFrame([[row[c] for c in columns] for row in rows], columns=list(columns)).astype(columns)
