"""Section: numbers of states beside each other and beside models that need no latent state.

The posteriors are those that the report has, and a few more that cost little beside them
(`analysis.report.compared_models`); what is left out is said.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np
import pandas as pd

from analysis.comparison import CLOSE, CRITERIA
from analysis.comparison_at_hand import Findings, findings, high_k_sentence
from analysis.comparison_words import called, listed
from analysis.figures.comparison import elpd_differences
from analysis.model_criteria import HIGH_K
from analysis.report.compared_models import candidates, scope
from analysis.report.context import ReportContext
from analysis.report.section import (
    Block,
    Figure,
    Headline,
    NotSupported,
    Origin,
    Points,
    Question,
    Table,
    Text,
)
from analysis.wording import counted
from models.parameters import STICKY

FOLDS = 10

FEWEST_PEOPLE = 10
"""People below whom nothing is said of who predicts people best."""

LOO = {
    "elpd_diff": "below best", "dse": "its standard error", "p_worse": "probability worse", "diag_diff": "caution",
    "weight": "stacking weight", "max_pareto_k": "largest Pareto k", "gate": "sampling",
}  # fmt: skip
CHECKS = {
    "kfold_diff": "below best", "kfold_dse": "its standard error", "log_marginal": "logarithm",
    "log_marginal_error": "its Monte Carlo error", "log_marginal_diff": "below best ",
}  # fmt: skip
LIKELIHOOD = {
    "n_parameters": "free parameters", "log_likelihood": "log-likelihood", "aic": "AIC", "bic": "BIC"
}  # fmt: skip
FORMATS = {
    "elpd_diff": ".1f", "dse": ".1f", "p_worse": ".2f", "weight": ".2f", "max_pareto_k": ".2f",
    "kfold_diff": ".1f", "kfold_dse": ".1f", "log_marginal": ".1f", "log_marginal_error": ".2f",
    "log_marginal_diff": ".1f", "n_parameters": ",d", "log_likelihood": ".1f", "aic": ".1f", "bic": ".1f",
}  # fmt: skip


def make(context: ReportContext) -> tuple[Block, ...]:
    """Sentence, tables and figure of the comparison."""
    log = context.log
    if log.n_responses_recorded == 0:
        raise NotSupported("no response was recorded, so there is nothing to predict")
    if log.n_participants < FEWEST_PEOPLE:
        raise NotSupported(
            f"{counted(log.n_participants, 'person', 'people')}, fewer than {FEWEST_PEOPLE}, say nothing about "
            "which model predicts people best"
        )
    compared = scope(context)
    settings = context.effort.comparison(context.seed, FOLDS)
    result = context.kept(
        "models beside each other", findings, log, candidates(context, compared), STICKY, settings
    )  # fmt: skip
    return blocks(result, context.origin, compared.left, context.effort.quick)


def blocks(result: Findings, origin: Origin, left: Sequence[str] = (), quick: bool = False) -> tuple[Block, ...]:
    """Sentence, tables, figure and warnings of a comparison.

    Parameters
    ----------
    result : Findings
    origin : Origin
        Of the data behind it.
    left : sequence of str
        Models that were left out for their cost.
    quick : bool
        Whether samples are short because the report is quick.
    """
    intro = (
        "Which model predicts the responses of a person that it has not seen? A model with a latent state has to "
        "beat models without one: chances of a response that depend on the robot's action alone (one state), or "
        "also on the last response (first-order Markov); types of people, who never change; and people who differ "
        "from each other by a trait, in no state. Leaving out is by person and not by event (PSIS-LOO), since "
        "events of one person are not independent."
    )
    made: list[Block] = [
        Text(intro),
        Text(best_sentence(result)),
        Text(high_k_sentence(result.table, result.people)),
    ]
    if result.sentence:
        made.append(Text(f"{result.sentence}{_reach(result)}"))
    made += [_loo(result, origin), figure(result, origin)]
    if result.checked:
        made.append(_checks(result, origin))
    made.append(_likelihood(result, origin))
    made += [Text(text) for text in (bic_sentence(result),) if text]
    warned = [*_gates(result, quick), *result.warnings]
    if warned:
        made.append(Points(tuple(warned), "Not to be relied on as they stand"))
    missing = _missing(result, left)
    if missing:
        made.append(Text(missing, "note"))
    return (*made, headline(result, origin))


def best_sentence(result: Findings) -> str:
    """Best model by LOO, what it cannot be told from, and by how much it beats the rest."""
    table = result.table.set_index("model")
    best, *alike = result.indistinct["elpd"]
    text = f"Left out and predicted from the others, people are predicted best by {called(best)}"
    if alike:
        text += f"; LOO cannot tell {called(best)} from {listed([called(m) for m in alike], 'or')}"
    behind = [m for m in table.index if m != best and m not in alike]
    few = (
        f" With {result.people} people the standard errors are themselves uncertain, and rather too small."
        if result.people < 100
        else ""
    )
    if not behind:
        return f"{text}. No model here predicts people worse than another by more than chance.{few}"
    told = ", ".join(f"{called(m)} by {-table.elpd_diff[m]:.1f} ({table.dse[m]:.1f})" for m in behind)
    return f"{text}. It beats {told}: nats of expected log predictive density, in brackets the standard error.{few}"


def bic_sentence(result: Findings) -> str:
    """How far BIC is from what it approximates, by number of states: the one check of its penalty there is."""
    some = result.table[(result.table["kind"] == "states") & result.table["model"].isin(result.checked)]
    if some.empty:
        return ""
    gap = (some["log_marginal"] + some["bic"] / 2).tolist()
    told = listed([f"{v:+.1f} nats at {m}" for v, m in zip(gap, some["model"], strict=True)], "and")
    text = f"BIC stands for -2 log marginal likelihood: the marginal likelihood less what BIC makes of it is {told}"
    if min(gap) > 0 and gap == sorted(gap) and len(gap) > 1:
        return (
            f"{text}. Beside this prior the penalty of BIC is too large, the more so the more states, so BIC leans "
            "towards few."
        )
    return f"{text} (above 0: BIC charges too much)."


def _table(
    key: str, result: Findings, columns: dict[str, str], caption: str, origin: Origin,
    groups: tuple[tuple[str, int], ...] = (), frame: pd.DataFrame | None = None,
) -> Table:  # fmt: skip
    frame = (result.table if frame is None else frame)[["model", *columns]].copy()
    formats = {c: FORMATS[c] for c in columns if c in FORMATS}
    return Table(key, frame, caption, (origin,), headings=columns, formats=formats, groups=groups)


def _loo(result: Findings, origin: Origin) -> Table:
    frame = result.table.copy()
    frame["diag_diff"] = [_caution(result, *row) for row in zip(frame["elpd_diff"], frame["p_worse"], strict=True)]
    return _table(
        "comparison-loo", result, LOO,
        f"Leave-one-person-out (PSIS-LOO), in nats; {result.people:,} people, {result.responses:,} recorded "
        "responses. The standard error is that of the difference, person by person. Do not rely on the probability "
        f"of being worse where a caution is given: a difference below {CLOSE:g} nats says nothing, and below 100 "
        "people the standard error is itself uncertain. A stacking weight is not a probability: among models that "
        "predict alike it picks one. Sampling: whether the posterior sample passed the convergence gate; exact "
        "where draws are independent.",
        origin, frame=frame,
    )  # fmt: skip


def _caution(result: Findings, difference: float, p_worse: float) -> str:
    """Why a difference from the best is not to be relied on, in words: all of it, where ArviZ names one reason."""
    if np.isnan(p_worse):
        return ""
    reasons = ("under 100 people", result.people < 100), (f"below {CLOSE:g} nats", abs(difference) < CLOSE)
    return ", ".join(words for words, holds in reasons if holds)


def _checks(result: Findings, origin: Origin) -> Table:
    frame = result.table[result.table["model"].isin(result.checked)]
    failed = [called(m) for m in result.checked if m in result.gates]
    missed = ""
    if failed:
        missed = f" The convergence gate FAILED for {listed(failed, 'and')}: their k-fold is provisional."
    return _table(
        "comparison-checks", result, CHECKS,
        f"Two criteria that need more sampling. K-fold leaves out {result.folds} groups of people in turn and "
        "learns from the rest, without importance sampling. The marginal likelihood is the probability of the data "
        f"under model and prior (kappa {result.stay:g}), by sequential Monte Carlo; it depends on the prior."
        + missed,
        origin, (("", 1), ("k-fold over people", 2), ("marginal likelihood", 3)), frame,
    )  # fmt: skip


def _likelihood(result: Findings, origin: Origin) -> Table:
    return _table(
        "comparison-likelihood", result, LIKELIHOOD,
        "The same models at their maximum of the likelihood; AIC and BIC are better when lower, and count a "
        "parameter that is estimated at 0 or 1 as if it were free.",
        origin,
    )  # fmt: skip


def figure(result: Findings, origin: Origin) -> Figure:
    """Differences in elpd with intervals, and the choices of the criteria."""
    shown = result.table
    chosen: dict[str, list[str]] = {}
    for column, model in result.choices.items():
        chosen.setdefault(model, []).append(CRITERIA[column])
    differences = "; ".join(
        f"{row.model} {row.elpd_diff:.1f} (LOO, standard error {row.dse:.1f})"
        + (f" and {row.kfold_diff:.1f} (k-fold)" if row.model in result.checked else "")
        for row in shown.itertuples()
    )
    best = "; ".join(f"{model} is best by {', '.join(names)}" for model, names in chosen.items())
    caption = (
        "How much worse each model predicts the responses of a person it has not seen than the best model by the "
        "same criterion, with two standard errors of the difference; at the right, the criteria that choose it. "
        f"In the shaded band, {CLOSE:g} nats, a difference says nothing. The axis is logarithmic beyond 10 nats."
    )
    alt = f"Expected log predictive density below the best: {differences}. {best}."
    return Figure("comparison-elpd", (partial(elpd_differences, shown, chosen),), caption, (alt,), (origin,))


def _gates(result: Findings, quick: bool) -> list[str]:
    """Samples that missed the convergence gate, all at once."""
    if not result.gates:
        return []
    told = "; ".join(f"{m} {rhat:.3f} and {ess:.0f}" for m, (rhat, ess) in result.gates.items())
    text = (
        "Convergence gate FAILED (largest r-hat and smallest effective sample size; below 1.01 and above 400 "
        f"wanted): {told}. LOO and k-fold of these models are provisional."
    )
    return [text + (" This is a quick report with few draws; a full report takes more." if quick else "")]


def _reach(result: Findings) -> str:
    """Of which models k-fold and marginal likelihood speak, where that is not all of them."""
    if not (result.checked and result.not_checked):
        return ""
    names = listed([called(m) for m in result.checked], "and")
    return (
        f" K-fold and the marginal likelihood speak of {names} alone, so a model without them is neither "
        "beaten nor allowed by them."
    )


def _missing(result: Findings, left: Sequence[str]) -> str:
    """What was not done for its cost, and where it is."""
    parts = []
    if left:
        parts.append(f"{listed([called(m) for m in left], 'and')} would cost too much on a study of this size")
    if not result.checked:
        parts.append("neither k-fold nor the marginal likelihood was made, for their cost")
    slow = result.table.loc[result.table["kind"] == "people", "model"].tolist()
    others = [m for m in result.not_checked if m not in slow]
    if result.checked and slow:
        parts.append(f"of {listed([called(m) for m in slow], 'and')} neither k-fold nor the marginal likelihood")
    if result.checked and others:
        parts.append(
            f"of {listed([called(m) for m in others], 'and')} neither k-fold nor the marginal likelihood, which "
            "were made for the contenders: the best model by LOO, its best rival, and what LOO cannot tell from "
            "the best, as far as a report can pay for them"
        )
    if not parts:
        return ""
    return f"Left out: {'; '.join(parts)}. `prosocial compare` makes them (`--people-differ` where people differ)."


def headline(result: Findings, origin: Origin) -> Headline:
    """Best model by LOO beside the best of the other kind, with a latent state that changes or without."""
    table = result.table.set_index("model")
    best, *alike = result.indistinct["elpd"]
    dynamic = table["kind"].isin(("states", "people"))
    text = f"People left out of the fit are predicted best by {called(best)}"
    if alike:
        text += f", which cannot be told from {listed([called(m) for m in alike], 'or')}"
    others = table[dynamic != dynamic[best]]
    if not others.empty:
        second = others["elpd"].idxmax()
        what = "without a state that changes" if dynamic[best] else "with a state that changes"
        text += (
            f"; the best model {what}, {called(second)}, is {-table.elpd_diff[second]:.1f} nats behind (standard "
            f"error {table.dse[second]:.1f})"
        )
    shown = (best, *alike)
    failed, high = [m for m in shown if m in result.gates], [m for m in shown if table.max_pareto_k[m] > HIGH_K]
    kind = "warning" if failed or high else "open" if alike else "plain"
    if failed:
        text += f". The convergence gate FAILED for {listed([called(m) for m in failed], 'and')}"
    if high:
        text += f". Pareto k is too high for {listed([called(m) for m in high], 'and')}"
    return Headline(text=f"{text}.", kind=kind, question=Question.STATES, origin=(origin,))
