"""Section: the paper's regression of study 1, from four sources, with what it does and does not say."""

from __future__ import annotations

import math
from functools import partial

import pandas as pd

from analysis import response_rates as rates
from analysis.bayes_twin import Twin, bayes_twin, why_absent
from analysis.figures.odds import odds_forest, rates_beside, residual_classes
from analysis.figures.style import spoken
from analysis.printed_regression import READING, TERM_OF, consistency
from analysis.regression import LEVEL, Regression, regress
from analysis.regression_checks import Residuals, by_condition, residuals
from analysis.regression_readings import readings
from analysis.regression_sources import (
    LAPLACE,
    PRINTED,
    QUADRATURE,
    Source,
    long_form,
    of_fit,
    of_print,
    of_twin,
    side_by_side,
)
from analysis.regression_words import cautions, interaction_sentence, main_sentence, odds_sentence, rules_sentence
from analysis.report.context import ReportContext
from analysis.report.section import (
    Block,
    Figure,
    Headline,
    NotSupported,
    Origin,
    Part,
    Points,
    Question,
    Table,
    Text,
    attempt,
)
from analysis.report.sections.regression_coverage import coverage
from analysis.report.sections.regression_states import by_state
from models.errors import InputError
from models.glmm import DEFAULT_NODES

FEW = 10
"""People from which a standard deviation between people is worth estimating."""


def make(context: ReportContext) -> tuple[Block, ...]:
    """The mixed model with its comparisons, checks and cautions; without the twin in quick reports."""
    if not rates.is_share(context.protocol):
        raise NotSupported(
            f"a logistic regression knows two responses, and this protocol has {context.protocol.n_responses}"
        )
    if context.log.n_participants < FEW:
        raise NotSupported(f"fewer than {FEW} people say nothing about how much people differ")
    try:
        regression, laplace = regress(context.log), regress(context.log, "laplace")
    except InputError as error:
        raise NotSupported(f"these responses cannot be regressed: {error}") from None
    meanings = "; ".join(f"{term.name}: {term.meaning}" for term in regression.table.terms)
    as_printed = set(regression.terms) == set(TERM_OF.values())
    whose = "The paper's analysis of study 1" if as_printed else "A regression after the paper's"
    intro = (
        f"{whose}: {regression.table.formula(regression.table.main)}, a logistic "
        "regression in which every person has an intercept of their own, normally distributed. 1 says: "
        f"{meanings}."
    )
    blocks: list[Block] = [Text(intro), Text(main_sentence(regression))]
    blocks += [Text(odds_sentence(regression, term)) for term in regression.terms]
    blocks += [
        _odds_table(context, regression),
        Text(interaction_sentence(regression)),
        *_models(context, regression),
    ]
    blocks += _sources(context, regression, laplace)
    blocks += _data(context, regression)
    blocks += _readings(context, regression)
    blocks += attempt("Coverage of the intervals", partial(coverage, context))
    blocks += attempt("The effect of an action by state", partial(by_state, context, regression))
    blocks.append(Points(cautions(regression), "What not to conclude"))
    if regression.terms:
        blocks.append(_headline(context, regression))
    return tuple(blocks)


def _odds_table(context: ReportContext, regression: Regression) -> Table:
    rows = []
    for term, row in regression.odds_ratios.iterrows():
        found = regression.marginal[str(term)]
        over = found.odds_ratio
        rows.append(
            {
                "term": term, "estimate": row["estimate"], "low": row["low"], "high": row["high"],
                "profile_low": row["profile_low"], "profile_high": row["profile_high"],
                "over": over.value, "over_low": over.lower, "over_high": over.upper,
                "without": found.reference_probability.value, "with": found.probability.value,
                "ratio": found.probability.value / found.reference_probability.value,
            }
        )  # fmt: skip
    frame = pd.DataFrame(rows)
    headings = {"low": "from", "high": "to", "profile_low": "profile from", "profile_high": "to ",
                "over": "estimate ", "over_low": "from ", "over_high": " to", "without": "at 0", "with": "at 1",
                "ratio": "times as likely"}  # fmt: skip
    return Table(
        "regression-odds", frame,
        f"Odds ratios for one and the same person, with {LEVEL:.0%} Wald and profile-likelihood intervals; odds "
        "ratios averaged over people; and probabilities over people with the term at 0 and at 1. "
        f"{DEFAULT_NODES}-node adaptive quadrature.",
        (context.origin,), headings=headings, formats=dict.fromkeys(frame.columns[1:], ".2f"),
        groups=(("", 1), ("one person", 5), ("over people", 3), ("probability", 3)),
    )  # fmt: skip


def _models(context: ReportContext, regression: Regression) -> tuple[Block, ...]:
    table = regression.models
    formats = {"parameters": "d", "log-likelihood": ".2f", "AIC": ".2f", "dAIC": ".2f", "weight": ".3f",
               "BIC": ".2f", "sd": ".2f"}  # fmt: skip
    models = Table(
        "regression-models", table, "Models by AIC, best first. BIC counts rows.", (context.origin,),
        headings={"dAIC": "above best", "sd": "sd of intercepts", "weight": "Akaike weight"}, formats=formats,
    )  # fmt: skip
    tests = Table(
        "regression-tests", regression.tests,
        "Likelihood-ratio tests; ΔAIC is that of the larger model less that of the smaller.", (context.origin,),
        headings={"full": "larger model", "restricted": "smaller model", "chi2": "χ²", "dAIC": "ΔAIC"},
        formats={"chi2": ".2f", "df": "d", "p": ".2g", "dAIC": "+.2f"},
    )  # fmt: skip
    return (Part("Models and tests", "regression-models-part", (models, tests), True),)


def _twin(context: ReportContext, regression: Regression) -> tuple[Twin | None, str]:
    if context.effort.quick:
        return None, "this is a quick report"
    if reason := why_absent():
        return None, reason
    if context.progress is not None:
        context.progress("Bayesian twin of the regression", 0, 1)
    twin = bayes_twin(regression.table, regression.table.main, seed=context.seed)
    if context.progress is not None:
        context.progress("Bayesian twin of the regression", 1, 1)
    return twin, ""


def _sources(context: ReportContext, regression: Regression, laplace: Regression) -> tuple[Block, ...]:
    """The four columns, the forest plot, and the note on what is printed."""
    twin, reason = _twin(context, regression)
    sources: list[Source] = [of_fit(LAPLACE, laplace), of_fit(QUADRATURE, regression), of_twin(twin)]
    beside = context.is_published_design and set(TERM_OF.values()) == set(regression.terms)
    origin: tuple[Origin, ...] = (context.origin,)
    if beside:
        sources.insert(0, of_print(context.published))
        origin = (context.origin, Origin.PRINTED)
    table = Table(
        "regression-sources", side_by_side(sources, regression),
        f"The same model from several sources: odds ratios for one person with {LEVEL:.0%} intervals (Wald; "
        "equal-tailed for the twin; profile for the standard deviation). χ² of a term is for leaving it out, "
        "“against null” for adding it alone. Likelihoods are compared within a column "
        "only.",
        origin, printed=(PRINTED,) if beside else (),
    )  # fmt: skip
    long = long_form(sources)
    order = {term: i for i, term in enumerate(regression.terms)}
    long = long.sort_values("term", key=lambda c: c.map(order), kind="stable")
    told = "; ".join(
        f"{r.term} {r.source} {r.estimate:.2f} ({r.low:.2f} to {r.high:.2f})" for r in long.itertuples()
    )
    forest = Figure(
        "regression-forest", (partial(odds_forest, long, sources=[s.name for s in sources]),),
        f"Odds ratios for one person with {LEVEL:.0%} intervals, by source, on a logarithmic axis."
        + (" The star is the printed number." if beside else ""),
        (f"Odds ratios: {told}.",), origin,
    )  # fmt: skip
    blocks: list[Block] = [forest, table, Text(rules_sentence(regression, laplace))]
    if twin is None:
        blocks.append(Text(f"The Bayesian twin was not run: {reason}.", "note"))
    else:
        blocks.append(Text(twin.sentence, "plain" if twin.passed else "warning"))
    if beside:
        blocks += _printed_notes(context, regression)
    return (Part("Side by side", "regression-sources-part", tuple(blocks)),)


def _printed_notes(context: ReportContext, regression: Regression) -> list[Block]:
    found = regression.marginal[TERM_OF["help"]]
    ratio = found.probability.value / found.reference_probability.value
    return [
        Points(consistency(context.published), "On the printed numbers themselves"),
        Text(
            f"The paper reads its odds ratio as “{READING}”. That is a statement about odds. In the data of this "
            "report, where the odds ratio is "
            f"{float(regression.odds_ratios.loc[TERM_OF['help'], 'estimate']):.2f}, "
            f"people are {ratio:.2f} times as likely to help."
        ),
        Text(
            "The printed column is for orientation: the people of this report are not the paper's, and a "
            "simulated truth may have been chosen so that studies land near the printed numbers. Agreement is "
            "no replication, and a difference within the intervals is no contradiction.",
            "note",
        ),
    ]


def _data(context: ReportContext, regression: Regression) -> tuple[Block, ...]:
    """Rates by condition and residuals."""
    rates_table = by_condition(regression, context.log)
    checked = residuals(regression, context.log, context.seed)
    measure = rates.measure_name(context.protocol)
    told = "; ".join(
        f"{r.condition} observed {r.rate:.2f} ({r.low:.2f} to {r.high:.2f}), regression {r.predicted:.2f} "
        f"({r.predicted_low:.2f} to {r.predicted_high:.2f})"
        for r in rates_table.itertuples()
    )
    blocks: list[Block] = [
        Figure(
            "regression-rates", (partial(rates_beside, rates_table, measure=measure),),
            f"Observed {measure} of each condition with {LEVEL:.0%} intervals that know people repeat, and the "
            "population-averaged probability of the main model.",
            (f"{measure.capitalize()} by condition: {told}.",), (context.origin,),
        ),
        Text(checked.sentence, "warning" if _fails(checked) else "plain"),
    ]  # fmt: skip
    if len(checked.by):
        named = "; ".join(f"{r.grouping} {r.value} {r.z:+.1f}" for r in checked.by.itertuples())
        blocks.append(
            Figure(
                "regression-residuals", (partial(residual_classes, checked.by, limit=checked.limit),),
                "Mean randomised quantile residual of every round, condition and schedule, in standard errors. "
                "In 95 of 100 studies that the model is right for, all lie inside the band. Residuals have a "
                f"random part, here of seed {checked.check.seed}.",
                (f"Mean residuals in standard errors: {named}.",), (context.origin,),
            )
        )  # fmt: skip
    return (Part("Does it describe the data?", "regression-checks-part", tuple(blocks)),)


def _fails(checked: Residuals) -> bool:
    return bool(checked.check.p < 0.05 or len(checked.outside))


def _readings(context: ReportContext, regression: Regression) -> tuple[Block, ...]:
    found = readings(regression, DEFAULT_NODES)
    columns = ["term", "reading", "rows", "people", "estimate", "low", "high", "z", "p", "sd"]
    frame = found.table[columns].sort_values(
        "term", key=lambda c: c.map({t: i for i, t in enumerate(regression.terms)}), kind="stable"
    )
    table = Table(
        "regression-readings", frame,
        "Odds ratios for one person under other readings of the formula. “Taken so far” turns 1 with the first "
        "act in the run, so it also compares people with themselves earlier, and is not randomised.",
        (context.origin,), row_headings=2,
        headings={"low": "from", "high": "to", "estimate": "odds ratio", "sd": "sd of intercepts"},
        formats={"rows": ",d", "people": ",d", "p": ".2g"}
        | dict.fromkeys(("estimate", "low", "high", "z", "sd"), ".2f"),
    )  # fmt: skip
    sentences = [Text(text) for term in regression.terms if (text := found.sentence_of(term))]
    failed = [Text(f"{name}: not fitted ({why}).", "note") for name, why in found.failed.items()]
    return (Part("Other readings", "regression-readings-part", (*sentences, table, *failed), True),)


def _headline(context: ReportContext, regression: Regression) -> Headline:
    """What each term changes over people.

    A sign is open where the interval holds zero, or has no ends; all is open where nothing was randomised.
    """
    parts, undecided = [], 0
    for term in regression.terms:
        found = regression.marginal[term].difference
        value, low, high = (100 * v for v in (found.value, found.lower, found.upper))
        open_ = not (low > 0 or high < 0)
        undecided += open_
        told = f"{LEVEL:.0%} interval {low:+.1f} to {high:+.1f}" if math.isfinite(high - low) else "no interval"
        told += ": sign not decidable" if open_ else ""
        parts.append((open_, f"{value:+.1f} with '{spoken(term)}' ({told})"))
    text = (
        f"By the regression, over people, the probability of '{spoken(regression.table.outcome)}' changes by so "
        f"many percentage points: {'; '.join(part for _, part in sorted(parts, key=lambda p: p[0]))}."
    )
    if not regression.table.randomised:
        text += " Not randomised, so none of this is the effect of anything."
    notes = [note.text for note in regression.main.notes]
    if notes:
        text += f" Caution: {notes[0]}."
    open_ = undecided == len(parts) or not regression.table.randomised
    kind = "warning" if notes else "open" if open_ else "plain"
    return Headline(text=text, kind=kind, question=Question.EFFECT, origin=(context.origin,))
