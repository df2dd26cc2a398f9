"""Controllers by name for a pool: the paper's baselines, that of an estimate, any policy as a controller."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from models.errors import Phrase, located
from models.lspomdp import LatentStatePOMDP
from models.planning.arrays import ProblemArrays
from models.planning.baselines import baselines
from models.planning.belief_policy import BeliefMemory
from models.planning.latent import LatentBatch, latent_problem
from models.planning.policies import Policy, Vocabulary
from models.planning.solver import solve
from models.robust.controllers import Controller, of_graph

MEMORIES, NODES = 2_000, 100
"""Memories that a policy may get into, and nodes of its controller, before beliefs are merged more coarsely."""

MERGED = (1e-6, 1e-4, 1e-3, 1e-2, 3e-2, 1e-1)
"""Beliefs that differ by less than about that are taken for one, the first of these that leaves few enough."""

CLOSE = 1e-3
"""A controller whose beliefs were merged more coarsely than that says so in its name."""


def model_controller(
    batch: LatentBatch, model: LatentStatePOMDP, name: str, precision: float = 1e-4, *, time_limit: float = 60.0
) -> Controller:
    """The controller of one model's solution, such as an estimate plugged in.

    Parameters
    ----------
    batch : LatentBatch
        Its modes and discount are used.
    model : LatentStatePOMDP
    name : str
    precision : float
        Relative gap at which solving stops.
    time_limit : float
        Seconds after which it stops with the best so far.

    Raises
    ------
    InputError
        If the model has another protocol or another number of states.
    """
    draws = batch.draws
    if model.protocol != draws.protocol or model.n_states != draws.n_states:
        found = Phrase(f"{model.n_states} states, protocol {model.protocol.name!r}")
        raise located(f"model {name}", found, f"{draws.n_states} states, protocol {draws.protocol.name!r}")
    solution = solve(latent_problem(model, batch.process, batch.discount), precision, time_limit=time_limit)
    start = np.full(len(batch.process.start), -1)
    for x in np.flatnonzero(batch.process.start > 0):
        own = np.flatnonzero(solution.mode == x)
        start[x] = own[np.argmax(solution.alpha[own] @ model.initial)]
    return of_graph(batch.template, solution.mode, solution.choice, solution.follow, start, name)


def baseline_controllers(batch: LatentBatch, model: LatentStatePOMDP) -> dict[str, Controller]:
    """Always, never, myopic, reactive and random as controllers; the myopic one with its belief by `model`.

    The belief of the myopic policy is merged with those next to it (`policy_controller`).
    """
    controllers = [policy_controller(batch, policy) for policy in baselines(model)]
    return {c.name: c for c in controllers}


def policy_controller(batch: LatentBatch, policy: Policy) -> Controller:
    """Any policy as a controller.

    A memory that is a belief has no end of values: beliefs that round to the same numbers are taken for the one
    that was met first. The controller is then a policy of its own, close to the one it was made of; what it is
    worth is exact. Where numbers had to be rounded to more than 0.001, its name says so.

    Parameters
    ----------
    batch : LatentBatch
    policy : Policy
        With the modes, actions and observations of the batch.

    Raises
    ------
    InputError
        If names differ, or there are too many memories however they are merged.
    """
    words = Vocabulary.of(batch.draws.protocol)
    if policy.vocabulary != words:
        raise located(f"policy {policy.name}, modes, actions and observations", policy.vocabulary, str(words))
    for merged in MERGED:
        found = _explored(batch, policy, merged)
        if found is not None:
            small = found.compact()
            if small.n_nodes <= NODES:
                coarse = "" if merged <= CLOSE else f" (beliefs to {merged:g})"
                return replace(small, name=f"{policy.name}{coarse}")
    found_words = Phrase(f"more than {MEMORIES} memories or {NODES} nodes")
    raise located(f"policy {policy.name}", found_words, "a policy with fewer, to become a controller")


def _explored(batch: LatentBatch, policy: Policy, merged: float) -> Controller | None:
    """All memories that the policy can get into from where the batch starts; None if there are too many."""
    t: ProblemArrays = batch.template
    numbers: dict[Any, int] = {}
    memories: list[Any] = []

    def number(memory: Any) -> int:
        key = memory
        if isinstance(memory, BeliefMemory):
            key = (memory.mode, np.round(memory.belief / merged).astype(np.int64).tobytes())
        if key not in numbers:
            numbers[key] = len(memories)
            memories.append(memory)
        return numbers[key]

    start = np.full(len(batch.process.start), -1)
    for first in np.flatnonzero(batch.process.start > 0).tolist():
        start[first] = number(policy.begin(first))
    offered = int(np.diff(t.mode_choice).max())
    width = int(np.diff(t.choice_outcome).max())
    modes: list[int] = []
    shares, follows = [], []
    while len(modes) < len(memories):
        if len(memories) > MEMORIES:
            return None
        memory = memories[len(modes)]
        x = policy.mode_of(memory)
        share, follow = np.zeros(offered), np.full((offered, width), -1, dtype=np.int32)
        own = policy.probabilities(memory)
        share[: len(own)] = own
        for c in np.flatnonzero(share):
            begin, end = t.choice_outcome[t.mode_choice[x] + c :][:2]
            for z in range(begin, end):
                after = policy.observe(memory, int(c), int(t.outcome_observation[z]), int(t.outcome_mode[z]))
                follow[c, z - begin] = number(after)
        modes.append(x)
        shares.append(share)
        follows.append(follow)
    return Controller(np.array(modes), np.stack(shares), np.stack(follows), start, policy.name)
