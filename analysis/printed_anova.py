"""Study 2's analyses of variance as the paper prints them, and what follows from the printed numbers alone.

Printed are F and p. With five policies, two times and the printed number of people the denominator degrees of
freedom of all three effects are N - 5, so p, partial eta squared and Cohen's f follow without any data.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy import special

from analysis.printed_regression import rounding

MEASURES = {
    "team_performance": "team performance",
    "observation": "observed help",
    "cumulative_tokens": "cumulative tokens",
}
"""Printed names of the measures, and ours."""

REFERENCE = "ls-POMDP"
"""The policy that the paper compares the others with."""


def printed_anova(published: Mapping[str, Any]) -> pd.DataFrame:
    r"""The printed tests, with what they imply.

    Returns
    -------
    DataFrame
        ``measure, effect, df1, df2, f, p`` as printed (`df2` follows from the design), ``p_implied``,
        ``partial_eta_squared`` (:math:`F d_1 / (F d_1 + d_2)`), ``cohens_f`` (:math:`\sqrt{\eta^2/(1-\eta^2)}`),
        ``agrees``: whether the printed p is the implied one within rounding; a printed 0 stands for p < .001.
    """
    study = published["study2"]
    df2 = study["participants"] - len(study["policies"])
    rows = []
    for key, effects in study["mixed_anova"].items():
        for effect, row in effects.items():
            implied = float(special.fdtrc(row["df"], df2, row["F"]))
            eta = row["F"] * row["df"] / (row["F"] * row["df"] + df2)
            agrees = implied < 0.001 if row["p"] == 0 else abs(implied - row["p"]) <= rounding(row["p"])
            rows.append(
                {
                    "measure": MEASURES.get(key, key), "effect": effect, "df1": row["df"], "df2": df2,
                    "f": row["F"], "p": row["p"], "p_implied": implied, "partial_eta_squared": eta,
                    "cohens_f": float(np.sqrt(eta / (1 - eta))), "agrees": bool(agrees),
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def printed_tukey(published: Mapping[str, Any]) -> pd.DataFrame:
    """The printed comparisons with `REFERENCE`: ``measure, policy, difference, p``."""
    printed = published["study2"]["tukey_minus_lspomdp"]
    return pd.DataFrame(
        [
            {"measure": MEASURES.get(key, key), "policy": policy, "difference": difference, "p": p}
            for key in MEASURES
            if key in printed
            for policy, (difference, p) in printed[key].items()
        ]
    )


def anova_consistency(table: pd.DataFrame) -> str:
    """Whether the printed p values follow from the printed F, in a sentence.

    Parameters
    ----------
    table : DataFrame
        Of `printed_anova`.
    """
    wrong = table[~table["agrees"]]
    if not len(wrong):
        return (
            f"All {len(table)} printed p values follow from the printed F with {table['df2'].iloc[0]} residual df."
        )
    told = "; ".join(
        f"{r.measure}, {r.effect}: F({r.df1}, {r.df2}) = {r.f} implies p = {r.p_implied:.4f}, {r.p} is printed"
        for r in wrong.itertuples()
    )
    return f"{len(wrong)} of {len(table)} printed p values do not follow from the printed F: {told}."
