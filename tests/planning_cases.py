"""Random planning problems of every kind the solvers know; a seed gives the numbers."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.latent import latent_problem
from models.planning.mode_process import ModeProcess, alternating, bernoulli, mode_table
from models.planning.problem import Branch, Choice, Problem, csr
from models.planning.textbook import textbook_problem
from models.protocol import PUBLISHED


def dense_problem(
    seed: int, n: int = 3, actions: int = 2, seen: int = 2, discount: float = 0.9, *, shift: float = 0.0
) -> Problem:
    """A textbook problem with full tables."""
    rng = np.random.default_rng(seed)
    return textbook_problem(
        rng.dirichlet(np.full(n, 0.6), size=(actions, n)), rng.dirichlet(np.full(seen, 0.6), size=(actions, n)),
        rng.normal(size=(actions, n)) + shift, discount, rng.dirichlet(np.ones(n)), name=f"dense {seed}",
    )  # fmt: skip


def sparse_problem(seed: int, n: int = 30, actions: int = 3, seen: int = 4, discount: float = 0.9) -> Problem:
    """A textbook problem where few states follow each state and show few observations."""
    rng = np.random.default_rng(seed)

    def rows(width: int, kept: int):
        table = np.zeros((actions, n, width))
        for a in range(actions):
            for s in range(n):
                table[a, s, rng.choice(width, kept, replace=False)] = rng.dirichlet(np.ones(kept))
        return table

    reward = rng.normal(size=(actions, n)) * (rng.random((actions, n)) < 0.3)
    return textbook_problem(rows(n, 3), rows(seen, 2), reward, discount, name=f"sparse {seed}")


def modal_problem(seed: int, sizes: Sequence[int] = (2, 3, 1), discount: float = 0.9) -> Problem:
    """Modes of different sizes, with different numbers of actions; every kind of branch occurs.

    A step may show its start state (two branches to one mode), its end state (an emission), both or neither; some
    tables have zeros, and the start is spread over two modes.
    """
    rng = np.random.default_rng(seed)
    modes = range(len(sizes))
    choices = []
    for x in modes:
        offered = []
        for a in range(int(rng.integers(1, 4))):
            targets = sorted(rng.choice(len(sizes), int(rng.integers(1, len(sizes) + 1)), replace=False))
            parts: list[tuple[int, tuple[int, ...], np.ndarray | None]] = []
            for after in targets:
                kind = rng.integers(3)
                if kind == 0:
                    parts.append((int(after), (0,), None))
                elif kind == 1:
                    parts += [(int(after), (1,), None), (int(after), (2,), None)]
                else:
                    parts.append((int(after), (1, 2), rng.dirichlet(np.full(2, 0.5), size=sizes[after])))
            width = sum(sizes[after] for after, _, _ in parts)
            joint = rng.dirichlet(np.full(width, 0.5), size=sizes[x])
            joint[joint < 0.02] = 0
            joint /= joint.sum(axis=1, keepdims=True)
            branches, place = [], 0
            for after, shown, emission in parts:
                block = joint[:, place : place + sizes[after]]
                place += sizes[after]
                branches.append(Branch(after, csr(block), shown, None if emission is None else csr(emission)))
            offered.append(Choice(f"a{a}", rng.normal(size=sizes[x]), tuple(branches)))
        choices.append(tuple(offered))
    start = [np.zeros(n) for n in sizes]
    weights = rng.dirichlet(np.ones(2))
    for x, w in zip(rng.choice(len(sizes), 2, replace=False), weights, strict=True):
        start[x] = w * rng.dirichlet(np.ones(sizes[x]))
    names = tuple(tuple(f"s{y}" for y in range(n)) for n in sizes)
    return Problem(
        tuple(f"m{x}" for x in modes), names, tuple(choices), ("none", "low", "high"), tuple(start), discount,
        f"modal {seed}",
    )  # fmt: skip


def sticky_model(rng: np.random.Generator, n: int = 4) -> LatentStatePOMDP:
    """A person whose states last: rows Dirichlet(.5 + 6 e_s), helping the likelier the higher the state."""
    transition = np.stack([
        np.stack([rng.dirichlet(0.5 + 6.0 * (np.arange(n) == s)) for s in range(n)])
        for _ in range(PUBLISHED.n_actions)
    ])  # fmt: skip
    helps = np.sort(rng.random((len(PUBLISHED.emission_actions), n)), axis=1)
    best = int(np.argmax(PUBLISHED.scores))
    emission = np.stack([helps if o == best else 1 - helps for o in range(2)], axis=-1)
    return LatentStatePOMDP(rng.dirichlet(np.ones(n)), transition, emission)


def sticky_draws(count: int, seed: int, n: int = 4) -> ModelDraws:
    rng = np.random.default_rng(seed)
    return ModelDraws.from_models([sticky_model(rng, n) for _ in range(count)])


def mode_processes(seed: int = 0) -> dict[str, ModeProcess]:
    rng = np.random.default_rng(seed)
    return {
        "alternating": alternating(PUBLISHED),
        "bernoulli": bernoulli(PUBLISHED, 0.3),
        "table": mode_table(PUBLISHED, rng.dirichlet(np.ones(2), size=2)),
    }


def latent_case(seed: int, kind: str = "alternating", n: int = 3, discount: float = 0.9) -> Problem:
    model = sticky_model(np.random.default_rng(seed), n)
    return latent_problem(model, mode_processes(seed)[kind], discount, name=f"latent {seed} {kind}")


def start_arrays(problem: Problem) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Modes, padded beliefs and weights a search starts from."""
    starts = list(problem.starts())
    beliefs = np.zeros((len(starts), problem.n_states))
    for r, (_, _, belief) in enumerate(starts):
        beliefs[r, : len(belief)] = belief
    return np.array([x for x, _, _ in starts]), beliefs, np.array([p for _, p, _ in starts])


def padded(belief: np.ndarray, width: int) -> np.ndarray:
    return np.concatenate([belief, np.zeros(width - len(belief))])


CASES: dict[str, Problem] = {
    **{p.name: p for p in (
        dense_problem(1, 2), dense_problem(2, 4, 3, 3), dense_problem(3, 6, 2, 2, 0.8, shift=-3.0),
        modal_problem(1, (2, 3, 1)), modal_problem(2, (2, 2)), modal_problem(3, (4, 1, 3, 2)),
        latent_case(1), latent_case(2, "bernoulli"), latent_case(3, "table", 4),
    )},
}  # fmt: skip
"""Small problems of every kind, for both searches."""
