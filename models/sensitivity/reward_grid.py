"""The grid of rewards that decisions are asked about, and what the draws answer in every cell of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView
from models.protocol import Protocol
from models.reward import Reward, default_x
from models.sensitivity.cases import Answers, Array, Cases, Decider

PRINTED_R = (0.001, 0.04, 0.06, 0.08, 0.09)
PRINTED_COSTS = (30.0, 15.0, 5.0, 0.0)
"""The paper's grid."""

SURE, LEANING = 0.95, 0.75
"""Shares of the draws from which on a recommendation is called sure, and from which on it is more than a toss."""

ENOUGH, ENOUGH_TO_BE_SURE = 20, 59
"""Draws from which on shares are told as percentages and a toss is called one, and from which on anything is sure.

Were the share of a posterior below `SURE`, 59 of its draws would all agree less than once in twenty times.
"""

FEW_DRAWS, ONE_MODEL, BY_RESPONSE = "too few draws", "one model", "depends on responses"
"""Verdicts where shares are none; the last of one model that does different things after different responses."""

ROUNDING = 1e-9
"""What sums of weights may miss such a share by."""

UNDECIDED = "undecided"
"""In place of an action's name."""


@dataclass(frozen=True)
class CostAxis:
    """A cost that is varied: of all actions of one mode but its null action.

    Attributes
    ----------
    name : str
        The action's name, or the mode's where it has several.
    mode : int
    actions : tuple of str
    """

    name: str
    mode: int
    actions: tuple[str, ...]


def cost_axes(protocol: Protocol) -> tuple[CostAxis, ...]:
    """Costs that can be varied, in the order of the modes; a mode that offers its null action only has none.

    Examples
    --------
    >>> from models.protocol import PUBLISHED
    >>> [axis.name for axis in cost_axes(PUBLISHED)]
    ['help', 'signal']
    """
    out = []
    for m, mode in enumerate(protocol.modes):
        costly = tuple(a.name for a in mode.actions if a.name != mode.null_action)
        if costly:
            out.append(CostAxis(costly[0] if len(costly) == 1 else mode.name, m, costly))
    return tuple(out)


def reward_of(draws: ModelDraws) -> Reward:
    """The reward of draws, the published one where they have none."""
    return draws.reward or Reward(default_x(draws.n_states))


def reward_at(base: Reward, r: float | None = None, costs: Mapping[CostAxis, float] | None = None) -> Reward:
    """A reward with another steepness and other costs."""
    named = {a: float(v) for axis, v in (costs or {}).items() for a in axis.actions}
    return replace(base, r=base.r if r is None else float(r), costs={**base.costs, **named})


@dataclass(frozen=True)
class RewardGrid:
    """Every steepness with every combination of costs.

    Attributes
    ----------
    protocol : Protocol
    base : Reward
        What is not varied.
    r : tuple of float
    costs : tuple of tuple of float
        One for each of `axes`: all costly actions of a mode cost the same.
    as_given : bool
        The only cell is `base` itself, in which costly actions of one mode may differ.

    Raises
    ------
    InputError
        On no value, one that is not finite, one that is named twice, or a number of cost lists that does not fit.
    """

    protocol: Protocol
    base: Reward
    r: tuple[float, ...] = PRINTED_R
    costs: tuple[tuple[float, ...], ...] = ()
    as_given: bool = False

    def __post_init__(self) -> None:
        if not self.costs:
            object.__setattr__(self, "costs", (PRINTED_COSTS,) * len(self.axes))
        if len(self.costs) != len(self.axes):
            raise located("grid, lists of costs", len(self.costs), f"{len(self.axes)}, one for each costly action")
        named = [(f"cost of {axis.name}", c) for axis, c in zip(self.axes, self.costs, strict=True)]
        for place, values in (("r", self.r), *named):
            if not values:
                raise located(f"grid, {place}", 0, "at least one value")
            for i, value in enumerate(values):
                if not np.isfinite(value):
                    raise located(f"grid, {place}", value, "finite numbers")
                if value in values[:i]:
                    raise located(f"grid, {place}", value, "every value once")

    @classmethod
    def of(
        cls, draws: ModelDraws, r: Sequence[float] | None = None, costs: Sequence[float] | None = None
    ) -> RewardGrid:
        """The paper's grid, or other values; the same costs for every costly action."""
        axes = cost_axes(draws.protocol)
        values = PRINTED_COSTS if costs is None else tuple(float(c) for c in costs)
        return cls(
            draws.protocol, reward_of(draws), PRINTED_R if r is None else tuple(float(v) for v in r),
            (values,) * len(axes),
        )  # fmt: skip

    @classmethod
    def point(cls, protocol: Protocol, reward: Reward) -> RewardGrid:
        """One cell: a reward as it is; named by the cost of each mode's first costly action."""
        first = [axis.actions[0] for axis in cost_axes(protocol)]
        costs = tuple((reward.costs.get(a, protocol.costs[a]),) for a in first)
        return cls(protocol, reward, (reward.r,), costs, as_given=True)

    @cached_property
    def axes(self) -> tuple[CostAxis, ...]:
        """Costs that are varied."""
        return cost_axes(self.protocol)

    @cached_property
    def cells(self) -> tuple[tuple[float, tuple[float, ...]], ...]:
        """Steepness and costs of every cell, in the order of the lists."""
        return tuple((r, costs) for r in self.r for costs in product(*self.costs))

    @cached_property
    def rewards(self) -> tuple[Reward, ...]:
        """Reward of every cell."""
        if self.as_given:
            return (self.base,)
        return tuple(reward_at(self.base, r, dict(zip(self.axes, costs, strict=True))) for r, costs in self.cells)

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values of steepness and of each cost."""
        return (len(self.r), *map(len, self.costs))


@dataclass(frozen=True)
class GridDecisions(NotebookView):
    """What the draws do in every cell of a grid, by one reading of the plan.

    Attributes
    ----------
    grid : RewardGrid
    reading : str
    discount : float
    weight : float64[d]
    answers : Answers
        Case ``g * draws + d``.
    available : int
        Draws that these were thinned from.
    cautions : tuple of str
        Those of the draws (`models.cautions`).
    """

    grid: RewardGrid
    reading: str
    discount: float
    weight: Array
    answers: Answers
    available: int
    cautions: tuple[str, ...] = ()

    @property
    def n_draws(self) -> int:
        """Number of draws."""
        return len(self.weight)

    @property
    def even(self) -> bool:
        """Whether all draws weigh the same."""
        return evenly(self.weight)

    @property
    def n_steps(self) -> int:
        """Number of steps."""
        return self.answers.nodes.n_steps

    def by_draw(self, k: int) -> Array:
        """How often each draw takes each action at step `k`, the last column open; shape ``[g, d, c + 1]``."""
        own = self.answers.shares(k)
        return own.reshape(len(self.grid.cells), self.n_draws, -1)

    def shares(self, k: int) -> Array:
        """Share of the draws, by weight, that take each action, the last column undecided; ``[g, c + 1]``."""
        return np.asarray(np.clip(np.einsum("d,gdc->gc", self.weight, self.by_draw(k)), 0.0, 1.0))

    def acting(self, k: int) -> Array:
        """How often each draw does anything but the null action; open decisions count half; ``[g, d]``."""
        return acting(self.by_draw(k), self.answers.nodes.null_choice(k))

    def bounds(self, k: int) -> list[dict[str, tuple[float, float]]]:
        """Bounds of what each action is worth at step `k` in every cell; only of one model with one history there.

        Raises
        ------
        InputError
            Of several draws: bounds belong to one model.
        """
        if self.n_draws != 1:
            raise located("bounds of action values, draws", self.n_draws, "1")
        nodes = self.answers.nodes
        n = nodes.of_step(k)[0]
        low, high = self.answers.lower[:, n], self.answers.upper[:, n]
        return [
            {a: (float(low[g, c]), float(high[g, c])) for c, a in enumerate(nodes.action_names(k))}
            for g in range(len(low))
        ]

    def rows(self) -> list[dict[str, Any]]:
        """One row a cell and step: what most draws do, and all shares."""
        nodes, out = self.answers.nodes, []
        by_step = [self.shares(k) for k in range(self.n_steps)]
        modes = [nodes.protocol.modes[m].name for m in nodes.modes]
        for g, (r, costs) in enumerate(self.grid.cells):
            own = {f"cost_{axis.name}": c for axis, c in zip(self.grid.axes, costs, strict=True)}
            for k, shares in enumerate(by_step):
                named = dict(zip((*nodes.action_names(k), UNDECIDED), shares[g].tolist(), strict=True))
                action, share = chosen(named)
                out.append({
                    "reading": self.reading, "r": r, **own, "k": k, "mode": modes[k],
                    "action": action, "share": share, "shares": named,
                    "verdict": verdict(action, share, self.n_draws),
                    "agree": of_draws(share, self.n_draws, self.even),
                })  # fmt: skip
        return out


def acting(shares: Array, null: int) -> Array:
    """Share of everything but the null action; what is open, in the last column, counts half."""
    others = [c for c in range(shares.shape[-1] - 1) if c != null]
    return np.asarray(shares[..., others].sum(axis=-1) + 0.5 * shares[..., -1])


def chosen(shares: Mapping[str, float]) -> tuple[str, float]:
    """The action that most draws take, the first of equals, and their share; undecided if none takes any."""
    actions = {name: share for name, share in shares.items() if name != UNDECIDED}
    name = max(actions, key=lambda a: actions[a])
    return (name, actions[name]) if actions[name] > 0 else (UNDECIDED, shares.get(UNDECIDED, 1.0))


def verdict(action: str, share: float, draws: int | None = None) -> str:
    """Whether a recommendation is knowledge or a toss: sure, leaning, or coin toss.

    Parameters
    ----------
    action : str
    share : float
        Of the draws that take it.
    draws : int, optional
        How many were asked. Fewer than `ENOUGH` say neither that something is sure nor that it is a toss, and fewer
        than `ENOUGH_TO_BE_SURE` at most that they lean; one model knows no doubt, but what it does may depend on
        the responses before. Without it only the share counts.

    Examples
    --------
    >>> verdict("help", 0.97), verdict("help", 0.8), verdict("help", 0.6)
    ('sure', 'leaning', 'coin toss')
    >>> verdict("help", 1.0, 100), verdict("help", 1.0, 25), verdict("help", 1.0, 10), verdict("help", 1.0, 1)
    ('sure', 'leaning', 'too few draws', 'one model')
    """
    if action == UNDECIDED:
        return UNDECIDED
    if draws == 1:
        return ONE_MODEL if share >= 1 - ROUNDING else BY_RESPONSE
    if draws is not None and draws < ENOUGH:
        return FEW_DRAWS
    if share >= SURE - ROUNDING and (draws is None or draws >= ENOUGH_TO_BE_SURE):
        return "sure"
    return "leaning" if share >= LEANING - ROUNDING else "coin toss"


def evenly(weight: Array) -> bool:
    """Whether all draws weigh the same."""
    return bool(np.allclose(weight, weight[0]))


def of_draws(share: float, draws: int, even: bool = True, noun: str = " draws") -> str:
    """A share with the number of draws that it rests on: a count where there are fewer than `ENOUGH`.

    Parameters
    ----------
    share : float
        By weight.
    draws : int
    even : bool
        Whether all weigh the same; if not, a few cannot be counted and the share is given.
    noun : str
        After the number; empty where the number of draws stands elsewhere, and then percentages go without it.

    Examples
    --------
    >>> of_draws(2 / 3, 3), of_draws(0.67, 400), of_draws(0.7, 3, even=False), of_draws(0.67, 400, noun="")
    ('2 of 3 draws', '67% of 400 draws', '70% of the weight of 3 draws', '67%')
    """
    if draws >= ENOUGH:
        return f"{share:.0%} of {draws:,}{noun}" if noun else f"{share:.0%}"
    if draws == 1:
        return ONE_MODEL
    count = share * draws
    if even and abs(count - round(count)) < 1e-6:
        return f"{round(count)} of {draws}{noun}"
    return f"{share:.0%} of {'' if even else 'the weight of '}{draws}{noun}"


def decide_grid(decider: Decider, grid: RewardGrid, discount: float, available: int | None = None) -> GridDecisions:
    """Ask all draws of a reading about all cells of a grid.

    Parameters
    ----------
    decider : Decider
    grid : RewardGrid
    discount : float
        From 0 to 1; below 1 without a horizon.
    available : int, optional
        Draws that the decider's were thinned from.

    Raises
    ------
    InputError
        On a discount that is out of range.
    """
    if not 0 <= discount <= 1:
        raise located("discount", discount, "a number from 0 to 1")
    draws = decider.draws
    answers = decider.decide(Cases.of(draws.n_draws, grid.rewards, draws.protocol, discount))
    return GridDecisions(
        grid, decider.reading, float(discount), draws.weight, answers,
        draws.n_draws if available is None else available, draws.cautions,
    )  # fmt: skip


def decisions_when_certain(
    deciders: Sequence[Decider], rewards: Sequence[Reward], discount: float
) -> NDArray[np.float64]:
    """How often each draw acts at the first step of each decider (one a state); shape ``[s, g, d]``."""
    out = []
    for decider in deciders:
        draws = decider.draws
        answers = decider.decide(Cases.of(draws.n_draws, rewards, draws.protocol, discount))
        acts = acting(answers.shares(0), answers.nodes.null_choice(0))
        out.append(acts.reshape(len(rewards), draws.n_draws))
    return np.stack(out)
