"""One round of the token game to be played move by move, by anybody.

The state is an array that only the rules change; everything else here is a view of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.game.chance import LARGEST_SEED, check_seed
from models.game.layout import Cell, Layout, packaged
from models.game.parameters import TICKS_A_SECOND, GameParameters
from models.game.rules import advance, begin
from models.game.state import COUNT, FREED_TICK, MOVES, PLAYERS, ROBOT, SIZE, TICK, TRAP_TICK, GameState, readable

__all__ = ["LARGEST_SEED", "Round"]


class Round:
    """A round in play.

    Parameters
    ----------
    layout : Layout, optional
        `packaged()` by default.
    parameters : GameParameters, optional
    trapped : str
        Whom this round traps, ``"human"`` or ``"robot"``: the mode `human_needs_help` or `robot_needs_help`.
    acts : bool
        Whether the robot helps (human trapped) or signals (robot trapped).
    seed : int
        From 0 to 2^64 - 1; of where tokens appear.

    Attributes
    ----------
    array : int64[SIZE]
        The state as the rules keep it (`models.game.state`); not to be written to.

    Raises
    ------
    InputError
        On a player or seed that does not exist, or if `acts` is no truth value.

    Examples
    --------
    >>> game = Round(trapped="robot", acts=True, seed=1)
    >>> game.step("right")
    >>> game.tick, game.human, game.doors[0]
    (1, (1, 2), ((4, 6), 'red'))
    """

    def __init__(
        self,
        layout: Layout | None = None,
        parameters: GameParameters | None = None,
        trapped: str = "robot",
        acts: bool = True,
        seed: int = 1,
    ) -> None:
        if trapped not in PLAYERS:
            raise located("round, trapped", trapped, f"one of {', '.join(PLAYERS)}")
        if not isinstance(acts, bool | np.bool_):
            raise located("round, acts", acts, "true or false")
        self.layout = packaged() if layout is None else layout
        self.parameters = GameParameters() if parameters is None else parameters
        self.named, self.acts, self.seed = trapped, bool(acts), check_seed(seed, "round, seed")
        self.array: NDArray[np.int64] = np.zeros(SIZE, dtype=np.int64)
        self._inputs: list[int] = []
        begin(
            self.array, self.layout.rooms, self.parameters.settings, self.layout.starts, PLAYERS.index(trapped),
            self.acts, np.uint64(self.seed),
        )  # fmt: skip

    # -- play --------------------------------------------------------------------------------------
    def step(self, human: int | str = 0, robot: int | str = 0) -> None:
        """Play one tick.

        A move that is not possible (a wall, a door of the other's colour, too soon after the last step) is a stay.

        Parameters
        ----------
        human, robot : int or str
            0 stay, 1 up, 2 down, 3 left, 4 right, or these words.

        Raises
        ------
        InputError
            On another move, or if the round is over.
        """
        if self.done:
            raise located("round, tick", self.tick, f"none after the round's {self.parameters.round_ticks}")
        moves = _move("human", human), _move("robot", robot)
        advance(self.array, self.layout.cells, self.layout.rooms, self.parameters.settings, *moves)
        self._inputs.append(len(MOVES) * moves[0] + moves[1])

    # -- views -------------------------------------------------------------------------------------
    @property
    def inputs(self) -> NDArray[np.int8]:
        """Moves of both so far, ``[tick, player]``: with the other arguments, all that a replay needs."""
        both = np.array(self._inputs, dtype=np.int8).reshape(-1, 1)
        return np.hstack(np.divmod(both, np.int8(len(MOVES))))

    @property
    def view(self) -> GameState:
        """Everything there is to see, as named fields."""
        return readable(self.array, self.layout, self.parameters.round_ticks)

    @property
    def tick(self) -> int:
        """Ticks played."""
        return int(self.array[TICK])

    @property
    def seconds_left(self) -> float:
        """Seconds until the round is over."""
        return (self.parameters.round_ticks - self.tick) / TICKS_A_SECOND

    @property
    def done(self) -> bool:
        """Whether the round is over."""
        return self.tick >= self.parameters.round_ticks

    @property
    def human(self) -> Cell:
        """Row and column of the human."""
        return self.view.human

    @property
    def robot(self) -> Cell:
        """Row and column of the robot."""
        return self.view.robot

    @property
    def doors(self) -> tuple[tuple[Cell, str], ...]:
        """Cell and present colour of every door."""
        return self.view.doors

    @property
    def tokens(self) -> dict[str, tuple[Cell, ...]]:
        """Tokens on the floor, by owner."""
        view = self.view
        return {"human": view.human_tokens, "robot": view.robot_tokens}

    @property
    def collected(self) -> dict[str, int]:
        """Tokens collected, by player."""
        return {player: int(self.array[COUNT + i]) for i, player in enumerate(PLAYERS)}

    @property
    def trapped(self) -> str | None:
        """Who is trapped now."""
        return self.view.trapped

    @property
    def flashing_room(self) -> int | None:
        """The room that flashes now."""
        return self.view.flashing_room

    @property
    def helped(self) -> bool:
        """Whether the trapped player has been freed."""
        return bool(self.array[FREED_TICK] >= 0)

    @property
    def response(self) -> str:
        """What an event log says of the round so far; ``none`` where the human was named."""
        if self.named != PLAYERS[ROBOT]:
            return "none"
        return "help" if self.helped else "no_help"

    @property
    def sprung(self) -> bool:
        """Whether the trap has happened."""
        return bool(self.array[TRAP_TICK] >= 0)

    def __repr__(self) -> str:
        view = self.view
        return (
            f"Round({self.layout.name!r}, {self.named} trapped, {'acts' if self.acts else 'acts not'}, "
            f"seed {self.seed}: tick {view.tick} of {self.parameters.round_ticks}, "
            f"tokens {view.human_collected} + {view.robot_collected})"
        )


def _move(player: str, move: int | str) -> int:
    if isinstance(move, str):
        if move in MOVES:
            return MOVES.index(move)
    elif isinstance(move, int | np.integer) and not isinstance(move, bool) and 0 <= move < len(MOVES):
        return int(move)
    raise located(f"move of the {player}", move, f"0 to {len(MOVES) - 1}, or one of {', '.join(MOVES)}")
