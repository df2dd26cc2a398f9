"""The best plan for who will not draw lots: all of them where they are few, else the best of those looked at.

Column generation (`models.robust.cautious`) proves the best mixture, and bounds what any single plan can reach. The
best single plan is another matter, a discrete one. Where few plans are possible all are valued. Elsewhere a pool
(plans of the search, and whatever else is known) is improved decision by decision: the values of all plans that
differ in one decision come from one pass forwards and one backwards, and when none is better, pairs of decisions
are tried. What comes of that is the best plan looked at, and no more is said of it.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from models.planning.exact import Decisions
from models.planning.policies import Policy
from models.planning.schedule import Array, Schedule
from models.robust.cautious import CautiousPlan
from models.robust.neighbour_plans import Neighbours, neighbour_values
from models.robust.plan_table import plan_key

MOST_VALUES = 2_000_000
"""Numbers (plans times draws) up to which every possible plan is valued."""

STARTS = 4
"""Plans of the pool that are improved, the best ones."""

MOST_PASSES, FEWEST_PASSES = 120, 5
"""Passes over all decisions that the search takes at most; with fewer than the latter it is not begun."""

WORK = 25_000_000
"""Numbers (histories times draws times states) that all passes together may look at."""


@dataclass(frozen=True)
class SinglePlan:
    """One plan that is always followed, and how it was found.

    Attributes
    ----------
    mixture : CautiousPlan
        The best plan of those that may draw lots, with the criterion and its bound.
    plan : Decisions
    worth : float
        Its criterion.
    values : float64[u]
        What it is worth in each draw.
    looked : int
        Different plans that were looked at.
    every : bool
        Whether these are all there are.
    """

    mixture: CautiousPlan
    plan: Decisions
    worth: float
    values: Array
    looked: int
    every: bool

    @property
    def proven(self) -> bool:
        """Whether no single plan is better: all were looked at, or this one reaches the bound of all policies."""
        return self.every or self.lost <= self.mixture.tolerance

    @property
    def lost(self) -> float:
        """What drawing lots could gain, at most."""
        return max(self.mixture.upper - self.worth, 0.0)

    @property
    def cautious(self) -> CautiousPlan:
        """The same in the form of a mixture of one plan.

        It keeps the bound that holds for all policies, so its gap is what drawing lots could gain at most.
        """
        return replace(
            self.mixture, plans=(self.plan,), share=np.ones(1), values=self.values, lower=self.worth,
            upper=max(self.mixture.upper, self.worth),
        )  # fmt: skip


def best_single(mixture: CautiousPlan, more: Sequence[Decisions] = ()) -> SinglePlan:
    """The best plan that draws no lots, for the criterion of a cautious plan.

    Parameters
    ----------
    mixture : CautiousPlan
        Best of the plans that may.
    more : sequence of Decisions
        Plans to look at besides those that its search has met. None of them is better than what is returned.
    """
    schedule, groups = mixture.schedule, mixture.groups
    table = mixture.table.with_plans(list(more))
    outcomes = groups.mean(table.values) - mixture.reference
    scores = mixture.risk.lowest_each(outcomes)
    best = int(np.argmax(scores))
    if mixture.upper - scores[best] <= mixture.tolerance:
        return _told(mixture, table.plans[best], len(table.plans), False)
    number = count_plans(schedule, MOST_VALUES // max(schedule.draws.n_draws, 1))
    if number is not None:
        return _told(mixture, _best_of_all(mixture), number, True)
    passes = min(MOST_PASSES, WORK // (sum(len(v) for v in table.plans[best]) * schedule.draws.initial.size))
    if passes < FEWEST_PASSES:
        return _told(mixture, table.plans[best], len(table.plans), False)
    search = _Search(mixture, {plan_key(p) for p in table.plans}, passes)
    ends = [search.climb(table.plans[i], scores[i]) for i in np.argsort(-scores, kind="stable")[:STARTS]]
    plan, score = max(ends, key=lambda end: end[1])
    return _told(mixture, search.by_pairs(plan, score), len(search.seen), False)


def count_plans(schedule: Schedule, most: int) -> int | None:
    """How many plans are possible; None if they are more than `most`.

    Examples
    --------
    >>> from models.lspomdp import LatentStatePOMDP
    >>> stays = LatentStatePOMDP([.5, .5], [np.eye(2)] * 4, [[[.9, .1], [.2, .8]]] * 2)
    >>> count_plans(Schedule.of(stays, "HRH"), 100)
    32
    """
    number = 1
    for k in range(schedule.n_events - 1, -1, -1):
        # Nothing is decided after the last event, whatever its response.
        number = len(schedule.mode(k).actions) * number ** schedule.n_outcomes(k)
        if number > most:
            return None
    return number


def decisions_of(policy: Policy, schedule: Schedule) -> Decisions | None:
    """What a policy does over a schedule, as a plan; None if it leaves an action to chance.

    Parameters
    ----------
    policy : Policy
    schedule : Schedule
        Histories that none of its draws believes possible are not followed; the first action stands there.
    """
    draws, p = schedule.draws, schedule.protocol
    level: list[tuple[object, Array] | None] = [(policy.begin(schedule.modes[0]), draws.initial)]
    out = []
    for k in range(schedule.n_events):
        actions = np.zeros(len(level), dtype=np.int8)
        after: list[tuple[object, Array] | None] = []
        for r, known in enumerate(level):
            if known is None:
                after += [None] * schedule.n_outcomes(k)
                continue
            memory, w = known
            share = policy.probabilities(memory)
            if np.count_nonzero(share) != 1:
                return None
            actions[r] = choice = int(np.argmax(share))
            if k + 1 == schedule.n_events:
                continue
            a = schedule.first_action(k) + choice
            row = p.emission_index[a]
            for o in range(schedule.n_outcomes(k)):
                seen = w if row < 0 else w * draws.emission[:, row, :, o]
                moved = np.einsum("ds,dst->dt", seen, draws.transition[:, a])
                possible = draws.weight @ moved.sum(axis=1) > 0
                observed = 0 if row < 0 else o + 1
                after.append(
                    (policy.observe(memory, choice, observed, schedule.modes[k + 1]), moved) if possible else None
                )
        out.append(actions)
        level = after
    return tuple(out)


def _told(mixture: CautiousPlan, plan: Decisions, looked: int, every: bool) -> SinglePlan:
    """The plan with its values, computed as those of all plans are."""
    values = mixture.groups.mean(mixture.table.evaluator.values(plan))
    return SinglePlan(
        mixture, plan, mixture.risk.lowest(values - mixture.reference)[0], values, looked, every
    )  # fmt: skip


# -- all plans -----------------------------------------------------------------------------------
def _best_of_all(mixture: CautiousPlan) -> Decisions:
    """The best of all plans that are possible."""
    s, draws = mixture.schedule, mixture.schedule.draws
    end = np.zeros(s.n_states) if s.terminal is None else s.terminal
    vectors = np.broadcast_to(end, (1, draws.n_draws, s.n_states))
    levels: list[list[tuple[int, tuple[int, ...]]]] = []
    for k in range(s.n_events - 1, -1, -1):
        plans: list[tuple[int, tuple[int, ...]]] = []
        grown = []
        for c in range(len(s.mode(k).actions)):
            a = s.first_action(k) + c
            row = s.protocol.emission_index[a]
            ahead = s.discount * np.einsum("dst,jdt->jds", draws.transition[:, a], vectors)
            follow = [ahead if row < 0 else ahead * draws.emission[:, row, :, o] for o in range(s.n_outcomes(k))]
            worth = np.broadcast_to(s.reward[a], (1, draws.n_draws, s.n_states))
            if k == 0:
                # Nothing comes before the first event: from here on one number a draw is enough.
                worth, follow = (worth * draws.initial).sum(axis=-1), [
                    (f * draws.initial).sum(axis=-1) for f in follow
                ]  # fmt: skip
            for one in follow:
                worth = (worth[:, None] + one[None]).reshape(-1, *worth.shape[1:])
            grown.append(worth)
            plans += [(c, after) for after in product(range(len(vectors)), repeat=s.n_outcomes(k))]
        vectors = np.concatenate(grown)
        levels.append(plans)
    outcomes = mixture.groups.mean(vectors) - mixture.reference
    number = int(np.argmax(mixture.risk.lowest_each(outcomes)))
    out, followed = [], [number]
    for plans in reversed(levels):
        out.append(np.array([plans[j][0] for j in followed], dtype=np.int8))
        followed = [after for j in followed for after in plans[j][1]]
    return tuple(out)


# -- decision by decision ------------------------------------------------------------------------
class _Search:
    """Improves plans while passes are left; remembers which plans were looked at."""

    def __init__(self, mixture: CautiousPlan, seen: set[bytes], passes: int) -> None:
        self.mixture, self.seen, self.left = mixture, seen, passes

    def climb(self, plan: Decisions, score: float) -> tuple[Decisions, float]:
        """Change the decision that gains most, until none gains."""
        while self.left > 0:
            found, scores = self._pass(plan)
            if not len(scores) or not self._better(float(scores.max()), score):
                break
            best = int(np.argmax(scores))
            plan, score = found.plan(best), float(scores[best])
        return plan, score

    def by_pairs(self, plan: Decisions, score: float) -> Decisions:
        """Change two decisions at once, the most promising first ones first, and climb from there."""
        improved = True
        while improved and self.left > 0:
            improved = False
            found, scores = self._pass(plan)
            for i in np.argsort(-scores, kind="stable"):
                if self.left <= 0:
                    break
                second, own = self._pass(found.plan(int(i)))
                if len(own) and self._better(float(own.max()), score):
                    best = int(np.argmax(own))
                    plan, score = self.climb(second.plan(best), float(own[best]))
                    improved = True
                    break
        return plan

    def _pass(self, plan: Decisions) -> tuple[Neighbours, Array]:
        """All plans that differ in one decision, with their criterion."""
        self.left -= 1
        mixture = self.mixture
        found = neighbour_values(mixture.schedule, plan)
        self.seen.update(found.keys())
        return found, mixture.risk.lowest_each(mixture.groups.mean(found.values) - mixture.reference)

    def _better(self, score: float, than: float) -> bool:
        return score > than + self.mixture.tolerance


def pooled(plans: Iterable[Decisions | None]) -> tuple[Decisions, ...]:
    """Different plans, in order; None is left out."""
    return tuple({plan_key(p): p for p in plans if p is not None}.values())
