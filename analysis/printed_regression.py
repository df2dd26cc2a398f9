"""The regression as the paper prints it, and whether its printed numbers can all be right at once."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import pandas as pd
from scipy.stats import norm

TERM_OF = {"help": "robot_help", "signal": "signal"}
"""Printed names of the terms, and ours."""

EQUATION = "log[Pr(o_help = 1)]"
"""Left-hand side of the printed equation, where the text says logit."""

READING = "participants were 10.42 times more likely to offer help when the robot had previously provided help"
"""How the paper reads its odds ratio."""

STATE_CLAIM = (
    "it may be effective in some states (e.g., high prosociality) but less so in others. These patterns are not "
    "captured by the fixed-effects model"
)
"""What the paper says of signalling."""


def printed_terms(published: Mapping[str, Any]) -> pd.DataFrame:
    """Odds ratios as printed, indexed by our names of the terms: ``estimate, low, high, z`` and ``p`` (text)."""
    glmm = published["study1"]["glmm"]
    rows = {
        TERM_OF[key]: {"estimate": glmm[key]["odds_ratio"], "low": glmm[key]["ci95"][0],
                       "high": glmm[key]["ci95"][1], "z": glmm[key]["z"], "p": glmm[key]["p"]}
        for key in TERM_OF
    }  # fmt: skip
    return pd.DataFrame.from_dict(rows, orient="index")


def rounding(value: float) -> float:
    """Half a unit of the last printed digit.

    Examples
    --------
    >>> rounding(10.42), rounding(-40.2)
    (0.005, 0.05)
    """
    digits = len(str(value).partition(".")[2])
    return 0.5 * 10.0**-digits


def implied_z(estimate: float, low: float, high: float) -> tuple[float, float, float, float]:
    """Standard error and z that an odds ratio with a 95% Wald interval implies.

    Returns
    -------
    standard_error, z, least, most : float
        The last two: what z can be, given that all three were rounded.

    Examples
    --------
    >>> [round(v, 3) for v in implied_z(10.42, 5.09, 21.32)]
    [0.365, 6.414, 6.407, 6.421]
    """
    width = 2 * float(norm.ppf(0.975))
    error = math.log(high / low) / width
    e, a, b = rounding(estimate), rounding(low), rounding(high)
    widest = math.log((high + b) / (low - a)) / width
    narrowest = math.log((high - b) / (low + a)) / width
    ends = [math.log(estimate - e) / widest, math.log(estimate + e) / narrowest]
    return error, math.log(estimate) / error, min(ends), max(ends)


def consistency(published: Mapping[str, Any]) -> tuple[str, ...]:
    """Sentences on whether the printed numbers follow from each other, rounding allowed for."""
    glmm = published["study1"]["glmm"]
    out = []
    for term, row in printed_terms(published).iterrows():
        error, z, least, most = implied_z(row["estimate"], row["low"], row["high"])
        agrees = least - rounding(row["z"]) <= row["z"] <= most + rounding(row["z"])
        verdict = "which agrees within rounding" if agrees else "which rounding does not explain"
        out.append(
            f"{term}: the printed interval {row['low']} to {row['high']} implies a standard error of {error:.3f} "
            f"and z = {z:.2f}; {row['z']} is printed, {verdict}."
        )
    test = glmm["help_vs_null"]
    implied = 2 * test["df"] - test["chi2"]
    slack = rounding(test["chi2"]) + rounding(test["delta_aic"])
    agrees = abs(implied - test["delta_aic"]) <= slack
    verdict = "which agrees within rounding" if agrees else "so the two cannot belong to one comparison"
    out.append(
        f"χ²({test['df']}) = {test['chi2']} implies ΔAIC = {implied:.2f}; {test['delta_aic']} is printed, "
        f"{verdict}."
    )
    ratio = test["chi2"] / glmm["help"]["z"] ** 2
    out.append(
        f"χ² / z² = {ratio:.2f} as printed. For a likelihood that is a parabola it is 1; "
        "the table has the ratio of each fit made here."
    )
    out.append(
        f"The printed equation has {EQUATION} on its left, where the text says logit: log odds are meant, not the "
        "logarithm of a probability."
    )
    return tuple(out)
