"""Study 2 as a terminal shows it: narrow tables, and conclusions answered as far as a study can answer them."""

from __future__ import annotations

from typing import Any

import pandas as pd

from analysis.study2 import Study2
from analysis.study2_claims import Claim
from analysis.study2_evidence import decidable
from analysis.study2_learning import EM, TRUTH
from analysis.study2_outcomes import SHORT


def wide_means(summary: pd.DataFrame) -> pd.DataFrame:
    """Means by policy, a column a measure; of `analysis.study2_outcomes.means`."""
    order = list(dict.fromkeys(summary["outcome"]))
    wide = summary.pivot_table(index="policy", columns="outcome", values="mean")
    names = SHORT | {"top_state_probability": "P(top state)", "costly_actions": "costly acts"}
    return wide.loc[list(dict.fromkeys(summary["policy"])), order].rename(columns=names).reset_index()


def narrow(table: pd.DataFrame) -> pd.DataFrame:
    """A table of simulated beside printed numbers with headings that fit a terminal."""
    heads = {"simulated_f": "F", "printed_f": "printed F", "simulated_dunnett": "p, Dunnett"}
    return table.rename(columns=heads).rename(columns=lambda n: n.removeprefix("simulated_").replace("_", " "))


def uneven(study: Study2) -> str:
    """How large groups are, where they are not equally large; empty where they are."""
    sizes = [len(study.of(policy)) for policy in study.policies]
    return "" if len({*sizes}) == 1 else f" Groups of {min(sizes)} and {max(sizes)}."


def answer(claim: Claim, holds: bool, study: Study2) -> str:
    """Whether a study leads to a conclusion; where the robot's fit decides that, it is said and not answered.

    Parameters
    ----------
    claim : Claim
    holds : bool
        Whether it comes out with this robot.
    study : Study2
    """
    if decidable(TRUTH if study.robot is study.truth else EM, claim):
        return f"{'yes' if holds else 'no '}  {claim.text}"
    return f" -   {claim.text}: not decidable, {'so' if holds else 'not so'} with this fit of the robot's"


def plain_rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    """One dict a row, for JSON."""
    return [{str(key): value for key, value in row.items()} for row in table.to_dict("records")]


def shown(table: pd.DataFrame) -> str:
    """A table as text."""
    return str(table.to_string(index=False, float_format=lambda v: f"{v:.4g}", na_rep="-"))
