"""The paper's regression in numbers: what follows from what, and the same model on the data of the report."""

from __future__ import annotations

import math
import re

import pandas as pd
from scipy.stats import norm

from analysis.paper_agreement import (
    Agreement,
    Word,
    apart,
    as_printed,
    chances,
    concluded,
    follows,
    statistics,
    unchecked,
    written,
)
from analysis.paper_numbers import Basis, Check, Ours, PaperNumber, with_interval
from analysis.printed_regression import STATE_CLAIM, TERM_OF, implied_z, printed_terms, rounding
from analysis.regression import Regression
from analysis.regression_sources import p_text
from analysis.signal_by_state import signal_by_state

TOPIC = "Study 1: the regression"
PLACE = "Sec. IV-A, Statistical Analysis"
SECTION = "regression"
SURE = 0.05
"""Level of the paper's tests."""

NAMES = {"robot_help": "the robot's helping", "signal": "signalling"}


def regression_numbers(ours: Ours) -> list[PaperNumber]:
    """Rows on odds ratios, tests, and what is concluded from them."""
    terms = printed_terms(ours.published)
    rows = [number for term, row in terms.iterrows() for number in _term(ours, str(term), row)]
    return [*rows, *_test(ours), *_conclusions(ours)]


def own_regression(ours: Ours) -> Regression | None:
    """The regression of the data, if it has the paper's terms."""
    found = ours.regression
    if isinstance(found, str) or set(found.terms) != set(TERM_OF.values()):
        return None
    return found


def _why(ours: Ours) -> Agreement:
    found = ours.regression
    return unchecked(found if isinstance(found, str) else "the regression of these data has other terms")


def _check(ours: Ours, text: str, agreement: Agreement, *, sized: bool = False) -> Check:
    """Ours on the data; `sized` where it cannot be compared between studies of different sizes."""
    if sized and not ours.as_many:
        agreement = unchecked(ours.other_size)
    return Check(text, Basis.DATA, agreement, SECTION)


def _term(ours: Ours, term: str, printed: pd.Series) -> list[PaperNumber]:
    name = NAMES[term]
    low, high = float(printed["low"]), float(printed["high"])
    _, z, least, most = implied_z(printed["estimate"], low, high)
    middle = [math.sqrt((low + s * rounding(low)) * (high + s * rounding(high))) for s in (-1, 0, 1)]
    smallest = 2 * float(norm.sf(printed["z"] + rounding(printed["z"])))
    ratio, own_z, own_p = _own_term(ours, term, printed)
    from_middle = Check(
        f"its middle is {written(middle[1])}, the odds ratio {as_printed(printed['estimate'])}", Basis.PRINTED,
        follows(printed["estimate"], middle[0], middle[2]), SECTION,
    )  # fmt: skip
    from_both = Check(
        f"{z:.3f}, from odds ratio and interval", Basis.PRINTED,
        follows(printed["z"], round(least, 3), round(most, 3)), SECTION,
    )  # fmt: skip
    from_z = Check(
        f"{written(2 * float(norm.sf(printed['z'])), 3)}, from z", Basis.PRINTED,
        _below(smallest, float(printed["p"].lstrip("<"))), SECTION,
    )  # fmt: skip
    rows = (
        ("odds ratio", as_printed(printed["estimate"]), (ratio,)),
        ("95% interval of the odds ratio", f"{low} to {high}", (from_middle, ratio)),
        ("z", as_printed(printed["z"]), (from_both, own_z)),
        ("p", str(printed["p"]), (from_z, own_p)),
    )
    return [PaperNumber(TOPIC, PLACE, f"{name}: {what}", text, checks, name) for what, text, checks in rows]


def _own_term(ours: Ours, term: str, printed: pd.Series) -> tuple[Check, Check, Check]:
    """Odds ratio, z and p of a term on the data of the report."""
    regression = own_regression(ours)
    reason = _why(ours)
    if regression is not None:
        own = regression.odds_ratios.loc[term]
        estimate, z, p = float(own["estimate"]), float(own["z"]), float(own["p"])
        error = math.log(estimate) / z if 0 < estimate < math.inf and z else math.inf
        if 0 < error < math.inf:
            both = math.hypot(implied_z(printed["estimate"], printed["low"], printed["high"])[0], error)
            told = with_interval(estimate, float(own["low"]), float(own["high"]))
            return (
                _check(ours, told, apart(printed["estimate"], estimate, both, log=True)),
                _check(ours, written(z, 3), statistics(printed["z"], z), sized=True),
                _check(ours, p_text(p), chances(printed["p"], p), sized=True),
            )
        reason = unchecked("the odds ratio of these data has no finite estimate")
    absent = Check("–", Basis.DATA, reason, SECTION)
    return absent, absent, absent


def _below(value: float, limit: float) -> Agreement:
    if value < limit:
        return Agreement(Word.AGREES)
    return Agreement(Word.CONTRADICTS, f"{written(value, 3)} follows")


def _test(ours: Ours) -> list[PaperNumber]:
    """The likelihood-ratio test of helping, and the AIC that has to go with it."""
    printed = ours.published["study1"]["glmm"]["help_vs_null"]
    regression = own_regression(ours)
    chi2, daic, df = printed["chi2"], printed["delta_aic"], printed["df"]
    if regression is None:
        own_chi = own_aic = own_p = Check("–", Basis.DATA, _why(ours), SECTION)
    else:
        test = regression.tests.set_index("question").loc[f"{TERM_OF['help']}, alone against the null"]
        found = float(test["chi2"])
        if math.isnan(found):
            reason = unchecked("the search for one of the two models did not end")
            own_chi = own_aic = own_p = Check("–", Basis.DATA, reason, SECTION)
        else:
            own_chi = _check(ours, written(found), statistics(chi2, found, chi_squared=True), sized=True)
            of_aic = statistics(2 * df - daic, found, chi_squared=True)
            own_aic = _check(ours, written(float(test["dAIC"])), of_aic, sized=True)
            own_p = _check(ours, p_text(float(test["p"])), chances(printed["p"], float(test["p"])), sized=True)
    implied, slack = 2 * df - chi2, rounding(chi2)
    from_chi = 2 * float(norm.sf(math.sqrt(chi2)))
    aic = Check(f"{written(implied)}, from χ²", Basis.PRINTED,
                follows(daic, round(implied - slack, 4), round(implied + slack, 4)), SECTION)  # fmt: skip
    p = Check(f"{written(from_chi, 2)}, from χ²", Basis.PRINTED,
              _below(from_chi, float(printed["p"].lstrip("<"))), SECTION)  # fmt: skip
    what, same = "helping against the null", NAMES[TERM_OF["help"]]
    return [
        PaperNumber(TOPIC, PLACE, f"{what}: χ²({df})", as_printed(chi2), (own_chi,), same),
        PaperNumber(TOPIC, PLACE, f"{what}: ΔAIC", as_printed(daic), (aic, own_aic), same),
        PaperNumber(TOPIC, PLACE, f"{what}: p", printed["p"], (p, own_p), same),
    ]


def _conclusions(ours: Ours) -> list[PaperNumber]:
    claim, regression = ours.published["claims"][0], own_regression(ours)
    if regression is None:
        absent = (Check("–", Basis.DATA, _why(ours), SECTION),)
        return [PaperNumber(TOPIC, PLACE, "conclusion", claim, absent), *_by_state(ours)]
    table = regression.odds_ratios
    help_p, signal_p = (float(table.loc[TERM_OF[k], "p"]) for k in ("help", "signal"))
    tests = regression.tests.set_index("question")["p"]
    between = float(tests["interaction"]) if "interaction" in tests else math.nan
    helps = help_p < SURE and float(table.loc[TERM_OF["help"], "estimate"]) > 1
    told = f"p of helping {p_text(help_p)}, of signalling {p_text(signal_p)}, of the interaction {p_text(between)}"
    every = None if math.isnan(between) else helps and signal_p >= SURE and between >= SURE
    trend = float(table.loc[TERM_OF["signal"], "estimate"])
    interaction = ours.published["study1"]["glmm"]["interaction"]
    return [
        PaperNumber(TOPIC, PLACE, "interaction", interaction,
                    (_check(ours, f"p {p_text(between)}",
                            concluded(None if math.isnan(between) else between >= SURE)),)),
        PaperNumber(TOPIC, PLACE, "conclusion", claim, (_check(ours, told, concluded(every)),)),
        PaperNumber(TOPIC, PLACE, "trend", "signalling exhibited an increasing trend",
                    (_check(ours, f"odds ratio {written(trend, 3)}", concluded(trend > 1)),),
                    NAMES[TERM_OF["signal"]]),
        *_by_state(ours),
    ]  # fmt: skip


def _by_state(ours: Ours) -> list[PaperNumber]:
    """What is said of signalling in different states, by the posterior at the paper's number of states."""
    states, action = ours.published["em"]["selected_states"], "signal"
    if ours.posterior is None or states not in ours.study.states:
        agreement, text = unchecked(f"no model with {states} states was sampled"), "–"
    else:
        found = signal_by_state(ours.posterior(states), action)
        sampled = ours.posterior(states).gate.passed
        holds = {"supported": True, "contradicted": False}.get(found.verdict)
        agreement = concluded(holds) if holds is not None else Agreement(Word.OPEN, "the posterior cannot tell")
        agreement = agreement if sampled else unchecked("the posterior did not pass its convergence gate")
        ends = [found.table[found.table["quantity"] == found.table["quantity"].iloc[0]].iloc[i] for i in (0, -1)]
        text = "; ".join(
            f"{100 * r['mean']:+.0f} ({100 * r['low']:+.0f} to {100 * r['high']:+.0f}) points in the {which} state"
            for which, r in zip(("lowest", "highest"), ends, strict=True)
        )
        text = re.sub(r"-(?=\d)", "\N{MINUS SIGN}", text)
    return [PaperNumber(TOPIC, PLACE, "signalling by state", STATE_CLAIM,
                        (Check(text, Basis.DATA, agreement, SECTION),))]  # fmt: skip
