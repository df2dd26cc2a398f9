r"""A pool of controllers, each valued in every draw: which one to take, and what no policy can exceed.

Without a horizon the best policy for all draws together cannot be found exactly. What can be done exactly is to
choose among, and mix, finitely many controllers; and as every draw has an upper bound :math:`\bar V_i`, no policy
whatever is worth more than :math:`\sum_i w_i \bar V_i`. So

.. math:: \sum_i w_i \bar V_i - \max_{p} \sum_i w_i V_i(\pi_p)

is an *upper bound on the expected value of perfect information*, and not that value: it also holds what the solver
left open and what a better policy than the pool's might gain. In the same way :math:`\bar V_i - V_i(\pi)` is an
upper bound on the regret of `\pi` in draw `i`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from models.errors import located
from models.notebook_view import NotebookView
from models.planning.arrays import Array
from models.planning.batch import BatchSolution
from models.planning.latent import LatentBatch
from models.robust.controller_values import value_matrix
from models.robust.controllers import Controller, own_controllers
from models.robust.risk import Outcome, cvar
from models.spread_out import chunks

SIZE = 32
"""Controllers of draws in a pool, beside those given by name."""

BELIEVED = 8
"""So many of them are the most believed ones."""

TAIL = 0.1
"""Share of the draws in the tail by which one member is chosen."""

SCREENED = 2_000_000
"""Values that are computed at most to choose them: controllers times draws."""

SOUND = 1e-6
"""No value may exceed its draw's upper bound by more, as a share of the bound's size: rounding, and no more."""


@dataclass(frozen=True)
class ControllerPool(NotebookView):
    r"""Controllers and what each is worth in every draw.

    Attributes
    ----------
    solution : BatchSolution
        The draws with their bounds.
    controllers : tuple of Controller
        With different names.
    values : float64[p, d]
        :math:`V_i(\pi_p)`.
    error : float
        They are off by no more than that.
    believed : float64[p]
        Share of the draws, by weight, whose own solution each controller is.
    distinct : int
        Controllers that the draws ask for in all.
    """

    solution: BatchSolution
    controllers: tuple[Controller, ...]
    values: Array
    error: float
    believed: Array
    distinct: int

    @property
    def weight(self) -> Array:
        """What is believed of the draws."""
        return self.solution.batch.draws.weight

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the controllers."""
        return tuple(c.name for c in self.controllers)

    @cached_property
    def upper(self) -> Array:
        """Upper bound of every draw, no less than what the pool attains there, shape ``[d]``."""
        # The solver's bounds and the pool's values are rounded apart from each other; more was refused before.
        return np.maximum(self.solution.upper, self.values.max(axis=0))

    @property
    def means(self) -> Array:
        """Mean value of each controller, shape ``[p]``."""
        return np.asarray(self.values @ self.weight)

    @property
    def best(self) -> int:
        """The controller with the highest mean."""
        return int(np.argmax(self.means))

    @property
    def ceiling(self) -> float:
        r""":math:`\sum_i w_i \bar V_i`: no policy is worth more in the mean."""
        return float(self.weight @ self.upper)

    @property
    def evpi_bound(self) -> float:
        """An upper bound on the expected value of perfect information; see the head of the module."""
        return self.ceiling - float(self.means[self.best])

    def number(self, name: str) -> int:
        """Number of a controller by name.

        Raises
        ------
        InputError
            If there is no such controller.
        """
        if name not in self.names:
            raise located("controller", name, f"one of {', '.join(self.names[:20])}")
        return self.names.index(name)

    def outcomes(self, outcome: Outcome = "value", against: str = "never") -> Array:
        """What a criterion is about, shape ``[p, d]``; regrets are bounds, gains are counted from `against`."""
        if outcome == "value":
            return self.values
        if outcome == "regret":
            return self.values - self.upper
        if outcome == "gain":
            return self.values - self.values[self.number(against)]
        raise located("outcome", outcome, "value, regret or gain")

    def table(self, alpha: float = 0.1) -> Any:
        """One row a controller, best mean first: mean, CVaR, worst draw, bounds on its regret, size, believed."""
        import pandas as pd

        regret = self.upper - self.values
        used = self.weight > 0
        rows = [
            {
                "controller": c.name, "mean": float(self.weight @ v), "cvar": cvar(v, self.weight, alpha),
                "worst": float(v[used].min()), "mean_regret_at_most": float(self.weight @ g),
                "regret_at_most": float(g[used].max()), "nodes": c.n_nodes, "believed": float(p),
            }
            for c, v, g, p in zip(self.controllers, self.values, regret, self.believed, strict=True)
        ]  # fmt: skip
        return pd.DataFrame(rows).sort_values("mean", ascending=False, kind="stable", ignore_index=True)

    @property
    def sentence(self) -> str:
        """The certificate in words."""
        best = self.controllers[self.best].name
        return (
            f"The draws ask for {self.distinct} different controllers. Of the {len(self.controllers)} compared, "
            f"{best} is worth most, {self.means[self.best]:.5g} in the mean; no policy is worth more than "
            f"{self.ceiling:.5g}, so knowing the draw beforehand is worth at most {self.evpi_bound:.3g} (an upper "
            f"bound on EVPI, not EVPI)."
        )


def controller_pool(
    solution: BatchSolution, named: Mapping[str, Controller] | None = None, *, size: int = SIZE,
    executor: Executor | None = None, progress: Callable[[int, int], None] | None = None,
) -> ControllerPool:  # fmt: skip
    r"""Choose different controllers among those that draws ask for, and value them in every draw.

    The most believed ones; those that are best alone by mean, lower tail, worst draw and largest regret; and then
    again and again the one that raises :math:`\sum_i w_i \max_p V_i(\pi_p)` most (greedy, as in Nemhauser et al.
    1978).

    Parameters
    ----------
    solution : BatchSolution
    named : mapping of str to Controller, optional
        Always in the pool, under these names: baselines, the controller of an estimate.
    size : int
        Controllers of draws in the pool at most.
    executor : concurrent.futures.Executor, optional
        What draws are spread over; threads of this process by default.
    progress : callable, optional
        Called with pieces of the value matrix done and in all.

    Raises
    ------
    InputError
        On a size below 1.
    ArithmeticError
        If a controller is worth more in a draw than the draw's upper bound: then the bound is none.
    """
    if size < 1:
        raise located("size of the pool", size, "at least 1")
    own = own_controllers(solution)
    fixed = list((named or {}).items())
    picked = _diverse(solution.batch, own.controllers, [c for _, c in fixed], size, executor)
    taken = {c.key for _, c in fixed}
    pool = [replace(c, name=name) for name, c in fixed]
    pool += [replace(own.controllers[i], name=f"c{i + 1}") for i in picked if own.controllers[i].key not in taken]
    shares = {c.key: share for c, share in zip(own.controllers, own.shares.tolist(), strict=True)}
    found = value_matrix(solution.batch, pool, executor, progress)
    over = found.values.max(axis=0) - solution.upper
    if np.any(over > found.error + SOUND * np.maximum(1.0, np.abs(solution.upper))):
        d = int(np.argmax(over))
        raise ArithmeticError(f"draw {d}: a controller is worth {over[d]:.3g} more than the draw's upper bound")
    believed = np.array([shares.get(c.key, 0.0) for c in pool])
    return ControllerPool(solution, tuple(pool), found.values, found.error, believed, len(own.controllers))


def _diverse(
    batch: LatentBatch, controllers: Sequence[Controller], fixed: Sequence[Controller], size: int,
    executor: Executor | None,
) -> list[int]:  # fmt: skip
    """Numbers of the controllers to take, in order of belief."""
    if len(controllers) <= size:
        return list(range(len(controllers)))
    draws = batch.draws.thin(max(1, SCREENED // len(controllers)))
    some = LatentBatch(draws, batch.process, batch.discount)
    values = value_matrix(some, [*fixed, *controllers], executor).values
    candidates, w = values[len(fixed) :], draws.weight
    regret = values.max(axis=0) - candidates
    champions: list[Array] = [
        candidates @ w, np.array([cvar(v, w, TAIL) for v in candidates]), candidates[:, w > 0].min(axis=1),
        -regret[:, w > 0].max(axis=1),
    ]  # fmt: skip
    picked = list(dict.fromkeys([*range(min(BELIEVED, size)), *(int(np.argmax(c)) for c in champions)]))[:size]
    best = values[[*range(len(fixed)), *(len(fixed) + i for i in picked)]].max(axis=0)
    while len(picked) < size:
        gains = _gains(candidates, best, w)
        new = int(np.argmax(gains))
        if gains[new] <= 0:  # those that were taken add nothing
            break
        picked.append(new)
        best = np.maximum(best, candidates[new])
    return sorted(picked)


def _gains(candidates: Array, best: Array, weight: Array) -> Array:
    """How much each candidate adds to the mean of the best values, shape ``[c]``."""
    out = np.empty(len(candidates))
    for span in chunks(len(candidates), 64):
        out[span] = np.maximum(candidates[span] - best, 0.0) @ weight
    return out
