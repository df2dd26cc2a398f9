"""What stands beside AIC and BIC: ties, a likelihood that tells nothing apart, and parameters that are not free.

AIC and BIC count free parameters: both rest on an expansion of the likelihood around an estimate that lies inside
and is the only one. Where the histories pin down fewer directions than there are parameters, the posterior has
nothing to pay for the others, so the penalty of BIC is too large (the learning coefficient of Watanabe 2009,
Algebraic Geometry and Statistical Learning Theory, is then less than half the number of parameters; Drton and
Plummer 2017). At 0 or 1 the cost depends on the prior: for n refusals in a row, the marginal likelihood falls as
1/n under a uniform prior on the probability of help and as the square root of that under Beta(1/2, 1/2); BIC
charges the latter to both.
"""

from __future__ import annotations

from collections.abc import Mapping

from analysis.comparison_words import listed
from analysis.em_study import EmStudy, fewest
from analysis.report.section import Block, Text
from analysis.wording import counted
from models.identification import BOUNDARY

SAME_FIT = 0.5
"""Nats of log-likelihood between numbers of states below which the data do not tell them apart."""

TIED = 2.0
"""Difference in BIC or AIC below which it does not tell two numbers of states apart."""


def caveats(study: EmStudy) -> list[Block]:
    """Paragraphs to stand right after the choice of the criteria; empty if nothing is to be said.

    Parameters
    ----------
    study : EmStudy
    """
    told = (only_one(study), same_likelihood(study), ties(study), not_free(study))
    kinds = ("note", "warning", "plain", "plain")
    return [Text(text, kind) for text, kind in zip(told, kinds, strict=True) if text]


def only_one(study: EmStudy) -> str:
    """What cannot be chosen because it was not fitted."""
    smallest = min(study.states)
    if len(study.states) == 1:
        return (
            f"Only models with {counted(smallest, 'state')} were asked for, so no criterion chooses anything here."
        )
    if study.best_by_bic == smallest > 1:
        return f"{smallest} is the smallest number that was asked for, so these criteria never saw fewer."
    return ""


def same_likelihood(study: EmStudy) -> str:
    """Whether all numbers of states fit these data alike, so that the criteria do nothing but count."""
    if len(study.states) < 2:
        return ""
    value = {k: fit.log_likelihood for k, fit in study.fits.items()}
    apart = max(value.values()) - min(value.values())
    if apart > SAME_FIT:
        return ""
    return (
        f"The likelihood does not tell the numbers of states apart: from {min(value)} to {max(value)} states its "
        f"maximum changes by {apart:.2f} nats ({min(value.values()):.2f} to {max(value.values()):.2f}). AIC "
        "and BIC then merely count parameters, and choose the smallest number that was asked for."
    )


def ties(study: EmStudy) -> str:
    """Numbers of states that BIC or AIC hardly tells from its choice."""
    bic = {k: fit.bic for k, fit in study.fits.items()}
    aic = {k: fit.aic for k, fit in study.fits.items()}
    told = [t for t in (_tie("BIC", bic, study.best_by_bic), _tie("AIC", aic, fewest(_negative(aic)))) if t]
    return " ".join(told)


def _negative(values: Mapping[int, float]) -> dict[int, float]:
    return {k: -v for k, v in values.items()}


def _tie(name: str, values: Mapping[int, float], best: int) -> str:
    near = {k: v - values[best] for k, v in values.items() if k != best and v - values[best] < TIED}
    if not near:
        return ""
    # The fewest states of those within rounding are chosen, so a difference may be a hair below zero.
    said = [f"{counted(k, 'state')} ({f'{d:+.2f}' if d > 0.005 else 'a tie'})" for k, d in near.items()]
    return (
        f"{name} does not tell {counted(best, 'state')} from {listed(said, 'or')}: below {TIED:g} a difference "
        "says nothing."
    )


def not_free(study: EmStudy) -> str:
    """How many counted parameters are not free, and what that does to AIC and BIC."""
    found = study.identifications
    edge = {k: (i.on_boundary, i.n_parameters) for k, i in found.items() if i.on_boundary}
    flat = {k: (i.rank, i.n_parameters) for k, i in found.items() if i.deficiency > 0}
    text = "The count of free parameters behind AIC and BIC does not hold here."
    if not (edge or flat):
        return ""
    if edge:
        said = [f"{n} of {total} at {counted(k, 'state')}" for k, (n, total) in edge.items()]
        text += (
            f" Estimated at 0 or 1 (within {BOUNDARY:g}) are {listed(said, 'and')}; what such a parameter costs "
            "depends on a prior that BIC does not know, and AIC, which counts it as free, charges it too much if "
            "the truth lies there."
        )
    if flat:
        said = [f"{rank} of {total} at {counted(k, 'state')}" for k, (rank, total) in flat.items()]
        text += (
            f" The observed histories pin down only {listed(said, 'and')}; for the rest BIC charges what costs "
            "nothing, so it leans towards fewer states."
        )
    return f"{text} The marginal likelihood, which BIC approximates, needs no such count."
