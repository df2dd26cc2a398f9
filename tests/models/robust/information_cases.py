"""Draws whose value of information is worth having, for tests of it."""

import numpy as np
from hypothesis import strategies as st

from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.reward import Reward
from models.robust.study_design import Arm, NextStudy
from tests.models.planning.schedule_cases import telling_tables
from tests.random_cases import random_tables

CHEAP = Reward((0.0, 1.0), 1.0, {"help": 0.3, "signal": 0.2})
"""Two states, acts that are sometimes worth their cost."""


def contested(seed, draws=3, states=2, weight=None):
    """Draws of the published protocol that want different plans."""
    rng = np.random.default_rng(seed)
    reward = Reward(tuple(np.linspace(0.0, 1.0, states).tolist()), 1.0, CHEAP.costs)
    models = [LatentStatePOMDP(*telling_tables(rng, PUBLISHED, states), reward=reward) for _ in range(draws)]
    return ModelDraws.from_models(models, rng.dirichlet(np.full(draws, 3.0)) if weight is None else weight)


def cloud(seed, draws, states=2, spread=12.0):
    """Draws around one model, as a posterior has them."""
    rng = np.random.default_rng(seed)
    centre = random_tables(rng, PUBLISHED, states)

    def around(table):
        drawn = rng.gamma(spread * table, size=(draws, *table.shape))
        return drawn / drawn.sum(axis=-1, keepdims=True)

    reward = Reward(tuple(np.linspace(0.0, 1.0, states).tolist()), 1.0, CHEAP.costs)
    return ModelDraws(PUBLISHED, *map(around, centre), np.full(draws, 1.0 / draws), reward=reward)


@st.composite
def doubts(draw, max_draws=5, max_events=4):
    """A schedule under a few draws that want different plans."""
    draws = contested(draw(st.integers(0, 10_000)), draw(st.integers(1, max_draws)), draw(st.integers(1, 3)))
    letters = draw(st.text("HR", min_size=1, max_size=max_events))
    return Schedule.of(draws, letters, draw(st.sampled_from([1.0, 0.9])))


def constant(schedule, helping="help", signalling="signal", name="constant"):
    actions = {"human_needs_help": helping, "robot_needs_help": signalling}
    return NextStudy(name, (Arm.constant(PUBLISHED, schedule, actions),))


@st.composite
def next_studies(draw, max_events=2):
    """A study of one or two arms, constant, listed or random."""
    arms = []
    for _ in range(draw(st.integers(1, 2))):
        letters = draw(st.text("HR", min_size=1, max_size=max_events))
        if draw(st.booleans()):
            arms.append(Arm.random(PUBLISHED, letters, {"help": 0.25, "no_help": 0.75}))
        else:
            modes = PUBLISHED.modes_from_letters(letters)
            actions = [draw(st.sampled_from([a.name for a in m.actions])) for m in modes]
            arms.append(Arm.listed(PUBLISHED, letters, actions))
    return NextStudy.of_arms("a study", arms, [1.0, 2.0][: len(arms)])
