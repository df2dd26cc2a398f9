"""Policies, draws and safeguards to test with, and direct ways to say what actions are worth."""

from functools import cache

import numpy as np

from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.baselines import baselines
from models.planning.belief_model import BeliefModel
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import solve_schedule
from models.planning.expected_cost import cost_frontier
from models.planning.plan_policy import PlanPolicy
from models.planning.policies import Policy, certain
from models.planning.schedule import Schedule
from models.planning.schedule_vectors import schedule_vectors
from models.protocol import PUBLISHED
from models.reward import Reward
from models.safeguards.budget import CostBudget
from models.safeguards.confidence import Confidence
from models.safeguards.consent import fallback_of
from models.safeguards.guarded import Guarded
from models.safeguards.influence import MinimumInfluence
from models.safeguards.schedule_worth import ScheduleWorth
from tests.models.planning.policy_cases import person
from tests.models.planning.policy_cases import policy as bare

HUMAN, ROBOT = 0, 1
NONE, NO_HELP, HELP = 0, 1, 2


@cache
def doubt(n=6, steep=0.075) -> ModelDraws:
    """Draws around one person, with a reward at which most plans act."""
    rng, like = np.random.default_rng(3), person()
    reward = Reward(like.reward.x, steep)

    def around(table):
        return 0.75 * table + 0.25 * rng.dirichlet(np.ones(table.shape[-1]), size=table.shape[:-1])

    models = [
        LatentStatePOMDP(around(like.initial), around(like.transition), around(like.emission), reward=reward)
        for _ in range(n)
    ]
    return ModelDraws.from_models(models, rng.dirichlet(np.full(n, 5.0)))


@cache
def rounds(letters="HRHRH", n=6) -> Schedule:
    return Schedule.of(doubt(n), letters)


@cache
def policy(kind, letters="HRHRH", n=6) -> Policy:
    """A policy for the rounds: baselines, beliefs, controllers of `policy_cases`, the plan, the plan as vectors."""
    s = rounds(letters, n)
    if kind == "plan":
        return PlanPolicy.of(solve_schedule(s))
    if kind == "followed":
        return PlanPolicy.of(solve_schedule(s), "followed plan", left="follow")
    if kind == "vectors":
        return schedule_vectors(s, impossible="keep")
    if kind == "mixed":
        return cost_frontier(s).mixture(17.0)
    if kind == "myopic":
        return next(p for p in baselines(s.draws.model(0)) if p.name == "myopic")
    return bare(kind)


def all_guards(s: Schedule, budget=30.0, tolerance=2.0, threshold=0.7):
    return [
        CostBudget.of(PUBLISHED, budget), MinimumInfluence.of(s.draws, tolerance),
        Confidence.of(PUBLISHED, threshold, 0.5),
    ]  # fmt: skip


def guarded(kind, guards=None, letters="HRHRH", n=6) -> Guarded:
    """A guarded policy; what actions are worth by vectors where it has them, else by following it."""
    s, own = rounds(letters, n), policy(kind, letters, n)
    worth = None if kind == "vectors" else ScheduleWorth(own, s)
    return Guarded(own, all_guards(s) if guards is None else guards, fallback_of(PUBLISHED), worth)


class Forced(Policy):
    """Does one thing first, whatever it wants, and then goes on as a policy does from some memory."""

    def __init__(self, policy, memory, choice):
        self.policy, self.memory, self.choice = policy, memory, choice
        self.vocabulary, self.name = policy.vocabulary, "forced"

    def begin(self, mode):
        assert mode == self.policy.mode_of(self.memory)
        return ("first", self.memory)

    def mode_of(self, memory):
        return self.policy.mode_of(memory[1])

    def probabilities(self, memory):
        if memory[0] == "first":
            return certain(self.choice, len(self.vocabulary.actions[self.mode_of(memory)]))
        return self.policy.probabilities(memory[1])

    def observe(self, memory, choice, observation, next_mode):
        return ("then", self.policy.observe(memory[1], choice, observation, next_mode))


def direct_worth(policy, memory, s: Schedule, history):
    """Worth of each action in each draw after a history of (choice, observation), by `evaluate_schedule`."""
    joint = s.start()
    for k, (choice, seen) in enumerate(history):
        joint = s.after(joint, s.first_action(k) + choice, seen - 1 if seen else None)
    k = len(history)
    rest = s.rest(k, joint)
    values = [evaluate_schedule(Forced(policy, memory, c), rest).values for c in range(len(s.mode(k).actions))]
    return np.stack(values, axis=1), rest.draws.weight, rest.draws.initial


def walked(policy, s: Schedule, rng, steps, overrule=0.3):
    """Memory and history after some steps with random responses, some actions overruled."""
    memory, history = policy.begin(s.modes[0]), []
    for k in range(steps):
        n = len(s.mode(k).actions)
        choice = int(rng.integers(n)) if rng.random() < overrule else policy.act(memory, rng)
        seen = 0 if s.n_outcomes(k) == 1 else 1 + int(rng.integers(s.n_outcomes(k)))
        memory = policy.observe(memory, choice, seen, s.modes[k + 1])
        history.append((choice, seen))
    return memory, tuple(history)


def tracker(model, discount):
    return BeliefModel.of_latent(model, discount, impossible="keep")
