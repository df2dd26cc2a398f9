"""The paper's sample sizes beside the formulas: which settings come closest to 200 and 90.

The paper prints an effect size, alpha, power and a minimum for each study, and neither the test nor the correlation
and sphericity behind it. So each plausible test is computed with its assumptions in sight, with the power that the
printed number of people gives, and with the correlation or sphericity at which the formula would ask for as many.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pandas as pd
from scipy import optimize

from analysis.design import published
from analysis.power_formulas import FTestDesign, curve_people, power, power_curve, sample_size
from models.notebook_view import NotebookView

USUAL_RHO = 0.5
"""Correlation between measurements that G*Power starts from."""

CANDIDATES: Mapping[str, tuple[FTestDesign, ...]] = {
    "study1": (
        FTestDesign("fixed", 4, df=1),
        FTestDesign("fixed", 4),
        FTestDesign("between", 4, times=5, rho=USUAL_RHO),
        FTestDesign("interaction", 4, times=5, rho=USUAL_RHO),
    ),
    "study2": (
        FTestDesign("between", 5, times=2, rho=USUAL_RHO),
        FTestDesign("interaction", 5, times=2, rho=USUAL_RHO),
        FTestDesign("interaction", 5, times=9, rho=USUAL_RHO),
        FTestDesign("within", 5, times=2, rho=USUAL_RHO),
    ),
}
"""Tests each study could have meant: four conditions, five rounds; five policies, first and last or nine rounds."""


@dataclass(frozen=True)
class PrintedSizes(NotebookView):
    """Formulas beside the printed numbers of people.

    Attributes
    ----------
    table : DataFrame
        One row a study and test: ``study, test, kind, groups, times, rho, epsilon, df1``, ``n`` by formula and
        ``n_balanced``, ``printed``, ``power_at_printed``, ``participants`` of the study as it was run and
        ``power_at_participants``; ``matching_rho, matching_epsilon``: the value at which
        `printed` people would have exactly the power wanted, the other assumption kept (NaN where no rho from 0
        and no epsilon does).
    settings : DataFrame
        One row a study: ``study, f, alpha, power, printed`` as the paper prints them.
    """

    _whose = "printed"

    table: pd.DataFrame
    settings: pd.DataFrame

    def curves(self) -> pd.DataFrame:
        """Power by number of people of every test: ``study, test, people, power``."""
        settings = self.settings.set_index("study")
        parts = []
        for row in self.table.to_dict("records"):
            given = settings.loc[row["study"]]
            df = int(row["df1"]) if row["kind"] == "fixed" else None
            design = FTestDesign(row["kind"], row["groups"], row["times"], row["rho"], row["epsilon"], df)
            people = curve_people(design, max(row["n"], row["printed"]))
            value = power_curve(design, people, given["f"], given["alpha"])
            parts.append(
                pd.DataFrame({"study": row["study"], "test": row["test"], "people": people, "power": value})
            )
        return pd.concat(parts, ignore_index=True)

    @property
    def sentence(self) -> str:
        """The closest test of each study."""
        parts = []
        for study, rows in self.table.groupby("study", sort=False):
            distance = (rows["n"] - rows["printed"]).abs()
            best = rows.loc[distance.idxmin()]
            wanted = float(self.settings.set_index("study").loc[study, "power"])
            text = (
                f"{study}: {best['printed']} people printed; closest among the usual settings is {best['n']} "
                f"({best['test']}; power with {best['printed']}: {best['power_at_printed']:.3f}, {wanted:g} wanted)"
            )
            matches = [
                f"{name} = {row[f'matching_{name}']:.3f} for {row['kind']} {row['groups']} x {row['times']}"
                for _, row in rows.iterrows()
                for name in ("rho", "epsilon")
                if np.isfinite(row[f"matching_{name}"])
            ]
            text += f"; as many would follow from {'; or '.join(matches)}" if matches else ""
            weakest = rows.loc[rows["power_at_participants"].idxmin()]
            text += (
                f"; with the {weakest['participants']} who took part the weakest of these tests "
                f"({weakest['test']}) has power {weakest['power_at_participants']:.3f}"
            )
            parts.append(text)
        return f"{'. '.join(parts)}. The paper prints none of these settings, so none can be called its own."


def printed_sizes() -> PrintedSizes:
    """Compare every candidate test with the printed number of people."""
    rows: list[dict[str, Any]] = []
    settings = []
    for study, designs in CANDIDATES.items():
        given = published()[study]["power"]
        f, alpha, wanted, people = given["f"], given["alpha"], given["power"], given["minimum_n"]
        took_part = published()[study]["participants"]
        settings.append({"study": study, "f": f, "alpha": alpha, "power": wanted, "printed": people})
        for design in designs:
            matching = _matching(design, people, f, alpha, wanted)
            rows.append(
                {
                    "study": study, "test": design.words, "kind": design.kind, "groups": design.groups,
                    "times": design.times, "rho": design.rho, "epsilon": design.epsilon,
                    "df1": design.degrees_of_freedom(people)[0], "n": sample_size(design, f, alpha, wanted),
                    "n_balanced": sample_size(design, f, alpha, wanted, balanced=True), "printed": people,
                    "power_at_printed": power(design, people, f, alpha), "participants": took_part,
                    "power_at_participants": power(design, took_part, f, alpha), **matching,
                }
            )  # fmt: skip
    return PrintedSizes(pd.DataFrame(rows), pd.DataFrame(settings))


def _matching(design: FTestDesign, people: int, f: float, alpha: float, wanted: float) -> dict[str, float]:
    """Correlation and sphericity at which `people` have exactly the power wanted; NaN where none does."""
    if design.kind == "fixed":
        return {"matching_rho": np.nan, "matching_epsilon": np.nan}

    def at_rho(rho: float) -> float:
        return power(replace(design, rho=rho), people, f, alpha) - wanted

    def at_epsilon(epsilon: float) -> float:
        return power(replace(design, epsilon=epsilon), people, f, alpha) - wanted

    lowest = 1 / (design.times - 1)
    rho = _root(at_rho, 0.0, 0.999)
    epsilon = np.nan if design.kind == "between" or design.times == 2 else _root(at_epsilon, lowest, 1.0)
    return {"matching_rho": rho, "matching_epsilon": epsilon}


def _root(excess: Callable[[float], float], low: float, high: float) -> float:
    if excess(low) * excess(high) > 0:
        return np.nan
    return float(optimize.brentq(excess, low, high, xtol=1e-12))
