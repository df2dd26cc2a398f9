"""Study 2's printed tests beside those of simulated studies, every number labelled with where it is from."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy import optimize
from scipy.stats import studentized_range

from analysis.printed_anova import MEASURES, printed_anova, printed_tukey
from analysis.printed_regression import rounding
from analysis.study2_analysis import Study2Analysis


def anova_beside(analysis: Study2Analysis, published: Mapping[str, Any]) -> pd.DataFrame:
    """Analyses of variance, simulated beside printed.

    Returns
    -------
    DataFrame
        ``outcome, effect, df1, df2``; ``simulated_f, simulated_p``; ``printed_f, printed_p`` (NaN where the paper
        prints none: it tests no beliefs).
    """
    printed = printed_anova(published)
    rows = []
    for key, found in analysis.anovas.items():
        for own in found.table.itertuples():
            same = printed[(printed["measure"] == MEASURES.get(key)) & (printed["effect"] == own.effect)]
            rows.append(
                {
                    "outcome": found.data.dv, "effect": own.effect, "df1": own.df1, "df2": own.df2,
                    "simulated_f": own.f, "simulated_p": own.p,
                    "printed_f": float(same["f"].iloc[0]) if len(same) else np.nan,
                    "printed_p": float(same["p"].iloc[0]) if len(same) else np.nan,
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def comparisons_beside(analysis: Study2Analysis, published: Mapping[str, Any]) -> pd.DataFrame:
    """Comparisons with the reference, simulated (Tukey and Dunnett) beside printed (Tukey).

    Returns
    -------
    DataFrame
        ``outcome, policy``; ``simulated_difference, simulated_low, simulated_high`` (Tukey's interval),
        ``simulated_p`` (Tukey), ``simulated_dunnett``; ``printed_difference, printed_p``, NaN where none are.
    """
    printed = printed_tukey(published)
    rows = []
    for key, found in analysis.tukey.items():
        pairs = found.table[found.table["reference"] == analysis.reference]
        matched = analysis.dunnett[key].table.set_index("group") if key in analysis.dunnett else None
        for own in pairs.itertuples():
            same = printed[(printed["measure"] == MEASURES.get(key)) & (printed["policy"] == own.group)]
            rows.append(
                {
                    "outcome": found.what, "policy": own.group, "simulated_difference": own.difference,
                    "simulated_low": own.low, "simulated_high": own.high, "simulated_p": own.p,
                    "simulated_dunnett": np.nan if matched is None else float(matched.loc[own.group, "p"]),
                    "printed_difference": float(same["difference"].iloc[0]) if len(same) else np.nan,
                    "printed_p": float(same["p"].iloc[0]) if len(same) else np.nan,
                }
            )  # fmt: skip
    return pd.DataFrame(rows)


def in_words(table: pd.DataFrame, digits: int = 3) -> pd.DataFrame:
    """A table with its chances in words: below .001 is said as papers do, and what is not printed is empty.

    Parameters
    ----------
    table : DataFrame
        Of `anova_beside`, `comparisons_beside`, or a `analysis.study2_beliefs.BeliefSpread`.
    digits : int
        Of all numbers.
    """
    chances = [
        name for name in table if name.endswith("_p") or name.startswith("p ") or name == "simulated_dunnett"
    ]
    out = table.round(digits)
    for name in chances:
        out[name] = [
            "" if np.isnan(p) else "< .001" if p < 0.001 else f"{p:.{digits}f}" for p in table[name].astype(float)
        ]
    return out


def implied_errors(published: Mapping[str, Any]) -> pd.DataFrame:
    """Standard errors that the printed differences imply, were Tukey's test fed one value a person.

    Printed numbers stand for all that round to them, so each comparison gives a range. Comparisons whose p is
    printed as 0 or 1 say too little and are left out.

    Returns
    -------
    DataFrame
        ``measure, policy, difference, p, low, high``: range of the standard error of the difference.
    """
    study = published["study2"]
    k = len(study["policies"])
    df = study["participants"] - k
    rows = []
    for own in printed_tukey(published).itertuples():
        half = rounding(own.p)
        if not half < own.p < 1 - half:
            continue
        largest, smallest = (_t_of(p, k, df) for p in (own.p - half, own.p + half))
        size, about = abs(own.difference), rounding(own.difference)
        rows.append(
            {
                "measure": own.measure, "policy": own.policy, "difference": own.difference, "p": own.p,
                "low": (size - about) / largest, "high": (size + about) / smallest,
            }
        )  # fmt: skip
    return pd.DataFrame(rows)


def implied_sentence(published: Mapping[str, Any]) -> str:
    """What the printed comparisons of observed help say about how much people differed."""
    table = implied_errors(published)
    own = table[table["measure"] == MEASURES["observation"]]
    each = published["study2"]["participants"] / len(published["study2"]["policies"])
    low, high = float(own["low"].max()), float(own["high"].min())
    responses = published["study2"]["sequence"].count("H")
    agree = low <= high
    error = (low + high) / 2 if agree else float(own[["low", "high"]].mean().mean())
    spread = error * np.sqrt(each / 2)
    rate = (1 + np.sqrt(max(0.0, 1 - 4 * responses * spread**2))) / 2
    fits = "one error fits all of them" if agree else "no single error fits all of them"
    return (
        f"The printed differences of observed help and their p values imply a standard error of about {error:.3f} "
        f"({fits}), so a standard deviation of {spread:.2f} between people's means under the same policy. Means of "
        f"{responses} independent responses vary as much where {rate:.0%} help; people who differ would vary more."
    )


def _t_of(p: float, k: int, df: int) -> float:
    """Size of a difference in standard errors at which Tukey's p is so much."""
    found = optimize.brentq(lambda q: float(studentized_range.sf(q, k, df)) - p, 1e-6, 20.0, xtol=1e-6)
    return float(found) / np.sqrt(2)
