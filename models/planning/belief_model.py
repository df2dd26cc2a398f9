r"""The model that a policy's belief lives in: outcomes of every choice as joint matrices, in plain numpy.

An outcome of a choice is a next mode and an observation with its matrix
:math:`J(y, y') = P(x', o, y' \mid x, y, a)`, so a belief moves by
:math:`b'(y') \propto \sum_y b(y) J(y, y')`. Where the mode moves by itself, outcomes leave it open (`ANY_MODE`) and
the belief only follows the person: any schedule of modes can then be observed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from models.errors import InputError, Phrase, located
from models.planning.belief_check import IMPOSSIBLE, checked_belief
from models.planning.policies import Array, Index, Vocabulary

if TYPE_CHECKING:
    from models.lspomdp import LatentStatePOMDP
    from models.planning.problem import Problem

ANY_MODE = -1
"""Next mode of an outcome that leaves the mode open."""

MOST_DENSE = 10_000
"""Entries up to which a matrix is kept with its zeros."""

Impossible = Literal["error", "keep", "reset"]


@dataclass(frozen=True)
class Outcome:
    """One way a choice can end: next mode (or `ANY_MODE`), observation, and the joint matrix by its entries."""

    mode: int
    observation: int
    row: Index
    column: Index
    value: Array

    def reached(self, belief: Array, n: int) -> Array:
        """Unnormalised next belief, shape ``[y']``, of one belief ``[y]`` or many ``[i, y]``."""
        if belief.ndim == 1:
            return np.bincount(self.column, belief[self.row] * self.value, minlength=n)
        if len(belief) == 1:
            return self.reached(belief[0], n)[None]
        return np.asarray(belief @ self._matrix(belief.shape[1], n))

    def _matrix(self, n_before: int, n_after: int) -> Any:
        """The joint matrix for many beliefs at once; kept. Sparse, which needs scipy, only where it is large."""
        if "matrix" not in self.__dict__:
            if n_before * n_after <= MOST_DENSE:
                table: Any = np.zeros((n_before, n_after))
                np.add.at(table, (self.row, self.column), self.value)
            else:
                from scipy import sparse

                entries = (self.value, (self.row, self.column))
                table = sparse.csr_array(entries, shape=(n_before, n_after))
            self.__dict__["matrix"] = table
        return self.__dict__["matrix"]


@dataclass(frozen=True)
class BeliefModel:
    """Modes, hidden states and outcomes, as far as beliefs and expected rewards need them.

    Attributes
    ----------
    vocabulary : Vocabulary
    states : tuple of tuple of str
        Hidden states of each mode.
    outcomes : tuple of tuple of tuple of Outcome
        Of each choice of each mode.
    rewards : tuple of float64[choice, y]
        One array a mode.
    initial : tuple of float64[y]
        Belief at the start in each mode; uniform where the problem never starts.
    starts : tuple of int
        Modes that the problem may start in.
    discount : float
    impossible : {"error", "keep", "reset"}
        What to do about a step of probability zero: raise, ignore what was seen, or restart from `initial`.
    """

    vocabulary: Vocabulary
    states: tuple[tuple[str, ...], ...]
    outcomes: tuple[tuple[tuple[Outcome, ...], ...], ...]
    rewards: tuple[Array, ...]
    initial: tuple[Array, ...]
    starts: tuple[int, ...]
    discount: float
    impossible: Impossible = "error"

    def __post_init__(self) -> None:
        if self.impossible not in ("error", "keep", "reset"):
            raise located("impossible observations", self.impossible, "error, keep or reset")

    # -- where it comes from -----------------------------------------------------------------------
    @classmethod
    def of_problem(cls, problem: Problem, *, impossible: Impossible = "error") -> BeliefModel:
        """Belief model of a planning problem."""
        outcomes = []
        for offered in problem.choices:
            own = []
            for choice in offered:
                found: list[Outcome] = []
                for branch in choice.branches:
                    for j, o in enumerate(branch.observations):
                        joint = branch.transition
                        if branch.emission is not None:
                            joint = joint.multiply(branch.emission[:, [j]].toarray().ravel()[None, :])
                        joint = joint.tocoo()
                        row, column = (np.asarray(c, dtype=np.int64) for c in joint.coords)
                        found.append(Outcome(branch.mode, o, row, column, np.asarray(joint.data)))
                own.append(tuple(_joined(found)))
            outcomes.append(tuple(own))
        start = tuple(b / b.sum() if b.sum() > 0 else np.full(len(b), 1.0 / len(b)) for b in problem.initial)
        rewards = tuple(np.stack([c.reward for c in offered]) for offered in problem.choices)
        words, starts = Vocabulary.of(problem), tuple(x for x, _, _ in problem.starts())
        return cls(words, problem.states, tuple(outcomes), rewards, start, starts, problem.discount, impossible)

    @classmethod
    def of_latent(
        cls, model: LatentStatePOMDP, discount: float = 1.0, *, impossible: Impossible = "error"
    ) -> BeliefModel:
        """Belief about a person, whatever the schedule of modes."""
        protocol = model.protocol
        vocabulary = Vocabulary.of(protocol)
        reward = model.reward_table()
        outcomes, rewards = [], []
        a = 0
        for mode in protocol.modes:
            rewards.append(reward[a : a + len(mode.actions)])
            own = []
            for _ in mode.actions:
                row = protocol.emission_index[a]
                joint = (
                    {0: model.transition[a]}
                    if row < 0
                    else {
                        o + 1: model.emission[row, :, o, None] * model.transition[a]
                        for o in range(protocol.n_responses)
                    }
                )
                own.append(tuple(_dense(ANY_MODE, o, table) for o, table in joint.items()))
                a += 1
            outcomes.append(tuple(own))
        n = len(protocol.modes)
        return cls(
            vocabulary, (model.state_names,) * n, tuple(outcomes), tuple(rewards), (model.initial,) * n,
            tuple(range(n)), discount, impossible,
        )  # fmt: skip

    # -- beliefs -----------------------------------------------------------------------------------
    def check_belief(self, mode: int, belief: Any) -> Array:
        """Return a belief over the hidden states of a mode as an array.

        Raises
        ------
        InputError
            If its length does not fit, or it is no probability vector (sum within 1e-9).
        """
        return checked_belief(belief, self.vocabulary.modes[mode], len(self.states[mode]))

    def update(self, mode: int, belief: Array, choice: int, observation: int | None, next_mode: int) -> Array:
        """Belief after a step; `observation` None: it was not recorded.

        Parameters
        ----------
        mode, choice, next_mode : int
        belief : float64[y]
            Over the hidden states of `mode`.
        observation : int or None

        Raises
        ------
        InputError
            On numbers out of range, a belief of another length, or a step of probability zero if `impossible` is
            ``error``.
        """
        self._check_step(mode, belief, choice, observation, next_mode)
        n = len(self.states[next_mode])
        options = self.outcomes[mode][choice]
        leads = [z for z in options if z.mode in (next_mode, ANY_MODE)]
        seen = leads if observation is None else [z for z in leads if z.observation == observation]
        joint = _total(seen, belief, n)
        if joint.sum() > IMPOSSIBLE:
            return joint / joint.sum()
        if self.impossible == "error":
            words = self.vocabulary
            shown = Phrase("a response not recorded") if observation is None else words.observations[observation]
            raise InputError(
                f"observation {shown!r}, then mode {words.modes[next_mode]!r}: has probability zero after "
                f"{words.actions[mode][choice]!r} in mode {words.modes[mode]!r} and belief "
                f"{np.round(belief, 4).tolist()}; choose impossible='keep' or 'reset' to go on"
            )
        if self.impossible == "keep":
            same_size = [z for z in options if z.mode == ANY_MODE or len(self.states[z.mode]) == n]
            for ignored in (leads, [z for z in same_size if z.observation == observation], same_size):
                joint = _total(ignored, belief, n)
                if joint.sum() > IMPOSSIBLE:
                    return joint / joint.sum()
        return self.initial[next_mode].copy()

    def update_many(self, mode: int, beliefs: Array, choice: int, observation: int | None, next_mode: int) -> Array:
        """Beliefs ``[i, y]`` after the same step, shape ``[i, y']``; impossible ones as `update` treats them.

        Raises
        ------
        InputError
            As `update` does.
        """
        self._check_step(mode, beliefs, choice, observation, next_mode)
        n = len(self.states[next_mode])
        joint = np.zeros((len(beliefs), n))
        for z in self.outcomes[mode][choice]:
            if z.mode in (next_mode, ANY_MODE) and observation in (None, z.observation):
                joint += z.reached(beliefs, n)
        total = joint.sum(axis=1)
        for i in np.flatnonzero(total <= IMPOSSIBLE):
            joint[i] = self.update(mode, beliefs[i], choice, observation, next_mode)
            total[i] = 1.0
        return joint / total[:, None]

    def _check_step(
        self, mode: int, beliefs: Array, choice: int, observation: int | None, next_mode: int
    ) -> None:  # fmt: skip
        words = self.vocabulary
        words.mode(mode)
        words.choice(mode, choice)
        words.observation(observation)
        words.mode(next_mode)
        if beliefs.shape[-1:] != (len(self.states[mode]),):
            raise located(f"belief in mode {words.modes[mode]}, states", beliefs.shape, f"{len(self.states[mode])}")

    # -- files -------------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Plain content of the model."""
        return {
            **self.vocabulary.to_dict(),
            "states": [list(s) for s in self.states],
            "discount": self.discount,
            "impossible": self.impossible,
            "initial": [b.tolist() for b in self.initial],
            "starts": list(self.starts),
            "rewards": [r.tolist() for r in self.rewards],
            "outcomes": [
                [
                    [
                        {"mode": z.mode, "observation": z.observation, "row": z.row.tolist(),
                         "column": z.column.tolist(), "value": z.value.tolist()}
                        for z in choice
                    ]
                    for choice in offered
                ]
                for offered in self.outcomes
            ],
        }  # fmt: skip


def _total(outcomes: list[Outcome], belief: Array, n: int) -> Array:
    joint = np.zeros(n)
    for z in outcomes:
        joint += z.reached(belief, n)
    return joint


def _dense(mode: int, observation: int, table: Array) -> Outcome:
    row, column = np.nonzero(table)
    return Outcome(mode, observation, row.astype(np.int64), column.astype(np.int64), table[row, column])


def _joined(outcomes: list[Outcome]) -> list[Outcome]:
    """Outcomes of the same mode and observation as one."""
    groups: dict[tuple[int, int], list[Outcome]] = {}
    for z in outcomes:
        groups.setdefault((z.mode, z.observation), []).append(z)

    def join(field: str, group: list[Outcome]) -> NDArray[Any]:
        return np.concatenate([getattr(z, field) for z in group])

    return [
        group[0] if len(group) == 1
        else Outcome(x, o, join("row", group), join("column", group), join("value", group))
        for (x, o), group in groups.items()
    ]  # fmt: skip
