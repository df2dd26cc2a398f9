"""One of each kind of policy, with the problem it is for."""

from functools import cache

import numpy as np

from models.lspomdp import LatentStatePOMDP
from models.planning.alpha_policy import AlphaPolicy
from models.planning.baselines import Reciprocal, baselines
from models.planning.belief_model import BeliefModel
from models.planning.controller import controller_of
from models.planning.exact import solve_schedule
from models.planning.latent import latent_problem
from models.planning.mode_process import alternating
from models.planning.plan_policy import PlanPolicy
from models.planning.schedule import Schedule
from models.planning.solver import solve
from models.protocol import PUBLISHED

SCHEDULE = "HRHRH"
KINDS = (
    "always", "never", "myopic", "reactive", "random", "literal", "alpha", "tracked", "controller", "plan",
)  # fmt: skip


@cache
def person() -> LatentStatePOMDP:
    """Three states with something to learn and costs that make the best action depend on it."""
    ladder = np.array([[0.85, 0.1, 0.05], [0.15, 0.7, 0.15], [0.05, 0.15, 0.8]])
    up = np.array([[0.35, 0.45, 0.2], [0.05, 0.45, 0.5], [0.02, 0.08, 0.9]])
    help_probability = np.array([[0.1, 0.5, 0.9], [0.25, 0.8, 0.92]])
    emission = np.stack([1 - help_probability, help_probability], axis=-1)
    nudged = 0.6 * ladder + 0.4 * up
    return LatentStatePOMDP([0.4, 0.3, 0.3], [ladder, up, ladder, nudged], emission)


@cache
def problem(discount=0.9):
    return latent_problem(person(), alternating(PUBLISHED, "H"), discount)


@cache
def alpha() -> AlphaPolicy:
    return solve(problem()).policy


@cache
def policy(kind):
    if kind in ("always", "never", "myopic", "reactive", "random"):
        return {p.name: p for p in baselines(person())}[kind]
    if kind == "literal":
        return Reciprocal(PUBLISHED, literal=True, name="literal")
    if kind == "alpha":
        return alpha()
    if kind == "tracked":
        own, a = BeliefModel.of_latent(person(), 0.9), alpha()
        return AlphaPolicy(problem(), a.alpha, a.mode, a.choice, a.follow, "tracked", tracker=own)
    if kind == "controller":
        return controller_of(alpha())
    return PlanPolicy.of(solve_schedule(Schedule.of(person(), SCHEDULE)))
