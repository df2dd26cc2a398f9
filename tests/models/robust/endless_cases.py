"""Small batches and random controllers without horizon."""

from __future__ import annotations

from functools import cache

import numpy as np
from hypothesis import strategies as st

from models.model_draws import ModelDraws
from models.planning.batch import BatchSolution, solve_draws
from models.planning.latent import LatentBatch
from models.planning.mode_process import mode_table
from models.robust.controllers import Controller
from tests.planning_cases import mode_processes, sticky_draws
from tests.random_cases import protocols, random_tables


@cache
def solved(count: int = 24, states: int = 3, kind: str = "alternating", discount: float = 0.9) -> BatchSolution:
    """Some people whose states last, all solved."""
    draws = sticky_draws(count, 5, states)
    weight = np.random.default_rng(1).dirichlet(np.ones(count))
    draws = ModelDraws(draws.protocol, draws.initial, draws.transition, draws.emission, weight,
                       {}, draws.state_names, draws.reward)  # fmt: skip
    return solve_draws(LatentBatch(draws, mode_processes()[kind], discount), 1e-3, threads=1)


@st.composite
def batches(draw) -> LatentBatch:
    """Draws under random protocols, modes moving by random tables, some entries zero."""
    protocol = draw(protocols())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, states = draw(st.integers(1, 5)), draw(st.integers(1, 4))
    tables = [random_tables(rng, protocol, states, zeros=0.2) for _ in range(n)]
    stacked = [np.stack(t) for t in zip(*tables, strict=True)]
    modes = len(protocol.modes)
    kernel = rng.dirichlet(np.full(modes, 0.7), modes)
    kernel[kernel < 0.1] = 0
    process = mode_table(protocol, kernel / kernel.sum(axis=1, keepdims=True))
    draws = ModelDraws(protocol, *stacked, rng.dirichlet(np.ones(n)))
    return LatentBatch(draws, process, draw(st.sampled_from([0.0, 0.5, 0.95])))


def random_controller(batch: LatentBatch, rng: np.random.Generator, nodes: int, mixed: float = 0.3) -> Controller:
    """Any controller of a batch; some nodes leave the action to chance, some are alike."""
    t, modes = batch.template, len(batch.draws.protocol.modes)
    offered, outcomes = np.diff(t.mode_choice), np.diff(t.choice_outcome)
    mode = np.concatenate([np.arange(modes), rng.integers(modes, size=nodes)])
    share = np.zeros((len(mode), offered.max()))
    follow = np.full((len(mode), offered.max(), outcomes.max()), -1, dtype=np.int32)
    for i, x in enumerate(mode):
        n = offered[x]
        if rng.random() < mixed:
            share[i, :n] = rng.dirichlet(np.ones(n))
        else:
            share[i, rng.integers(n)] = 1
        for c in np.flatnonzero(share[i]):
            number = t.mode_choice[x] + c
            for z in range(outcomes[number]):
                after = t.outcome_mode[t.choice_outcome[number] + z]
                follow[i, c, z] = rng.choice(np.flatnonzero(mode == after))
    start = np.where(batch.process.start > 0, np.arange(modes), -1)
    return Controller(mode, share, follow, start, "random")


def doubled(controller: Controller, rng: np.random.Generator) -> Controller:
    """The same behaviour with every node twice, in another order, followers picked among the twins."""
    n = controller.n_nodes
    place = rng.permutation(2 * n)
    which = np.argsort(place) % n
    follow = controller.follow[which]
    twin = np.stack([place[:n], place[n:]])
    chosen = twin[rng.integers(2, size=follow.shape), np.maximum(follow, 0)]
    start = np.where(controller.start >= 0, twin[1, np.maximum(controller.start, 0)], -1)
    return Controller(
        controller.mode[which], controller.share[which], np.where(follow >= 0, chosen, -1).astype(np.int32), start,
        "doubled",
    )  # fmt: skip
