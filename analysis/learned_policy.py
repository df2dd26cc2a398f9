"""What a learned model says the robot should do: over a schedule, without horizon, and beside a truth."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from analysis.policy_graph import PolicyGraph, policy_graph_of
from analysis.policy_study import SIMULATED_RUNS, STUDY2, PolicyStudy, infinite_baselines, policy_study
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.controller import controller_of
from models.planning.finite_memory import infinite_value
from models.planning.latent import DISCOUNT, latent_problem
from models.planning.mode_process import alternating
from models.planning.solution import Solution
from models.planning.solver import solve
from models.unseen import without_actions

PRECISION, TIME_LIMIT = 1e-4, 5.0
"""Relative gap at which solving without horizon stops, and seconds after which it gives up."""


@dataclass(frozen=True)
class LearnedPolicy:
    """What one learned model says.

    Attributes
    ----------
    model : LatentStatePOMDP
        Without the actions that are left out.
    left_out : tuple of str
    study : PolicyStudy
        The best plan of a schedule and the baselines, if the learned model were true.
    in_truth : PolicyStudy or None
        The same policies in a known truth, and the best plan there.
    solution : Solution
        Without horizon, modes taking turns, the schedule's first mode first.
    graph : PolicyGraph
        Its policy.
    baselines : dict
        Values of the baselines without horizon (`analysis.policy_study.infinite_baselines`).
    policy_in_truth : float or None
        What the policy without horizon is worth in the truth.
    solution_of_truth : Solution or None
        Without horizon, were the truth known.
    """

    model: LatentStatePOMDP
    left_out: tuple[str, ...]
    study: PolicyStudy
    in_truth: PolicyStudy | None
    solution: Solution
    graph: PolicyGraph
    baselines: dict[str, dict[str, float]]
    policy_in_truth: float | None
    solution_of_truth: Solution | None


def learned_policy(
    model: LatentStatePOMDP, unseen: Sequence[str] = (), schedule: str = STUDY2, *,
    truth: LatentStatePOMDP | None = None, discount: float = DISCOUNT, seed: int = 1, runs: int = SIMULATED_RUNS,
) -> LearnedPolicy:  # fmt: skip
    """Plan with a learned model.

    Parameters
    ----------
    model : LatentStatePOMDP
    unseen : sequence of str
        Actions that the data say nothing about; they are left out.
    schedule : str
        Letters.
    truth : LatentStatePOMDP, optional
        What people are like, where that is known; the same actions are left out.
    discount : float
        Without horizon; the schedule is not discounted.
    seed, runs : int
        Of the baseline that is simulated.

    Raises
    ------
    InputError
        As `without`.
    """
    own = without(model, unseen)
    known = None if truth is None else without(truth, unseen)
    turns = alternating(own.protocol, schedule[0])
    problem = latent_problem(own, turns, discount)
    solution = solve(problem, PRECISION, time_limit=TIME_LIMIT)
    worth, best = None, None
    if known is not None:
        people = latent_problem(known, turns, discount)
        worth = infinite_value(controller_of(solution.policy, impossible="keep"), people).value
        best = solve(people, PRECISION, time_limit=TIME_LIMIT)
    return LearnedPolicy(
        own, tuple(unseen), policy_study(own, schedule),
        None if known is None else policy_study(known, schedule, learned=own), solution,
        policy_graph_of(solution), infinite_baselines(own, problem, seed, runs), worth, best,
    )  # fmt: skip


def without(model: LatentStatePOMDP, actions: Sequence[str]) -> LatentStatePOMDP:
    """The model of a robot that does not have some actions.

    Raises
    ------
    InputError
        On an unknown action, or a null action.
    """
    return without_actions(ModelDraws.from_models([model]), actions).model(0) if actions else model
