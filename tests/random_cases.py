"""Random protocols, designs and models for property tests: hypothesis draws the sizes, a seed the numbers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from models.histories import HistoryTree
from models.protocol import Action, Mode, Protocol, Response

Run = list[tuple[int, int]]


@dataclass(frozen=True)
class Case:
    """A protocol, some runs under it and one model."""

    protocol: Protocol
    runs: list[Run]
    initial: NDArray
    transition: NDArray
    emission: NDArray

    @property
    def tables(self):
        return self.initial, self.transition, self.emission

    @property
    def index(self):
        return np.array(self.protocol.emission_index, dtype=np.int64)

    @property
    def n_states(self):
        return len(self.initial)

    def tree(self, runs: list[Run] | None = None) -> HistoryTree:
        return tree_of(self.runs if runs is None else runs, self.protocol)


def tree_of(runs: list[Run], protocol: Protocol) -> HistoryTree:
    offsets = np.cumsum([0, *map(len, runs)]).astype(np.int64)
    codes = np.array([event for run in runs for event in run], dtype=np.int8).reshape(-1, 2)
    action, response = np.ascontiguousarray(codes.T)
    return HistoryTree.build(offsets, action, response, protocol.n_actions, protocol.n_responses)


def make_protocol(shows: list[bool], n_actions: list[int], n_responses: int) -> Protocol:
    modes = []
    for i, (show, n) in enumerate(zip(shows, n_actions, strict=True)):
        actions = tuple(Action(f"act{i}{j}", float(j)) for j in range(n))
        modes.append(Mode(f"mode{i}", "ABC"[i], actions, actions[0].name, show))
    return Protocol("random", tuple(modes), tuple(Response(f"r{o}", float(o)) for o in range(n_responses)))


@st.composite
def protocols(draw) -> Protocol:
    n_modes = draw(st.integers(1, 3))
    shows = draw(st.lists(st.booleans(), min_size=n_modes, max_size=n_modes).filter(any))
    n_actions = draw(st.lists(st.integers(1, 3), min_size=n_modes, max_size=n_modes))
    return make_protocol(shows, n_actions, draw(st.integers(2, 3)))


def random_run(rng: np.random.Generator, protocol: Protocol, length: int, missing: float) -> Run:
    run = []
    for a in rng.integers(protocol.n_actions, size=length):
        seen = protocol.emission_index[a] >= 0 and rng.random() >= missing
        run.append((int(a), int(rng.integers(protocol.n_responses)) if seen else -1))
    return run


def random_tables(rng: np.random.Generator, protocol: Protocol, n_states: int, zeros: float = 0.0):
    """Dirichlet tables; a share of entries is exactly zero (never a whole row)."""

    def rows(*shape: int) -> NDArray:
        table = rng.dirichlet(np.full(shape[-1], 1.5), size=shape[:-1])
        if zeros:
            keep = table.max(axis=-1, keepdims=True) == table
            table = np.where(keep | (rng.random(shape) >= zeros), table, 0.0)
        return table / table.sum(axis=-1, keepdims=True)

    n, e = protocol.n_actions, len(protocol.emission_actions)
    return rows(n_states), rows(n, n_states, n_states), rows(e, n_states, protocol.n_responses)


@st.composite
def cases(
    draw, *, max_states: int = 5, max_length: int = 7, max_paths: int = 3000, max_runs: int = 12, zeros: float = 0.0
) -> Case:
    """Runs have at most `max_paths` state paths each, so that they can be enumerated."""
    protocol = draw(protocols())
    n_states = draw(st.integers(1, max_states))
    longest = max_length
    while n_states**longest > max_paths:
        longest -= 1
    lengths = draw(st.lists(st.integers(1, longest), min_size=1, max_size=max_runs))
    missing = draw(st.sampled_from([0.0, 0.3]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    runs = [random_run(rng, protocol, k, missing) for k in lengths]
    return Case(protocol, runs, *random_tables(rng, protocol, n_states, zeros))
