"""What can be moved while everything else stays: steepness, costs, discount, scores of states."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from models.errors import located
from models.protocol import Protocol
from models.reward import Reward
from models.sensitivity.cases import Array, Cases, Index
from models.sensitivity.flips import Setting
from models.sensitivity.reward_grid import CostAxis


def reward_cases(
    protocol: Protocol, draw: Index, *, x: Array, r: Array | float, costs: Array, discount: Array | float
) -> Cases:
    """Cases whose rewards differ in whatever way.

    Parameters
    ----------
    protocol : Protocol
    draw : int64[m]
    x : float64[s] or float64[m, s]
    r, discount : float or float64[m]
    costs : float64[a] or float64[m, a]
    """
    m = len(draw)
    x = np.broadcast_to(x, (m, np.shape(x)[-1]))
    steep = np.broadcast_to(r, (m,))[:, None]
    prosocial = np.exp(steep * x) - np.exp(steep * x[:, :1])
    reward = prosocial[:, None, :] - np.broadcast_to(costs, (m, protocol.n_actions))[:, :, None]
    return Cases(np.asarray(draw), reward, prosocial, np.array(np.broadcast_to(discount, (m,)), dtype=np.float64))


def costs_of(protocol: Protocol, reward: Reward) -> Array:
    """Cost of every action under a reward, shape ``[a]``."""
    return np.array([reward.costs.get(a, protocol.costs[a]) for a in protocol.action_names])


def moving(
    protocol: Protocol, base: Reward, discount: float, *, r: bool = False, cost: CostAxis | None = None,
    gamma: bool = False, state: int | None = None,
) -> Setting:  # fmt: skip
    """Cases in which one number moves: exactly one of `r`, a cost, the discount (`gamma`), the score of a state.

    Parameters
    ----------
    protocol : Protocol
    base : Reward
        What stays.
    discount : float
        Of everything but `gamma`.
    r, gamma : bool
    cost : CostAxis, optional
    state : int, optional

    Raises
    ------
    InputError
        If not exactly one is named.
    """
    named = int(r) + int(gamma) + (cost is not None) + (state is not None)
    if named != 1:
        raise located("what moves", named, "exactly one of r, cost, gamma, state")
    x, fixed = np.asarray(base.x), costs_of(protocol, base)

    def setting(values: Array, draw: Index) -> Cases:
        if r:
            return reward_cases(protocol, draw, x=x, r=values, costs=fixed, discount=discount)
        if gamma:
            return reward_cases(protocol, draw, x=x, r=base.r, costs=fixed, discount=values)
        if cost is not None:
            own = np.tile(fixed, (len(values), 1))
            own[:, [protocol.action(a) for a in cost.actions]] = values[:, None]
            return reward_cases(protocol, draw, x=x, r=base.r, costs=own, discount=discount)
        moved = np.tile(x, (len(values), 1))
        moved[:, state] = values
        return reward_cases(protocol, draw, x=moved, r=base.r, costs=fixed, discount=discount)

    return setting


def ranges(
    base: Reward, grid_r: tuple[float, ...], grid_costs: Mapping[CostAxis, tuple[float, ...]]
) -> dict[str, tuple[float, float]]:
    """Where each number is looked for: beyond the grid and from zero on; scores between their neighbours.

    Parameters
    ----------
    base : Reward
    grid_r : tuple of float
    grid_costs : mapping of CostAxis to tuple of float
    """
    out = {"r": (min(0.0, *grid_r), 1.5 * max(*grid_r, 1e-3))}
    for axis, values in grid_costs.items():
        out[f"cost_{axis.name}"] = (min(0.0, *values), max(2.0 * max(values), 1.0))
    x = list(base.x)
    for s in range(len(x)):
        if len(x) > 1:
            before = x[s - 1] if s > 0 else x[0] - (x[1] - x[0])
            after = x[s + 1] if s + 1 < len(x) else x[-1] + (x[-1] - x[-2])
            if before < after:
                out[f"x_{s}"] = (before, after)
    return out
