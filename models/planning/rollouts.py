r"""Simulated runs of a policy in a planning problem: for what cannot be computed exactly.

All runs move together. The random numbers of run `i` at step `k` are the same for every policy with the same seed,
so policies are compared on the same luck and their difference has a smaller error than either value.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from statistics import NormalDist
from typing import Any

import numpy as np

from models.errors import Phrase, located
from models.notebook_view import NotebookView
from models.planning.belief_model import BeliefModel
from models.planning.policies import Array, Index, Policy, Vocabulary, grouped
from models.planning.problem import Problem
from models.reward import UNIT

DEFAULT_SEED = 1

STREAM = 61
"""Task number of these random streams."""


@dataclass(frozen=True)
class SimulatedValue(NotebookView):
    r"""What a policy was worth in simulated runs.

    Attributes
    ----------
    policy : str
    value : float
        Mean of :math:`\sum_{k<H} \gamma^k R_k` over runs, in `unit`.
    error : float
        Standard error of the mean.
    low, high : float
        Interval of `level` for the value without horizon: the normal interval of the mean, widened on either side
        by what the steps after the last simulated one can be worth at most (`left`, a bound from the rewards) and
        by `rounding`. With discount 1 the value of `steps` steps. It knows nothing of what is so rare that none of
        the runs met it.
    level : float
    left : float
    rounding : float
        How far sums of floating-point numbers may be from the returns and their mean.
    runs, steps, seed : int
    discount : float
    frequencies : dict of str to float
        Share of the steps, discounted, of each action.
    returns : float64[run]
    unit : str
        What the value is in: the word of the problem.
    cautions : tuple of str
        Those of the problem (`models.cautions`).
    """

    _whose = "simulated"

    policy: str
    value: float
    error: float
    low: float
    high: float
    level: float
    left: float
    rounding: float
    runs: int
    steps: int
    seed: int
    discount: float
    frequencies: dict[str, float]
    returns: Array = field(repr=False)
    unit: str = UNIT
    cautions: tuple[str, ...] = ()

    @property
    def table(self) -> Any:
        """The result as a data frame of one row."""
        import pandas as pd

        shown = ("policy", "value", "error", "low", "high", "runs", "steps", "discount", "seed")
        return pd.DataFrame([{key: getattr(self, key) for key in shown}])

    @property
    def sentence(self) -> str:
        """The result in one sentence."""
        return (
            f"{self.policy} was worth {self.value:.4g} {self.unit} in {self.runs} simulated runs of {self.steps} "
            f"steps (discount {self.discount:g}, seed {self.seed}); {self.level:.0%} interval {self.low:.4g} to "
            f"{self.high:.4g}."
        )


def simulate_policies(
    policies: Sequence[Policy], problem: Problem, *, runs: int = 10_000, steps: int | None = None,
    level: float = 0.95, seed: int = DEFAULT_SEED,
) -> tuple[SimulatedValue, ...]:  # fmt: skip
    """Simulate policies on the same luck.

    Parameters
    ----------
    policies : sequence of Policy
    problem : Problem
        What is true.
    runs : int
        At least 2.
    steps : int, optional
        Steps of a run. By default as many as make what is left out less than a ten-thousandth of what rewards can
        add up to; needed where the discount is 1.
    level : float
    seed : int

    Raises
    ------
    InputError
        On names that differ from the problem's, numbers out of range, or an observation that a policy takes for
        impossible.
    """
    words = Vocabulary.of(problem)
    for policy in policies:
        if policy.vocabulary != words:
            place = f"policy {policy.name}, modes, actions and observations"
            raise located(place, policy.vocabulary, str(words))
    _check_count("runs", runs, 2)
    if not 0 < level < 1:
        raise located("simulation, level", level, "a number between 0 and 1")
    if steps is None:
        if problem.discount >= 1:
            found = Phrase("none, with discount 1")
            raise located("simulation, steps", found, "a number of steps, or a discount below 1")
        steps = 1 if problem.discount == 0 else max(1, int(np.ceil(np.log(1e-4) / np.log(problem.discount))))
    _check_count("steps", steps, 1)
    world = _World(problem)
    return tuple(_simulate(policy, world, runs, steps, level, seed) for policy in policies)


def _check_count(what: str, count: Any, least: int) -> None:
    if isinstance(count, bool) or not isinstance(count, int | np.integer) or count < least:
        raise located(f"simulation, {what}", count, f"a whole number, at least {least}")


def simulate_policy(policy: Policy, problem: Problem, **options: Any) -> SimulatedValue:
    """Simulate one policy; options as in `simulate_policies`."""
    return simulate_policies([policy], problem, **options)[0]


def beside(simulated: SimulatedValue, control: SimulatedValue, exact: float) -> SimulatedValue:
    """The value of a policy by its difference from another one, on the same luck, whose value is known exactly.

    The closer the two policies are, the smaller the error: that of the difference.

    Raises
    ------
    InputError
        If the two were not simulated alike.
    """
    alike = ("runs", "steps", "seed", "discount", "level")
    if any(getattr(simulated, key) != getattr(control, key) for key in alike):
        raise located("simulated difference", Phrase("runs on different luck"), "one call of simulate_policies")
    gain = simulated.returns - control.returns
    value, error = exact + float(gain.mean()), float(gain.std(ddof=1) / np.sqrt(len(gain)))
    rounding = simulated.rounding + control.rounding + float(np.spacing(abs(exact)))
    half = NormalDist().inv_cdf(0.5 + simulated.level / 2) * error + 2 * simulated.left + rounding
    return replace(
        simulated, value=value, error=error, low=value - half, high=value + half, rounding=rounding,
        returns=gain + exact,
    )  # fmt: skip


class _World:
    """Outcomes of every choice, ready for drawing many at once."""

    def __init__(self, problem: Problem) -> None:
        self.problem = problem
        truth = BeliefModel.of_problem(problem)
        self.words, self.rewards = truth.vocabulary, truth.rewards
        lowest = min(float(r.min()) for r in self.rewards)
        highest = max(float(r.max()) for r in self.rewards)
        self.most = max(abs(lowest), abs(highest))
        self.tables: dict[tuple[int, int], tuple[Array, Index, Index, Index]] = {}
        for x, offered in enumerate(truth.outcomes):
            for c, outcomes in enumerate(offered):
                row = np.concatenate([z.row for z in outcomes])
                column = np.concatenate([z.column for z in outcomes])
                mode = np.concatenate([np.full(len(z.row), z.mode) for z in outcomes])
                seen = np.concatenate([np.full(len(z.row), z.observation) for z in outcomes])
                value = np.concatenate([z.value for z in outcomes])
                order = np.lexsort((seen, column, mode, row))
                row, value = row[order], value[order]
                total = np.bincount(row, value, minlength=len(problem.states[x]))
                running = np.cumsum(value)
                before = np.concatenate([[0.0], np.cumsum(total)])[row]
                # Row number plus the share of its row up to and with this entry: one search finds all runs'.
                edge = row + np.minimum((running - before) / total[row], 1.0)
                edge[np.append(np.flatnonzero(np.diff(row)), len(row) - 1)] = (
                    row[np.append(np.flatnonzero(np.diff(row)), len(row) - 1)] + 1.0
                )
                self.tables[x, c] = (edge, mode[order], column[order], seen[order])

    def begin(self, luck: Array) -> tuple[Index, Index]:
        joined = np.concatenate(self.problem.initial)
        edges = np.cumsum(joined) / joined.sum()
        place = np.minimum(np.searchsorted(edges, luck, side="right"), np.flatnonzero(joined)[-1])
        sizes = np.cumsum([0, *map(len, self.problem.initial)])
        mode = np.searchsorted(sizes, place, side="right") - 1
        return mode, place - sizes[mode]

    def step(self, x: int, c: int, states: Index, luck: Array) -> tuple[Index, Index, Index]:
        edge, mode, column, seen = self.tables[x, c]
        entry = np.searchsorted(edge, states + luck, side="right")
        return mode[entry], column[entry], seen[entry]


def _simulate(policy: Policy, world: _World, runs: int, steps: int, level: float, seed: int) -> SimulatedValue:
    discount = world.problem.discount
    streams = np.random.SeedSequence(seed, spawn_key=(STREAM,)).spawn(2)
    nature, chance = (np.random.default_rng(s) for s in streams)
    mode, state = world.begin(nature.random(runs))
    memories = policy.begin_many(mode)
    returns, weight, size = np.zeros(runs), 1.0, 0.0
    counts: dict[str, float] = {}
    for k in range(steps):
        share = policy.probabilities_many(memories)
        # A draw for everybody even where nothing is left to chance keeps the luck of policies together.
        draw = chance.random(runs)
        # The last action with any probability takes what rounding leaves of the sum.
        top = share.shape[1] - 1 - np.argmax(share[:, ::-1] > 0, axis=1)
        choice = np.minimum((np.cumsum(share, axis=1) <= draw[:, None]).sum(axis=1), top)
        luck = nature.random(runs)
        after, reached, seen = np.zeros_like(mode), np.zeros_like(mode), np.zeros_like(mode)
        for x, c, own in grouped(mode, choice):
            returns[own] += weight * world.rewards[x][c][state[own]]
            after[own], reached[own], seen[own] = world.step(x, c, state[own], luck[own])
            name = world.words.actions[x][c]
            counts[name] = counts.get(name, 0.0) + weight * len(own) / runs
        if k + 1 < steps:
            memories = policy.observe_many(memories, choice, seen, after)
        mode, state = after, reached
        size += weight * world.most
        weight *= discount
    left = weight * world.most / (1 - discount) if discount < 1 else 0.0
    value, error = float(returns.mean()), float(returns.std(ddof=1) / np.sqrt(runs))
    # A return is a sum of `steps` products, their mean is summed pairwise in blocks of 128; each operation is off
    # by half an epsilon of the sum so far, at most `size`.
    rounding = float(np.finfo(float).eps) * size * (steps + 128 + np.log2(runs))
    half = NormalDist().inv_cdf(0.5 + level / 2) * error + left + rounding
    total = sum(counts.values())
    return SimulatedValue(
        policy.name, value, error, value - half, value + half, level, left, rounding, runs, steps, seed, discount,
        {a: counts[a] / total for a in sorted(counts)}, returns, world.problem.unit,
        world.problem.cautions,
    )  # fmt: skip
