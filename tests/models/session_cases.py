"""Sessions with people by chance, for tests of the robot's runtime and its log."""

from datetime import UTC, datetime, timedelta
from functools import cache

import numpy as np

from models.planning.baselines import Reciprocal, always, uniformly_random
from models.planning.mixed_policy import MixedPolicy
from models.planning.mixture import Mixture
from models.planning.plan_policy import PlanPolicy
from models.planning.product_policy import ProductPolicy
from models.planning.schedule import Schedule
from models.planning.schedule_vectors import schedule_vectors
from models.protocol import PUBLISHED
from models.runtime import Session
from models.safeguards.budget import CostBudget
from models.safeguards.confidence import Confidence
from models.safeguards.consent import fallback_of
from models.safeguards.guarded import Guarded
from tests.models.planning.policy_cases import SCHEDULE, policy
from tests.planning_cases import sticky_draws

ROBOT, HUMAN = "robot_needs_help", "human_needs_help"
KINDS = (
    "alpha", "by_mode", "controller", "guarded", "guarded product", "mixed", "mixture", "myopic", "plan", "product",
    "random", "reactive", "tracked",
)  # fmt: skip
KEPT_TO_A_PLAN = ("mixed", "controller")
"""Kinds that take no response for missing."""


class Clock:
    """A clock that moves on by itself."""

    def __init__(self):
        self.now = datetime(2026, 1, 31, 12, tzinfo=UTC)

    def __call__(self):
        self.now += timedelta(milliseconds=7)
        return self.now


def make(kind):
    """A policy of a kind, for any modes or (plans) those of `SCHEDULE`."""
    if kind == "by_mode":
        return always(PUBLISHED)
    if kind == "random":
        return uniformly_random(PUBLISHED)
    if kind == "reactive":
        return Reciprocal(PUBLISHED)
    if kind == "guarded":
        return Guarded(policy("alpha"), [CostBudget.of(PUBLISHED, 20.0)], fallback_of(PUBLISHED))
    if kind == "product":
        return product()
    if kind == "guarded product":
        guards = [CostBudget.of(PUBLISHED, 20.0), Confidence.of(PUBLISHED, 0.9)]
        return Guarded(product(), guards, fallback_of(PUBLISHED))
    if kind == "mixture":
        return Mixture([policy("tracked"), Reciprocal(PUBLISHED), always(PUBLISHED)], [0.5, 0.3, 0.2])
    if kind == "mixed":
        plan = policy("plan")
        other = [np.ones_like(level) for level in plan.decisions]
        return MixedPolicy(plan.vocabulary, plan.modes, plan.outcomes, [plan.decisions, other], [0.4, 0.6])
    return policy(kind)


@cache
def product():
    return schedule_vectors(Schedule.of(sticky_draws(20, seed=1, n=3), SCHEDULE))


def modes_of(chosen, events, rng):
    """Modes of a run that the policy can follow."""
    inner = getattr(chosen, "policy", chosen)
    if isinstance(inner, ProductPolicy):
        inner = policy("plan")
    if isinstance(inner, PlanPolicy | MixedPolicy):
        return [chosen.vocabulary.modes[m] for m in inner.modes]
    if "ls-POMDP" in inner.name:
        return [(ROBOT, HUMAN)[k % 2] for k in range(events)]
    return [(HUMAN, ROBOT)[int(rng.integers(2))] for _ in range(events)]


def response_to(mode, rng, missing=True):
    if mode == HUMAN:
        return None
    seen = int(rng.integers(3 if missing else 2))
    return (*PUBLISHED.response_names, None)[seen]


def run(session, modes, rng, *, missing=True, overrule=False):
    """Let a session run through modes with responses by chance; returns what was decided."""
    done = []
    for mode in modes:
        if session.pending is None:
            done.append(session.act(mode))
        performed = None
        if overrule and rng.random() < 0.2:
            offered = session.policy.vocabulary.actions[session.pending.mode]
            performed = offered[int(rng.integers(len(offered)))]
        name = session.policy.vocabulary.modes[session.pending.mode]
        session.observe(response_to(name, rng, missing), performed)
    return done


def written(kind, seed, folder, *, events=5, withdraw=None, consent=True, restart=None):
    """Write the log of a random session; returns its path."""
    rng, chosen = np.random.default_rng(seed), make(kind)
    path = folder / f"{kind}-{seed}.log"
    path.unlink(missing_ok=True)
    modes = modes_of(chosen, events, rng)
    session, clock = Session(chosen, path, seed=seed, consent=consent, clock=Clock()), Clock()
    for k, mode in enumerate(modes):
        if k == withdraw:
            session.withdraw()
        if k == restart:
            session.act(mode)
            session.close()
            session = Session.restore(path, clock=clock)
        run(session, [mode], rng, missing=kind not in KEPT_TO_A_PLAN)
    session.close()
    return path
