r"""The first steps of the policy without a horizon, each decision with its proof.

Every decision rests on bounds of what each action is worth at the belief there
(`models.sensitivity.endless_kernel`): it is said only if they do not overlap. Decisions that follow one that is
open are open too, for their beliefs are not known.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Executor
from dataclasses import replace
from typing import Any

import numpy as np

from models.errors import located
from models.model_draws import ModelDraws
from models.planning.arrays import Array, ProblemArrays
from models.planning.grid_run import GridRun, blind_slots, new_run
from models.planning.latent import LatentBatch
from models.planning.loading import load_kernels
from models.planning.mode_process import alternating
from models.planning.solver import GRID_STATES, solve
from models.sensitivity.cases import Answers, Cases, Nodes, joined, steps_in_order
from models.sensitivity.endless_kernel import OPEN, certain_choice, decide
from models.spread_out import chunks, spread_out

INFINITE = "infinite"

TOLERANCE = 1e-6
"""Bounds no further apart than this share of a round's stakes leave a decision open."""

ROUNDS = 60
"""Rounds of the grid for one decision, at most."""

POINTS, SLOTS = 8_192, 2_048
"""Room for one decision; what needs more stays open."""

PORTION = 32
"""Cases that one call works on."""


class EndlessSteps:
    """The policy without a horizon, modes taking turns in the protocol's order.

    Parameters
    ----------
    draws : ModelDraws
        Its reward is not used: cases bring theirs.
    modes : tuple of int, optional
        Mode of each step, following each other in the protocol's order; all of them by default.
    tolerance : float
        As a share of a round's stakes: what the best state brings more than the worst, and the largest cost.
    rounds : int
        Of the grid, for one decision.
    executor : concurrent.futures.Executor, optional
        Threads of this process by default.
    progress : callable, optional
        Called with portions done and portions in all.

    Raises
    ------
    InputError
        On modes that do not follow each other.
    """

    reading = INFINITE

    def __init__(
        self, draws: ModelDraws, modes: tuple[int, ...] | None = None, *, tolerance: float = TOLERANCE,
        rounds: int = ROUNDS, executor: Executor | None = None,
        progress: Callable[[int, int], None] | None = None,
    ) -> None:  # fmt: skip
        self.draws = draws
        self.nodes = Nodes(draws.protocol, steps_in_order(draws.protocol) if modes is None else modes)
        n = len(draws.protocol.modes)
        for before, after in zip(self.nodes.modes, self.nodes.modes[1:], strict=False):
            if after != (before + 1) % n:
                raise located("steps without a horizon", self.nodes.modes, "modes that take turns in their order")
        self.tolerance, self.rounds = tolerance, rounds
        self.executor, self.progress = executor, progress
        self._batch = LatentBatch(draws, alternating(draws.protocol))
        self._local = threading.local()

    def __getstate__(self) -> dict[str, Any]:
        """What other processes need: neither who does the work nor the room that a thread works in."""
        return {k: v for k, v in vars(self).items() if k not in ("executor", "progress", "_local")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Start with room of its own."""
        vars(self).update(state, executor=None, progress=None, _local=threading.local())

    def decide(self, cases: Cases) -> Answers:
        """What the policy does in every case, as far as bounds prove it.

        Parameters
        ----------
        cases : Cases

        Raises
        ------
        InputError
            On a discount of 1: values would be infinite.
        """
        if np.any(cases.discount >= 1) or np.any(~(cases.discount >= 0)):
            wrong = cases.discount[~((cases.discount >= 0) & (cases.discount < 1))][0]
            raise located("discount without a horizon", wrong, "from 0 to below 1")
        if self.draws.n_states <= GRID_STATES:
            load_kernels("run")
            _ = self._batch.template, self._batch.values  # worked out before threads ask for them
        pieces = [cases.some(span) for span in chunks(len(cases), PORTION)]
        return joined(spread_out(self.executor, self._portion, pieces, self.progress))

    def _portion(self, cases: Cases) -> Answers:
        return joined([self._one(cases, i) for i in range(len(cases))])

    def _one(self, cases: Cases, i: int) -> Answers:
        """Choices, chances and bounds of one case."""
        nodes, d, model = self.nodes, int(cases.draw[i]), self.draws
        problem = self._problem(cases, i)
        tolerance = self.tolerance * _stakes(cases, i)
        choice = np.full(nodes.n_nodes, OPEN, dtype=np.int8)
        chance = np.zeros(nodes.n_nodes)
        lower = np.full((nodes.n_nodes, max(nodes.actions)), np.nan)
        upper = lower.copy()
        joints, known = [model.initial[d]], [True]
        for k, count in enumerate(nodes.actions):
            following: list[Array] = []
            sure: list[bool] = []
            for n, joint, certain in zip(nodes.of_step(k), joints, known, strict=True):
                chance[n] = joint.sum()
                leading = nodes.null_choice(k)
                if chance[n] > 0:
                    low, high = np.zeros(count), np.zeros(count)
                    belief = joint / chance[n]
                    found = self._bounds(problem, cases, i, nodes.modes[k], belief, tolerance, low, high)
                    lower[n, :count], upper[n, :count] = low, high
                    leading = int(np.argmax(low)) if found == OPEN else found
                    choice[n] = found if certain else OPEN
                else:
                    choice[n] = nodes.null_choice(k) if certain else OPEN  # never met: nothing is to be decided
                a = nodes.first_action(k) + leading
                row = model.protocol.emission_index[a]
                seen = [joint] if row < 0 else [joint * e for e in model.emission[d, row].T]
                following += [v @ model.transition[d, a] for v in seen]
                sure += [certain and choice[n] != OPEN] * len(seen)
            joints, known = following, sure
            chance[list(nodes.of_step(k))] /= chance[list(nodes.of_step(k))].sum()
        return Answers(nodes, choice[None], chance[None], lower[None], upper[None])

    def _problem(self, cases: Cases, i: int) -> ProblemArrays:
        reward, g = np.ascontiguousarray(cases.reward[i]), float(cases.discount[i])
        if self.draws.n_states > GRID_STATES:
            return self._batch.template
        return self._batch.template._replace(
            value=self._batch.values[int(cases.draw[i])], reward=reward, discount=g,
            span=float(reward.max() - reward.min()) / (1 - g), largest=float(np.abs(reward).max()) / (1 - g),
            least=0.0,
        )  # fmt: skip

    def _bounds(
        self, problem: ProblemArrays, cases: Cases, i: int, mode: int, belief: Array, tolerance: float,
        lower: Array, upper: Array,
    ) -> int:  # fmt: skip
        """Fill the bounds of every action at a belief; the action that they prove best, or `OPEN`."""
        if len(lower) == 1:
            return 0
        if self.draws.n_states > GRID_STATES:
            return self._by_trials(cases, i, mode, belief, tolerance, lower, upper)
        if not hasattr(self._local, "run"):
            self._local.run = new_run(problem, POINTS, SLOTS + blind_slots(problem))
        run: GridRun = self._local.run
        return int(
            decide(problem, run, mode, np.ascontiguousarray(belief), tolerance, self.rounds, 0, lower, upper)
        )

    def _by_trials(
        self, cases: Cases, i: int, mode: int, belief: Array, tolerance: float, lower: Array, upper: Array
    ) -> int:
        """The same where there are too many states for the grid: every belief that may follow solved by itself."""
        base = self._batch.problem(int(cases.draw[i])).with_discount(float(cases.discount[i]))
        a, choices = 0, []
        for offered in base.choices:
            choices.append(tuple(replace(c, reward=cases.reward[i, a + j]) for j, c in enumerate(offered)))
            a += len(offered)
        problem = replace(base, choices=tuple(choices))
        for c, action in enumerate(problem.choices[mode]):
            lower[c] = upper[c] = belief @ action.reward
            for x, _, p, after in problem.outcomes(mode, c, belief):
                start = [after if m == x else np.zeros_like(after) for m in range(problem.n_modes)]
                solved = solve(problem.started(start), tolerance, relative=False, time_limit=5.0)
                lower[c] += problem.discount * p * solved.lower
                upper[c] += problem.discount * p * solved.upper
        return int(certain_choice(lower, upper))


def _stakes(cases: Cases, i: int) -> float:
    """What a round is about: what the best state brings more than the worst, and the largest cost."""
    states = float(np.ptp(cases.prosocial[i]))
    return max(states, float(np.ptp(cases.reward[i], axis=0).max()), 1e-300)
