r"""Policies given by alpha vectors: a set of vectors for each mode, each with the action that starts it.

At a belief a vector is worth :math:`\alpha \cdot b`, and the best one bounds the optimum from below. What is *done*
is the best one-step look-ahead on the vectors, which is never worth less than following the best vector.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from models.errors import Phrase, located
from models.planning.belief_model import ANY_MODE, BeliefModel, Impossible
from models.planning.belief_policy import BeliefPolicy
from models.planning.policies import Array

if TYPE_CHECKING:
    from models.planning.problem import Problem


class AlphaPolicy(BeliefPolicy):
    r"""A policy given by alpha vectors.

    Parameters
    ----------
    source : Problem or BeliefModel
        What the vectors were made for, and the belief is made with.
    alpha : float64[k, y]
        Vectors; entries beyond the hidden states of a vector's mode do not count.
    mode, choice : int[k]
        Mode of each vector and the choice that it starts with, by its place among those of the mode.
    follow : int[k, z], optional
        For each outcome of that choice the vector that follows; outcomes in the order of the problem's branches and
        their observations. With it the vectors form a finite-state controller (`models.planning.controller`).
    name : str
    tracker : BeliefModel, optional
        What the belief is made with; `source` by default. One that leaves the mode open (`BeliefModel.of_latent`)
        lets the policy follow any schedule of modes.
    outcomes : sequence, optional
        Next mode and observation of each outcome of every choice, where `source` has them in another order.
    impossible : {"error", "keep", "reset"}
        What to do about a step of probability zero, where `source` is a problem.

    Raises
    ------
    InputError
        On arrays that do not fit together, or a mode without a vector.
    """

    def __init__(
        self, source: Problem | BeliefModel, alpha: ArrayLike, mode: ArrayLike, choice: ArrayLike,
        follow: ArrayLike | None = None, name: str = "ls-POMDP", *, tracker: BeliefModel | None = None,
        outcomes: Sequence[Sequence[Sequence[tuple[int, int]]]] | None = None, impossible: Impossible = "error",
    ) -> None:  # fmt: skip
        self.name = name
        self.model = (
            source if isinstance(source, BeliefModel) else BeliefModel.of_problem(source, impossible=impossible)
        )
        self.alpha = np.asarray(alpha, dtype=np.float64)
        self.mode = np.asarray(mode, dtype=np.int64)
        self.choice = np.asarray(choice, dtype=np.int64)
        self.follow = None if follow is None else np.asarray(follow, dtype=np.int64)
        self.keys = outcome_keys(source) if outcomes is None else outcomes
        self._tracker = tracker or self.model
        self._check()
        self._of_mode = [np.flatnonzero(self.mode == x) for x in range(len(self.model.states))]

    def _check(self) -> None:
        place, words = f"policy {self.name}", self.model.vocabulary
        if any(z.mode == ANY_MODE for offered in self.model.outcomes for outcomes in offered for z in outcomes):
            raise located(f"{place}, model", Phrase("modes left open"), "a model that says how the mode moves")
        if self._tracker.vocabulary != words or self._tracker.states != self.model.states:
            raise located(
                f"{place}, tracker", self._tracker.vocabulary, "the modes, actions and states of the model"
            )
        k = len(self.alpha)
        width = max(map(len, self.model.states))
        if self.alpha.ndim != 2 or self.alpha.shape[1] < width or not np.isfinite(self.alpha).all():
            raise located(f"{place}, alpha, shape", self.alpha.shape, f"finite numbers [vectors, {width}]")
        for field in ("mode", "choice"):
            if getattr(self, field).shape != (k,):
                raise located(f"{place}, shape of {field}", getattr(self, field).shape, f"({k},)")
        for i in range(k):
            x, c = int(self.mode[i]), int(self.choice[i])
            if not 0 <= x < len(words.modes):
                raise located(f"{place}, vector {i}, mode", x, f"0 to {len(words.modes) - 1}")
            if not 0 <= c < len(words.actions[x]):
                wanted = f"0 to {len(words.actions[x]) - 1} in mode {words.modes[x]}"
                raise located(f"{place}, vector {i}, choice", c, wanted)
        for x, name in enumerate(words.modes):
            if not np.any(self.mode == x):
                raise located(f"{place}, vectors of mode {name}", 0, "at least one")
        if self.follow is not None:
            if self.follow.ndim != 2 or len(self.follow) != k:
                raise located(f"{place}, shape of follow", self.follow.shape, f"({k}, outcomes)")
            for i in range(k):
                keys = self.keys[int(self.mode[i])][int(self.choice[i])]
                if len(keys) > self.follow.shape[1]:
                    raise located(f"{place}, follow, outcomes", self.follow.shape[1], f"at least {len(keys)}")
                for z, (x, _) in enumerate(keys):
                    after = int(self.follow[i, z])
                    if not 0 <= after < k or self.mode[after] != x:
                        raise located(
                            f"{place}, vector {i}, follower of outcome {z}", after,
                            f"a vector of mode {words.modes[x]}",
                        )  # fmt: skip

    @property
    def tracker(self) -> BeliefModel:
        """The model that the belief is made with."""
        return self._tracker

    # -- values ------------------------------------------------------------------------------------
    def values_many(self, beliefs: Array, mode: int) -> Array:
        r"""Best :math:`\alpha \cdot b` at beliefs ``[i, y]`` (which need not be normalised), shape ``[i]``."""
        vectors = self.alpha[self._of_mode[mode], : beliefs.shape[1]]
        return np.asarray((beliefs @ vectors.T).max(axis=1))

    def value(self, belief: Any, mode: int | str) -> float:
        r"""What the policy is at least worth from a belief: :math:`\max_\alpha \alpha \cdot b`.

        Raises
        ------
        InputError
            On an unknown mode, or a belief that is no probability vector.
        """
        m = self.vocabulary.mode(mode)
        return float(self.values_many(self.model.check_belief(m, belief)[None], m)[0])

    def vector(self, belief: Any, mode: int | str) -> int:
        """Number of the best vector at a belief."""
        m = self.vocabulary.mode(mode)
        b = self.model.check_belief(m, belief)
        return int(self._of_mode[m][np.argmax(self.alpha[self._of_mode[m], : len(b)] @ b)])

    def action_values_many(self, beliefs: Array, mode: int) -> Array:
        """One step and the best vector after each outcome, shape ``[i, choice]``."""
        out = beliefs @ self.model.rewards[mode].T
        for c, outcomes in enumerate(self.model.outcomes[mode]):
            for z in outcomes:
                after = z.reached(beliefs, len(self.model.states[z.mode]))
                out[:, c] += self.model.discount * self.values_many(after, z.mode)
        return np.asarray(out)

    def to_dict(self) -> dict[str, Any]:
        """Plain content of the policy."""
        return {
            "kind": "alpha", "name": self.name, "model": self.model.to_dict(), "alpha": self.alpha.tolist(),
            "mode": self.mode.tolist(), "choice": self.choice.tolist(),
            "follow": None if self.follow is None else self.follow.tolist(),
            "outcomes": [[[list(key) for key in keys] for keys in offered] for offered in self.keys],
            "tracker": None if self._tracker is self.model else self._tracker.to_dict(),
        }  # fmt: skip


def outcome_keys(source: Problem | BeliefModel) -> Sequence[Sequence[Sequence[tuple[int, int]]]]:
    """Next mode and observation of each outcome of every choice, in the order of the problem's branches."""
    if isinstance(source, BeliefModel):
        return [
            [[(z.mode, z.observation) for z in outcomes] for outcomes in offered] for offered in source.outcomes
        ]
    return [
        [[(branch.mode, o) for branch in choice.branches for o in branch.observations] for choice in offered]
        for offered in source.choices
    ]
