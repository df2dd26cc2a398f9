r"""Study 2, simulated: people and a robot play whole rounds of the token game, round after round.

Every round is a closed loop. The robot acts by its policy, which knows what the robot has learned and seen. The
person's hidden state :math:`s_k` moves by the *truth*, and willingness to help is drawn from the truth's emission
row of that state and action. Then the round is played in the game (`models.game`), and the response that the robot
sees is what happened in it: whether the person entered the room while the robot was trapped. So the robot is as
wrong about people as its learning makes it, and tokens are an outcome of the game, no number attached to a state.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from analysis.policy_study import STUDY2
from analysis.study2_policies import Learned, PolicySet
from analysis.study2_rounds import ROBOT_TRAPPED, People, Robot, World, traps
from models.errors import Phrase, located
from models.events import EventLog
from models.lspomdp import LatentStatePOMDP
from models.notebook_view import NotebookView, View, frame_rows
from models.planning.mode_process import schedule_modes
from models.protocol import PUBLISHED, Protocol

if TYPE_CHECKING:
    from models.game.layout import Layout
    from models.game.parameters import GameParameters

Array = NDArray[np.float64]
Index = NDArray[np.int64]

STUDY2_NAME = "simulated_study2"
PARTICIPANTS = 100

FEWEST = 2
"""People a policy: with one there is no variation between people of the same policy."""

_TASK = 102
"""First number of the spawn key of this module's random streams."""

_STREAMS = ("assignment", "people", "robot", "game")

Progress = Callable[[str, int, int], None]


@dataclass(frozen=True, eq=False)
class Study2(NotebookView):
    """One simulated study 2.

    Attributes
    ----------
    policies : tuple of str
    letters : str
        Of the rounds; H: the human may help, so the robot is trapped.
    truth, robot : LatentStatePOMDP
        What people are like, and what the robot believes they are like.
    policy : int64[person]
        Index into `policies`.
    action : int8[person, round]
        Number among the protocol's actions.
    response : int8[person, round]
        `models.histories.UNSEEN` in rounds that show none.
    human_tokens, robot_tokens : int64[person, round]
    state : int64[person, round + 1]
        True state before each round, and after the last.
    willing : bool[person, round]
        Whether the person would help; False in rounds that show no response.
    belief : float64[person, round + 1, s]
        The robot's belief before each round and after the last, by its own model, whatever its policy acts on.
    seed : int
    notes : tuple of str
        What must be known of the policies.
    """

    policies: tuple[str, ...]
    letters: str
    truth: LatentStatePOMDP
    robot: LatentStatePOMDP
    policy: Index
    action: NDArray[np.int8]
    response: NDArray[np.int8]
    human_tokens: Index
    robot_tokens: Index
    state: Index
    willing: NDArray[np.bool_]
    belief: Array
    seed: int
    notes: tuple[str, ...] = field(default=())

    # -- sizes -------------------------------------------------------------------------------------
    @property
    def n_people(self) -> int:
        """Number of people."""
        return len(self.policy)

    @property
    def n_rounds(self) -> int:
        """Rounds a person."""
        return self.action.shape[1]

    @property
    def protocol(self) -> Protocol:
        """The protocol of the truth."""
        return self.truth.protocol

    @cached_property
    def shows(self) -> Index:
        """Rounds that show a response: the robot is trapped in them."""
        return np.flatnonzero(traps(self.letters, self.protocol) == ROBOT_TRAPPED)

    def of(self, policy: str) -> Index:
        """People of a policy."""
        return np.flatnonzero(self.policy == self.policies.index(policy))

    def some(self, people: Index, policies: tuple[str, ...]) -> Study2:
        """Part of the people, under the policies named: a study of its own.

        Parameters
        ----------
        people : int64[n]
            All of them under one of `policies`.
        policies : tuple of str
            In the order wanted.
        """
        place = np.array([policies.index(p) if p in policies else -1 for p in self.policies])
        kept = place[self.policy[people]]
        if np.any(kept < 0):
            gone = self.policies[int(self.policy[people][np.argmin(kept)])]
            raise located("people, policy", gone, f"one of {', '.join(policies)}")
        parts = {name: getattr(self, name)[people] for name in _BY_PERSON}
        return Study2(
            policies, self.letters, self.truth, self.robot, kept, seed=self.seed, notes=self.notes, **parts
        )

    # -- outcomes ----------------------------------------------------------------------------------
    @cached_property
    def team(self) -> Array:
        """Tokens of both in each round, ``[person, round]``."""
        return np.asarray(self.human_tokens + self.robot_tokens, dtype=np.float64)

    @cached_property
    def cumulative(self) -> Array:
        """Tokens of both up to and with each round, ``[person, round]``."""
        return np.cumsum(self.team, axis=1)

    @cached_property
    def helped(self) -> Array:
        """Whether the person helped, 0 or 1, in rounds that show it, ``[person, shown round]``."""
        best = int(np.argmax(self.protocol.scores))
        return np.asarray(self.response[:, self.shows] == best, dtype=np.float64)

    @cached_property
    def believed_state(self) -> Array:
        """Expected index of the state by the robot's belief after each round, ``[person, round]``."""
        return np.asarray(self.belief[:, 1:] @ np.arange(self.belief.shape[2]))

    @property
    def believed_top(self) -> Array:
        """The robot's probability of the most prosocial state after each round, ``[person, round]``."""
        return self.belief[:, 1:, -1]

    @cached_property
    def costly(self) -> Array:
        """Actions other than the null action of their mode, a person, ``[person]``."""
        null = [self.protocol.action(m.null_action) for m in self.protocol.modes]
        return np.asarray((~np.isin(self.action, null)).sum(axis=1), dtype=np.float64)

    @cached_property
    def reward(self) -> Array:
        """Sum of the rounds' rewards by the true states, the truth's reward, not discounted, ``[person]``."""
        return np.asarray(self.truth.reward_table()[self.action, self.state[:, :-1]].sum(axis=1))

    @property
    def missed(self) -> int:
        """Times that a willing person did not reach the robot before the round was over."""
        return int((self.willing[:, self.shows] & (self.helped == 0)).sum())

    # -- as data -----------------------------------------------------------------------------------
    @cached_property
    def log(self) -> EventLog:
        """The study as an event log with token columns; the condition is the policy."""
        n, k = self.action.shape
        names = tuple(sorted(self.policies[p] for p in np.unique(self.policy)))
        condition = np.array([names.index(p) if p in names else -1 for p in self.policies], dtype=np.int32)
        tokens = {
            "team_tokens": self.team, "human_tokens": self.human_tokens, "robot_tokens": self.robot_tokens
        }  # fmt: skip
        return EventLog(
            self.protocol, STUDY2_NAME, np.arange(n + 1, dtype=np.int64) * k, np.arange(1, n + 1),
            np.zeros(n, dtype=np.int64), condition[self.policy], names, self.action.ravel(), self.response.ravel(),
            {name: np.asarray(v, dtype=np.float64).ravel() for name, v in tokens.items()},
        )  # fmt: skip

    def _view(self) -> View:
        rows = []
        for name in self.policies:
            own = self.of(name)
            rows.append(
                {"policy": name, "people": len(own), "team": float(self.team[own].mean()),
                 "helped": float(self.helped[own].mean()), "costly": float(self.costly[own].mean())}
            )  # fmt: skip
        told = f"{self.n_people:,} simulated people under {len(self.policies)} policies, rounds {self.letters}."
        units = {"team": "tokens a round", "helped": "share", "costly": "costly actions a person"}
        return View("Study 2 in the game", "simulated", (), self.notes, (told,), (frame_rows(rows),), units)


_BY_PERSON = (
    "action", "response", "human_tokens", "robot_tokens", "state", "willing", "belief"
)  # fmt: skip


def run_study2(
    policies: PolicySet, truth: LatentStatePOMDP, learned: Learned, participants: int = PARTICIPANTS, *,
    letters: str = STUDY2, layout: Layout | None = None, parameters: GameParameters | None = None, seed: int = 1,
    threads: int | None = None, progress: Progress | None = None,
) -> Study2:  # fmt: skip
    """Simulate study 2.

    Policies have equally many people (the first ones have one more where that does not come out even), drawn at
    random. Streams are ``SeedSequence(seed, spawn_key=(task, index))``.

    Parameters
    ----------
    policies : PolicySet
        Of `analysis.study2_policies.make_policies`.
    truth : LatentStatePOMDP
        What people are like, under the published protocol.
    learned : Learned
        The model that the robot's belief is made with.
    participants : int
        At least `FEWEST` a policy.
    letters : str
        The rounds.
    layout, parameters : optional
        Of the game; the bundled map and the calibrated settings by default.
    seed : int
    threads : int, optional
        That the game plays rounds in. No result depends on it.
    progress : callable, optional
        Called with (what is running, rounds done, rounds in all).

    Raises
    ------
    InputError
        On too few people, a protocol other than the published one, or letters that are none.
    """
    check_study(participants, len(policies.policies), seed)
    for name, model in (("truth", truth), ("learned model", learned.model)):
        if model.protocol != PUBLISHED:
            raise located(f"{name}, protocol", model.protocol.name, "the published one, which the game plays")
    modes = schedule_modes(PUBLISHED, letters)
    rng = {name: _stream(seed, i) for i, name in enumerate(_STREAMS)}
    policy = rng["assignment"].permutation(np.arange(participants) % len(policies.policies))
    world = World(truth, letters, layout, parameters, threads)
    people = People(world, len(modes), participants, rng["people"])
    robots = [Robot(p, learned.model, np.flatnonzero(policy == i), modes) for i, p in enumerate(policies.policies)]
    for k in range(len(modes)):
        chance = rng["robot"].random(participants)
        choice = np.zeros(participants, dtype=np.int64)
        for robot in robots:
            choice[robot.people] = robot.choose(chance[robot.people])
        seen = people.play(k, choice, rng["game"])
        for robot in robots:
            robot.observe(k, choice[robot.people], seen[robot.people])
        if progress is not None:
            progress("rounds", k + 1, len(modes))
    belief = np.zeros((participants, len(modes) + 1, learned.model.n_states))
    for robot in robots:
        belief[robot.people] = robot.belief
    return Study2(
        policies.names, letters, truth, learned.model, policy, people.action, people.response, people.human,
        people.robot, people.state, people.willing, belief, seed, (*learned.notes, *policies.notes),
    )  # fmt: skip


def check_study(participants: int, policies: int, seed: int = 1) -> None:
    """Refuse a study with too few people, or a seed that is none, before anything is learned for it.

    Raises
    ------
    InputError
        Naming which.
    """
    if participants < FEWEST * policies:
        found = Phrase(f"{participants} under {policies} policies")
        raise located("participants", found, f"at least {FEWEST * policies}: {FEWEST} a policy")
    if seed < 0:
        raise located("seed", seed, "an integer of at least 0")


def _stream(seed: int, index: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(_TASK, index)))
