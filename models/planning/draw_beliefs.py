r"""Beliefs over which draw is true and the state the person is in, in plain numpy.

Draws share the robot's actions and nothing else, so a belief over both moves draw by draw:

.. math:: b'(i, s') \propto \sum_s b(i, s)\, O_i(o \mid s, a)\, T_i(s' \mid s, a)

and the weight of a draw is its posterior probability after what was seen. Arrays have the draws last, ``[s, d]``:
the innermost loops then run over neighbours in memory.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import InputError, Phrase, located
from models.lspomdp import default_state_names
from models.model_draws import ModelDraws
from models.planning.belief_check import IMPOSSIBLE
from models.planning.policies import Vocabulary
from models.protocol import Protocol
from models.reward import UNIT, Reward, default_x

Array = NDArray[np.float64]


@dataclass(frozen=True)
class DrawBeliefs:
    """Models that may be true, laid out for moving beliefs over them.

    Attributes
    ----------
    draws : ModelDraws
    impossible : {"error", "keep", "reset"}
        What to do about a response of probability zero in every draw: raise, ignore it, or start anew.
    """

    draws: ModelDraws
    impossible: str = "error"

    def __post_init__(self) -> None:
        if self.impossible not in ("error", "keep", "reset"):
            raise located("impossible observations", self.impossible, "error, keep or reset")

    @cached_property
    def vocabulary(self) -> Vocabulary:
        """Names of what can be done and seen."""
        return Vocabulary.of(self.draws.protocol)

    @cached_property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states."""
        return self.draws.state_names or default_state_names(self.draws.n_states)

    @cached_property
    def start(self) -> Array:
        """Belief before anything has happened, shape ``[s, d]``."""
        return _fixed((self.draws.weight[:, None] * self.draws.initial).T)

    @cached_property
    def rewards(self) -> tuple[Array, ...]:
        """Reward of the choices of each mode, ``[c, s]``."""
        table = (self.draws.reward or Reward(default_x(self.draws.n_states))).table(self.draws.protocol)
        first = self._first
        return tuple(table[first[m] : first[m + 1]] for m in range(len(first) - 1))

    @cached_property
    def _first(self) -> list[int]:
        return [0, *np.cumsum([len(m.actions) for m in self.draws.protocol.modes]).tolist()]

    def outcomes(self, mode: int) -> int:
        """Responses that a mode may show; 1 where it shows none."""
        protocol = self.draws.protocol
        return protocol.n_responses if protocol.modes[mode].shows_response else 1

    @cached_property
    def joint(self) -> tuple[Array, ...]:
        r""":math:`O(o \mid s, a) T(s' \mid s, a)` of the choices of each mode, shape ``[s, c, o, s', d]``."""
        draws, protocol = self.draws, self.draws.protocol
        out = []
        for m, mode in enumerate(protocol.modes):
            tables = []
            for a in range(self._first[m], self._first[m + 1]):
                row = protocol.emission_index[a]
                shown = (
                    np.ones((*draws.initial.shape, 1))
                    if row < 0 or not mode.shows_response
                    else draws.emission[:, row]
                )
                tables.append(np.einsum("dso,dst->sotd", shown, draws.transition[:, a]))
            out.append(np.ascontiguousarray(np.stack(tables, axis=1)))
        return tuple(out)

    # -- moving on ---------------------------------------------------------------------------------
    def ahead(self, mode: int, belief: Array) -> Array:
        """Unnormalised beliefs after every choice and response, ``[z, s', d]`` with z = choice * responses + o."""
        table = self.joint[mode]
        s, d = belief.shape
        return np.einsum("sd,skd->kd", belief, table.reshape(s, -1, d)).reshape(-1, s, d)

    def ahead_many(self, mode: int, beliefs: Array) -> Array:
        """The same of many beliefs ``[n, s, d]``, shape ``[n, z, s', d]``."""
        table = self.joint[mode]
        n, s, d = beliefs.shape
        if d == 1:
            return (beliefs[..., 0] @ table.reshape(s, -1)).reshape(n, -1, s, 1)
        return np.einsum("nsd,skd->nkd", beliefs, table.reshape(s, -1, d)).reshape(n, -1, s, d)

    def seen(self, mode: int, observation: int | None) -> int | None:
        """Number of the response in an observation of a mode: None if it was not recorded.

        Raises
        ------
        InputError
            If a response shows where none can, or none where one must.
        """
        if observation is None:
            return None
        shows = self.draws.protocol.modes[mode].shows_response
        if shows != (observation > 0):
            words = self.vocabulary
            wanted = "a response, or None: not recorded" if shows else f"{words.observations[0]}: it shows none"
            raise located(f"observation in mode {words.modes[mode]}", words.observations[observation], wanted)
        return observation - 1 if shows else 0

    def moved(self, mode: int, belief: Array, choice: int, observation: int | None) -> Array:
        """Belief ``[s, d]`` after a step, summing to one.

        Raises
        ------
        InputError
            On an observation that cannot be, or one of probability zero in all draws if `impossible` is ``error``.
        """
        o = self.seen(mode, observation)
        table = self.joint[mode][:, choice]
        if o is not None:
            out = np.einsum("sd,std->td", belief, table[:, o])
            total = out.sum()
            if total > IMPOSSIBLE:
                return _fixed(out / total)
            if self.impossible == "error":
                words = self.vocabulary
                raise InputError(
                    f"observation {words.observations[observation or 0]!r}: has probability zero after "
                    f"{words.actions[mode][choice]!r} in mode {words.modes[mode]!r} in every draw; choose "
                    "impossible='keep' or 'reset' to go on"
                )
            if self.impossible == "reset":
                return self.start
        out = np.einsum("sd,sotd->td", belief, table)
        return _fixed(out / out.sum())

    # -- files -------------------------------------------------------------------------------------
    def to_dict(self) -> dict[str, Any]:
        """Plain content, for files."""
        d = self.draws
        reward = d.reward or Reward(default_x(d.n_states))
        return {
            "protocol": d.protocol.to_dict(), "states": list(self.state_names),
            "reward": {
                "x": list(reward.x), "r": reward.r, "costs": dict(reward.costs),
                **({} if reward.unit == UNIT else {"unit": reward.unit}),
            },
            "weight": d.weight.tolist(), "initial": d.initial.tolist(), "transition": d.transition.tolist(),
            "emission": d.emission.tolist(), "impossible": self.impossible,
        }  # fmt: skip


def draw_beliefs(place: str, content: Any) -> DrawBeliefs:
    """Read what `DrawBeliefs.to_dict` wrote, everything checked.

    Raises
    ------
    InputError
        Names the entry, what was found and what was wanted.
    """
    if not isinstance(content, Mapping):
        raise located(place, Phrase(type(content).__name__), "an object")
    own = content.get("protocol")
    if not isinstance(own, Mapping):
        raise located(f"{place}, protocol", own, "an object")
    protocol = Protocol.from_dict(own, f"{place}, protocol")
    states = content.get("states")
    if not isinstance(states, list) or not states or not all(isinstance(s, str) for s in states):
        raise located(f"{place}, states", states, "a list of state names")
    if len(set(states)) != len(states):
        raise located(f"{place}, states", states, "different names")
    tables = {
        key: _table(f"{place}, {key}", content.get(key), ndim)
        for key, ndim in (("weight", 1), ("initial", 2), ("transition", 4), ("emission", 4))
    }
    if tables["initial"].shape[1] != len(states):
        raise located(f"{place}, initial, states", tables["initial"].shape[1], f"{len(states)}")
    given = content.get("reward")
    if not isinstance(given, Mapping) or not isinstance(given.get("costs"), Mapping):
        raise located(f"{place}, reward", given, "an object with x, r and costs")
    x = _table(f"{place}, reward, x", given.get("x"), 1)
    if len(x) != len(states):
        raise located(f"{place}, reward, x", len(x), f"{len(states)} numbers, one a state")
    costs = {}
    for name, cost in given["costs"].items():
        protocol.action(name)
        costs[name] = float(_table(f"{place}, reward, cost of {name}", cost, 0))
    reward = Reward(
        tuple(x.tolist()), float(_table(f"{place}, reward, r", given.get("r"), 0)), costs, given.get("unit", UNIT)
    )
    draws = ModelDraws(protocol, tables["initial"], tables["transition"], tables["emission"], tables["weight"],
                       {"source": place}, tuple(states), reward)  # fmt: skip
    return DrawBeliefs(draws, content.get("impossible", "error"))


def _table(place: str, value: Any, ndim: int) -> Array:
    wanted = "a number" if ndim == 0 else f"numbers, {ndim} levels of lists of equal length"
    if value is None or isinstance(value, bool | str):
        raise located(place, value, wanted)
    try:
        given = np.asarray(value)
    except ValueError:
        raise located(place, Phrase("lists of unequal length"), wanted) from None
    if given.dtype.kind not in "iuf":
        raise located(place, value, wanted)
    out = given.astype(np.float64)
    if out.ndim != ndim or not np.isfinite(out).all():
        raise located(place, Phrase(f"shape {out.shape}" if out.ndim != ndim else "numbers not finite"), wanted)
    return out


def _fixed(belief: Array) -> Array:
    out = np.ascontiguousarray(belief)
    out.setflags(write=False)
    return out
