"""Study 1's regression in words, made from its numbers."""

from __future__ import annotations

from analysis.regression import LEVEL, Regression
from analysis.regression_sources import p_text
from models.glmm_marginal import Estimate
from models.glmm_warnings import SeparationWarning

SIGNIFICANT = 0.05
"""p below which the paper, and so these sentences, call an effect significant."""


def main_sentence(regression: Regression) -> str:
    """What the main model says of each term."""
    tests = regression.tests.set_index("question")
    parts = []
    for name, row in regression.odds_ratios.iterrows():
        test = tests.loc[f"{name}, beside the others"]
        verdict = "significant" if test["p"] < SIGNIFICANT else "not significant"
        parts.append(
            f"{name}: odds ratio {row['estimate']:.2f} for one person ({LEVEL:.0%} profile interval "
            f"{row['profile_low']:.2f} to {row['profile_high']:.2f}), z = {row['z']:.2f}, χ²({test['df']:.0f}) = "
            f"{test['chi2']:.2f}, p {_p(test['p'])}: {verdict} at {SIGNIFICANT:g}"
        )
    return f"{'; '.join(parts)}. Standard deviation of people's intercepts {regression.main.sd:.2f}."


def interaction_sentence(regression: Regression) -> str:
    """Whether terms interact; empty where they cannot."""
    if len(regression.terms) == 1:
        return f"{regression.terms[0]} is the only term, so nothing can interact."
    if not regression.interaction:
        return "Interactions cannot be estimated: the terms never meet, or a cell of the design is empty."
    test = regression.tests.set_index("question").loc["interaction"]
    verdict = "significant" if test["p"] < SIGNIFICANT else "not significant"
    text = (
        f"The interaction is {verdict} (χ²({test['df']:.0f}) = {test['chi2']:.2f}, p {_p(test['p'])}, ΔAIC "
        f"{test['dAIC']:+.1f})"
    )
    if test["p"] >= SIGNIFICANT:
        fit = regression.fits[regression.interaction]
        products = [str(name) for name in fit.params.index if ":" in str(name)]
        ratios = fit.odds_ratios(1 - LEVEL).loc[products]
        told = ", ".join(
            f"{name} between {row['lower']:.2f} and {row['upper']:.2f}" for name, row in ratios.iterrows()
        )
        text += f", which is no proof that there is none: ratios of odds ratios {told} remain possible"
    return f"{text}."


def odds_sentence(regression: Regression, term: str) -> str:
    """What an odds ratio is over people, and what "times more likely" would have to say."""
    found = regression.marginal[term]
    odds = float(regression.odds_ratios.loc[term, "estimate"])
    ratio = found.probability.value / found.reference_probability.value
    return (
        f"Odds, not likelihood: {term} multiplies one person's odds by {odds:.2f}. Over people it takes the "
        f"probability of the response from {_percent(found.reference_probability)} to "
        f"{_percent(found.probability)}, "
        f"which is an odds ratio of {found.odds_ratio.value:.2f} ({found.odds_ratio.lower:.2f} to "
        f"{found.odds_ratio.upper:.2f}) and {ratio:.2f} times as likely, {100 * found.difference.value:+.1f} "
        f"percentage points ({100 * found.difference.lower:+.1f} to {100 * found.difference.upper:+.1f})."
    )


def rules_sentence(quadrature: Regression, laplace: Regression) -> str:
    """How far Laplace's approximation is from quadrature, and whether any of the two depends on its nodes."""
    fine, coarse = quadrature.main, laplace.main
    parts = [f"standard deviation {coarse.sd:.2f} against {fine.sd:.2f}"]
    for name in quadrature.terms:
        one, other = (r.odds_ratios.loc[name] for r in (laplace, quadrature))
        parts.append(
            f"odds ratio of {name} {one['estimate']:.2f} against {other['estimate']:.2f} (z {one['z']:.2f} against "
            f"{other['z']:.2f})"
        )
    text = f"Laplace's approximation against {fine.model.rule.name}: {'; '.join(parts)}."
    if coarse.node_check.dependent:
        text += " Laplace's estimate depends on the rule and is not the maximum of the likelihood of these data."
    if fine.node_check.dependent:
        text += f" So does the other, though: {fine.node_check.text}."
    elif not fine.boundary:
        text += f" Quadrature has settled: {fine.node_check.text}."
    return text


def cautions(regression: Regression) -> tuple[str, ...]:
    """What not to conclude."""
    table = regression.table
    out = []
    assigned = [t.name for t in table.terms if t.kind == "assigned"]
    if assigned:
        out.append(
            f"{' and '.join(assigned)} is what the condition's robot does throughout, so it also says 1 for "
            "responses before the first chance to act, where it cannot have mattered; other readings stand "
            "beside it."
        )
    if not table.randomised:
        out.append(
            "Not randomised: an action of the robot may answer to what the person did before, so no odds ratio "
            "of it is the effect of anything."
        )
    out.append(
        "Each person has one intercept that never changes: given it, responses are taken to be independent. A "
        "state that moves from round to round is not in this model."
    )
    out.append(
        "People's intercepts are taken to be normal on the logit scale. Odds ratios for one person depend on "
        "that and on the standard deviation; the differences in probability hardly do."
    )
    if table.constant:
        names = ", ".join(t.name for t in table.constant)
        out.append(f"Nothing is said of {names}: the same in every row.")
    notes = [f"{note.category.__name__}: {note.text}." for note in regression.main.notes]
    if any(note.category is SeparationWarning for note in regression.main.notes):
        notes.append("Nothing in this section that rests on the separated coefficients means anything.")
    return (*notes, *out)


def _percent(estimate: Estimate) -> str:
    return f"{100 * estimate.value:.0f}% ({100 * estimate.lower:.0f} to {100 * estimate.upper:.0f})"


def _p(p: float) -> str:
    return f"< {p_text(p)[1:]}" if p < 0.001 else f"= {p_text(p)}"
