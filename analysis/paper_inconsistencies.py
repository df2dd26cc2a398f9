"""Where the paper contradicts itself, each with the check that shows it."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from analysis.paper_agreement import written
from analysis.paper_model import replicated_likelihoods
from analysis.paper_numbers import Ours
from analysis.paper_regression import own_regression
from analysis.printed_anova import MEASURES
from analysis.printed_regression import TERM_OF, rounding
from analysis.study2_claims import EFFECTS
from models.baum_welch import SAME_OPTIMUM
from models.errors import located

TEAM_CLAIM, EFFECTS_CLAIM = 2, 6
"""Places of the claims on team performance and on main effects."""


@dataclass(frozen=True)
class Inconsistency:
    """One inconsistency.

    Attributes
    ----------
    noted : str
        As it is noted among the published numbers.
    place : str
    check : str
        What was computed, and what came of it.
    shown : bool or None
        Whether the check shows it; None where it could not be made.
    detail : str
        Key of the section of the report that has more.
    """

    noted: str
    place: str
    check: str
    shown: bool | None
    detail: str

    @property
    def word(self) -> str:
        """Whether the check shows it."""
        return {True: "shown", False: "not shown", None: "cannot be checked"}[self.shown]


def inconsistencies(ours: Ours) -> tuple[Inconsistency, ...]:
    """Every inconsistency that is noted, in its order.

    Raises
    ------
    InputError
        If there is not one check for each.
    """
    noted = ours.published["inconsistencies_noted"]
    if len(noted) != len(CHECKS):
        raise located("inconsistencies noted", len(noted), f"{len(CHECKS)}, one for each check")
    return tuple(
        Inconsistency(text, place, *make(ours), detail)
        for text, (place, make, detail) in zip(noted, CHECKS, strict=True)
    )


def _limit(claim: str) -> float:
    """The level that a claim gives in its text."""
    found = re.search(r"p < (0?\.\d+)", claim)
    if found is None:
        raise located("published claim", claim, "one with 'p < ' and a number")
    return float(found[1])


def _main_effects(ours: Ours) -> tuple[str, bool | None]:
    limit = _limit(ours.published["claims"][EFFECTS_CLAIM])
    tests = ours.published["study2"]["mixed_anova"]
    largest, where = max((tests[k][e]["p"], k) for k in tests for e in EFFECTS if ":" not in e)
    text = f"the largest printed p of a main effect is {largest:g} ({MEASURES[where]}); below {limit:g} is said"
    return text, largest - rounding(largest) >= limit


def _reactive(ours: Ours) -> tuple[str, bool | None]:
    limit = _limit(ours.published["claims"][TEAM_CLAIM])
    p = ours.published["study2"]["tukey_minus_lspomdp"]["team_performance"]["reactive"][1]
    half = rounding(p)
    text = f"{p:g} is printed, which stands for {p - half:g} to {p + half:g}; below {limit:g} is said"
    return text, not p < limit


def _all_metrics(ours: Ours) -> tuple[str, bool | None]:
    printed = ours.published["study2"]["tukey_minus_lspomdp"]
    rows = {name: printed[key]["always"][0] for key, name in MEASURES.items() if key in printed}
    told = "; ".join(f"{name} {written(difference)}" for name, difference in rows.items())
    text = f"always less ls-POMDP as printed: {told}; above 0 is in favour of always"
    return text, any(difference > 0 for difference in rows.values())


def _opportunities(ours: Ours) -> tuple[str, bool | None]:
    letters = ours.published["study2"]["sequence"]
    n = {letter: letters.count(letter) for letter in sorted(set(letters))}
    told = " and ".join(f"{count} {letter}" for letter, count in n.items())
    return f"{letters} has {told}", len(set(n.values())) > 1


def _logarithm(ours: Ours) -> tuple[str, bool | None]:
    """With a log link exp(b) multiplies the probability, so without helping it could be 1 / exp(b) at most."""
    ratio = ours.published["study1"]["glmm"]["help"]["odds_ratio"]
    text = (
        f"were it the logarithm of a probability, at most 1 / {ratio:g} = {1 / ratio:.1%} could help without help"
    )
    regression = own_regression(ours)
    if regression is None:
        return f"{text}; the text has a logit link and an odds ratio", None
    rate = regression.marginal[TERM_OF["help"]].reference_probability.value
    return f"{text}; in the data of this report {rate:.1%} do", bool(rate > 1 / ratio)


def _times(ours: Ours) -> tuple[str, bool | None]:
    printed = ours.published["study1"]["glmm"]["help"]["odds_ratio"]
    regression = own_regression(ours)
    if regression is None:
        return f"an odds ratio of {printed:g} is that many times as likely only where hardly anybody helps", None
    found = regression.marginal[TERM_OF["help"]]
    base = found.reference_probability.value
    own = float(regression.odds_ratios.loc[TERM_OF["help"], "estimate"])
    ratio, implied = found.probability.value / base, printed / (1 - base + base * printed)
    text = (
        f"in the data of this report an odds ratio of {own:.2f} is {ratio:.2f} times as likely; {printed:g} at the "
        f"same {base:.0%} without help would be {implied:.2f} times"
    )
    return text, bool(abs(implied - printed) > rounding(printed))


def _five_states(ours: Ours) -> tuple[str, bool | None]:
    states = ours.published["em"]["selected_states"]
    fits, parts, shown = ours.study.fits, [], []
    if {states, states + 1} <= set(fits):
        few, more = (fits[k].log_likelihood for k in (states, states + 1))
        parts.append(
            f"the longer search finds {written(few, 5)} at {states} and {written(more, 5)} at {states + 1}"
        )
        shown.append(bool(more >= few - SAME_OPTIMUM))
    found = replicated_likelihoods(ours)
    if {states, states + 1} <= set(found):
        higher = np.array(found[states + 1]) >= np.array(found[states]) - SAME_OPTIMUM
        parts.append(
            f"{states + 1} states are at least as high in {higher.sum()} of {len(higher)} simulated studies"
        )
        shown.append(bool(higher.all()))
    if not parts:
        return f"neither {states} and {states + 1} states nor replications were fitted", None
    return "; ".join(parts), all(shown)


def _constant(ours: Ours) -> tuple[str, bool | None]:
    """In how many runs the robot took more than one action in a mode."""
    log = ours.log
    modes = np.asarray(log.protocol.mode_of_action)[log.action]
    varied = np.zeros(log.n_runs, dtype=bool)
    for m in range(len(log.protocol.modes)):
        own = modes == m
        low = np.full(log.n_runs, log.protocol.n_actions)
        high = np.full(log.n_runs, -1)
        np.minimum.at(low, log.run_of_event[own], log.action[own])
        np.maximum.at(high, log.run_of_event[own], log.action[own])
        varied |= (high > low) & (high >= 0)
    people = len(np.unique(log.participant[varied]))
    text = f"{people:,} of {log.n_participants:,} people of this report saw the robot vary what it does in a mode"
    return f"{text}; a belief-based policy varies it", people == 0


Made = Callable[[Ours], tuple[str, bool | None]]

CHECKS: tuple[tuple[str, Made, str], ...] = (
    ("Sec. V-A and Table I", _main_effects, "anova"),
    ("Sec. V-A and Table II", _reactive, "anova"),
    ("Sec. V-A and Table II", _all_metrics, "anova"),
    ("Sec. V-A", _opportunities, "study2"),
    ("Sec. IV-A, equation", _logarithm, "regression"),
    ("Sec. IV-A", _times, "regression"),
    ("Sec. IV-B", _five_states, "states"),
    ("Sec. IV-A and V-A", _constant, "study"),
)
"""Place, check and section of each, in the order in which they are noted."""
