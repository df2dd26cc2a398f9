"""Study 2 in the paper's numbers: design, and both tables of tests."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy.stats import studentized_range

from analysis.paper_agreement import Agreement, as_printed, counted, follows, inside, overall, unchecked, written
from analysis.paper_numbers import NO_EVIDENCE, Basis, Check, Ours, PaperNumber, with_interval
from analysis.paper_study1 import ages_and_payment, not_recorded, power_rows
from analysis.policy_study import STUDY2
from analysis.printed_anova import MEASURES, printed_anova
from analysis.printed_regression import rounding
from analysis.printed_study2 import implied_errors
from analysis.study2 import PARTICIPANTS
from analysis.study2_learning import EM, TRUTH
from analysis.study2_policies import LS_POMDP, PAPER

DESIGN, TESTS, COMPARED = "Study 2: design and people", "Study 2: analyses of variance", "Study 2: comparisons"
PLACE, ANOVA, TUKEY = "Sec. V-A", "Table I", "Table II"
SECTION = "study2"
FOUR_DIGITS = 0.01
"""Below it p values of Table I, as all its F, have four decimals, whose zeros a number does not keep."""

BELOW = 0.001
"""A p that is printed as 0 stands for anything below."""


def study2_numbers(ours: Ours) -> list[PaperNumber]:
    """Rows on design and people, on Table I and on Table II."""
    return [*_design(ours), *_anova(ours), *_tukey(ours)]


# -- design ----------------------------------------------------------------------------------------
def _design(ours: Ours) -> list[PaperNumber]:
    study = ours.published["study2"]
    each, rest = divmod(study["participants"], len(study["policies"]))
    told, letters = study["demographics"], study["sequence"]
    even = Check(f"{each} under each of {len(study['policies'])} policies, {rest} left", Basis.PRINTED,
                 follows(0, rest), SECTION)  # fmt: skip
    rows = [
        PaperNumber(DESIGN, PLACE, "participants, balanced across policies", str(study["participants"]),
                    (even, _taken(study["participants"], PARTICIPANTS, str(PARTICIPANTS)))),
        PaperNumber(DESIGN, PLACE, "rounds", str(study["rounds"]),
                    (Check(f"{len(letters)} letters of the sequence", Basis.PRINTED,
                           follows(study["rounds"], len(letters)), SECTION),)),
        PaperNumber(DESIGN, PLACE, "sequence", letters, (_taken(letters, STUDY2, STUDY2),)),
        PaperNumber(DESIGN, PLACE, "policies", ", ".join(study["policies"]),
                    (_taken(set(study["policies"]), set(PAPER), ", ".join(PAPER)),)),
    ]  # fmt: skip
    rows += power_rows(ours.published, "study2", PLACE, DESIGN)
    rows += [not_recorded(DESIGN, PLACE, name, text) for name, text in ages_and_payment(told)]
    rows += [not_recorded(DESIGN, PLACE, f"share {sex}", f"{told[sex]:.0%}") for sex in ("female", "male")]
    return rows


def _taken(printed: object, own: object, text: str) -> Check:
    return Check(text, Basis.PROJECT, counted(printed, own, taken_over=True), SECTION)


# -- Table I ---------------------------------------------------------------------------------------
def _anova(ours: Ours) -> list[PaperNumber]:
    rows = _degrees(ours)
    for r in printed_anova(ours.published).itertuples():
        key = _key(str(r.measure))
        what = f"{r.measure}, {_effect(str(r.effect))}"
        rows.append(
            PaperNumber(
                TESTS, ANOVA, f"{what}: F", f"{r.f:.4f}", (replicated(ours, f"F {key}, {r.effect}", r.f),), what
            )
        )
        implied, printed = float(r.p_implied), float(r.p)
        rows.append(
            PaperNumber(
                TESTS, ANOVA, f"{what}: p", f"{printed:.4f}" if printed < FOUR_DIGITS else as_printed(printed),
                (Check(f"{written(implied, 3)}, from F({r.df1}, {r.df2})", Basis.PRINTED,
                       _p_follows(printed, implied, implied), "anova"),), what,
            )
        )  # fmt: skip
    return rows


def _degrees(ours: Ours) -> list[PaperNumber]:
    """Degrees of freedom, which Table I prints once for all outcomes."""
    study = ours.published["study2"]
    policies = len(study["policies"]) - 1
    wanted = {"policy": (policies, "policies less one"), "time": (1, "two times less one"),
              "policy:time": (policies, "their product")}  # fmt: skip
    rows = []
    for effect, (implied, how) in wanted.items():
        printed = [tests[effect]["df"] for tests in study["mixed_anova"].values()]
        check = Check(f"{implied}, {how}", Basis.PRINTED, overall(follows(df, implied) for df in printed), "anova")
        told = " or ".join(map(str, dict.fromkeys(printed)))
        rows.append(PaperNumber(TESTS, ANOVA, f"degrees of freedom, {_effect(effect)}", told, (check,)))
    return rows


def _p_follows(printed: float, least: float, most: float) -> Agreement:
    """Whether a printed p follows; one that is printed as 0 stands for p below .001."""
    if printed == 0:
        half = max(BELOW, rounding(printed)) if most > BELOW else BELOW
        return follows(printed, 0.0, 0.0) if most < half else follows(printed, least, most)
    return follows(printed, least, most)


def _effect(effect: str) -> str:
    return {"policy": "policy", "time": "time", "policy:time": "policy by time"}[effect]


def _key(measure: str) -> str:
    return next(key for key, name in MEASURES.items() if name == measure)


# -- replications ----------------------------------------------------------------------------------
def replicated(ours: Ours, number: str, printed: float) -> Check:
    """A printed number among those of simulated studies in which the robot had learned from a study 1.

    Parameters
    ----------
    ours : Ours
    number : str
        Name, as `analysis.study2_replicates.quantities` has it.
    printed : float
    """
    content = ours.stored("study2")
    found = [] if content is None else [
        r for r in content["numbers"] if r["planner"] == LS_POMDP and r["number"] == number
    ]  # fmt: skip
    by_kind: Mapping[str, Mapping[str, Any]] = {str(r["learning"]): r for r in found}
    if content is None or EM not in by_kind:
        return Check("–", Basis.REPLICATIONS, unchecked(NO_EVIDENCE), SECTION)
    own = by_kind[EM]
    text = with_interval(own["q50"], own["q05"], own["q95"])
    if TRUTH in by_kind:
        text += f"; truth known: {written(by_kind[TRUTH]['q50'], 3)}"
    return Check(text, Basis.REPLICATIONS, inside(printed, own["q50"], own["q05"], own["q95"]), SECTION)


# -- Table II --------------------------------------------------------------------------------------
def _tukey(ours: Ours) -> list[PaperNumber]:
    rows = []
    errors = implied_errors(ours.published)
    printed = ours.published["study2"]["tukey_minus_lspomdp"]
    for key in (k for k in MEASURES if k in printed):
        for policy, (difference, p) in printed[key].items():
            what = f"{MEASURES[key]}, {policy} less {LS_POMDP}"
            rows.append(
                PaperNumber(COMPARED, TUKEY, f"{what}: difference", as_printed(difference),
                            (replicated(ours, f"difference {key}, {policy}", difference),), what)
            )  # fmt: skip
            rows.append(
                PaperNumber(COMPARED, TUKEY, f"{what}: adjusted p", as_printed(p),
                            (_from_the_others(ours, errors, key, policy, difference, p),), what)
            )  # fmt: skip
    return rows


def _from_the_others(ours: Ours, errors: pd.DataFrame, key: str, policy: str, difference: float, p: float) -> Check:
    """The p that a difference has with the standard error that the other comparisons of its outcome imply."""
    study = ours.published["study2"]
    groups = len(study["policies"])
    df = study["participants"] - groups
    others = errors[(errors["measure"] == MEASURES[key]) & (errors["policy"] != policy)]
    low, high = float(others["low"].max()), float(others["high"].min())
    if not len(others) or low > high:
        reason = unchecked("the other comparisons of this outcome imply no common standard error")
        return Check("–", Basis.PRINTED, reason, SECTION)
    size, half = abs(difference), rounding(difference)
    t = np.array([max(size - half, 0.0) / high, (size + half) / low])
    most, least = (float(v) for v in studentized_range.sf(t * np.sqrt(2), groups, df))
    text = f"{written(least, 2)} to {written(most, 2)}, by the standard error of the others"
    return Check(text, Basis.PRINTED, _p_follows(p, least, most), SECTION)
