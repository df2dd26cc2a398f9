"""Many whole rounds at once: robot and simulated people play, compiled and in threads."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from models.compiled import kernel
from models.errors import Phrase, located
from models.game.human import HUMAN_MEMORY, human_move, start_human
from models.game.layout import Layout
from models.game.parameters import SETTING, TICKS_A_SECOND, GameParameters
from models.game.robot import ROBOT_MEMORY, robot_move
from models.game.route import route_scratch
from models.game.rules import advance, begin
from models.game.state import COUNT, FREED_TICK, GROUP_SIZE, HUMAN, ROBOT, SIZE, TRAP_TICK
from models.game.walker import INTERRUPTED, start_walking

PORTION = 500
"""Rounds that a thread plays before it looks for more, so that an interrupt is heard soon."""

_OUTCOMES = 6


@dataclass(frozen=True)
class RoundOutcomes:
    """What came of many rounds; all arrays have one entry a round.

    Attributes
    ----------
    trapped : int8
        Whom the round named: 0 human, 1 robot.
    acts, willing : bool
        As given.
    human_tokens, robot_tokens : int32
        Tokens collected.
    trapped_tick, freed_tick : int32
        Tenths of a second; -1 where nobody was trapped or freed.
    robot_interruption_ticks, human_interruption_ticks : int32
        Ticks in which a player was trapped, or on its way to help and out of that room again.
    """

    trapped: NDArray[np.int8]
    acts: NDArray[np.bool_]
    willing: NDArray[np.bool_]
    human_tokens: NDArray[np.int32]
    robot_tokens: NDArray[np.int32]
    trapped_tick: NDArray[np.int32]
    freed_tick: NDArray[np.int32]
    robot_interruption_ticks: NDArray[np.int32]
    human_interruption_ticks: NDArray[np.int32]

    def __len__(self) -> int:
        return len(self.trapped)

    @property
    def helped(self) -> NDArray[np.bool_]:
        """Whether the trapped player was freed: where the robot was trapped, the response that is seen."""
        return self.freed_tick >= 0

    @property
    def team_tokens(self) -> NDArray[np.int32]:
        """Tokens of both."""
        return self.human_tokens + self.robot_tokens

    @property
    def unseen_willingness(self) -> NDArray[np.bool_]:
        """Rounds in which a willing person did not free the robot: too late, or the robot never got trapped.

        Their response is `no_help`, since that is what was seen.
        """
        return (self.trapped == ROBOT) & self.willing & ~self.helped

    @property
    def sentence(self) -> str:
        """What was played, and whether the rounds were long enough for what was to happen in them."""
        waited = (self.freed_tick - self.trapped_tick)[self.helped] / TICKS_A_SECOND
        missed = int(self.unseen_willingness.sum())
        never = int((self.trapped_tick < 0).sum())
        text = f"{len(self)} rounds"
        if len(self):
            text += f" with {self.team_tokens.mean():.1f} tokens a round"
        text += f"; {int(self.helped.sum())} players freed"
        if len(waited):
            text += f", {waited.mean():.1f} s after the trap in the mean and {waited.max():.1f} s at most"
        if missed:
            text += f"; {missed} willing people did not get to help before the round was over"
        if never:
            text += f"; in {never} rounds nobody got trapped"
        return text + "."

    def some(self, which: NDArray[np.bool_] | NDArray[np.integer] | slice) -> RoundOutcomes:
        """Some of the rounds."""
        return RoundOutcomes(*(getattr(self, entry.name)[which] for entry in fields(self)))


def play_rounds(
    layout: Layout,
    parameters: GameParameters,
    trapped: ArrayLike,
    acts: ArrayLike,
    willing: ArrayLike,
    seed: ArrayLike,
    threads: int | None = None,
) -> RoundOutcomes:
    """Play rounds with the robot and simulated people.

    A round is a function of its own entries: neither the others nor the threads matter.

    Parameters
    ----------
    layout : Layout
    parameters : GameParameters
    trapped : int[n]
        Whom each round traps: 0 human, 1 robot.
    acts : bool[n]
        Whether the robot helps (human trapped) or signals (robot trapped).
    willing : bool[n]
        Whether the person would help in this round; without meaning where the human is trapped.
    seed : uint64[n]
        Of token places, and of the person's wandering, lapses and delays. One number may stand for all rounds in
        any of the four.
    threads : int, optional
        As many as there are processors by default.

    Raises
    ------
    InputError
        On entries that are no players, no truth values, no seeds, or of different lengths.

    Examples
    --------
    >>> from models.game.layout import packaged
    >>> played = play_rounds(packaged(), GameParameters(), [0, 1, 1], True, [False, True, False], [7, 8, 9])
    >>> played.helped.tolist()
    [True, True, False]
    """
    if threads is not None and threads < 1:
        raise located("rounds, threads", threads, "at least 1")
    named = _whole("trapped", trapped, 1, "0 (human) or 1 (robot)")
    flags = [_whole(name, given, 1, "true or false") for name, given in (("acts", acts), ("willing", willing))]
    seeds = _whole("seed", seed, 2**64 - 1, "a whole number from 0 to 2^64 - 1")
    columns = [named, *flags, seeds]
    lengths = {len(column) for column in columns if column.ndim}
    if len(lengths) > 1:
        raise located("rounds", Phrase(f"entries of lengths {', '.join(map(str, sorted(lengths)))}"), "one length")
    n = lengths.pop() if lengths else 1
    named, helping, would, seeds = (np.ascontiguousarray(np.broadcast_to(column, n)) for column in columns)
    out = np.zeros((n, _OUTCOMES), dtype=np.int32)

    def play(first: int) -> None:
        part = slice(first, first + PORTION)
        _play(
            layout.cells, layout.rooms, parameters.settings, layout.starts, named[part], helping[part], would[part],
            seeds[part], out[part], *_room_to_play(layout),
        )  # fmt: skip

    workers = threads or os.cpu_count() or 1
    if workers == 1 or n <= PORTION:
        for first in range(0, n, PORTION):
            play(first)
    else:
        with ThreadPoolExecutor(workers) as pool:
            futures = [pool.submit(play, first) for first in range(0, n, PORTION)]
            try:
                for future in futures:
                    future.result()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    columns_out = (np.ascontiguousarray(out[:, i]) for i in range(_OUTCOMES))
    return RoundOutcomes(named.astype(np.int8), helping.astype(np.bool_), would.astype(np.bool_), *columns_out)


def _whole(name: str, given: ArrayLike, most: int, wanted: str) -> NDArray[np.uint64]:
    """Check entries and give them the type that kernels want; zero dimensions stay as they are."""
    values = np.asarray(given)
    if values.dtype.kind == "f" and not isinstance(given, np.ndarray):
        # numpy takes whole numbers above 2^63 among smaller ones for floats.
        values = np.asarray(given, dtype=object)
    if values.ndim > 1:
        raise located(f"rounds, {name}", Phrase(f"{values.ndim} dimensions"), "one")
    if values.dtype == object:
        whole = all(isinstance(v, int | np.integer) and not isinstance(v, bool) for v in values.ravel().tolist())
    else:
        whole = values.dtype.kind in "biu" or values.size == 0
    if not whole:
        raise located(f"rounds, {name}", Phrase(f"values of type {np.asarray(given).dtype}"), wanted)
    wrong = np.flatnonzero((values < 0) | (values > most)) if values.dtype.kind != "b" else np.zeros(0, dtype=int)
    if len(wrong):
        raise located(f"rounds, {name}, entry {wrong[0]}", values.ravel()[wrong[0]], wanted)
    return values.astype(np.uint64)


def _room_to_play(layout: Layout) -> tuple[NDArray[np.integer], ...]:
    """State, memories of both, goals, paths of both, scratch."""
    whole = [np.zeros(n, dtype=np.int64) for n in (SIZE, HUMAN_MEMORY, ROBOT_MEMORY, GROUP_SIZE)]
    paths = [np.zeros(len(layout.cells), dtype=np.int32) for _ in range(2)]
    return (*whole, *paths, route_scratch(layout))


@kernel(_nrt=False)
def _play(  # type: ignore[no-untyped-def]
    cells, rooms, settings, starts, named, acts, willing, seeds, out, state, human_memory, robot_memory, goals,
    human_path, robot_path, scratch,
):  # fmt: skip
    for i in range(len(named)):
        begin(state, rooms, settings, starts, np.int64(named[i]), acts[i] == 1, seeds[i])
        start_walking(robot_memory)
        start_human(human_memory, willing[i] == 1, seeds[i])
        for _ in range(settings[SETTING.round_ticks]):
            human = human_move(state, cells, rooms, settings, human_memory, goals, human_path, scratch)
            robot = robot_move(state, cells, rooms, settings, robot_memory, goals, robot_path, scratch)
            advance(state, cells, rooms, settings, human, robot)
        out[i, 0] = state[COUNT + HUMAN]
        out[i, 1] = state[COUNT + ROBOT]
        out[i, 2] = state[TRAP_TICK]
        out[i, 3] = state[FREED_TICK]
        out[i, 4] = robot_memory[INTERRUPTED]
        out[i, 5] = human_memory[INTERRUPTED]
