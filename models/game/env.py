"""The token game as an environment for agents that learn: a PettingZoo `ParallelEnv`.

Needs the optional packages of the extra ``game``. Everybody who does not ask for this module does without them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import Phrase, located
from models.game.chance import LARGEST_SEED
from models.game.env_views import PLANES, Views
from models.game.layout import Layout
from models.game.parameters import TICKS_A_SECOND, GameParameters
from models.game.render import Painter, as_text
from models.game.round import Round
from models.game.state import MOVES, PLAYERS

try:
    from gymnasium import spaces
    from pettingzoo import ParallelEnv  # type: ignore[import-untyped]
except ImportError as error:  # pragma: no cover - the test environment has them; a test hides them in a new process
    raise located(
        "models.game.env", Phrase(f"no package {error.name}"), "the optional packages of the extra 'game'"
    ) from None

Observation = dict[str, NDArray]

REWARDS = ("own", "team")
RENDER_MODES = ("rgb_array", "ansi")

MODES = {"human": "human_needs_help", "robot": "robot_needs_help"}
"""What an event log calls a round, by whom it traps."""

_IGNORED = "options"
"""PettingZoo's conformance test passes an option of this name and wants it to be accepted."""


class TokenGame(ParallelEnv):
    """Two players collect tokens in four rooms; each round traps one of them, whom only the other can free.

    **Agents**: ``human`` and ``robot``. They move at once. Whoever is to be played by the project's own players is
    asked through `round`; see the example.

    **Actions**, ``Discrete(5)`` for both: 0 stay, 1 up, 2 down, 3 left, 4 right. A player steps once in so many
    ticks (`GameParameters`); until then, and towards walls and doors of the other's colour, a move is a stay. There
    is no action for the rest of the game: tokens are collected by standing on them, and *help* is to enter the room
    in which the other is trapped. Whether the robot *signals* is, as in the paper, its choice for the round, not
    for a tick: the argument or option `acts`.

    **Observations**, a ``Dict`` for both. Players see the whole map, the other, and the clock. What is one's own
    comes first everywhere, so one policy can play either.

    =============== ============================ ==============================================================
    key             space                        meaning
    =============== ============================ ==============================================================
    ``planes``      Box 0..1, int8,              one plane a kind of thing: walls; doors that let oneself pass
                    (9, height, width)           now; that let the other; oneself; the other; own tokens; the
                                                 other's; inside of the room with somebody trapped; of the one that
                                                 flashes (`models.game.env_views.PLANES`)
    ``time_left``   Box 0..1, float32, (1,)      share of the round that is left
    ``wait``        Box, int32, (2,)             ticks until oneself, the other may step again
    ``collected``   Box, int32, (2,)             tokens collected by oneself, by the other
    ``trapped``     MultiBinary(2)               whether oneself, the other is trapped
    ``action_mask`` Box 0..1, int8, (5,)         moves that lead somewhere; any action is allowed nevertheless
    =============== ============================ ==============================================================

    **Rewards**: tokens collected in this step, by the agent itself (``reward="own"``) or by both (``"team"``).
    Helping costs what is not collected meanwhile, and nothing else.

    **End**: after `GameParameters.round_ticks` ticks both agents *terminate*: a round is that long, the clock is
    seen, and nothing is worth anything afterwards. Nothing is ever truncated.

    **Infos**, the same for both: `mode` (``human_needs_help`` or ``robot_needs_help``), `acts`, `round_seed`,
    `tick`, `trapped` (``human``, ``robot``, or None: now), `sprung` (whether the trap has happened), `helped`, and
    `response`, what an event log would say. They are for who evaluates, not for agents: people are not told the
    mode beforehand.

    **Start**: map and starts are fixed. The seed decides where tokens appear and, where they are not given, who is
    trapped and whether the robot acts (each with probability one half). The same seed gives the same rounds;
    without one, `reset` goes on with the random numbers of the last.

    Parameters
    ----------
    layout : Layout, optional
        The packaged map by default.
    parameters : GameParameters, optional
    trapped : str, optional
        Whom every round traps, ``"human"`` or ``"robot"``; drawn for each by default. An option of the same name
        decides for one round.
    acts : bool, optional
        Whether the robot signals where it is trapped; drawn by default. Where the human is trapped no rule depends
        on it, but the project's own `RobotPlayer` helps if it is true. Also an option.
    reward : str
        ``"own"`` or ``"team"``.
    ticks_a_step : int
        Every action is repeated for so many ticks of a tenth of a second.
    render_mode : str, optional
        ``"rgb_array"`` (uint8, ``[height, width, 3]``) or ``"ansi"`` (text).
    seed : int
        Of the first `reset` that is not given one.

    Attributes
    ----------
    round : Round or None
        The round in play.

    Raises
    ------
    InputError
        On unusable arguments, options or actions, and on a step before the first reset.

    Examples
    --------
    A robot of the project's own, and a person who presses keys at random:

    >>> from models.game.robot import RobotPlayer
    >>> env, robot = TokenGame(trapped="human", acts=True), RobotPlayer()
    >>> observations, infos = env.reset(seed=1)
    >>> tokens = 0.0
    >>> _ = env.action_space("human").seed(1)
    >>> while env.agents:
    ...     keys = env.action_space("human").sample(mask=observations["human"]["action_mask"])
    ...     actions = {"human": keys, "robot": robot.move(env.round)}
    ...     observations, rewards, terminations, truncations, infos = env.step(actions)
    ...     tokens += rewards["robot"]
    >>> infos["robot"]["mode"], tokens == env.round.collected["robot"] > 10
    ('human_needs_help', True)
    """

    metadata: dict[str, Any] = {  # noqa: RUF012 - PettingZoo's, of the class and of every environment
        "name": "token_game_v0",
        "render_modes": list(RENDER_MODES),
        "render_fps": TICKS_A_SECOND,
        "is_parallelizable": True,
    }

    def __init__(
        self,
        layout: Layout | None = None,
        parameters: GameParameters | None = None,
        *,
        trapped: str | None = None,
        acts: bool | None = None,
        reward: str = "own",
        ticks_a_step: int = 1,
        render_mode: str | None = None,
        seed: int = 1,
    ) -> None:
        self.parameters = GameParameters() if parameters is None else parameters
        self.layout = Round(layout).layout
        if reward not in REWARDS:
            raise located("token game, reward", reward, f"one of {', '.join(REWARDS)}")
        if isinstance(ticks_a_step, bool) or not isinstance(ticks_a_step, int) or ticks_a_step < 1:
            raise located("token game, ticks_a_step", ticks_a_step, "a whole number, at least 1")
        if render_mode is not None and render_mode not in RENDER_MODES:
            raise located("token game, render_mode", render_mode, f"one of {', '.join(RENDER_MODES)}, or None")
        self.trapped, self.acts = _whom("argument", trapped), _whether("argument", acts)
        self.reward, self.ticks_a_step, self.render_mode = reward, ticks_a_step, render_mode
        self.metadata = type(self).metadata | {"render_fps": TICKS_A_SECOND / ticks_a_step}
        self.possible_agents = list(PLAYERS)
        self.agents: list[str] = []
        self.round: Round | None = None
        self._views = Views(self.layout, self.parameters.round_ticks)
        self._luck = _luck(seed)
        self._painter: Painter | None = None
        self.action_spaces = {agent: spaces.Discrete(len(MOVES)) for agent in PLAYERS}
        self.observation_spaces = {agent: self._observation_space() for agent in PLAYERS}

    def _observation_space(self) -> spaces.Dict:
        ticks = self.parameters.round_ticks
        wait = max(self.parameters.human_step_ticks, self.parameters.robot_step_ticks)
        shape = (len(PLANES), self.layout.height, self.layout.width)
        return spaces.Dict(
            {
                "planes": spaces.Box(0, 1, shape, np.int8),
                "time_left": spaces.Box(0, 1, (1,), np.float32),
                "wait": spaces.Box(0, wait, (2,), np.int32),
                "collected": spaces.Box(0, ticks, (2,), np.int32),
                "trapped": spaces.MultiBinary(2),
                "action_mask": spaces.Box(0, 1, (len(MOVES),), np.int8),
            }
        )

    def observation_space(self, agent: str) -> spaces.Dict:
        """Return the space of an agent's observations, always the same object."""
        return self.observation_spaces[agent]

    def action_space(self, agent: str) -> spaces.Discrete:
        """Return the space of an agent's actions, always the same object."""
        return self.action_spaces[agent]

    # -- play --------------------------------------------------------------------------------------
    def reset(
        self, seed: int | None = None, options: Mapping[str, Any] | None = None
    ) -> tuple[dict[str, Observation], dict[str, dict[str, Any]]]:
        """Begin a round.

        Parameters
        ----------
        seed : int, optional
        options : mapping, optional
            `trapped`, `acts` and `round_seed` (the seed of `Round`) decide for this round what would be drawn.

        Returns
        -------
        observations, infos : dict by agent
        """
        if seed is not None:
            self._luck = _luck(seed)
        given = {name: value for name, value in (options or {}).items() if name != _IGNORED}
        for name in given:
            if name not in ("trapped", "acts", "round_seed"):
                raise located("token game, option", name, "one of trapped, acts, round_seed")
        # All three are drawn whatever is given, so that an option leaves the later rounds alone.
        drawn_seed = int(self._luck.integers(0, LARGEST_SEED, dtype=np.uint64, endpoint=True))
        drawn_trapped, drawn_acts = PLAYERS[self._luck.integers(2)], bool(self._luck.integers(2))
        trapped = _whom("option", given.get("trapped")) or self.trapped or drawn_trapped
        acts = next(a for a in (_whether("option", given.get("acts")), self.acts, drawn_acts) if a is not None)
        self.round = Round(self.layout, self.parameters, trapped, acts, given.get("round_seed", drawn_seed))
        self.agents = list(self.possible_agents)
        return self._observations(self.round), self._infos(self.round)

    def step(
        self, actions: Mapping[str, int]
    ) -> tuple[
        dict[str, Observation], dict[str, float], dict[str, bool], dict[str, bool], dict[str, dict[str, Any]]
    ]:
        """Move both players and let `ticks_a_step` ticks pass, or as many as are left.

        Returns
        -------
        observations, rewards, terminations, truncations, infos : dict by agent
            Empty once the round is over.
        """
        game = self._playing("step")
        if not self.agents:
            return {}, {}, {}, {}, {}
        for agent in actions:
            if agent not in self.agents:
                raise located("token game, actions", agent, f"only {' and '.join(self.agents)}")
        for agent in self.agents:
            if agent not in actions:
                raise located("token game, actions", Phrase(f"none of the {agent}"), "one of each player")
        before = game.collected
        for _ in range(self.ticks_a_step):
            game.step(actions["human"], actions["robot"])
            if game.done:
                break
        found = {agent: float(count - before[agent]) for agent, count in game.collected.items()}
        if self.reward == "team":
            found = dict.fromkeys(found, sum(found.values()))
        if game.done:
            self.agents = []
        return (
            self._observations(game), found, dict.fromkeys(PLAYERS, game.done), dict.fromkeys(PLAYERS, False),
            self._infos(game),
        )  # fmt: skip

    def _playing(self, what: str) -> Round:
        if self.round is None:
            raise located(f"token game, {what}", Phrase("no round"), "reset() first")
        return self.round

    def _observations(self, game: Round) -> dict[str, Observation]:
        return {agent: self._views.observation(game.array, i) for i, agent in enumerate(PLAYERS)}

    def _infos(self, game: Round) -> dict[str, dict[str, Any]]:
        info = {
            "mode": MODES[game.named], "acts": game.acts, "round_seed": game.seed, "tick": game.tick,
            "trapped": game.trapped, "sprung": game.sprung, "helped": game.helped, "response": game.response,
        }  # fmt: skip
        return {agent: dict(info) for agent in PLAYERS}

    # -- views -------------------------------------------------------------------------------------
    def state(self) -> NDArray[np.float32]:
        """Return all there is to see as one vector: the human's observation, flattened in the order of its keys.

        Not the whole state of the rules: the seed, which knows where tokens will appear, is left out.
        """
        seen = self._views.observation(self._playing("state").array, 0)
        return np.concatenate([seen[key].ravel() for key in sorted(seen)]).astype(np.float32)

    def render(self) -> NDArray[np.uint8] | str | None:
        """Return the present tick as the render mode says; None without one."""
        if self.render_mode is None:
            return None
        game = self._playing("render")
        if self.render_mode == "ansi":
            return as_text(game.view, self.layout, self.parameters.round_ticks)
        if self._painter is None:
            self._painter = Painter(self.layout, self.parameters.round_ticks)
        return self._painter.frame(game.view)

    def close(self) -> None:
        """Nothing is held open."""


def _luck(seed: int) -> np.random.Generator:
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or seed < 0:
        raise located("token game, seed", seed, "a whole number, at least 0")
    return np.random.default_rng(np.random.SeedSequence(int(seed), spawn_key=(0,)))


def _whom(kind: str, trapped: object) -> str | None:
    if trapped is not None and trapped not in PLAYERS:
        raise located(f"token game, {kind} trapped", trapped, f"one of {', '.join(PLAYERS)}")
    return trapped


def _whether(kind: str, acts: object) -> bool | None:
    if acts is not None and not isinstance(acts, bool | np.bool_):
        raise located(f"token game, {kind} acts", acts, "true or false")
    return None if acts is None else bool(acts)
