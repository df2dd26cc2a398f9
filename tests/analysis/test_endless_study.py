"""Plans under doubt without an end, put together."""

import numpy as np
import pytest

from analysis.endless_study import MEAN_PLAN, endless_study, mean_plan
from models.planning.evaluation import evaluate_schedule
from models.planning.latent import LatentBatch
from models.planning.mode_process import alternating
from models.planning.schedule import Schedule
from models.robust.candidates import posterior_mean
from tests.planning_cases import sticky_draws


@pytest.fixture(scope="module")
def batch():
    draws = sticky_draws(6, 3)
    return LatentBatch(draws, alternating(draws.protocol), 0.9)


def test_everything_is_of_the_same_draws(batch):
    steps = []
    found = endless_study(batch, "HRH", progress=lambda step, done, total: steps.append((step, done == total)))
    assert found.solution.certified.all()
    np.testing.assert_array_equal(found.wide.lower, found.solution.lower)
    assert len(found.wide.beliefs) == batch.draws.n_states
    assert found.along.letters == "HRH"
    assert found.along.policy == MEAN_PLAN
    assert {"never", "always", "posterior mean"} <= set(found.pool.names)
    assert np.all(found.pool.values.max(axis=0) <= found.pool.upper + 1e-9)
    assert {step for step, _ in steps} == {"draws solved", "draws solved from the corners", "controllers valued"}
    assert steps[-1][1]


def test_the_mean_plan_follows_any_schedule(batch):
    mean = posterior_mean(batch.draws)
    plan = mean_plan(batch)
    assert plan.action(mean.initial, "human_needs_help") in ("no_help", "help")
    values = evaluate_schedule(plan, Schedule.of(batch.draws, "HHRR")).values
    assert values.shape == (6,)
