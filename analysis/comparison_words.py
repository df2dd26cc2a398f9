"""The comparison in words: which criteria agree on how many states, and whether a latent state is needed.

A criterion rarely names one model alone. What it cannot tell from its best model (`Comparison.indistinct`) is said
with it, so that two criteria disagree only where neither allows the other's choice.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from analysis.comparison import Comparison


def sentence(result: Comparison) -> str:
    """State each conclusion with the criteria for and against it."""
    return " ".join(
        part for part in (_how_many(result), _against_rivals(result), _people(result), _provisional(result)) if part
    )


def _provisional(result: Comparison) -> str:
    """What the predictive criteria say of models whose posterior sample missed the gate is not settled."""
    failed = [m.name for m in result.models if m.gate is not None and not m.gate.passed]
    if not failed:
        return ""
    names = listed([called(m) for m in failed], "and")
    return (
        f"PROVISIONAL: the posterior sample{'s' * (len(failed) > 1)} of {names} missed the convergence gate, on "
        "which LOO and k-fold rest."
    )


def _how_many(result: Comparison) -> str:
    kinds = ("states", "constant")
    if sum(m.kind in kinds for m in result.models) < 2:
        return ""
    chosen, allowed = result.choices(kinds), result.indistinct(kinds)
    paper = chosen.pop("log_likelihood")
    groups: dict[str, list[str]] = {}
    for column in chosen:
        groups.setdefault(_span(allowed[column]), []).append(_name(column))
    common = [m.name for m in result.models if all(m.name in allowed[c] for c in chosen)]
    by_group = "; ".join(f"{listed(names, 'and')}: {models}" for models, names in groups.items())
    if common:
        text = f"On the number of states the criteria agree on {listed(common, 'or')} ({by_group})"
    else:
        text = f"On the number of states the criteria disagree ({by_group})"
    return (
        f"{text}. The log-likelihood, which is the paper's criterion and cannot fall as states are added, is "
        f"highest at {paper}."
    )


def _against_rivals(result: Comparison) -> str:
    if not any(m.is_dynamic for m in result.models):
        return ""
    dynamic = {m.name for m in result.models if m.is_dynamic}
    verdicts: dict[str, list[str]] = {"for": [], "against": [], "open": []}
    for column, models in result.indistinct().items():
        if column != "log_likelihood":
            ours = dynamic.intersection(models)
            key = "for" if len(ours) == len(models) else "open" if ours else "against"
            verdicts[key].append(_name(column))
    best = result.choices(["states"])["elpd"]
    rival = result.choices(["types", "markov", "constant", "traits"])["elpd"]
    gap, error = result.elpd_difference(best, rival)
    margin = (
        f"by LOO {best} {'leads' if gap > 0 else 'trails'} {rival}, the best rival, by {abs(gap):.1f} nats "
        f"(standard error {error:.1f})"
    )
    if not (verdicts["against"] or verdicts["open"]):
        text = "A latent state that changes beats every rival by every criterion"
    else:
        said = {
            "for": "beats every rival by", "against": "is beaten by a rival by",
            "open": "cannot be told from a rival by",
        }  # fmt: skip
        text = "A latent state that changes " + ", ".join(
            f"{said[key]} {listed(names, 'and')}" for key, names in verdicts.items() if names
        )
    return f"{text}; {margin}."


def _people(result: Comparison) -> str:
    """Whether letting people differ helps to predict people."""
    if not any(m.kind == "people" for m in result.models):
        return ""
    best, plain = result.choices(["people"])["elpd"], result.choices(["states"])["elpd"]
    gap, error = result.elpd_difference(best, plain)
    if abs(gap) < max(4.0, 2 * error):
        verdict = "People who differ predict people neither better nor worse than people who do not"
    elif gap > 0:
        verdict = "People differ, and knowing that helps to predict them"
    else:
        verdict = "Letting people differ predicts people worse"
    return f"{verdict}: by LOO {best} less {plain} is {gap:+.1f} nats (standard error {error:.1f})."


def _name(column: str) -> str:
    from analysis.comparison import CRITERIA

    return CRITERIA[column]


def _span(models: Iterable[str]) -> str:
    """Models a criterion allows, best first."""
    best, *others = models
    if not others:
        return called(best)
    return f"{called(best)}, not told from {listed([called(m) for m in others], 'or')}"


def called(model: str) -> str:
    """A model's name within a sentence: between quotation marks where it has a comma of its own.

    Examples
    --------
    >>> called("2 states"), called("2 states, people differ")
    ('2 states', '“2 states, people differ”')
    """
    return f"\N{LEFT DOUBLE QUOTATION MARK}{model}\N{RIGHT DOUBLE QUOTATION MARK}" if "," in model else model


def listed(items: Sequence[str], last: str) -> str:
    """Items as read aloud.

    Examples
    --------
    >>> listed(["LOO", "BIC", "AIC"], "and")
    'LOO, BIC and AIC'
    """
    return items[0] if len(items) == 1 else f"{', '.join(items[:-1])} {last} {items[-1]}"
