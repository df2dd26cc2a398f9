"""The rounds of study 2: people who change by the truth, robots that act on what they believe, and the game."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.histories import UNSEEN
from models.lspomdp import LatentStatePOMDP
from models.planning.belief_model import BeliefModel
from models.planning.mode_process import schedule_modes
from models.planning.policies import Policy
from models.protocol import Protocol

Array = NDArray[np.float64]
Index = NDArray[np.int64]

HUMAN_TRAPPED, ROBOT_TRAPPED = 0, 1
"""Whom a round of the game traps, as `models.game.rounds.play_rounds` counts them."""


class World:
    """How people change and when they help, and the game that they play."""

    def __init__(
        self, truth: LatentStatePOMDP, letters: str, layout: Any, parameters: Any, threads: int | None
    ) -> None:
        from models.game.layout import packaged
        from models.game.parameters import GameParameters

        self.truth, self.threads = truth, threads
        self.layout = packaged() if layout is None else layout
        self.parameters = GameParameters() if parameters is None else parameters
        self.modes = schedule_modes(truth.protocol, letters)
        self.trapped = traps(letters, truth.protocol)
        self.moved = np.cumsum(truth.transition, axis=-1)
        best = int(np.argmax(truth.protocol.scores))
        self.helps = truth.emission[:, :, best]
        self.responses = np.array([int(np.argmin(truth.protocol.scores)), best], dtype=np.int8)


class People:
    """All people of the study, round by round."""

    def __init__(self, world: World, rounds: int, n: int, rng: np.random.Generator) -> None:
        self.world = world
        # Every number is drawn beforehand, so that people have the same luck whatever the robot does.
        self.luck_moved, self.luck_willing = rng.random((rounds + 1, n)), rng.random((rounds, n))
        self.action = np.zeros((n, rounds), dtype=np.int8)
        self.response = np.full((n, rounds), UNSEEN, dtype=np.int8)
        self.human, self.robot = (np.zeros((n, rounds), dtype=np.int64) for _ in range(2))
        self.willing = np.zeros((n, rounds), dtype=bool)
        self.state = np.zeros((n, rounds + 1), dtype=np.int64)
        self.state[:, 0] = _drawn(np.cumsum(world.truth.initial)[None], self.luck_moved[0])

    def play(self, k: int, choice: Index, rng: np.random.Generator) -> Index:
        """Play a round with everybody; what the robot observes: 0 where nothing shows, else 1 + response."""
        from models.game.rounds import play_rounds

        world, n = self.world, len(choice)
        mode = world.truth.protocol.modes[world.modes[k]]
        action = world.truth.protocol.mode_of_action.index(world.modes[k]) + choice
        names = [a.name for a in mode.actions]
        acts = choice != names.index(mode.null_action)
        row = world.truth.emission_index[action]
        shows = world.trapped[k] == ROBOT_TRAPPED
        if shows:
            self.willing[:, k] = self.luck_willing[k] < world.helps[row, self.state[:, k]]
        outcome = play_rounds(
            world.layout, world.parameters, np.full(n, world.trapped[k]), acts, self.willing[:, k],
            rng.integers(2**64, size=n, dtype=np.uint64), threads=world.threads,
        )  # fmt: skip
        self.action[:, k] = action
        self.human[:, k], self.robot[:, k] = outcome.human_tokens, outcome.robot_tokens
        if shows:
            self.response[:, k] = world.responses[np.asarray(outcome.helped, dtype=np.int64)]
        self.state[:, k + 1] = _drawn(world.moved[action, self.state[:, k]], self.luck_moved[k + 1])
        return np.asarray(self.response[:, k] + 1 if shows else np.zeros(n), dtype=np.int64)


class Robot:
    """One policy with all its people, and the belief by the robot's model."""

    def __init__(self, policy: Policy, model: LatentStatePOMDP, people: Index, modes: tuple[int, ...]) -> None:
        self.policy, self.people, self.modes = policy, people, modes
        self.tracker = BeliefModel.of_latent(model, impossible="keep")
        self.memories = policy.begin_many(np.full(len(people), modes[0], dtype=np.int64))
        self.belief = np.zeros((len(people), len(modes) + 1, model.n_states))
        self.belief[:, 0] = model.initial

    def choose(self, chance: Array) -> Index:
        """What to do with everybody, counted within the mode."""
        share = self.policy.probabilities_many(self.memories)
        # The last action with any probability takes what rounding leaves of the sum.
        top = share.shape[1] - 1 - np.argmax(share[:, ::-1] > 0, axis=1)
        return np.asarray(np.minimum((np.cumsum(share, axis=1) <= chance[:, None]).sum(axis=1), top))

    def observe(self, k: int, choice: Index, seen: Index) -> None:
        """What came of it."""
        self.belief[:, k + 1] = follow(self.tracker, self.modes, k, self.belief[:, k], choice, seen)
        if k + 1 < len(self.modes):
            after = np.full(len(choice), self.modes[k + 1], dtype=np.int64)
            self.memories = self.policy.observe_many(self.memories, choice, seen, after)


def follow(
    tracker: BeliefModel, modes: tuple[int, ...], k: int, belief: Array, choice: Index, seen: Index
) -> Array:  # fmt: skip
    """Beliefs ``[person, s]`` after round k, from those before it.

    Parameters
    ----------
    tracker : BeliefModel
        Of a robot's model.
    modes : tuple of int
        Of all rounds.
    k : int
    belief : float64[person, s]
    choice : int64[person]
        What the robot did, counted within the mode.
    seen : int64[person]
        0 in rounds that show nothing, else the response and 1.
    """
    mode, following = modes[k], modes[min(k + 1, len(modes) - 1)]
    out = np.empty_like(belief)
    for c, o in np.unique(np.stack([choice, seen], axis=1), axis=0):
        own = np.flatnonzero((choice == c) & (seen == o))
        out[own] = tracker.update_many(mode, belief[own], int(c), int(o), following)
    return out


def traps(letters: str, protocol: Protocol) -> Index:
    """Whom each round traps: the robot where the human's response shows."""
    shows = [protocol.modes[m].shows_response for m in schedule_modes(protocol, letters)]
    return np.where(shows, ROBOT_TRAPPED, HUMAN_TRAPPED).astype(np.int64)


def _drawn(edges: Array, luck: Array) -> Index:
    """States drawn from rows of cumulative probabilities."""
    return np.asarray(np.minimum((edges <= luck[:, None]).sum(axis=1), edges.shape[-1] - 1))
