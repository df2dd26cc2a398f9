r"""Costs at which a decision is contested: the point where the best first action flips.

At the published costs one plan may be best for nearly everybody. How a method behaves when there is something to
decide shows where the best plan is indifferent. Costs of one mode's actions are scaled together, the others stay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.optimize import brentq

from models.notebook_view import NotebookView
from models.planning.exact import solve_schedule
from models.planning.schedule import Array, Schedule
from models.reward import Reward, default_x

PRECISION = 1e-12
"""Of the flip point, as a share of the multiples that it is looked for between."""

SETTLED, ROUNDS, FULL_STEPS = 1e-9, 60, 10
"""Costs are found together when none moves by more than this share; rounds at most, those with full steps."""

LARGEST = 1024.0
"""Multiple of the costs beyond which no flip is looked for."""

WIDER = 4.0
"""A flip point is looked for again within so many times what it moved by last, before anywhere else."""


@dataclass(frozen=True)
class Flip(NotebookView):
    """Where the first decision of one mode flips.

    Attributes
    ----------
    mode : str
    multiple : float or None
        Of the costs of the mode's actions; None if the decision is the same at every multiple.
    costs : dict of str to float
        The costs there, in the unit of the reward.
    action : str
        What is best below the flip point (or everywhere).
    event : int
        From 0: the event at which the schedule is taken to begin, so that this decision is the first one.
    cautions : tuple of str
        Those of the draws (`models.cautions`).
    """

    mode: str
    multiple: float | None
    costs: dict[str, float]
    action: str
    event: int = 0
    cautions: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        # A plan that has seen earlier events may do something else here, and no word may sound as if it could not.
        where = f", were the schedule to begin with event {self.event + 1}" if self.event else ""
        if self.multiple is None:
            return f"{self.mode}{where}: {self.action} comes first at every multiple of these costs."
        at = ", ".join(f"{a} {c:.3g}" for a, c in self.costs.items() if c != 0)
        return f"{self.mode}{where}: {self.action} comes first up to a cost of {at}, not beyond."


def flip_points(schedule: Schedule) -> tuple[Flip, ...]:
    """For each mode of a schedule, the costs at which the best first action flips.

    The decision is the one of the first event with that mode, were the schedule to begin with it.

    Parameters
    ----------
    schedule : Schedule
    """
    out = []
    for m in dict.fromkeys(schedule.modes):
        k = schedule.modes.index(m)
        found = _flip(replace(schedule, modes=schedule.modes[k:]), m)
        out.append(replace(found, event=k, cautions=schedule.cautions))
    return tuple(out)


def contested(schedule: Schedule) -> tuple[Schedule, tuple[Flip, ...]]:
    """The schedule with costs at which the first decision of every mode flips, all at once.

    What a mode's action is worth depends on the costs of the others, so each flip point is looked for again with
    the others where they flip, until none moves. A mode that once has no flip point keeps its costs. Should flip
    points chase each other, only that of the last mode, given the others', is a flip point in the end.

    Parameters
    ----------
    schedule : Schedule

    Returns
    -------
    Schedule
    tuple of Flip
        With the costs of all modes there.
    """
    modes = list(dict.fromkeys(schedule.modes))
    settled = dict.fromkeys(modes, False)
    costs: dict[int, dict[str, float]] = {}
    flips: dict[int, Flip] = {}
    near: dict[int, tuple[float, float]] = {}
    for number in range(ROUNDS):
        moved = 0.0
        for m in modes:
            if settled[m]:
                continue
            others = {a: c for n, own in costs.items() if n != m for a, c in own.items()}
            from_there = replace(with_costs(schedule, others), modes=schedule.modes[schedule.modes.index(m) :])
            flips[m] = flip = replace(
                _flip(from_there, m, near.get(m)), event=schedule.modes.index(m), cautions=schedule.cautions
            )
            if flip.multiple is None:
                settled[m] = True
                moved = np.inf if m in costs else moved
                costs.pop(m, None)
                continue
            apart = abs(flip.multiple - near[m][0]) if m in near else 0.1 * flip.multiple
            near[m] = flip.multiple, WIDER * apart
            before = costs.get(m)
            last = number == ROUNDS - 1
            # Halfway steps end a chase that full steps would go on with for ever.
            step = 0.5 if before is not None and number >= FULL_STEPS and not last else 1.0
            for action, cost in flip.costs.items():
                old = cost if before is None else before[action]
                new = old + step * (cost - old)
                moved = max(moved, np.inf if before is None else abs(new - old) / max(abs(cost), 1e-9))
                costs.setdefault(m, {})[action] = new
        if moved <= SETTLED:
            break
    every = {a: c for own in costs.values() for a, c in own.items()}
    return with_costs(schedule, every), tuple(flips[m] for m in modes)


def with_costs(schedule: Schedule, costs: dict[str, float]) -> Schedule:
    """The schedule with other costs of some actions."""
    reward = schedule.draws.reward or Reward(default_x(schedule.n_states))
    return replace(schedule, draws=replace(schedule.draws, reward=replace(reward, costs={**reward.costs, **costs})))


def _flip(schedule: Schedule, m: int, near: tuple[float, float] | None = None) -> Flip:
    """Where the first decision flips; `near`: where it did with costs a little different, and how far around."""
    mode = schedule.protocol.modes[m]
    base = dict(zip(schedule.protocol.action_names, schedule.costs.tolist(), strict=True))
    own = {a.name: base[a.name] for a in mode.actions}

    @cache
    def advantage(multiple: float) -> Array:
        """Worth of each first action over the best other one."""
        values = solve_schedule(with_costs(schedule, {a: multiple * c for a, c in own.items()})).first_values
        if len(values) == 1:
            return np.ones(1)
        best = np.argsort(values, kind="stable")[::-1]
        others = np.full(len(values), values[best[0]])
        others[best[0]] = values[best[1]]
        return np.asarray(values - others)

    free = int(np.argmax(advantage(0.0)))
    low, high = 0.0, 0.0
    if near is not None:
        low, high = max(0.0, near[0] - near[1]), near[0] + near[1]
    if not (low < high and advantage(low)[free] > 0 >= advantage(high)[free]):
        low, high = 0.0, 1.0
        while high <= LARGEST and advantage(high)[free] > 0:
            low, high = high, 2 * high
        if high > LARGEST:
            return Flip(mode.name, None, own, mode.actions[free].name)
        if advantage(low)[free] <= 0:
            return Flip(mode.name, low, {a: low * c for a, c in own.items()}, mode.actions[free].name)
    # Worth is piecewise linear in the costs, so a secant is exact near the root.
    multiple = brentq(lambda m: advantage(m)[free], low, high, xtol=PRECISION * high)
    return Flip(mode.name, multiple, {a: multiple * c for a, c in own.items()}, mode.actions[free].name)
