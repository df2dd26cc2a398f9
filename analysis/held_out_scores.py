"""How predictions of what was left out are scored, and contenders ranked."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pandas as pd

from analysis.held_out_cells import OVERALL, ROUND
from models.parameters import Array


def crps(simulated: Array, observed: Array) -> Array:
    r"""Continuous ranked probability score of simulated values at the observed one, a column each.

    .. math:: E|X - y| - \tfrac12 E|X - X'|

    with the second mean over pairs of different simulated values (the *fair* form, unbiased in their number; Ferro
    2014), so a number just below zero is possible. It is a proper score in the unit of the values; smaller is
    better.

    Parameters
    ----------
    simulated : float64[n, quantity]
        At least two.
    observed : float64[quantity]

    Examples
    --------
    >>> crps(np.array([[0.0], [1.0]]), np.array([0.0]))
    array([0.])
    >>> crps(np.array([[0.2], [0.2]]), np.array([0.5]))
    array([0.3])
    """
    n = len(simulated)
    rank = 2 * np.arange(1, n + 1) - n - 1
    pairs = rank @ np.sort(simulated, axis=0) / (n * (n - 1))
    return np.asarray(np.abs(simulated - observed).mean(axis=0) - pairs)


def ranking(rates: pd.DataFrame, scores: pd.DataFrame, people: Mapping[str, Array]) -> pd.DataFrame:
    """One row a contender, best log score first.

    Parameters
    ----------
    rates, scores : DataFrame
        As in `analysis.held_out.HeldOut`.
    people : mapping of contender to float64[person]
        Log predictive of each person left out.

    Returns
    -------
    DataFrame
        ``contender, kind, cells``,
        ``log_score, log_score_error`` : joint log predictive of the people left out, summed over cells,
        ``log_score_diff`` : below the best (0 for it),
        ``dse`` : standard error of the difference to the best in each person's own log predictive, summed over
        people. A yardstick for ``log_score_diff``: it knows that other people might have been in the cells, not
        that other cells might have been in the study,
        ``error, crps`` : mean absolute error and mean CRPS of the cells' rates,
        ``round_crps`` : of the rates by round,
        ``inside, rounds_inside, rounds`` : observed rates in the predictive interval, cells and rounds,
        ``prior`` : cells in which something is the prior because the rest never showed it,
        ``gate`` : ``exact``, ``passed``, or ``failed`` with the number of cells.
    """
    names = list(dict.fromkeys(scores["contender"]))
    total = scores.groupby("contender")["log_score"].sum()
    best = max(names, key=lambda name: float(total[name]))
    rows = []
    for name in names:
        own, own_rates = scores[scores["contender"] == name], rates[rates["contender"] == name]
        whole, rounds = (own_rates[own_rates["part"] == part] for part in (OVERALL, ROUND))
        apart = people[name] - people[best]
        failed = int((own["gate"] == "failed").sum())
        rows.append(
            {
                "contender": name, "kind": own["kind"].iloc[0], "cells": len(own),
                "log_score": total[name],
                "log_score_error": float(np.sqrt((own["log_score_error"] ** 2).sum())),
                "log_score_diff": total[name] - total[best],
                "dse": float(np.sqrt(len(apart) * apart.var())),
                "error": whole["error"].abs().mean(), "crps": whole["crps"].mean(),
                "round_crps": rounds["crps"].mean(), "inside": int(whole["inside"].sum()),
                "rounds_inside": int(rounds["inside"].sum()), "rounds": len(rounds),
                "prior": int((whole["prior"] != "").sum()),
                "gate": f"failed ({failed})" if failed else str(own["gate"].iloc[0]),
            }
        )  # fmt: skip
    frame = pd.DataFrame(rows)
    order = np.argsort(-frame["log_score"].to_numpy(), kind="stable")
    return frame.iloc[order].reset_index(drop=True)
