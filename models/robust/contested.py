r"""Costs at which a decision is contested: the point where the best first action flips.

At the published costs one plan may be best for nearly everybody. How a method behaves when there is something to
decide shows where the best plan is indifferent. Costs of one mode's actions are scaled together, the others stay.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from models.planning.exact import solve_schedule
from models.planning.schedule import Schedule
from models.reward import Reward, default_x

STEPS = 40
"""Halvings: the flip point is known to 1e-12 of the largest multiple."""

LARGEST = 1024.0
"""Multiple of the costs beyond which no flip is looked for."""


@dataclass(frozen=True)
class Flip:
    """Where the first decision of one mode flips.

    Attributes
    ----------
    mode : str
    multiple : float or None
        Of the costs of the mode's actions; None if the decision is the same at every multiple.
    costs : dict of str to float
        The costs there, in reward units.
    action : str
        What is best below the flip point (or everywhere).
    """

    mode: str
    multiple: float | None
    costs: dict[str, float]
    action: str

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        if self.multiple is None:
            return f"{self.mode}: {self.action} comes first at any cost."
        at = ", ".join(f"{a} {c:.3g}" for a, c in self.costs.items() if c != 0)
        return f"{self.mode}: {self.action} comes first up to a cost of {at}, not beyond."


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
        out.append(_flip(replace(schedule, modes=schedule.modes[k:]), m))
    return tuple(out)


def contested(schedule: Schedule) -> tuple[Schedule, tuple[Flip, ...]]:
    """The schedule with the costs of every mode at its flip point (as they are where there is none)."""
    flips = flip_points(schedule)
    costs = {a: c for flip in flips if flip.multiple is not None for a, c in flip.costs.items()}
    return with_costs(schedule, costs), flips


def with_costs(schedule: Schedule, costs: dict[str, float]) -> Schedule:
    """The schedule with other costs of some actions."""
    reward = schedule.draws.reward or Reward(default_x(schedule.n_states))
    return replace(schedule, draws=replace(schedule.draws, reward=replace(reward, costs={**reward.costs, **costs})))


def _flip(schedule: Schedule, m: int) -> Flip:
    mode = schedule.protocol.modes[m]
    base = dict(zip(schedule.protocol.action_names, schedule.costs.tolist(), strict=True))
    own = {a.name: base[a.name] for a in mode.actions}

    def first(multiple: float) -> int:
        plan = solve_schedule(with_costs(schedule, {a: multiple * c for a, c in own.items()}))
        return int(plan.decisions[0][0])

    low, high = 0.0, 1.0
    free = first(low)
    while high <= LARGEST and first(high) == free:
        low, high = high, 2 * high
    if high > LARGEST:
        return Flip(mode.name, None, own, mode.actions[free].name)
    for _ in range(STEPS):
        middle = (low + high) / 2
        low, high = (middle, high) if first(middle) == free else (low, middle)
        if high - low <= 1e-9 * high:
            break
    return Flip(mode.name, low, {a: low * c for a, c in own.items()}, mode.actions[free].name)
