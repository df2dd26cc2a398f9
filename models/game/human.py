"""A simulated person: collects with less precision than the robot, and helps where willing.

Whether the person is willing is given from outside: it is the one thing that the latent state decides. The rest is
speed, tokens that are not the nearest, lapses of attention, and how long it takes to notice that the robot is
trapped, which a signal shortens. Nothing of this is printed in the paper.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from models.compiled import kernel
from models.game.chance import check_seed, mixed, random_below
from models.game.parameters import SETTING, share_of
from models.game.state import ACTS, HUMAN, ROBOT, TICK, TRAP_TICK, TRAPPED
from models.game.walker import DRAWS, OWN, SEED, Walker, start_walking, take_turn

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from models.game.round import Round

_WILLING = OWN
_NOTICES = OWN + 1
"""Tick at which the trapped robot is noticed, -1 before that is known."""
HUMAN_MEMORY = OWN + 2

_STREAM = np.uint64(0x706572736F6E0001)
"""Keeps the person's luck apart from other uses of a round's seed."""


@kernel(_nrt=False)
def start_human(memory, willing, seed):  # type: ignore[no-untyped-def]
    """Make the memory of a person at the start of a round."""
    start_walking(memory)
    memory[SEED] = np.int64(mixed(np.uint64(seed) ^ _STREAM))
    memory[_WILLING] = 1 if willing else 0
    memory[_NOTICES] = -1


@kernel(_nrt=False)
def human_move(state, cells, rooms, settings, memory, goals, path, scratch):  # type: ignore[no-untyped-def]
    """Choose the person's move of this tick; to be called once a tick."""
    helps = False
    if state[TRAPPED] == ROBOT and memory[_WILLING] == 1:
        if memory[_NOTICES] < 0:
            memory[_NOTICES] = state[TRAP_TICK] + _delay(state, settings, memory)
        helps = state[TICK] >= memory[_NOTICES]
    return take_turn(
        state, cells, rooms, memory, HUMAN, helps, settings[SETTING.human_lapse],
        settings[SETTING.human_lapse_ticks], settings[SETTING.human_wander], goals, path, scratch,
    )  # fmt: skip


@kernel(_nrt=False)
def _delay(state, settings, memory):  # type: ignore[no-untyped-def]
    """Ticks from the trap until a willing person sets off."""
    delay = settings[SETTING.human_notice_ticks]
    delay += random_below(memory, SEED, DRAWS, settings[SETTING.human_notice_spread] + 1)
    if state[ACTS] == 1:
        delay = share_of(delay, settings[SETTING.signal_notice_share])
    return delay


class HumanPlayer(Walker):
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
        super().__init__(HUMAN_MEMORY)

    def _begin(self, game: Round) -> None:
        start_human(self._memory, self.willing, np.uint64(game.seed if self.seed is None else self.seed))

    def _choose(self, *given: NDArray[np.integer]) -> int:
        return int(human_move(*given))
