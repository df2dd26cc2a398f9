"""Section: numbers of states beside each other and beside models that need no latent state."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial

from analysis.comparison import CLOSE, CRITERIA, CompareSettings, Comparison, compare
from analysis.datasets import log_digest
from analysis.figures.comparison import elpd_differences
from analysis.fits import stored_fit
from analysis.report.context import ReportContext
from analysis.report.section import Block, Figure, NotSupported, Origin, Points, Table, Text
from models.parameters import Array
from models.person_offset import PersonOffset
from models.posterior import Posterior

FOLDS = 10

HEADINGS = {
    "n_parameters": "free parameters", "elpd_diff": "LOO below best", "dse": "its standard error",
    "p_worse": "probability worse", "diag_diff": "caution", "weight": "stacking weight",
    "max_pareto_k": "largest Pareto k", "kfold_diff": "k-fold below best", "kfold_dse": "its standard error ",
    "log_marginal": "log marginal likelihood", "log_marginal_error": "its Monte Carlo error",
    "log_likelihood": "log-likelihood", "aic": "AIC", "bic": "BIC", "gate": "sampling",
}  # fmt: skip
FORMATS = {
    "n_parameters": ",d", "elpd_diff": ".1f", "dse": ".1f", "p_worse": ".2f", "weight": ".2f",
    "max_pareto_k": ".2f", "kfold_diff": ".1f", "kfold_dse": ".1f", "log_marginal": ".1f",
    "log_marginal_error": ".2f", "log_likelihood": ".1f", "aic": ".1f", "bic": ".1f",
}  # fmt: skip


def make(context: ReportContext) -> tuple[Block, ...]:
    """Sentence, table and figure of the comparison; minutes of work, so left out of quick reports."""
    if context.effort.quick:
        raise NotSupported(
            "it takes minutes, and this is a quick report; `prosocial compare --quick` is the short way"
        )
    if context.log.n_participants < FOLDS:
        raise NotSupported(f"fewer than {FOLDS} people, so no folds of people can be held out")
    settings = CompareSettings.of(folds=FOLDS, seed=context.seed)
    digest = log_digest(context.log)

    def learn(k: int, held: Mapping[str, Array | None], people: PersonOffset | None) -> Posterior:
        return stored_fit(context.log, digest, k, pins=held, people=people, sampler=settings.sampler).posterior

    result = compare(
        context.log, context.study.states, pins=dict.fromkeys(context.pins), settings=settings, learn=learn,
        progress=context.progress,
    )  # fmt: skip
    return blocks(result, context.origin)


def blocks(result: Comparison, origin: Origin) -> tuple[Block, ...]:
    """Sentence, table, figure and warnings of a comparison.

    Parameters
    ----------
    result : Comparison
    origin : Origin
        Of the data behind it.
    """
    frame = result.table[["model", *HEADINGS]].copy()
    caption = (
        f"Models under every criterion; {result.people:,} people, {result.responses:,} recorded responses. LOO and "
        f"k-fold ({result.settings.folds} folds) leave out people. The marginal likelihood depends on the prior "
        f"(kappa {result.prior.stay:g}). A stacking weight is not a probability: among models that predict alike "
        "it picks one. Do not rely on the probability of being worse where a caution is given."
    )
    table = Table("comparison", frame, caption, (origin,), headings=HEADINGS, formats=FORMATS)
    made: list[Block] = [Text(result.sentence), table, figure(result, origin)]
    if result.warnings:
        made.append(Points(tuple(result.warnings), "Not to be relied on as they stand"))
    return tuple(made)


def figure(result: Comparison, origin: Origin) -> Figure:
    """Differences in elpd with intervals, and the choices of the criteria."""
    shown = result.table
    chosen: dict[str, list[str]] = {}
    for column, model in result.choices().items():
        chosen.setdefault(model, []).append(CRITERIA[column])
    differences = "; ".join(
        f"{row.model} {row.elpd_diff:.1f} (LOO, standard error {row.dse:.1f}) and {row.kfold_diff:.1f} (k-fold)"
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
