"""A simulated person: collects with less precision than the robot, and helps where willing.

Whether the person is willing is given from outside: it is the one thing that the latent state decides. The rest is
speed, tokens that are not the nearest, lapses of attention, and how long it takes to notice that the robot is
trapped, which a signal shortens. Nothing of this is printed in the paper.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from models.compiled import kernel
from models.game.chance import check_seed, happens, mixed, random_below
from models.game.parameters import SETTING, share_of
from models.game.route import route_scratch
from models.game.state import ACTS, HUMAN, ROBOT, TICK, TRAP_TICK, TRAPPED, may_step
from models.game.walker import (
    COLLECTING,
    INTERRUPTED,
    OWN,
    PHASE,
    find_way,
    keep_phase,
    next_move,
    remaining,
    route_is_old,
    start_walking,
)

if TYPE_CHECKING:
    from models.game.round import Round

_SEED, _DRAWS = OWN, OWN + 1
_WILLING = OWN + 2
_NOTICES = OWN + 3
"""Tick at which the trapped robot is noticed, -1 before that is known."""
_PAUSES = OWN + 4
"""Tick until which attention has lapsed."""
HUMAN_MEMORY = OWN + 5

_STREAM = np.uint64(0x706572736F6E0001)
"""Keeps the person's luck apart from other uses of a round's seed."""


@kernel(_nrt=False)
def start_human(memory, willing, seed):  # type: ignore[no-untyped-def]
    """Make the memory of a person at the start of a round."""
    start_walking(memory)
    memory[_SEED] = np.int64(mixed(np.uint64(seed) ^ _STREAM))
    memory[_WILLING] = 1 if willing else 0
    memory[_NOTICES] = -1


@kernel(_nrt=False)
def human_move(state, cells, rooms, settings, memory, goals, path, scratch):  # type: ignore[no-untyped-def]
    """Choose the person's move of this tick; to be called once a tick."""
    tick = state[TICK]
    helps = False
    if state[TRAPPED] == ROBOT and memory[_WILLING] == 1:
        if memory[_NOTICES] < 0:
            memory[_NOTICES] = state[TRAP_TICK] + _delay(state, settings, memory)
        helps = tick >= memory[_NOTICES]
    keep_phase(state, memory, HUMAN, helps)
    if not may_step(state, HUMAN):
        return 0
    if memory[PHASE] == COLLECTING:
        if tick < memory[_PAUSES]:
            return 0
        if happens(memory, _SEED, _DRAWS, settings[SETTING.human_lapse]):
            memory[_PAUSES] = tick + settings[SETTING.human_lapse_ticks]
            return 0
    if route_is_old(state, memory, HUMAN):
        left = remaining(state, HUMAN, goals)
        if left > 1 and happens(memory, _SEED, _DRAWS, settings[SETTING.human_wander]):
            goals[0] = goals[random_below(memory, _SEED, _DRAWS, left)]
            left = 1
        find_way(state, cells, rooms, memory, HUMAN, goals, left, path, scratch)
    return next_move(state, cells, memory, HUMAN, path)


@kernel(_nrt=False)
def _delay(state, settings, memory):  # type: ignore[no-untyped-def]
    """Ticks from the trap until a willing person sets off."""
    delay = settings[SETTING.human_notice_ticks]
    delay += random_below(memory, _SEED, _DRAWS, settings[SETTING.human_notice_spread] + 1)
    if state[ACTS] == 1:
        delay = share_of(delay, settings[SETTING.signal_notice_share])
    return delay


class HumanPlayer:
    """A simulated person as a player of one `Round`, tick by tick.

    Parameters
    ----------
    willing : bool
        Whether the person helps a trapped robot.
    seed : int, optional
        Of wandering, lapses and delays; the round's by default.

    Raises
    ------
    InputError
        On a seed that does not exist.
    """

    def __init__(self, willing: bool = True, seed: int | None = None) -> None:
        if seed is not None:
            check_seed(seed, "simulated person, seed")
        self.willing, self.seed = willing, seed
        self._memory = np.zeros(HUMAN_MEMORY, dtype=np.int64)
        self._goals = np.zeros(3, dtype=np.int64)
        self._round: Round | None = None

    def move(self, game: Round) -> int:
        """Choose the move of this tick, 0 to 4; to be asked once a tick."""
        if self._round is not game:
            start_human(self._memory, self.willing, np.uint64(game.seed if self.seed is None else self.seed))
            self._path = np.zeros(len(game.layout.cells), dtype=np.int32)
            self._scratch = route_scratch(game.layout)
            self._round = game
        return int(
            human_move(
                game.array, game.layout.cells, game.layout.rooms, game.parameters.settings, self._memory,
                self._goals, self._path, self._scratch,
            )
        )  # fmt: skip

    @property
    def interruption_ticks(self) -> int:
        """Ticks so far in which the person was trapped or helping."""
        return int(self._memory[INTERRUPTED])
