"""What the paper concludes from study 2, each conclusion as a function of one study's result.

A conclusion holds of a study if the study would have led to it: the difference has the sign that is claimed, and
the test that the paper makes has the result that it reports. Tests are those of `analysis.study2_analysis`, Tukey's
comparisons fed one value a person. Where the paper's words leave open what is meant, `Claim.text` says how they are
read here. The planner under test takes the place of the paper's own, among the paper's four other policies.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray
from scipy.stats import studentized_range

from analysis.anova import mixed_anova
from analysis.study2 import Study2
from analysis.study2_outcomes import BELIEF, CUMULATIVE, OBSERVED, TEAM, first_and_last, person_values
from analysis.study2_policies import ALWAYS, LS_POMDP, MYOPIC, NEVER, PAPER, REACTIVE
from models.errors import InputError

Array = NDArray[np.float64]

MEASURED = (TEAM, OBSERVED, CUMULATIVE)
"""Outcomes that the paper tests."""

EFFECTS = ("policy", "time", "policy:time")

SURE = 0.05
"""Level at which the paper calls a difference significant where it names no other."""

ROUNDING = 1e-9
"""Smaller differences of means are what adding in another order leaves, and no difference."""


@dataclass(frozen=True)
class Facts:
    """What the conclusions depend on.

    Attributes
    ----------
    planner : str
        The policy under test.
    policies : tuple of str
    size : float64[policy]
        People under each.
    mean : mapping of str to float64[policy]
        Of one value a person, by outcome.
    variance : mapping of str to float
        Pooled over policies, by outcome; NaN where nobody differs from others under the same policy.
    f, p : mapping of (outcome, effect) to float
        Mixed analyses of variance, first against last; NaN where they are not possible.
    costly : mapping of str to float
        Mean number of costly actions a person, by policy.
    """

    planner: str
    policies: tuple[str, ...]
    size: Array
    mean: Mapping[str, Array]
    variance: Mapping[str, float]
    f: Mapping[tuple[str, str], float]
    p: Mapping[tuple[str, str], float]
    costly: Mapping[str, float]

    @classmethod
    def of(cls, study: Study2, planner: str = LS_POMDP) -> Facts:
        """The facts of a study.

        Parameters
        ----------
        study : Study2
            Whose policies are the planner and the paper's four others.
        planner : str
        """
        size = np.bincount(study.policy, minlength=len(study.policies)).astype(np.float64)
        mean: dict[str, Array] = {}
        variance: dict[str, float] = {}
        f: dict[tuple[str, str], float] = {}
        p: dict[tuple[str, str], float] = {}
        for key in (*MEASURED, BELIEF):
            people = person_values(study, key)
            mean[key] = np.bincount(people.group, people.value, minlength=len(size)) / size
            try:
                variance[key] = people.summary()[2]
            except InputError:
                variance[key] = float("nan")
        for key in MEASURED:
            try:
                table = mixed_anova(first_and_last(study, key)).table
                tests = {r.effect: (float(r.f), float(r.p)) for r in table.itertuples()}
            except InputError:
                tests = dict.fromkeys(EFFECTS, (float("nan"), float("nan")))
            for effect, (ratio, chance) in tests.items():
                # Cells that differ by nothing leave a sum of squares of rounding, which may be negative.
                f[key, effect], p[key, effect] = (0.0, 1.0) if ratio <= 0 else (ratio, chance)
        costly = {policy: float(study.costly[study.of(policy)].mean()) for policy in study.policies}
        return cls(planner, study.policies, size, mean, variance, f, p, costly)

    def difference(self, outcome: str, policy: str, other: str | None = None) -> float:
        """Mean under the planner (or another policy) less that under a policy; equal counts are no difference."""
        difference = float(self.mean[outcome][self._at(other)] - self.mean[outcome][self._at(policy)])
        return 0.0 if abs(difference) < ROUNDING else difference

    def above(self, outcome: str, policy: str, level: float, other: str | None = None) -> bool:
        """Whether the planner (or another policy) is above a policy with Tukey's p below a level."""
        return self.difference(outcome, policy, other) > 0 and self.differs(outcome, policy, level, other)

    def differs(self, outcome: str, policy: str, level: float, other: str | None = None) -> bool:
        """Whether Tukey's p is below a level; not so where nothing can be tested."""
        places = [self._at(policy), self._at(other)]
        error = float(np.sqrt(self.variance[outcome] * np.sum(1 / self.size[places])))
        df = int(self.size.sum()) - len(self.size)
        return abs(self.difference(outcome, policy, other)) > tukey_t(level, len(self.size), df) * error

    def effect(self, outcome: str, effect: str, level: float) -> bool:
        """Whether an effect of the analysis of variance is significant."""
        return self.p[outcome, effect] < level

    def _at(self, policy: str | None) -> int:
        return self.policies.index(self.planner if policy is None else policy)


@cache
def tukey_t(level: float, policies: int, df: int) -> float:
    """Size in standard errors from which on Tukey's p of a difference is below a level."""
    return float(studentized_range.isf(level, policies, df)) / float(np.sqrt(2))


@dataclass(frozen=True)
class Claim:
    """One conclusion.

    Attributes
    ----------
    key : str
    name : str
        In a few words; a part's makes sense below that of its whole.
    text : str
        As read here; "planner" is the policy under test.
    sentence : int
        Place of the sentence it is part of in the `claims` of the printed numbers.
    holds : callable
        Of the facts of one study.
    whole : bool
        Whether it is the whole sentence; the others are parts.
    printed : str
        Whether the paper's own study leads to it: "yes", or what there is to say.
    own_scale : bool
        Whether it is about the states of the robot's model, so that the robot's fit decides it and not people.
    """

    key: str
    name: str
    text: str
    sentence: int
    holds: Callable[[Facts], bool]
    whole: bool = False
    printed: str = "yes"
    own_scale: bool = False


# -- the conclusions -------------------------------------------------------------------------------
def team_above(facts: Facts, policy: str) -> bool:
    """More tokens a round than a policy, p < .01."""
    return facts.above(TEAM, policy, 0.01)


def team_like_always(facts: Facts) -> bool:
    """About as many tokens as always: not significantly different."""
    return not facts.differs(TEAM, ALWAYS, SURE)


def myopic_above_never(facts: Facts) -> bool:
    """More tokens a round under myopic than under never."""
    return facts.above(TEAM, NEVER, SURE, MYOPIC)


def help_above(facts: Facts, policy: str) -> bool:
    """More observed help than a policy, p < .001."""
    return facts.above(OBSERVED, policy, 0.001)


def help_higher(facts: Facts, policy: str) -> bool:
    """More observed help than a policy, not significantly."""
    return facts.difference(OBSERVED, policy) > 0 and not facts.differs(OBSERVED, policy, SURE)


def fewer_costly(facts: Facts) -> bool:
    """Fewer costly actions than always."""
    return facts.costly[facts.planner] < facts.costly[ALWAYS]


def belief_faster(facts: Facts) -> bool:
    """Belief is at higher states than under always, on the mean of the rounds; both start from the same belief."""
    return facts.difference(BELIEF, ALWAYS) > 0


def main_effects(facts: Facts, level: float = SURE) -> bool:
    """Policy and time have main effects on all three outcomes."""
    return all(facts.effect(key, effect, level) for key in MEASURED for effect in ("policy", "time"))


def main_effect(facts: Facts, outcome: str, effect: str) -> bool:
    """One main effect."""
    return facts.effect(outcome, effect, SURE)


def interaction_of(facts: Facts, outcome: str, level: float = SURE) -> bool:
    """Policy by time for one outcome."""
    return facts.effect(outcome, "policy:time", level)


def interaction_of_cumulative_only(facts: Facts) -> bool:
    """Policy by time for cumulative tokens, and for no other outcome."""
    return interaction_of(facts, CUMULATIVE) and not any(interaction_of(facts, k) for k in (TEAM, OBSERVED))


def no_interaction(facts: Facts, outcome: str) -> bool:
    """No significant policy by time."""
    return facts.p[outcome, "policy:time"] >= SURE


def _all(*parts: Callable[[Facts], bool]) -> Callable[[Facts], bool]:
    return lambda facts: all(part(facts) for part in parts)


_TEAM = tuple(partial(team_above, policy=p) for p in (NEVER, REACTIVE, MYOPIC))
_HELP = (*(partial(help_above, policy=p) for p in (NEVER, MYOPIC)),
         *(partial(help_higher, policy=p) for p in (ALWAYS, REACTIVE)))  # fmt: skip

NAMES = {TEAM: "team performance", OBSERVED: "observed help", CUMULATIVE: "cumulative tokens"}

CLAIMS: tuple[Claim, ...] = (
    Claim("team", "team performance", "team performance: planner above never, reactive and myopic (each p < .01), "
          "no significant difference from always", 2, _all(*_TEAM, team_like_always), whole=True,
          printed="in the text; reactive .01 in the table"),
    *(Claim(f"team-{p}", f"above {p}, p < .01", f"team performance: planner above {p}, p < .01", 2, part,
            printed="in the text; .01 in the table" if p == REACTIVE else "yes")
      for p, part in zip((NEVER, REACTIVE, MYOPIC), _TEAM, strict=True)),
    Claim("team-always", "like always", "team performance: no significant difference from always", 2,
          team_like_always, printed="difference .027"),
    Claim("myopic-never", "myopic above never, p < .05", "team performance: myopic above never, p < .05, as the "
          "printed differences and their p values imply", 2, myopic_above_never, printed="implied"),
    Claim("help", "observed help", "observed help: planner above never and myopic (each p < .001), above always "
          "and reactive, not significantly", 3, _all(*_HELP), whole=True),
    *(Claim(f"help-{p}", f"above {p}, p < .001", f"observed help: planner above {p}, p < .001", 3, part)
      for p, part in zip((NEVER, MYOPIC), _HELP[:2], strict=True)),
    *(Claim(f"help-{p}", f"above {p}, not significantly", f"observed help: planner above {p}, not significantly", 3,
            part) for p, part in zip((ALWAYS, REACTIVE), _HELP[2:], strict=True)),
    Claim("costly", "fewer costly actions", "planner takes fewer costly actions than always", 4, fewer_costly,
          whole=True),
    Claim("belief", "belief rises faster", "belief is at higher states than under always, on the mean of the "
          "rounds and the robot's own scale", 5, belief_faster, whole=True, own_scale=True),
    Claim("main-effects", "main effects", "policy and time have main effects on all three outcomes, p < .05", 6,
          main_effects, whole=True),
    Claim("main-effects-text", "all with p < .02", "policy and time have main effects on all three outcomes, "
          "p < .02", 6, partial(main_effects, level=0.02), printed="in the text; .0263 in the table"),
    *(Claim(f"{effect}-{key}", f"{effect}: {name}", f"{effect} has a main effect on {name}, p < .05", 6,
            partial(main_effect, outcome=key, effect=effect))
      for key, name in NAMES.items() for effect in ("policy", "time")),
    Claim("interaction", "interaction", "policy by time for cumulative tokens only, p < .05", 7,
          interaction_of_cumulative_only, whole=True),
    Claim("interaction-cumulative", "cumulative tokens, p < .001", "policy by time for cumulative tokens, "
          "p < .001", 7, partial(interaction_of, outcome=CUMULATIVE, level=0.001),
          printed="in the text; .0010 in the table"),
    *(Claim(f"interaction-no-{key}", f"none: {NAMES[key]}", f"no policy by time for {NAMES[key]}, p at least .05",
            7, partial(no_interaction, outcome=key)) for key in (TEAM, OBSERVED)),
)  # fmt: skip
"""All conclusions from study 2, each sentence of the paper followed by its parts."""


def check_claims(study: Study2, planner: str = LS_POMDP) -> dict[str, bool]:
    """Which conclusions a study leads to, by their keys.

    Parameters
    ----------
    study : Study2
        May have other policies besides; the paper's four others and the planner are looked at.
    planner : str
    """
    facts = Facts.of(as_printed(study, planner), planner)
    return {claim.key: bool(claim.holds(facts)) for claim in CLAIMS}


def as_printed(study: Study2, planner: str = LS_POMDP) -> Study2:
    """The study with the planner in the place of the paper's own policy, beside the paper's four others."""
    names = (planner, *(p for p in PAPER if p != LS_POMDP))
    if study.policies == names:
        return study
    wanted = [study.policies.index(name) for name in names]
    return study.some(np.flatnonzero(np.isin(study.policy, wanted)), names)
