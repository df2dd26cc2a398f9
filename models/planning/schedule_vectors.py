r"""The exact plan of a schedule as alpha vectors over the draw and the state: a plan that no history leaves.

Every event (with a budget: every event and amount left) has a set of vectors over the hidden pair (draw, state). It
is made backwards. The last events have all their plans, as long as those are few. Before that a vector is made for
every history that can come: all actions, those that no good plan takes and those that could not be paid for
included, all responses, and responses that were not recorded. So the policy is exact after all of them, and a lower
bound at other beliefs.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product as combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from models.errors import Phrase, located
from models.planning.budget_levels import BudgetLevels, budget_levels
from models.planning.charges import Units, charges_of, checked_charges, in_units
from models.planning.draw_beliefs import DrawBeliefs
from models.planning.policy_graph import PolicyGraph, graph_vectors
from models.planning.product_modes import OVER, ProductModes
from models.planning.product_policy import ProductPolicy
from models.planning.schedule import Schedule

Array = NDArray[np.float64]
Index = NDArray[np.int64]

MOST_PLANS = 64
"""Plans of an event up to which all are made, whatever history comes before."""

MOST_ENTRIES = 200_000_000
"""Numbers that the beliefs after all histories of one event may have: 1.6 GB."""

PORTION = 4_000_000
"""Numbers that are worked on at a time."""


def schedule_vectors(
    schedule: Schedule, budget: float | None = None, charges: ArrayLike | None = None, *, missing: bool = True,
    impossible: str = "error", name: str = "exact plan by belief",
) -> ProductPolicy:  # fmt: skip
    """The exact plan of a schedule as a policy that acts on its belief.

    Parameters
    ----------
    schedule : Schedule
        Under one model, or many draws: then it learns which is true.
    budget : float, optional
        What may be spent at most, on every path. An action done in the policy's stead may exceed it: then nothing
        is left.
    charges : float64[a], optional
        What each action is charged (`models.planning.charges.charges_of`): its cost by default.
    missing : bool
        Whether to be exact also after responses that were not recorded. Without, the policy takes them as well, and
        acts on a lower bound then.
    impossible : {"error", "keep", "reset"}
        What to do about a response of probability zero in every draw.
    name : str

    Raises
    ------
    InputError
        On a budget or charges that are none, or more histories than can be held.

    Examples
    --------
    >>> from models.lspomdp import LatentStatePOMDP
    >>> stays = LatentStatePOMDP([.5, .5], [[[1, 0], [0, 1]]] * 4, [[[.9, .1], [.2, .8]]] * 2)
    >>> policy = schedule_vectors(Schedule.of(stays, "HRH"))
    >>> memory = policy.begin(policy.vocabulary.mode("robot_needs_help"))
    >>> policy.action_values(memory).round(3)
    array([61.232, 46.232])
    """
    beliefs = DrawBeliefs(schedule.draws, impossible)
    units = None
    if budget is not None:
        own = charges_of(schedule) if charges is None else checked_charges(schedule.protocol, charges)
        units = in_units(own, budget)
    rounds = Rounds.of(schedule, units)
    graph = _Graph(schedule, beliefs, rounds)
    reached = _histories(schedule, beliefs, rounds, missing)
    for k in range(schedule.n_events, -1, -1):
        for x in rounds.at(k):
            graph.add(x, k, reached.pop(x, None))
    return graph.policy(name)


@dataclass(frozen=True, eq=False)
class Rounds:
    """Events of a schedule and amounts left as product modes.

    Attributes
    ----------
    product : ProductModes
        By event, then by amount left; the last ones are those after the schedule.
    begin : tuple of int
        First product mode of each event, of the end, and how many there are.
    """

    product: ProductModes
    begin: tuple[int, ...]

    def at(self, k: int) -> range:
        """Product modes of an event; of the end for `k` = K."""
        return range(self.begin[k], self.begin[k + 1])

    @classmethod
    def of(cls, schedule: Schedule, units: Units | None = None) -> Rounds:
        """Join the events with amounts left that they can be reached with, whoever acts."""
        n = schedule.n_events
        modes = schedule.protocol.modes
        charge = np.zeros(schedule.protocol.n_actions, dtype=np.int64) if units is None else units.charge
        own = [charge[schedule.first_action(k) :][: len(schedule.mode(k).actions)] for k in range(n)]
        levels = budget_levels(own, 0 if units is None else units.budget)
        reached = _reached(levels, [len(c) for c in own])
        place: list[dict[int, int]] = []
        begin = [0]
        for found in reached:
            place.append({i: begin[-1] + j for j, i in enumerate(found)})
            begin.append(begin[-1] + len(found))
        size, most = begin[-1], max(len(m.actions) for m in modes)
        mode, names = np.full(size, OVER), []
        follow, allowed = np.full((size, most, len(modes)), -1), np.zeros((size, most), dtype=bool)
        chance, left = np.zeros((size, len(modes))), np.zeros(size)
        for k, found in enumerate(reached):
            for i in found:
                x = place[k][i]
                text = "the end" if k == n else f"event {k + 1}, {schedule.mode(k).name}"
                if units is not None:
                    left[x] = units.amount(int(levels.left[k][i]))
                    text += f", {left[x]:g} left"
                names.append(text)
                if k == n:
                    continue
                mode[x] = schedule.modes[k]
                last = k + 1 == n
                chance[x, schedule.modes[k] if last else schedule.modes[k + 1]] = 1.0
                for c, after in enumerate(levels.after[k, i, : len(own[k])].tolist()):
                    allowed[x, c] = after >= 0
                    y = place[k + 1][max(after, 0)]
                    follow[x, c, slice(None) if last else schedule.modes[k + 1]] = y
        start = np.full(len(modes), -1)
        start[schedule.modes[0]] = 0
        product = ProductModes(tuple(names), mode, follow, chance, allowed, start, None if units is None else left)
        return cls(product, tuple(begin))


def _reached(levels: BudgetLevels, choices: list[int]) -> list[list[int]]:
    """Levels of each event that come about, overspending included, and of the end."""
    out = [[len(levels.left[0]) - 1]]
    for after, n in zip(levels.after, choices, strict=True):
        # What cannot be paid for may be done all the same: nothing is left then.
        out.append(np.unique(np.maximum(after[out[-1], :n], 0)).tolist())
    return out


def _histories(schedule: Schedule, beliefs: DrawBeliefs, rounds: Rounds, missing: bool) -> dict[int, Array]:
    """Beliefs ``[n, s, d]`` after all histories, by product mode, as far as vectors are made for them."""
    product = rounds.product
    reached = {0: np.array(beliefs.start)[None]}
    fresh = dict(reached)
    for k in range(schedule.n_events - 1 - _covered(schedule)):
        after: dict[int, list[Array]] = {}
        m = schedule.modes[k]
        outcomes = beliefs.outcomes(m)
        each = len(schedule.mode(k).actions) * (outcomes + (missing and outcomes > 1))
        histories = each * sum(map(len, fresh.values()))
        if histories * beliefs.start.size > MOST_ENTRIES:
            size = Phrase(f"{histories} histories, {beliefs.start.size} numbers each")
            wanted = f"at most {MOST_ENTRIES:.0e} numbers: a shorter schedule, fewer draws, or missing=False"
            raise located(f"schedule {schedule.letters}, event {k + 1}", size, wanted)
        for x, points in fresh.items():
            n = len(points)
            ahead = beliefs.ahead_many(m, points).reshape(n, -1, outcomes, *points.shape[1:])
            for c in range(ahead.shape[1]):
                y = int(product.follow[x, c, schedule.modes[k + 1]])
                found = [ahead[:, c, o] for o in range(outcomes)]
                if missing and outcomes > 1:
                    found.append(ahead[:, c].sum(axis=1))
                after.setdefault(y, []).extend(found)
        fresh = {}
        for y, found in after.items():
            points = np.concatenate(found)
            total = points.sum(axis=(1, 2))
            points, total = points[total > 0], total[total > 0]
            points /= total[:, None, None]
            fresh[y] = points
        reached.update(fresh)
    return reached


def _covered(schedule: Schedule) -> int:
    """How many of the last events have all their plans, whatever the budget."""
    plans, events = 1, 0
    for k in range(schedule.n_events - 1, -1, -1):
        plans = len(schedule.mode(k).actions) * plans ** schedule.n_outcomes(k)
        if plans > MOST_PLANS:
            break
        events += 1
    return events


class _Graph:
    """Vectors of all product modes, made backwards."""

    def __init__(self, schedule: Schedule, beliefs: DrawBeliefs, rounds: Rounds) -> None:
        self.schedule, self.beliefs, self.rounds = schedule, beliefs, rounds
        self.width = max(beliefs.outcomes(m) for m in range(len(schedule.protocol.modes)))
        self.covered = schedule.n_events - _covered(schedule)
        self.vectors: dict[int, Array] = {}
        self.links: dict[int, tuple[Index, Index]] = {}
        s, d = beliefs.start.shape
        end = np.zeros(s) if schedule.terminal is None else schedule.terminal
        self.end = np.broadcast_to(end[:, None], (s, d))

    def add(self, x: int, k: int, points: Array | None) -> None:
        """Vectors of a product mode of event `k`, for beliefs `points`."""
        if k == self.schedule.n_events:
            self._keep(x, self.end[None], np.full((1, 1 + self.width), -1))
            return
        links = self._all_links(x, k) if k >= self.covered else self._best_links(x, k, points)
        vectors = np.stack([self._vector(x, k, *link) for link in links])
        if k >= self.covered:
            kept = _undominated(vectors.reshape(len(vectors), -1))
            vectors, links = vectors[kept], links[kept]
        self._keep(x, vectors, links)

    def _keep(self, x: int, vectors: Array, links: Index) -> None:
        self.vectors[x], self.links[x] = vectors, (links[:, 0], links[:, 1:])

    def _after(self, x: int, k: int, c: int) -> int:
        last = k + 1 == self.schedule.n_events
        return int(self.rounds.product.follow[x, c, self.schedule.modes[k if last else k + 1]])

    def _choices(self, x: int) -> list[int]:
        return np.flatnonzero(self.rounds.product.allowed[x]).tolist()

    def _vector(self, x: int, k: int, choice: int, *follow: int) -> Array:
        m, after = self.schedule.modes[k], self.vectors[self._after(x, k, choice)]
        out = np.repeat(self.beliefs.rewards[m][choice][:, None], after.shape[2], axis=1)
        for o in range(self.beliefs.outcomes(m)):
            ahead = np.einsum("std,td->sd", self.beliefs.joint[m][:, choice, o], after[follow[o]])
            out += self.schedule.discount * ahead
        return out

    def _all_links(self, x: int, k: int) -> Index:
        rows = []
        outcomes = self.schedule.n_outcomes(k)
        for c in self._choices(x):
            plans = range(len(self.vectors[self._after(x, k, c)]))
            rows += [(c, *follow) for follow in combinations(plans, repeat=outcomes)]
        return self._padded(np.array(rows, dtype=np.int64))

    def _best_links(self, x: int, k: int, points: Array | None) -> Index:
        assert points is not None
        found = [np.zeros((0, 1 + self.width), dtype=np.int64)]
        step = max(1, PORTION // (points[0].size * self.beliefs.joint[self.schedule.modes[k]][0, ..., 0, 0].size))
        for begin in range(0, len(points), step):
            found.append(self._best_of(x, k, points[begin : begin + step]))
            found = [np.unique(np.concatenate(found), axis=0)]
        return found[0]

    def _best_of(self, x: int, k: int, points: Array) -> Index:
        m, n = self.schedule.modes[k], len(points)
        outcomes = self.beliefs.outcomes(m)
        ahead = self.beliefs.ahead_many(m, points).reshape(n, -1, outcomes, points[0].size)
        state = points.sum(axis=2)
        choices = self._choices(x)
        worth, links = np.empty((n, len(choices))), []
        for i, c in enumerate(choices):
            after = self.vectors[self._after(x, k, c)]
            dots = ahead[:, c].reshape(n * outcomes, -1) @ after.reshape(len(after), -1).T
            best = dots.argmax(axis=1)
            worth[:, i] = state @ self.beliefs.rewards[m][c]
            worth[:, i] += self.schedule.discount * dots.max(axis=1).reshape(n, outcomes).sum(axis=1)
            links.append(np.column_stack([np.full(n, c), best.reshape(n, outcomes)]))
        top = worth.argmax(axis=1)
        return self._padded(np.stack(links, axis=1)[np.arange(n), top])

    def _padded(self, rows: Index) -> Index:
        return np.pad(rows, ((0, 0), (0, 1 + self.width - rows.shape[1])), constant_values=-1)

    def policy(self, name: str) -> ProductPolicy:
        """All of it as a policy."""
        product = self.rounds.product
        sizes = [len(self.vectors[x]) for x in range(len(product))]
        first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        mode = np.repeat(np.arange(len(product)), sizes)
        choice = np.concatenate([self.links[x][0] for x in range(len(product))])
        follow = np.concatenate([self.links[x][1] for x in range(len(product))])
        for i, (x, c) in enumerate(zip(mode.tolist(), choice.tolist(), strict=True)):
            if c >= 0:
                k = int(np.searchsorted(self.rounds.begin, x, side="right")) - 1
                follow[i] += np.where(follow[i] >= 0, first[self._after(x, k, c)], 0)
        graph = PolicyGraph(choice, follow)
        # Valued from the graph, as a file is: the same bits in both.
        s = self.schedule
        alpha = graph_vectors(self.beliefs, product, mode, graph, s.discount, s.terminal, f"policy {name}")
        return ProductPolicy(
            self.beliefs, product, alpha, mode, s.discount, name, graph=graph, terminal=s.terminal
        )  # fmt: skip


def _undominated(vectors: Array) -> Any:
    """Vectors that no other one equals or exceeds everywhere; the first of equals."""
    kept = []
    for i, own in enumerate(vectors):
        above = np.all(vectors >= own, axis=1)
        equal = np.all(vectors == own, axis=1)
        if not np.any(above & ~equal) and not np.any(equal[:i]):
            kept.append(i)
    return np.array(kept, dtype=np.int64)
