"""The best mixture of a pool's controllers for a cautious analyst, and its score on draws it has not seen."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.planning.arrays import Array, Index
from models.robust.controller_pool import ControllerPool
from models.robust.master import mix
from models.robust.risk import Outcome, RiskSet

SMALLEST_SHARE = 1e-9
"""Shares of controllers below this are left out of a mixture, before its value is computed."""


@dataclass(frozen=True)
class PoolMixture:
    """A mixture of the pool's controllers: one is drawn before the first event and followed for ever.

    Attributes
    ----------
    pool : ControllerPool
    risk : RiskSet
    outcome : str
    members : int64[k]
        Controllers with a share.
    share : float64[k]
        How often each is drawn.
    values : float64[d]
        What the mixture is worth in each draw.
    criterion : float
        Of this mixture: of values, minus bounds on regret, or gains.
    pool_bound : float
        No mixture of these controllers exceeds it.
    ceiling : float
        No policy whatever exceeds it, from the draws' upper bounds; loose.
    single : int
        The best controller of those that do not randomise.
    single_criterion : float
    """

    pool: ControllerPool
    risk: RiskSet
    outcome: Outcome
    members: Index
    share: Array
    values: Array
    criterion: float
    pool_bound: float
    ceiling: float
    single: int
    single_criterion: float

    @property
    def gap(self) -> float:
        """How much better another mixture of the pool could be, at most."""
        return self.pool_bound - self.criterion

    @property
    def mean(self) -> float:
        """Mean value of the mixture."""
        return float(self.pool.weight @ self.values)

    @property
    def regret_bound(self) -> float:
        """An upper bound on the largest regret of the mixture over the draws with weight."""
        return float((self.pool.upper - self.values)[self.pool.weight > 0].max())

    @property
    def shares(self) -> dict[str, float]:
        """How often each controller is drawn, by name."""
        names = [self.pool.names[i] for i in self.members]
        return dict(zip(names, self.share.tolist(), strict=True))


def best_mixture(
    pool: ControllerPool, alpha: float = 0.1, *, mean_share: float = 0.0, outcome: Outcome = "value",
    against: str = "never",
) -> PoolMixture:  # fmt: skip
    r"""The mixture of a pool that is best for a criterion: mean, CVaR, worst draw, regret, or between.

    Parameters
    ----------
    pool : ControllerPool
    alpha : float
        Share of the draws that counts; 1 is the mean, 0 the worst draw.
    mean_share : float
        How much of the criterion is the plain mean.
    outcome : {"value", "regret", "gain"}
        With ``regret`` and `alpha` 0 the mixture minimises the largest bound on the regret.
    against : str
        Name of the controller that gains are counted from.

    Raises
    ------
    InputError
        On a criterion that is none.
    """
    risk = RiskSet(pool.weight, alpha, mean_share)
    x = pool.outcomes(outcome, against)
    found = mix(x, risk)
    share = np.where(found.share > SMALLEST_SHARE, found.share, 0.0)
    share /= share.sum()
    worth = risk.lowest(share @ x)[0]
    singles = np.array([risk.lowest(row)[0] for row in x])
    single = int(np.argmax(singles))
    if singles[single] >= worth:
        share, worth = np.eye(len(x))[single], float(singles[single])
    # Weights of the set bound every mixture: no controller has a higher mean under them than this.
    bound = max(worth, float((x @ risk.project(found.weight)).max()))
    reference = pool.upper - (pool.values - x)[0]
    members = np.flatnonzero(share)
    return PoolMixture(
        pool, risk, outcome, members, share[members], share @ pool.values, worth, bound,
        risk.lowest(reference)[0], single, float(singles[single]),
    )  # fmt: skip


def held_out(
    pool: ControllerPool, alpha: float = 0.1, *, mean_share: float = 0.0, outcome: Outcome = "value",
    against: str = "never", folds: int = 2,
) -> float:  # fmt: skip
    """The criterion over all draws, each with the mixture that was chosen without its part of the draws.

    Draws that follow each other are kept together, as those of one chain are alike. The pool itself was made of all
    draws; only the choice within it is tested.

    Parameters
    ----------
    pool, alpha, mean_share, outcome, against
        As for `best_mixture`.
    folds : int
        Parts of the draws.

    Raises
    ------
    InputError
        On fewer than two parts, or a part without weight.
    """
    n = len(pool.weight)
    if not 2 <= folds <= n:
        raise located("folds", folds, f"2 to {n}, as many as there are draws")
    x = pool.outcomes(outcome, against)
    outcomes = np.empty(n)
    for part in np.array_split(np.arange(n), folds):
        out = np.zeros(n, dtype=np.bool_)
        out[part] = True
        weight = float(pool.weight[out].sum())
        if not 0 < weight < 1:
            raise located(f"folds, weight of draws {part[0]} to {part[-1]}", weight, "between 0 and 1")
        chosen = best_mixture(_part(pool, ~out), alpha, mean_share=mean_share, outcome=outcome, against=against)
        outcomes[out] = chosen.share @ x[chosen.members][:, out]
    return RiskSet(pool.weight, alpha, mean_share).lowest(outcomes)[0]


def _part(pool: ControllerPool, keep: NDArray[np.bool_]) -> ControllerPool:
    """The pool with some of its draws only."""
    s, d = pool.solution, pool.solution.batch.draws
    weight = d.weight[keep] / d.weight[keep].sum()
    draws = replace(d, initial=d.initial[keep], transition=d.transition[keep], emission=d.emission[keep],
                    weight=weight)  # fmt: skip
    solutions = tuple(one for one, kept in zip(s.solutions, keep, strict=True) if kept)
    solution = replace(s, batch=replace(s.batch, draws=draws), solutions=solutions)
    return replace(pool, solution=solution, values=pool.values[:, keep])
