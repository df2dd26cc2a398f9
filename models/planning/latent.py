r"""The prosocial model as a planning problem: modes seen, the person's state hidden.

The response shows the state the round *started* from, so the joint kernel of a round is
:math:`P(M', o, s' \mid M, s, a) = P(M' \mid M)\, O(o \mid s, a)\, T(s' \mid s, a)`, without the factor `O` where
the mode shows no response.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from models.errors import located
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.arrays import Array, ProblemArrays, arrays_of
from models.planning.mode_process import ModeProcess, alternating
from models.planning.problem import EXACT, Branch, Choice, Problem, csr
from models.protocol import NO_RESPONSE, Protocol
from models.reward import UNIT, Reward, default_x

DISCOUNT = 0.95
"""Discount of the repeated interaction; the paper prints none."""


def latent_problem(
    model: LatentStatePOMDP, process: ModeProcess | None = None, discount: float = DISCOUNT, *, name: str = ""
) -> Problem:
    """The repeated interaction with one person.

    Parameters
    ----------
    model : LatentStatePOMDP
    process : ModeProcess, optional
        Alternating modes from the protocol's first by default.
    discount : float
        In ``[0, 1]``.
    name : str

    Raises
    ------
    InputError
        If the process is of another number of modes, or the discount is out of range.
    """
    process = process or alternating(model.protocol)
    problem = _problem(
        model.protocol, process, model.initial, model.transition, model.emission, model.reward_table(), discount,
        model.state_names, name or "interaction", model.reward.unit,
    )  # fmt: skip
    return replace(problem, cautions=model.cautions) if model.cautions else problem


def _problem(
    protocol: Protocol, process: ModeProcess, initial: Array, transition: Array, emission: Array, reward: Array,
    discount: float, state_names: tuple[str, ...], name: str, unit: str, *, full: bool = False,
) -> Problem:  # fmt: skip
    """One problem; `full` stores zeros too, so that every draw of a batch has its entries in the same places."""
    _check_modes(protocol, process)
    choices = []
    a = 0
    for m, mode in enumerate(protocol.modes):
        offered = []
        for action in mode.actions:
            row = protocol.emission_index[a]
            joint = (
                [transition[a]]
                if row < 0
                else [emission[row, :, o][:, None] * transition[a] for o in range(protocol.n_responses)]
            )
            branches = tuple(
                Branch(int(after), _table(p * table, full), (0 if row < 0 else o + 1,))
                for o, table in enumerate(joint)
                for after, p in enumerate(process.table[m])
                if p > 0
            )
            offered.append(Choice(action.name, np.array(reward[a]), branches))
            a += 1
        choices.append(tuple(offered))
    start = tuple(p * initial for p in process.start)
    modes = tuple(m.name for m in protocol.modes)
    return Problem(
        modes, (state_names,) * len(modes), tuple(choices), (NO_RESPONSE, *protocol.response_names), start,
        discount, name, unit=unit,
    )  # fmt: skip


def _check_modes(protocol: Protocol, process: ModeProcess) -> None:
    if len(process.start) != len(protocol.modes):
        raise located("mode process, modes", len(process.start), f"{len(protocol.modes)}, as the protocol has")


def _table(values: Array, full: bool):  # type: ignore[no-untyped-def]
    if not full:
        return csr(values)
    out = csr(np.ones_like(values))
    out.data = values.ravel().copy()
    return out


def _summing_to_one(rows: Array) -> Array:
    """Rows as a `models.planning.problem.Problem` takes them: divided by sums that are more than rounding off."""
    total = rows.sum(axis=-1, keepdims=True)
    return np.where(np.abs(total - 1) > EXACT, rows / total, rows)


@dataclass(frozen=True)
class LatentBatch:
    """Many draws of one model as planning problems of the same shape.

    Attributes
    ----------
    draws : ModelDraws
    process : ModeProcess
    discount : float
        In ``[0, 1]``.

    Raises
    ------
    InputError
        If the process is of another number of modes, or the discount is out of range.
    """

    draws: ModelDraws
    process: ModeProcess
    discount: float = DISCOUNT

    def __post_init__(self) -> None:
        _check_modes(self.draws.protocol, self.process)
        if not 0 <= self.discount <= 1:
            raise located("draws, discount", self.discount, "a number from 0 to 1")

    def __len__(self) -> int:
        return self.draws.n_draws

    @property
    def cautions(self) -> tuple[str, ...]:
        """Why not to trust the draws (`models.cautions`)."""
        return self.draws.cautions

    @property
    def unit(self) -> str:
        """What values are in: the word of the draws' reward."""
        return self.draws.reward.unit if self.draws.reward is not None else UNIT

    @cached_property
    def _reward(self) -> Array:
        reward = self.draws.reward or Reward(default_x(self.draws.n_states))
        return reward.table(self.draws.protocol)

    @cached_property
    def template(self) -> ProblemArrays:
        """Arrays of draw 0, zeros stored: only `value` and `least` differ between draws.

        Sizes of values are those over all states, as rewards are: what draw 0 comes to says nothing of the others.
        """
        first = self._draw(0)
        return arrays_of(first.started([np.full(len(s), 1 / (first.n_modes * len(s))) for s in first.states]))

    def _draw(self, d: int) -> Problem:
        draws = self.draws
        names = draws.state_names or tuple(f"s{i}" for i in range(draws.n_states))
        return _problem(
            draws.protocol, self.process, draws.initial[d], draws.transition[d], draws.emission[d], self._reward,
            self.discount, names, f"draw {d}", self.unit, full=True,
        )  # fmt: skip

    def problem(self, d: int) -> Problem:
        """One draw as a problem of its own."""
        return latent_problem(self.draws.model(d), self.process, self.discount, name=f"draw {d}")

    @cached_property
    def values(self) -> Array:
        """Entries of the transition matrices of every draw, shape ``[draw, entry]``, as in `template`."""
        protocol = self.draws.protocol
        transition, emission = map(_summing_to_one, (self.draws.transition, self.draws.emission))
        following = _summing_to_one(self.process.table)
        blocks = []
        a = 0
        for m, mode in enumerate(protocol.modes):
            for _ in mode.actions:
                row = protocol.emission_index[a]
                joint = (
                    [transition[:, a]]
                    if row < 0
                    else [emission[:, row, :, o, None] * transition[:, a] for o in range(protocol.n_responses)]
                )
                blocks += [(p * table).reshape(len(self), -1) for table in joint for p in following[m] if p > 0]
                a += 1
        return np.ascontiguousarray(np.concatenate(blocks, axis=1))

    @cached_property
    def least_size(self) -> Array:
        """What values of every draw count as at least, as `Problem.least_size`, shape ``[draw]``."""
        # Draws with zeros in the same places can come to the same states.
        alike = np.ones(len(self), dtype=bool)
        for entries in (self.draws.initial, self.values):
            alike &= ((entries > 0) == (entries[0] > 0)).all(axis=1)
        first = self._draw(0).least_size
        return np.array([first if alike[d] else self.problem(d).least_size for d in range(len(self))])

    def arrays(self, d: int) -> ProblemArrays:
        """Arrays of one draw."""
        return self.template._replace(value=self.values[d], least=float(self.least_size[d]))

    def with_reward(self, reward: Reward) -> LatentBatch:
        """The same draws with another reward."""
        return replace(self, draws=replace(self.draws, reward=reward))
