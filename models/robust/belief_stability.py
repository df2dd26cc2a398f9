r"""How stable a decision is: which action each draw prefers at a belief, and what the other actions lose there.

What an action is worth in draw `i` is one step followed by the best of the draw's alpha vectors,

.. math:: Q_i(b, a) = \sum_y b(y) R(a, y)
   + \gamma \sum_z \max_\alpha \sum_{y'} \alpha(y') \sum_y b(y) P_i(z, y' \mid y, a)

a lower bound of its value. The bounds of a draw are known to lie close together at the start only, so elsewhere
their gap is a yardstick and no proof: a draw whose best two actions differ by no more than its gap is *undecided*.
For beliefs far from where the start leads, widen the solution first (`models.robust.wider_solution`).
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from typing import Any

import numpy as np

from models.compiled import kernel
from models.errors import located
from models.lspomdp import check_rows
from models.planning.arrays import Array, Index, ProblemArrays
from models.planning.batch import BatchSolution
from models.planning.latent import LatentBatch
from models.spread_out import chunks, spread_out

CHUNK = 128
"""Draws that one call works on."""

UNDECIDED = "undecided"
"""In place of an action's name."""


@dataclass(frozen=True)
class BeliefStability:
    """Which actions draws prefer in one mode, belief by belief.

    Attributes
    ----------
    mode : str
    actions : tuple of str
    beliefs : float64[g, y] or float64[d, g, y]
        The same for all draws, or each draw's own.
    share : float64[g, c]
        Share of the draws, by weight, that prefer each action by more than their gap.
    undecided : float64[g]
        Share of the draws whose best two actions differ by no more than their gap.
    loss : float64[g, c]
        Mean over the draws of what each action is worth less than the draw's best one, in reward units.
    value : float64[g]
        Mean over the draws of what the best action is worth.
    """

    mode: str
    actions: tuple[str, ...]
    beliefs: Array
    share: Array
    undecided: Array
    loss: Array
    value: Array

    @property
    def whose(self) -> str:
        """Whose beliefs these are: the robot's filter is part of the policy."""
        return "each draw's own belief" if self.beliefs.ndim == 3 else "one belief for all draws"

    @property
    def leaning(self) -> Array:
        """Share of each action if undecided draws are split equally, shape ``[g, c]``; rows sum to one."""
        return self.share + self.undecided[:, None] / len(self.actions)

    def shares(self, belief: int = 0) -> dict[str, float]:
        """Shares at one belief by name, those undecided among them; they sum to one."""
        out = dict(zip(self.actions, self.share[belief].tolist(), strict=True))
        return {**out, UNDECIDED: float(self.undecided[belief])}

    def losses(self, belief: int = 0) -> dict[str, float]:
        """Expected loss of each action at one belief, by name, in reward units."""
        return dict(zip(self.actions, self.loss[belief].tolist(), strict=True))


def belief_stability(
    solution: BatchSolution, beliefs: Array, mode: int | str, *, weight: Array | None = None,
    executor: Executor | None = None,
) -> BeliefStability:  # fmt: skip
    """Decisions of all draws at beliefs of one mode.

    Parameters
    ----------
    solution : BatchSolution
    beliefs : float64[g, y] or float64[d, g, y]
        Fixed ones, such as a robot's whose filter runs on one model, or each draw's own: which it is belongs to the
        question, for the filter is part of the policy.
    mode : int or str
        Number or name.
    weight : float64[d] or float64[d, g], optional
        Weights of the draws, at each belief if they change with what was seen; sums are made one. Those of the
        draws by default.
    executor : concurrent.futures.Executor, optional
        What draws are spread over; threads of this process by default.

    Raises
    ------
    InputError
        On an unknown mode, or beliefs or weights that are none.
    """
    batch = solution.batch
    x = _mode(batch, mode)
    d, n = len(batch), batch.draws.n_states
    beliefs = np.asarray(beliefs, dtype=np.float64)
    if beliefs.ndim not in (2, 3) or beliefs.shape[-1] != n or (beliefs.ndim == 3 and len(beliefs) != d):
        raise located("beliefs, shape", beliefs.shape, f"[belief, {n}] or [{d}, belief, {n}]")
    flat = beliefs.reshape(-1, n)
    check_rows("belief", flat, [(f"belief {i}",) for i in range(len(flat))])
    w = np.asarray(batch.draws.weight if weight is None else weight, dtype=np.float64)
    w = w[:, None] if w.ndim == 1 else w
    if w.shape not in ((d, 1), (d, beliefs.shape[-2])) or np.any(~(w >= 0)) or np.any(w.sum(axis=0) <= 0):
        raise located("weights at beliefs, shape", w.shape, f"({d},) or ({d}, beliefs), not negative, some above 0")
    w = np.broadcast_to(w / w.sum(axis=0), (d, beliefs.shape[-2]))
    alpha, begins = _by_mode(solution)
    gap = solution.upper - solution.lower
    joint = batch.values.reshape(d, -1, n, n)
    pieces = [
        (batch.template, joint[s], alpha[begins[s][0, 0] : begins[s][-1, -1]], begins[s] - begins[s][0, 0],
         beliefs if beliefs.ndim == 2 else beliefs[s], x, w[s], gap[s])
        for s in chunks(d, CHUNK)
    ]  # fmt: skip
    parts = spread_out(executor, _some_draws, pieces)
    share, undecided, loss, value = (np.sum([p[i] for p in parts], axis=0) for i in range(4))
    actions = tuple(a.name for a in batch.draws.protocol.modes[x].actions)
    return BeliefStability(batch.draws.protocol.modes[x].name, actions, beliefs, share, undecided, loss, value)


def draw_action_values(solution: BatchSolution, beliefs: Array, mode: int | str) -> Array:
    """What each action is worth in each draw, at beliefs ``[g, y]`` or ``[d, g, y]``; shape ``[d, g, c]``."""
    batch = solution.batch
    n = batch.draws.n_states
    alpha, begins = _by_mode(solution)
    joint = batch.values.reshape(len(batch), -1, n, n)
    given = np.ascontiguousarray(beliefs if beliefs.ndim == 3 else beliefs[None], dtype=np.float64)
    return _values(batch.template, joint, alpha, begins, given, _mode(batch, mode))


def start_stability(solution: BatchSolution, executor: Executor | None = None) -> dict[str, BeliefStability]:
    """Decisions of all draws at their own initial beliefs, by mode."""
    batch = solution.batch
    own = batch.draws.initial[:, None, :]
    return {
        mode.name: belief_stability(solution, own, x, executor=executor)
        for x, mode in enumerate(batch.draws.protocol.modes)
    }


def edge_walk(n: int, points: int) -> Array:
    """Beliefs from certainty of the first state to that of the next and so on, `points` a step; shape ``[g, n]``.

    Examples
    --------
    >>> edge_walk(2, 2)
    array([[1. , 0. ],
           [0.5, 0.5],
           [0. , 1. ]])
    """
    share = np.linspace(0, 1, points, endpoint=False)[:, None]
    corners = np.eye(n)
    steps = [(1 - share) * corners[i] + share * corners[i + 1] for i in range(n - 1)]
    return np.concatenate([*steps, corners[-1:]])


def face_grid(n: int, corners: Sequence[int], points: int) -> Array:
    """All beliefs over three states in steps of ``1 / points``, the others impossible; shape ``[g, n]``.

    Examples
    --------
    >>> face_grid(3, (0, 1, 2), 1)
    array([[0., 0., 1.],
           [0., 1., 0.],
           [1., 0., 0.]])
    """
    weights = [(i, j, points - i - j) for i in range(points + 1) for j in range(points + 1 - i)]
    out = np.zeros((len(weights), n))
    out[:, list(corners)] = np.array(weights) / points
    return out


def _mode(batch: LatentBatch, mode: int | str) -> int:
    names = batch.draws.protocol.mode_names
    if isinstance(mode, str) and mode in names:
        return names.index(mode)
    if isinstance(mode, int | np.integer) and 0 <= mode < len(names):
        return int(mode)
    raise located("mode", mode, f"one of {', '.join(names)}")


def _by_mode(solution: BatchSolution) -> tuple[Array, Index]:
    """Alpha vectors of all draws sorted by mode ``[k, y]``, and where those of each draw and mode begin."""
    modes = len(solution.batch.draws.protocol.modes)
    vectors, begins, at = [], np.zeros((len(solution.solutions), modes + 1), dtype=np.int64), 0
    for d, own in enumerate(solution.solutions):
        order = np.argsort(own.mode, kind="stable")
        vectors.append(own.alpha[order])
        begins[d] = at + np.searchsorted(own.mode[order], np.arange(modes + 1))
        at += len(order)
    return np.ascontiguousarray(np.concatenate(vectors)), begins


def _some_draws(piece: tuple[Any, ...]) -> tuple[Array, Array, Array, Array]:
    """Sums over some draws: weight that prefers each action, undecided weight, losses, values."""
    problem, joint, alpha, begins, beliefs, mode, weight, gap = piece
    given = np.ascontiguousarray(beliefs if beliefs.ndim == 3 else beliefs[None])
    q = _values(problem, np.ascontiguousarray(joint), alpha, begins, given, mode)
    best = q.max(axis=2)
    if q.shape[2] > 1:
        lead = best - np.partition(q, -2, axis=2)[:, :, -2]
        decided = lead > gap[:, None]
    else:
        decided = np.ones(best.shape, dtype=bool)
    first = np.argmax(q, axis=2)
    share = np.stack([np.sum(weight * (decided & (first == c)), axis=0) for c in range(q.shape[2])], axis=1)
    loss = np.einsum("dg,dgc->gc", weight, best[:, :, None] - q)
    return share, np.sum(weight * ~decided, axis=0), loss, np.sum(weight * best, axis=0)


@kernel
def _values(problem: ProblemArrays, joint: Array, alpha: Array, begins: Index, beliefs: Array, mode: int) -> Array:
    """Action values ``[d, g, c]``; `beliefs` ``[d, g, y]``, or ``[1, g, y]`` for all draws."""
    draws, size, count = len(joint), beliefs.shape[2], beliefs.shape[1]
    first, last = problem.mode_choice[mode], problem.mode_choice[mode + 1]
    out = np.empty((draws, count, last - first))
    reached = np.empty(size)
    for d in range(draws):
        own = beliefs[d if len(beliefs) > 1 else 0]
        for g in range(count):
            for c in range(first, last):
                total = 0.0
                for y in range(size):
                    total += own[g, y] * problem.reward[c, y]
                for z in range(problem.choice_outcome[c], problem.choice_outcome[c + 1]):
                    reached[:] = 0.0
                    for y in range(size):
                        for x in range(size):
                            reached[x] += own[g, y] * joint[d, z, y, x]
                    best = -np.inf
                    after = problem.outcome_mode[z]
                    for k in range(begins[d, after], begins[d, after + 1]):
                        worth = 0.0
                        for x in range(size):
                            worth += alpha[k, x] * reached[x]
                        best = max(best, worth)
                    total += problem.discount * best
                out[d, g, c - first] = total
    return out
