"""The raw difference between randomised arms, and when there are none.

Conditions in which the robot's action in every mode is constant are arms: people who were always helped against
people who never were. Where the action varies within a condition it may answer to what people did, and a difference
of rates says nothing about effects.
"""

from __future__ import annotations

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis import response_rates as rates
from models.events import EventLog


def arms(log: EventLog) -> NDArray[np.int64]:
    """Constant action of each condition in each mode, ``[condition, mode]``; -1: it varies, -2: unseen."""
    p = log.protocol
    out = np.full((len(log.conditions), len(p.modes)), -2, dtype=np.int64)
    mode = np.asarray(p.mode_of_action)[log.action]
    condition = log.condition[log.run_of_event]
    for c, m in np.ndindex(out.shape):
        used = np.unique(log.action[(condition == c) & (mode == m)])
        if len(used):
            out[c, m] = used[0] if len(used) == 1 else -1
    return out


def why_not_randomised(log: EventLog, mode: str) -> str:
    """Why the log has no randomised arms for a mode; empty if it has."""
    table = arms(log)
    m = log.protocol.mode_names.index(mode)
    varying = [name for name, row in zip(log.conditions, table, strict=True) if -1 in row]
    if varying:
        which = "every condition" if len(varying) == len(log.conditions) else f"condition {', '.join(varying)}"
        return (
            f"in {which} the action varies within a person and may answer to what people did before, so no raw "
            "difference is shown and the model's contrast is no estimate of an effect"
        )
    if len(np.unique(table[:, m][table[:, m] >= 0])) < 2:
        return "all conditions have the same action, so there is nothing to compare it with"
    return ""


def answering(log: EventLog) -> tuple[str, ...]:
    """Modes whose action varies within a person, so that it may answer to what people did: nobody assigned it."""
    varies = (arms(log) == -1).any(axis=0)
    return tuple(name for name, own in zip(log.protocol.mode_names, varies, strict=True) if own)


def arm_differences(log: EventLog, null: str, action: str, level: float) -> pd.DataFrame | None:
    r"""Difference of the response measure between the arms that always and never take an action.

    Arms are compared within strata of equal actions in the other modes, :math:`\sum_h w_h (r_{h1} - r_{h0})` with
    weights by recorded responses. Intervals combine those of the rates, which know that people repeat
    (`analysis.response_rates`), by the square-and-add method of Zou and Donner (2008), good up to rates of 0 and 1.

    Parameters
    ----------
    log : EventLog
        With constant actions (`why_not_randomised`).
    null, action : str
        Of one mode.
    level : float

    Returns
    -------
    DataFrame or None
        Indexed by round as text and ``all``, columns ``raw, raw_low, raw_high``; None if no stratum has both arms.
    """
    p = log.protocol
    table = arms(log)
    m = p.mode_of_action[p.action(action)]
    own = table[:, m]
    _, stratum = np.unique(np.delete(table, m, axis=1), axis=0, return_inverse=True)
    stratum = stratum.ravel()
    on, off = (np.unique(stratum[own == p.action(a)]) for a in (action, null))
    both = np.intersect1d(on, off)
    chosen = np.isin(stratum, both) & np.isin(own, [p.action(action), p.action(null)])
    if not len(both):
        return None
    part = log.select(conditions=[c for c, ok in zip(log.conditions, chosen, strict=True) if ok])
    condition = np.flatnonzero(chosen)[part.condition[part.run_of_event]]
    keys = {"stratum": stratum[condition], "acts": own[condition] == p.action(action)}
    by_round = rates.response_rates(part, {"round": part.k, **keys}, level)
    pooled = rates.response_rates(part, keys, level)
    out = {str(k): _difference(rows) for k, rows in by_round.groupby("round")}
    out["all"] = _difference(pooled)
    return pd.DataFrame(out, index=["raw", "raw_low", "raw_high"]).T


def _difference(rows: pd.DataFrame) -> tuple[float, float, float]:
    acts, never = (rows[rows["acts"] == flag].set_index("stratum") for flag in (True, False))
    both = acts.index.intersection(never.index)
    if not len(both):
        return np.nan, np.nan, np.nan
    acts, never = acts.loc[both], never.loc[both]
    weight = (acts["responses"] + never["responses"]).to_numpy(dtype=np.float64)
    weight = weight / weight.sum()
    value = float(weight @ (acts["rate"] - never["rate"]))
    (a, a_low, a_high), (b, b_low, b_high) = (
        side[["rate", "low", "high"]].to_numpy(dtype=np.float64).T for side in (acts, never)
    )
    down = np.sqrt(np.sum(weight**2 * ((a - a_low) ** 2 + (b_high - b) ** 2)))
    up = np.sqrt(np.sum(weight**2 * ((a_high - a) ** 2 + (b - b_low) ** 2)))
    return value, value - float(down), value + float(up)
