r"""A planning problem: a POMDP part of whose state is observed, given by its joint kernel.

The state has two parts: the *mode* :math:`x`, which everybody sees, and the hidden *state* :math:`y`. One step is

.. math:: P(x', o, y' \mid x, y, a)

with reward :math:`R(x, y, a)`. The joint kernel covers every convention there is: an observation that shows the
state the step started from (the robot's rounds, see `models.lspomdp`), the state it ended in (textbooks, the
`.pomdp` format), or both. Without an observed part there is one mode, and the problem is a textbook POMDP.

A step is stored by *branches*: one for each mode it may end in (or for each observation that shows where it
started), each a sparse matrix over hidden states, followed by observations of the end state if there are any.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from models.errors import InputError, Phrase, located
from models.planning.belief_check import IMPOSSIBLE, TOLERANCE, checked_belief
from models.planning.reachable import Stakes, stakes_of
from models.reward import UNIT

Array = NDArray[np.float64]

AT_STAKE, ROUNDING = 1e-9, 1e-11
"""Values count as at least these shares of what is at stake, and of the largest value there can be."""

EXACT = 1e-14
"""Rows that miss a sum of one by more are divided by it: with a discount near one a chain that gains mass is worth
more than the highest reward for ever, which is where upper bounds begin."""


@dataclass(frozen=True)
class Branch:
    r"""One way a step can go on.

    Attributes
    ----------
    mode : int
        The mode it leads to.
    transition : sparse float64[y, y']
        :math:`P(x', y' \mid x, y, a)`; of an observation that shows the start state, jointly with it.
    observations : tuple of int
        What may be seen, one entry if `emission` is None.
    emission : sparse float64[y', o], optional
        :math:`P(o \mid a, x', y')` over `observations`, of the end state.
    """

    mode: int
    transition: sparse.csr_array
    observations: tuple[int, ...]
    emission: sparse.csr_array | None = None

    def row_sums(self) -> Array:
        """Probability of this branch from each hidden state, shape ``[y]``."""
        if self.emission is None:
            return np.asarray(self.transition.sum(axis=1)).ravel()
        return np.asarray(self.transition @ np.asarray(self.emission.sum(axis=1)).ravel())


@dataclass(frozen=True)
class Choice:
    """An action in a mode: its name, its reward by hidden state ``[y]``, and how the step may go on."""

    action: str
    reward: Array
    branches: tuple[Branch, ...]


@dataclass(frozen=True)
class Problem:
    """A POMDP with an observed part.

    Attributes
    ----------
    modes : tuple of str
        Values of the observed part; one for a textbook problem.
    states : tuple of tuple of str
        Hidden states of each mode.
    choices : tuple of tuple of Choice
        What can be done in each mode.
    observations : tuple of str
    initial : tuple of float64[y]
        :math:`P(x_0, y_0)`, one array a mode, summing to one together. The first mode is seen before acting.
    discount : float
        In ``[0, 1]``; solving without a horizon needs less than 1.
    name : str
    costs : bool
        The source gave costs; rewards here are their negatives.
    unit : str
        What rewards are in, in the plural. Words only; no number depends on it.
    cautions : tuple of str
        Why not to trust the model behind it (`models.cautions`).

    Raises
    ------
    InputError
        On shapes that do not fit, probabilities that are negative, not finite or do not sum to one within 1e-9,
        rewards that are not finite: the message names mode, action and state.
    """

    modes: tuple[str, ...]
    states: tuple[tuple[str, ...], ...]
    choices: tuple[tuple[Choice, ...], ...]
    observations: tuple[str, ...]
    initial: tuple[Array, ...]
    discount: float
    name: str = "problem"
    costs: bool = False
    unit: str = UNIT
    cautions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        place = self.name
        if not (np.isfinite(self.discount) and 0 <= self.discount <= 1):
            raise located(f"{place}, discount", self.discount, "a number from 0 to 1")
        if not self.modes or len(self.states) != len(self.modes) or len(self.choices) != len(self.modes):
            found = Phrase(f"{len(self.modes)} modes, {len(self.states)} and {len(self.choices)} entries")
            raise located(f"{place}, states and choices", found, "one entry for each of at least one mode")
        for x, mode in enumerate(self.modes):
            if not self.states[x]:
                raise located(f"{place}, mode {mode}, hidden states", 0, "at least one")
            if not self.choices[x]:
                raise located(f"{place}, mode {mode}, actions", 0, "at least one")
            names = [c.action for c in self.choices[x]]
            if len(set(names)) != len(names):
                raise located(f"{place}, mode {mode}, actions", names, "different names")
            for choice in self.choices[x]:
                self._check_choice(x, choice)
        self._check_initial()
        choices = tuple(tuple(_joined(_summing_to_one(c)) for c in offered) for offered in self.choices)
        object.__setattr__(self, "choices", choices)

    def _check_choice(self, x: int, choice: Choice) -> None:
        place = f"{self.name}, mode {self.modes[x]}, action {choice.action}"
        n = len(self.states[x])
        if choice.reward.shape != (n,):
            raise located(f"{place}, shape of the reward", choice.reward.shape, f"({n},)")
        if not np.isfinite(choice.reward).all():
            y = int(np.flatnonzero(~np.isfinite(choice.reward))[0])
            raise located(f"{place}, state {self.states[x][y]}, reward", choice.reward[y], "a finite number")
        total = np.zeros(n)
        for branch in choice.branches:
            if not 0 <= branch.mode < len(self.modes):
                raise located(f"{place}, next mode", branch.mode, f"0 to {len(self.modes) - 1}")
            wanted = (n, len(self.states[branch.mode]))
            if branch.transition.shape != wanted:
                raise located(f"{place}, shape of the transition", branch.transition.shape, str(wanted))
            seen = 1 if branch.emission is None else branch.emission.shape[1]
            if branch.emission is not None and branch.emission.shape[0] != wanted[1]:
                raise located(f"{place}, shape of the emission", branch.emission.shape, f"({wanted[1]}, {seen})")
            if len(branch.observations) != seen or not all(
                0 <= o < len(self.observations) for o in branch.observations
            ):
                raise located(f"{place}, observations", branch.observations, f"{seen} known ones")
            for table in (branch.transition, branch.emission):
                if table is not None and not (np.isfinite(table.data).all() and (table.data >= 0).all()):
                    bad = table.data[~(np.isfinite(table.data) & (table.data >= 0))][0]
                    raise located(f"{place}, probability", bad, "a number from 0 to 1")
            total += branch.row_sums()
        wrong = np.flatnonzero(np.abs(total - 1) > TOLERANCE)
        if wrong.size:
            y = int(wrong[0])
            where = f"{place}, state {self.states[x][y]}, sum of the probabilities"
            raise located(where, f"{total[y]:.10g}", "1 within 1e-9")

    def _check_initial(self) -> None:
        place = f"{self.name}, initial belief"
        if [len(b) for b in self.initial] != [len(s) for s in self.states]:
            found = Phrase(str([len(b) for b in self.initial]))
            raise located(f"{place}, sizes by mode", found, str([len(s) for s in self.states]))
        joined = np.concatenate(self.initial)
        if not (np.isfinite(joined).all() and (joined >= 0).all()):
            raise located(place, joined[~(np.isfinite(joined) & (joined >= 0))][0], "probabilities from 0 to 1")
        if abs(joined.sum() - 1) > TOLERANCE:
            raise located(f"{place}, sum", f"{joined.sum():.10g}", "1 within 1e-9")

    # -- names -------------------------------------------------------------------------------------
    @property
    def n_modes(self) -> int:
        """Number of modes."""
        return len(self.modes)

    @property
    def n_states(self) -> int:
        """Number of hidden states of the largest mode."""
        return max(len(s) for s in self.states)

    @cached_property
    def stakes(self) -> Stakes:
        """Rewards that it can pay, in states that it can come to."""
        return stakes_of(self)

    @property
    def span(self) -> float:
        r"""Largest difference there can be between two values, :math:`(\max R - \min R) / (1 - \gamma)`.

        Of beliefs that it can come to, as are `largest_value` and `least_size`.
        """
        return _for_ever(self.stakes.highest - self.stakes.lowest, self.discount)

    @property
    def largest_value(self) -> float:
        r"""Largest size that a value can have, :math:`\max |R| / (1 - \gamma)`; rounding is in proportion to it."""
        return _for_ever(max(abs(self.stakes.highest), abs(self.stakes.lowest)), self.discount)

    @property
    def least_size(self) -> float:
        """What values count as at least where gaps are told relative to them (`models.planning.precision`)."""
        at_stake = _for_ever(self.stakes.highest - self.stakes.sure, self.discount)
        return max(AT_STAKE * at_stake, ROUNDING * self.largest_value)

    def mode(self, name: str) -> int:
        """Index of a mode.

        Raises
        ------
        InputError
            If there is no such mode.
        """
        if name not in self.modes:
            raise located(f"{self.name}, mode", name, f"one of {', '.join(self.modes[:20])}")
        return self.modes.index(name)

    def action(self, mode: int, name: str) -> int:
        """Index of an action among the choices of a mode.

        Raises
        ------
        InputError
            If the mode does not offer it.
        """
        names = [c.action for c in self.choices[mode]]
        if name not in names:
            raise located(f"{self.name}, action in mode {self.modes[mode]}", name, f"one of {', '.join(names)}")
        return names.index(name)

    # -- belief ------------------------------------------------------------------------------------
    def starts(self) -> Iterator[tuple[int, float, Array]]:
        """Modes the problem may start in: mode, its probability, belief over its hidden states."""
        for x, joint in enumerate(self.initial):
            total = float(joint.sum())
            if total > 0:
                yield x, total, joint / total

    def check_belief(self, mode: int, belief: Any) -> Array:
        """Return a belief over the hidden states of a mode as an array.

        Raises
        ------
        InputError
            If its length does not fit, or it is no probability vector (sum within 1e-9).
        """
        return checked_belief(belief, self.modes[mode], len(self.states[mode]))

    def outcomes(self, mode: int, choice: int, belief: Array) -> list[tuple[int, int, float, Array]]:
        r"""What may follow an action: next mode, observation, probability, next belief.

        Outcomes less probable than `IMPOSSIBLE` are left out; branches that end alike are joined.
        """
        found: dict[tuple[int, int], Array] = {}
        for branch in self.choices[mode][choice].branches:
            reached = belief @ branch.transition
            for j, observation in enumerate(branch.observations):
                weight = reached if branch.emission is None else reached * branch.emission[:, [j]].toarray().ravel()
                key = (branch.mode, observation)
                found[key] = found[key] + weight if key in found else weight
        out = []
        for (x, o), joint in found.items():
            p = float(joint.sum())
            if p > IMPOSSIBLE:
                out.append((x, o, p, joint / p))
        return out

    def update(
        self,
        mode: int,
        belief: Array,
        choice: int,
        observation: int,
        next_mode: int,
        *,
        impossible: Literal["error", "keep", "reset"] = "error",
    ) -> tuple[Array, float]:
        """Belief after a step, and how probable the step was.

        Parameters
        ----------
        mode, choice, observation, next_mode : int
        belief : float64[y]
        impossible : {"error", "keep", "reset"}
            What to do about an observation of probability zero: raise, ignore the observation, or restart from
            the initial belief in the mode reached (uniform where the problem never starts there).

        Raises
        ------
        InputError
            On an impossible observation, a belief that is none, or an index that is out of range.
        """
        if impossible not in ("error", "keep", "reset"):
            raise located("impossible observations", impossible, "error, keep or reset")
        for what, index, count in (
            ("mode", mode, self.n_modes), ("next mode", next_mode, self.n_modes),
            ("observation", observation, len(self.observations)),
        ):  # fmt: skip
            _check_index(f"{self.name}, {what}", index, count)
        _check_index(f"{self.name}, choice in mode {self.modes[mode]}", choice, len(self.choices[mode]))
        belief = self.check_belief(mode, belief)
        outcomes = self.outcomes(mode, choice, belief)
        for x, o, p, after in outcomes:
            if (x, o) == (next_mode, observation):
                return after, p
        action = self.choices[mode][choice].action
        if impossible == "error":
            raise InputError(
                f"{self.name}: observation {self.observations[observation]!r} in mode {self.modes[next_mode]!r} "
                f"has probability zero after {action!r} in mode {self.modes[mode]!r} and belief "
                f"{np.round(belief, 4).tolist()}; pass impossible='keep' or 'reset' to go on"
            )
        reached = [(p, after) for x, _, p, after in outcomes if x == next_mode]
        if impossible == "keep" and reached:
            joint = np.sum([p * after for p, after in reached], axis=0)
            return joint / joint.sum(), 0.0
        start = self.initial[next_mode]
        n = len(start)
        return (start / start.sum() if start.sum() > 0 else np.full(n, 1.0 / n)), 0.0

    # -- variants ----------------------------------------------------------------------------------
    def with_discount(self, discount: float) -> Problem:
        """The same problem with another discount."""
        return replace(self, discount=discount)

    def started(self, initial: Sequence[Array]) -> Problem:
        """The same problem from another initial belief (one array a mode, joint with the mode)."""
        return replace(self, initial=tuple(np.asarray(b, dtype=np.float64) for b in initial))


def _check_index(place: str, index: int, count: int) -> None:
    if not 0 <= index < count:
        raise located(place, index, f"0 to {count - 1}")


def _for_ever(reward: float, discount: float) -> float:
    if reward == 0:
        return 0.0
    return reward / (1 - discount) if discount < 1 else np.inf


def _summing_to_one(choice: Choice) -> Choice:
    """A choice whose rows sum to one but for rounding; entries stay where they are, zeros included."""
    total = np.sum([b.row_sums() for b in choice.branches], axis=0)
    if np.abs(total - 1).max() <= EXACT:
        return choice
    branches = []
    for b in choice.branches:
        table = sparse.csr_array(b.transition)
        data = table.data / np.repeat(total, np.diff(table.indptr))
        scaled = sparse.csr_array((data, table.indices, table.indptr), shape=table.shape)
        branches.append(replace(b, transition=scaled))
    return replace(choice, branches=tuple(branches))


def _joined(choice: Choice) -> Choice:
    """A choice with one outcome for each next mode and observation: what looks alike cannot be told apart."""
    keys = [(b.mode, o) for b in choice.branches for o in b.observations]
    if len(set(keys)) == len(keys):
        return choice
    tables: dict[tuple[int, int], Any] = {}
    for b in choice.branches:
        for j, o in enumerate(b.observations):
            table = b.transition
            if b.emission is not None:
                table = table @ sparse.diags_array(b.emission[:, [j]].toarray().ravel())
            tables[b.mode, o] = tables[b.mode, o] + table if (b.mode, o) in tables else table
    return replace(choice, branches=tuple(Branch(x, csr(t), (o,)) for (x, o), t in tables.items()))


def csr(table: Any) -> sparse.csr_array:
    """Return a table as a sparse float64 matrix without stored zeros, rows in order."""
    out = sparse.csr_array(table, dtype=np.float64)
    out.sum_duplicates()
    out.eliminate_zeros()
    return out
