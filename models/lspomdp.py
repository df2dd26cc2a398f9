r"""The latent-state POMDP of human prosociality (Zahedi et al. 2026) with known tables.

Order of events in a round: the mode is known, the robot acts, the human responds from the *current* state,
:math:`o_k \sim O(\cdot \mid s_k, a_k)`, and only then the state moves, :math:`s_{k+1} \sim T(\cdot \mid s_k, a_k)`.
A textbook POMDP emits the observation from the next state instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from models.errors import InputError, located
from models.labels import canonical_order, permute
from models.notebook_view import NotebookView, View, frame_rows
from models.protocol import PUBLISHED, Protocol
from models.reward import Reward, default_x

Array = NDArray[np.float64]

ROW_TOLERANCE = 1e-9
PUBLISHED_STATE_NAMES = ("non-prosocial", "low-prosocial", "mid-prosocial", "high-prosocial")


def default_state_names(n: int) -> tuple[str, ...]:
    """The paper's names for four states, ``s0, s1, ...`` otherwise."""
    return PUBLISHED_STATE_NAMES if n == 4 else tuple(f"s{i}" for i in range(n))


@dataclass(frozen=True)
class LatentStatePOMDP(NotebookView):
    """Initial belief, transition and emission tables of one model under a protocol.

    Attributes
    ----------
    initial : float64[s]
        The paper's :math:`b_0`.
    transition : float64[a, s, s']
        The paper's `T`, actions in the protocol's order.
    emission : float64[e, s, o]
        The paper's `O`, for the actions of response-showing modes.
    protocol : Protocol
    state_names : tuple of str
    reward : Reward
    cautions : tuple of str
        Why not to trust it, such as a search that stopped before it converged. Plans made for the model repeat them
        (`models.cautions`).

    Raises
    ------
    InputError
        If a shape does not fit, an entry is negative or not finite, or a row does not sum to one within
        1e-9: the message names table, action and state.
    """

    initial: Array
    transition: Array
    emission: Array
    protocol: Protocol = PUBLISHED
    state_names: tuple[str, ...] = ()
    reward: Reward = field(default=None)  # type: ignore[assignment]
    cautions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("initial", "transition", "emission"):
            value = np.array(getattr(self, name), dtype=np.float64, order="C")
            value.setflags(write=False)
            object.__setattr__(self, name, value)
        n = len(self.initial) if self.initial.ndim == 1 else 0
        if n == 0:
            raise located("model, initial", self.initial.shape, "one probability a state")
        if not self.state_names:
            object.__setattr__(self, "state_names", default_state_names(n))
        if len(self.state_names) != n or len(set(self.state_names)) != n:
            raise located("model, state names", list(self.state_names), f"{n} different names")
        if self.reward is None:
            object.__setattr__(self, "reward", Reward(default_x(n)))
        if len(self.reward.x) != n:
            raise located("model, reward x", len(self.reward.x), f"{n} values, one a state")
        protocol = self.protocol
        wanted = {
            "transition": (protocol.n_actions, n, n),
            "emission": (len(protocol.emission_actions), n, protocol.n_responses),
        }
        for name, shape in wanted.items():
            if getattr(self, name).shape != shape:
                raise located(f"model, shape of {name}", getattr(self, name).shape, str(shape))
        check_rows("initial", self.initial[None], [()])
        for names, table, label in (
            (protocol.action_names, self.transition, "transition"),
            (protocol.emission_actions, self.emission, "emission"),
        ):
            rows = [(f"action {a}", f"state {s}") for a in names for s in self.state_names]
            check_rows(label, table.reshape(-1, table.shape[-1]), rows)

    # -- sizes -------------------------------------------------------------------------------------
    @property
    def n_states(self) -> int:
        """Number of latent states."""
        return len(self.initial)

    @cached_property
    def emission_index(self) -> NDArray[np.int64]:
        """Emission table of each action, -1 for silent modes; shape ``[a]``."""
        return np.asarray(self.protocol.emission_index, dtype=np.int64)

    # -- belief ------------------------------------------------------------------------------------
    def response_probability(self, belief: Array, action: str) -> Array:
        r"""Probability of each response, :math:`\sum_s b(s) O(o \mid s, a)`; shape ``[o]``."""
        row = self.protocol.emission_index[self.protocol.action(action)]
        if row < 0:
            raise located("response probability, action", action, "an action whose mode shows a response")
        return np.asarray(belief) @ self.emission[row]

    def update(
        self,
        belief: Array,
        action: str,
        response: str | None = None,
        *,
        impossible: Literal["error", "keep", "reset"] = "error",
    ) -> Array:
        r"""Belief after a round, :math:`b'(s') \propto \sum_s b(s) O(o \mid s, a) T(s' \mid s, a)`.

        Parameters
        ----------
        belief : float64[s]
        action : str
        response : str, optional
            Leave out in a silent mode, or where the response was not recorded.
        impossible : {"error", "keep", "reset"}
            What to do when the response has probability zero: raise, ignore the response, or ignore it
            and restart from the initial belief.

        Returns
        -------
        float64[s]
        """
        belief = np.asarray(belief, dtype=np.float64)
        if belief.shape != (self.n_states,):
            raise located("belief, shape", belief.shape, f"({self.n_states},)")
        check_rows("belief", belief[None], [()])
        a = self.protocol.action(action)
        weighted = belief
        if response is not None:
            row = self.protocol.emission_index[a]
            if row < 0:
                raise located(f"response after {action}", response, "none: its mode shows no response")
            if response not in self.protocol.response_names:
                raise located("response", response, f"one of {', '.join(self.protocol.response_names)}")
            weighted = belief * self.emission[row, :, self.protocol.response_names.index(response)]
        total = weighted.sum()
        if total <= 0:
            if impossible == "error":
                raise InputError(
                    f"response {response!r} after {action!r} has probability zero under this model and belief "
                    f"{np.round(belief, 4).tolist()}; pass impossible='keep' or 'reset' to go on"
                )
            weighted = belief if impossible == "keep" else self.initial
            total = weighted.sum()
        after = weighted @ self.transition[a] / total
        return np.asarray(after / after.sum())

    # -- variants ----------------------------------------------------------------------------------
    def reordered(self, order: Sequence[int] | NDArray[np.int64]) -> LatentStatePOMDP:
        """Same model with its states permuted; names and rewards stay with the *position*."""
        tables = permute(np.asarray(order, dtype=np.int64), self.initial, self.transition, self.emission)
        return replace(self, initial=tables[0], transition=tables[1], emission=tables[2])

    def canonical(self, weights: Array | None = None) -> LatentStatePOMDP:
        """Same model in canonical order of states (`models.labels`)."""
        return self.reordered(canonical_order(self.emission, self.protocol.scores, weights))

    def reward_table(self) -> Array:
        """Reward ``[a, s]``, in the reward's own unit."""
        return self.reward.table(self.protocol)

    def _view(self) -> View:
        p, names = self.protocol, self.state_names
        moves = [
            {"after": a, "from": s, **{f"to {t}": float(self.transition[i, j, k]) for k, t in enumerate(names)}}
            for i, a in enumerate(p.action_names) for j, s in enumerate(names)
        ]  # fmt: skip
        seen = [
            {"under": a, "state": s, **dict(zip(p.response_names, self.emission[i, j].tolist(), strict=True))}
            for i, a in enumerate(p.emission_actions) for j, s in enumerate(names)
        ]  # fmt: skip
        first = [{name: float(v) for name, v in zip(names, self.initial, strict=True)}]
        told = f"{self.n_states} states, protocol {p.name}; entries are probabilities."
        tables = (
            frame_rows(first, ".initial", "initial belief"), frame_rows(moves, ".transition", "moves of the state"),
            frame_rows(seen, ".emission", "responses"),
        )  # fmt: skip
        return View("Latent-state POMDP", "", (), (), (told,), tables)


def check_rows(table: str, rows: Array, names: Sequence[tuple[str, ...]]) -> None:
    """Refuse rows that are not probability vectors; `names` say where each row stands."""
    bad = ~np.all(np.isfinite(rows) & (rows >= 0), axis=-1) | (np.abs(rows.sum(axis=-1) - 1) > ROW_TOLERANCE)
    if not np.any(bad):
        return
    i = int(np.flatnonzero(bad)[0])
    place = ", ".join(("model, " + table, *names[i]))
    row = rows[i]
    if not np.all(np.isfinite(row)) or np.any(row < 0):
        raise located(place, [float(v) for v in row], "probabilities between 0 and 1")
    raise located(f"{place}, sum of the row", f"{row.sum():.10g}", "1 within 1e-9")
