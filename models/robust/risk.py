r"""Criteria of a cautious analyst, all of one form.

A plan has an outcome :math:`X_i` in every draw. What it is worth is the mean under the least favourable weights of
a set around what is believed,

.. math:: \rho(X) = \min_{q \in Q} \sum_i q_i X_i, \qquad
   Q = \Big\{\kappa w + (1 - \kappa) z \;:\; 0 \le z_i \le w_i / \alpha,\ \textstyle\sum_i z_i = 1 \Big\}

which is the mean for :math:`\alpha = 1`, the conditional value at risk :math:`\mathrm{CVaR}_\alpha` (mean of the
worst :math:`\alpha` share of the draws) for :math:`\kappa = 0`, the worst draw as :math:`\alpha \to 0`, and a
mixture of mean and CVaR in between (Derman et al. 2018 call it soft-robust). Outcomes are values, or values less
what each draw offers: its own optimum (minus the regret) or what never helping is worth there (the gain).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from models.errors import located
from models.planning.schedule import Array

Outcome = Literal["value", "regret", "gain"]
"""What a criterion is about: the value, minus the regret, or the gain over never helping."""


@dataclass(frozen=True)
class RiskSet:
    """The weights of draws that a criterion guards against.

    Attributes
    ----------
    weight : float64[d]
        What is believed; non-negative, summing to one.
    alpha : float
        Share of the draws that counts, in ``[0, 1]``; 0: only the worst draw (of those with weight).
    mean_share : float
        `kappa`, in ``[0, 1]``: how much of the criterion is the plain mean.

    Raises
    ------
    InputError
        On numbers outside those ranges, or weights that are none.
    """

    weight: Array
    alpha: float = 1.0
    mean_share: float = 0.0

    def __post_init__(self) -> None:
        check_weight(self.weight)
        if not (np.isfinite(self.alpha) and 0 <= self.alpha <= 1):
            raise located("criterion, alpha", self.alpha, "a share from 0 (the worst draw) to 1 (the mean)")
        if not (np.isfinite(self.mean_share) and 0 <= self.mean_share <= 1):
            raise located("criterion, share of the mean", self.mean_share, "from 0 to 1")

    @property
    def is_mean(self) -> bool:
        """Whether the set holds one element, what is believed."""
        return self.alpha == 1 or self.mean_share == 1

    @property
    def caps(self) -> Array:
        """Upper bounds of `z`, shape ``[d]``."""
        if self.alpha > 0:
            return self.weight / self.alpha
        return np.asarray((self.weight > 0).astype(np.float64))

    def lowest(self, outcomes: Array) -> tuple[float, Array]:
        r""":math:`\rho(X)` and the weights that attain it.

        Parameters
        ----------
        outcomes : float64[d]
        """
        if self.is_mean:
            return float(self.weight @ outcomes), self.weight
        order = np.argsort(outcomes, kind="stable")
        caps = self.caps[order]
        before = np.concatenate([[0.0], np.cumsum(caps)[:-1]])
        z = np.empty_like(caps)
        z[order] = np.clip(1.0 - before, 0.0, caps)
        q = self.mean_share * self.weight + (1 - self.mean_share) * z / z.sum()
        return float(q @ outcomes), q

    def lowest_each(self, outcomes: Array) -> Array:
        r""":math:`\rho(X)` of many plans at once, shape ``[p]``.

        Parameters
        ----------
        outcomes : float64[p, d]
        """
        if self.is_mean:
            return np.asarray(outcomes @ self.weight)
        order = np.argsort(outcomes, axis=1, kind="stable")
        caps = self.caps[order]
        z = np.clip(1.0 - (np.cumsum(caps, axis=1) - caps), 0.0, caps)
        tail = (z * np.take_along_axis(outcomes, order, axis=1)).sum(axis=1) / z.sum(axis=1)
        return np.asarray(self.mean_share * (outcomes @ self.weight) + (1 - self.mean_share) * tail)

    def project(self, q: Array) -> Array:
        """A member of the set next to `q`, which may be outside by rounding."""
        if self.is_mean:
            return self.weight
        caps = self.caps
        z = np.clip((q - self.mean_share * self.weight) / (1 - self.mean_share), 0.0, caps)
        total = z.sum()
        if total > 1:
            z /= total
        elif total < 1:
            room = caps - z
            z += room * ((1 - total) / room.sum())
        return self.mean_share * self.weight + (1 - self.mean_share) * z


def cvar(outcomes: Array, weight: Array, alpha: float) -> float:
    r"""Mean of the worst `alpha` share of the draws, by weight; 0: the worst draw.

    Examples
    --------
    >>> cvar(np.array([1.0, 2.0, 3.0, 4.0]), np.full(4, 0.25), 0.5)
    1.5
    """
    return RiskSet(weight, alpha).lowest(outcomes)[0]


def weighted_quantiles(values: Array, weight: Array, levels: Sequence[float]) -> list[float]:
    """Quantiles of weighted draws: the smallest value at which the cumulated weight reaches the level.

    Examples
    --------
    >>> weighted_quantiles(np.array([3.0, 1.0, 2.0]), np.array([0.5, 0.25, 0.25]), (0.25, 0.5, 0.9))
    [1.0, 2.0, 3.0]
    """
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weight[order])
    places = np.searchsorted(reached, np.asarray(levels) * reached[-1] * (1 - 1e-12))
    return [float(values[order[min(i, len(order) - 1)]]) for i in places.tolist()]


def check_weight(weight: Array) -> None:
    """Refuse weights that are no probabilities.

    Raises
    ------
    InputError
        Naming the first bad weight, or the sum.
    """
    bad = np.flatnonzero(~(weight >= 0))
    if bad.size:
        raise located(f"weights of the draws, draw {bad[0]}", float(weight[bad[0]]), "a number of at least 0")
    if abs(weight.sum() - 1) > 1e-9:
        raise located("weights of the draws, sum", f"{weight.sum():.10g}", "1")
