"""Controllers by the book: dense linear systems, behaviours told apart by trying, action values by loops."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.planning.batch import DrawSolution
from models.planning.latent import LatentBatch
from models.robust.controllers import Controller

Array = NDArray[np.float64]


def joint_tables(batch: LatentBatch, d: int) -> list[tuple[int, int, Array]]:
    """Every outcome of every choice: choice, next mode, ``P(mode', o, s' | s, a)``, from the tables themselves."""
    draws, out = batch.draws, []
    for a, m in enumerate(draws.protocol.mode_of_action):
        row = draws.protocol.emission_index[a]
        for o in [None] if row < 0 else range(draws.protocol.n_responses):
            seen = np.ones(draws.n_states) if o is None else draws.emission[d, row, :, o]
            for after, p in enumerate(batch.process.table[m]):
                if p > 0:
                    out.append((a, after, p * seen[:, None] * draws.transition[d, a]))
    return out


def controller_value(batch: LatentBatch, controller: Controller, d: int) -> float:
    """Value of a controller in one draw: one dense system over nodes and states."""
    s, n = batch.draws.n_states, controller.n_nodes
    reward = batch.draws.model(d).reward_table()
    first = np.cumsum([0, *(len(m.actions) for m in batch.draws.protocol.modes)])
    matrix, known = np.eye(n * s), np.zeros(n * s)
    tables = joint_tables(batch, d)
    for i in range(n):
        own = slice(i * s, i * s + s)
        for c, share in enumerate(controller.share[i]):
            if share > 0:
                a = first[controller.mode[i]] + c
                known[own] += share * reward[a]
                outcomes = [table for number, _, table in tables if number == a]
                for z, table in enumerate(outcomes):
                    j = controller.follow[i, c, z]
                    matrix[own, j * s : j * s + s] -= batch.discount * share * table
    values = np.linalg.solve(matrix, known).reshape(n, s)
    starts = [(p, controller.start[x]) for x, p in enumerate(batch.process.start) if p > 0]
    return float(sum(p * batch.draws.initial[d] @ values[node] for p, node in starts))


def same_behaviour(controller: Controller, i: int, j: int) -> bool:
    """Whether two nodes act alike after whatever is seen: all pairs that they lead to are tried."""
    seen, left = set(), [(i, j)]
    while left:
        a, b = left.pop()
        if (a, b) in seen:
            continue
        seen.add((a, b))
        if controller.mode[a] != controller.mode[b] or not np.array_equal(controller.share[a], controller.share[b]):
            return False
        for p, q in zip(controller.follow[a].ravel(), controller.follow[b].ravel(), strict=True):
            if (p < 0) != (q < 0):
                return False
            if p >= 0:
                left.append((int(p), int(q)))
    return True


def action_values(batch: LatentBatch, solution: DrawSolution, d: int, belief: Array, mode: int) -> list[float]:
    """One step, then the best vector of the mode that is reached."""
    reward = batch.draws.model(d).reward_table()
    tables = joint_tables(batch, d)
    out = []
    for a in [a for a, m in enumerate(batch.draws.protocol.mode_of_action) if m == mode]:
        total = float(belief @ reward[a])
        for number, after, table in tables:
            if number == a:
                total += batch.discount * float((solution.alpha[solution.mode == after] @ (belief @ table)).max())
        out.append(total)
    return out
