"""A known schedule of rounds with a person, under one model or many: what exact planning and evaluation work on."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from models.errors import InputError, Phrase, located
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView
from models.planning.mode_process import schedule_modes
from models.protocol import Mode, Protocol
from models.reward import UNIT, Reward, default_x

Array = NDArray[np.float64]

Event = tuple[str, str | None]
"""One event of a history: the action, and the response (None where none shows or it was not recorded)."""


@dataclass(frozen=True)
class Schedule(NotebookView):
    r"""Rounds whose modes are known beforehand, worth :math:`\sum_{k<K} g^k R(s_k, a_k) + g^K F(s_K)`.

    Attributes
    ----------
    draws : ModelDraws
        Models that may be true, weighted. One model is one draw; with several nobody knows which is true.
    modes : tuple of int
        Mode of each event, in the protocol's order.
    discount : float
        `g`, in ``[0, 1]``.
    terminal : float64[s], optional
        `F`: worth of the state after the last event; nothing by default.

    Raises
    ------
    InputError
        On an empty schedule, a mode that is none, a discount outside 0..1, a terminal reward that does not fit.
    """

    draws: ModelDraws
    modes: tuple[int, ...]
    discount: float = 1.0
    terminal: Array | None = None

    def __post_init__(self) -> None:
        if not self.modes:
            raise located("schedule, events", 0, "at least one")
        for k, m in enumerate(self.modes):
            if not 0 <= m < len(self.protocol.modes):
                raise located(f"schedule, event {k + 1}, mode", m, f"0 to {len(self.protocol.modes) - 1}")
        if not (np.isfinite(self.discount) and 0 <= self.discount <= 1):
            raise located("schedule, discount", self.discount, "a number from 0 to 1")
        if self.terminal is not None:
            terminal = np.asarray(self.terminal, dtype=np.float64)
            if terminal.shape != (self.n_states,):
                raise located("terminal reward, shape", terminal.shape, f"({self.n_states},), one a state")
            if not np.isfinite(terminal).all():
                raise located("terminal reward", terminal[~np.isfinite(terminal)][0], "finite numbers")
            object.__setattr__(self, "terminal", terminal)

    @classmethod
    def of(
        cls,
        models: LatentStatePOMDP | ModelDraws,
        schedule: str | Sequence[str],
        discount: float = 1.0,
        *,
        terminal: ArrayLike | None = None,
        weight: ArrayLike | None = None,
    ) -> Schedule:
        """A schedule from letters (``HRHRH``, H: the *human* may help) or names of modes.

        Parameters
        ----------
        models : LatentStatePOMDP or ModelDraws
        schedule : str or sequence of str
        discount : float
        terminal : float64[s], optional
        weight : float64[d], optional
            Other weights of the draws; non-negative, summing to one.
        """
        draws = ModelDraws.from_models([models]) if isinstance(models, LatentStatePOMDP) else models
        if weight is not None:
            draws = replace(draws, weight=np.asarray(weight, dtype=np.float64))
        end = None if terminal is None else np.asarray(terminal, dtype=np.float64)
        return cls(draws, schedule_modes(draws.protocol, schedule), float(discount), end)

    @property
    def sentence(self) -> str:
        """What is planned for, in one sentence."""
        n, draws = self.n_events, self.draws.n_draws
        end = "" if self.terminal is None else ", the state after them rewarded"
        return (
            f"{n} event{'s' * (n != 1)} {self.letters} under {draws:,} model{'s' * (draws != 1)} with "
            f"{self.n_states} states (protocol {self.protocol.name}), discount {self.discount:g}{end}."
        )

    # -- sizes and names ---------------------------------------------------------------------------
    @property
    def protocol(self) -> Protocol:
        """The protocol of the models."""
        return self.draws.protocol

    @property
    def n_events(self) -> int:
        """Number of rounds, the paper's `K`."""
        return len(self.modes)

    @property
    def n_states(self) -> int:
        """Number of latent states."""
        return self.draws.n_states

    @property
    def letters(self) -> str:
        """The schedule in letters."""
        return "".join(self.mode(k).letter for k in range(self.n_events))

    def mode(self, k: int) -> Mode:
        """Mode of an event."""
        return self.protocol.modes[self.modes[k]]

    def first_action(self, k: int) -> int:
        """Number of the event's first action among all of the protocol."""
        return self.protocol.mode_of_action.index(self.modes[k])

    def n_outcomes(self, k: int) -> int:
        """Responses that an event may show; 1 where it shows none."""
        return self.protocol.n_responses if self.mode(k).shows_response else 1

    @cached_property
    def reward(self) -> Array:
        """Reward of every action in every state, shape ``[a, s]``."""
        return (self.draws.reward or Reward(default_x(self.n_states))).table(self.protocol)

    @property
    def cautions(self) -> tuple[str, ...]:
        """Why not to trust the draws (`models.cautions`)."""
        return self.draws.cautions

    @property
    def unit(self) -> str:
        """What values and costs are in: the word of the draws' reward."""
        return self.draws.reward.unit if self.draws.reward is not None else UNIT

    @property
    def costs(self) -> Array:
        """Cost of every action in `unit`, shape ``[a]``."""
        own = (self.draws.reward or Reward(default_x(self.n_states))).costs
        return np.array([own.get(a, self.protocol.costs[a]) for a in self.protocol.action_names])

    # -- histories ---------------------------------------------------------------------------------
    def start(self) -> Array:
        r""":math:`P(\text{draw}, s_0)`, shape ``[d, s]``."""
        return self.draws.weight[:, None] * self.draws.initial

    def after(self, joint: Array, action: int, outcome: int | None) -> Array:
        r"""Joint vector ``[d, s]`` after one more event, not discounted; `outcome` None: not recorded."""
        row = self.protocol.emission_index[action]
        if row >= 0 and outcome is not None:
            joint = joint * self.draws.emission[:, row, :, outcome]
        return np.asarray(np.matmul(joint[:, None, :], self.draws.transition[:, action])[:, 0, :])

    def read(self, history: Iterable[Event]) -> list[tuple[int, int | None]]:
        """A history as numbers: action within its mode, and response.

        Raises
        ------
        InputError
            On an action that the event does not offer, a response where none shows, one that is unknown, or more
            events than the schedule has.
        """
        out: list[tuple[int, int | None]] = []
        for k, (action, response) in enumerate(history):
            place = f"history, event {k + 1}"
            if k >= self.n_events:
                raise located(place, Phrase(f"{action}"), f"no more than {self.n_events} events")
            names = [a.name for a in self.mode(k).actions]
            if action not in names:
                raise located(f"{place}, action", action, f"one of {', '.join(names)}")
            if response is not None and not self.mode(k).shows_response:
                raise located(f"{place}, response", response, "None: the mode shows no response")
            if response is not None and response not in self.protocol.response_names:
                raise located(f"{place}, response", response, f"one of {', '.join(self.protocol.response_names)}")
            seen = None if response is None else self.protocol.response_names.index(response)
            out.append((names.index(action), seen))
        return out

    def joint_after(self, history: Iterable[Event]) -> tuple[Array, int]:
        r""":math:`P(\text{history}, \text{draw}, s_k)`, shape ``[d, s]``, and the number of events passed.

        Raises
        ------
        InputError
            As `read`, and where the history has probability zero.
        """
        joint, k = self.start(), 0
        for choice, response in self.read(history):
            joint = self.after(joint, self.first_action(k) + choice, response)
            if joint.sum() <= 0:
                raise InputError(
                    f"history, event {k + 1}: this response has probability zero there under every model"
                )
            k += 1
        return joint, k

    def rest(self, k: int, joint: Array) -> Schedule:
        """What is left from an event on, started from the draws and states of a joint vector."""
        mass = joint.sum(axis=1)
        share = np.divide(joint, mass[:, None], out=self.draws.initial.copy(), where=mass[:, None] > 0)
        share /= share.sum(axis=1, keepdims=True)
        draws = replace(self.draws, initial=share, weight=mass / mass.sum())
        return replace(self, draws=draws, modes=self.modes[k:])
