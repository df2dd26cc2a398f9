"""The groups of a mixed model, one row each: its intercept with interval, and how much the fit hangs on it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from analysis.wording import counted
from models.errors import InputError
from models.glmm_influence import influence

SAME = 1e-9
"""Relative difference up to which Cook's distances are those of groups with the same rows."""


def group_table(results: Any) -> pd.DataFrame:
    """Intercepts of the groups and their influence, in the order of the data.

    Returns
    -------
    DataFrame
        Indexed by group: ``mode, mean, sd, lower, upper`` of the intercept given the group's outcomes, on the logit
        scale (`random_effects`, 95% equal-tailed, estimates taken as known); ``rows, trials, successes``; ``cook``
        and ``d NAME``, the change of each parameter when the group is left out, in standard errors
        (`models.glmm_influence`). Without a maximum there is no influence and its columns are absent.
    """
    effects = results.random_effects
    try:
        moved = influence(results)
    except InputError:
        return effects
    return effects.join(moved)


def influence_of(results: Any) -> dict[str, Any] | None:
    """The group that the fit hangs on most; None for a fit without a maximum.

    Returns
    -------
    dict
        ``group`` (its label), ``others`` (how many have the same rows and so the same influence), ``cook``,
        ``parameter`` that it moves most and ``change``, in standard errors, ``text``.
    """
    try:
        table = influence(results)
    except InputError:
        return None
    first = table.iloc[0]
    others = int(np.sum(table["cook"] >= first["cook"] * (1 - SAME))) - 1
    changes = first[[c for c in table.columns if str(c).startswith("d ")]].astype(float).dropna()
    name = str(changes.abs().idxmax())
    where = f"{table.index.name} {table.index[0]}"
    like = f" (and as much on each of {counted(others, 'other')} with the same rows)" if others else ""
    text = (
        f"Of {counted(len(table), 'group')} the fit hangs most on {where}{like}: left out, it moves "
        f"{name.removeprefix('d ')} by {changes[name]:+.2f} standard errors (Cook's distance {first['cook']:.3g})."
    )
    return {
        "group": table.index[0], "others": others, "cook": float(first["cook"]),
        "parameter": name.removeprefix("d "), "change": float(changes[name]), "text": text,
    }  # fmt: skip
