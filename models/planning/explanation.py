"""Why an action: what each is worth, and what would have to change for another one."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.notebook_view import NotebookView
from models.planning.policies import Array

POINTS = 65
"""Places along a shift at which actions are compared before the flip between two of them is narrowed down."""

TIE = 1e-9
"""Another action is better only if it is by more than that share of the values' size."""


@dataclass(frozen=True)
class Shift:
    """How far the belief may move towards a state before another action is best.

    Attributes
    ----------
    state : str
    share : float or None
        The belief is ``(1 - share) * belief + share * certainty of the state`` there; None: not even certainty of
        that state changes the action.
    action : str or None
        The action that is best from there on.
    """

    state: str
    share: float | None
    action: str | None


@dataclass(frozen=True)
class Explanation(NotebookView):
    """Why a policy does what it does.

    Attributes
    ----------
    mode, action : str
    belief : dict of str to float
        By state.
    values : dict of str to float
        What each action is worth by the policy's lights, in the unit of the reward.
    other : str or None
        The best other action; None if the mode offers no other.
    margin : float
        How much more the action is worth than the best other one: this one act could cost that much more (or the
        other that much less) before the other is done.
    costs : dict of str to float
        For each other action how much less it would have to cost, this once, to be done.
    shifts : tuple of Shift
        One a state. A change of mind and back again within 1/64 of the way may be missed.
    """

    mode: str
    action: str
    belief: dict[str, float]
    values: dict[str, float]
    other: str | None
    margin: float
    costs: dict[str, float]
    shifts: tuple[Shift, ...]

    @property
    def nearest(self) -> Shift | None:
        """The smallest shift of belief that changes the action."""
        found = [s for s in self.shifts if s.share is not None]
        return min(found, key=lambda s: s.share or 0.0) if found else None

    @property
    def table(self) -> Any:
        """Actions and what they are worth, best first, as a data frame."""
        import pandas as pd

        best = max(self.values.values())
        ranked = sorted(self.values.items(), key=lambda entry: -entry[1])
        return pd.DataFrame([{"action": a, "value": v, "less_than_best": best - v} for a, v in ranked])

    @property
    def sentence(self) -> str:
        """The explanation in one sentence."""
        if self.other is None:
            return f"{self.action}: mode {self.mode} offers nothing else."
        near = self.nearest
        if near is None:
            belief = "not even certainty of one state would change that"
        elif near.share == 0:
            belief = f"the slightest doubt towards {near.state} would make it {near.action}"
        else:
            belief = (
                f"a belief {near.share:.0%} of the way to certainty of {near.state} would make it {near.action}"
            )
        if self.margin <= 0:
            return f"{self.action} is worth {self.values[self.action]:.4g}, as much as {self.other}; {belief}."
        own, other = _apart(self.values[self.action], self.values[self.other])
        return (
            f"{self.action} is worth {own} and {self.other} {other}; {self.other} would be done if it cost "
            f"{self.margin:.3g} less this once; {belief}."
        )


def _apart(one: float, other: float) -> tuple[str, str]:
    """Two numbers with four digits, or as many as it takes to tell them apart.

    Examples
    --------
    >>> _apart(219.36, 209.81), _apart(275546.6, 275506.4)
    (('219.4', '209.8'), ('275547', '275506'))
    """
    for digits in range(4, 16):
        pair = f"{one:.{digits}g}", f"{other:.{digits}g}"
        if "e" not in "".join(pair) and pair[0] != pair[1]:
            return pair
    return f"{one:.4g}", f"{other:.4g}"


def explain(
    values_at: Callable[[Array], Array], belief: Array, states: Sequence[str], actions: Sequence[str], mode: str,
    points: int = POINTS,
) -> Explanation:  # fmt: skip
    """Explain the best action at a belief.

    Parameters
    ----------
    values_at : callable
        Beliefs ``[i, y]`` to what each action is worth there, ``[i, choice]``.
    belief : float64[y]
    states, actions : sequence of str
    mode : str
    points : int
        Places along each shift at which actions are compared.
    """
    values = values_at(belief[None])[0]
    best = int(np.argmax(values))
    others = [c for c in range(len(actions)) if c != best]
    rival = max(others, key=lambda c: values[c]) if others else None
    shifts = []
    for y, state in enumerate(states):
        corner = np.zeros(len(states))
        corner[y] = 1.0
        share, winner = (None, None) if rival is None else _flip(values_at, belief, corner, best, points)
        shifts.append(Shift(state, share, None if winner is None else actions[winner]))
    return Explanation(
        mode, actions[best], dict(zip(states, belief.tolist(), strict=True)),
        dict(zip(actions, values.tolist(), strict=True)), None if rival is None else actions[rival],
        float("inf") if rival is None else float(values[best] - values[rival]),
        {actions[c]: float(values[best] - values[c]) for c in others}, tuple(shifts),
    )  # fmt: skip


def _flip(
    values_at: Callable[[Array], Array], belief: Array, corner: Array, best: int, points: int
) -> tuple[float | None, int | None]:
    """Where on the way to a corner the best action stops being best, and which one is best from there on."""

    def ahead(t: Array) -> tuple[Any, Any]:
        values = values_at((1 - t)[:, None] * belief + t[:, None] * corner)
        scale = TIE * np.maximum(np.abs(values).max(axis=1), 1e-300)
        top = values.argmax(axis=1)
        return values[np.arange(len(t)), top] - values[:, best] > scale, top

    t = np.linspace(0.0, 1.0, points)
    better, top = ahead(t)
    if not better.any():
        return None, None
    i = int(np.argmax(better))
    if i == 0:
        return 0.0, int(top[0])
    low, high, winner = t[i - 1], t[i], int(top[i])
    while high - low > 1e-6:
        # Several places at once: values may be dear to start computing and cheap to compute.
        between = np.linspace(low, high, 10)[1:-1]
        better, top = ahead(between)
        j = int(np.argmax(better)) if better.any() else len(between)
        if j < len(between):
            winner, high = int(top[j]), between[j]
        low = between[j - 1] if j > 0 else low
    return float(high), winner
