"""Draws that belong together: the kinds of people within one draw of a hierarchical posterior.

Whoever learns more about people in general learns which draw is true, and not which kind of person comes next. So
what can be learned is counted by draws, while plans are made for draws and kinds. Where people do not differ each
draw is by itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.model_draws import ModelDraws
from models.planning.schedule import Array


@dataclass(frozen=True)
class DrawGroups:
    """How the rows of some `ModelDraws` make up draws of a posterior.

    Attributes
    ----------
    weight : float64[u]
        What is believed of each draw.
    share : float64[u, k]
        How common each kind of person is under it; rows sum to one.
    """

    weight: Array
    share: Array

    @classmethod
    def of(cls, draws: ModelDraws, kinds: int = 1) -> DrawGroups:
        """Cut draws into runs of `kinds` that follow each other, as `models.robust.people_draws` lays them out.

        Raises
        ------
        InputError
            If the draws cannot be cut so.
        """
        if isinstance(kinds, bool) or not isinstance(kinds, int | np.integer) or kinds < 1 or draws.n_draws % kinds:
            raise located("kinds of people", kinds, f"an integer that divides the {draws.n_draws} draws")
        both = draws.weight.reshape(-1, kinds)
        weight = both.sum(axis=1)
        share = np.divide(both, weight[:, None], out=np.full_like(both, 1.0 / kinds), where=weight[:, None] > 0)
        return cls(weight, share)

    @property
    def kinds(self) -> int:
        """Kinds of people."""
        return self.share.shape[1]

    def __len__(self) -> int:
        return len(self.weight)

    def mean(self, values: Array) -> Array:
        """Means over kinds, of values whose last axis goes over rows."""
        return np.asarray(
            np.einsum("...uk,uk->...u", values.reshape(*values.shape[:-1], *self.share.shape), self.share)
        )

    def folds(self, number: int, chains: int | None = None) -> NDArray[np.int64]:
        """Cut the draws into parts: runs of neighbours, as many parts in each chain. Shape ``[u]``."""
        each = len(self) // (chains or 1)
        return np.asarray(np.tile(np.arange(each) * min(number, max(each, 1)) // each, chains or 1))

    def expand(self, weight: Array) -> Array:
        """Weights of rows ``[..., d]`` from weights of draws ``[..., u]``."""
        return np.asarray((weight[..., None] * self.share).reshape(*weight.shape[:-1], -1))
