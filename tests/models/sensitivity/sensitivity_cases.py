"""Random draws and rewards for the tests of decisions."""

import numpy as np
from hypothesis import strategies as st

from models.model_draws import ModelDraws
from models.protocol import PUBLISHED
from models.reward import Reward
from models.sensitivity.cases import Cases
from tests.planning_cases import sticky_model
from tests.random_cases import protocols, random_tables


def some_draws(seed, count=3, states=3, protocol=PUBLISHED):
    rng = np.random.default_rng(seed)
    tables = [random_tables(rng, protocol, states) for _ in range(count)]
    weight = rng.dirichlet(np.ones(count))
    return ModelDraws(protocol, *(np.stack(t) for t in zip(*tables, strict=True)), weight / weight.sum())


def people(seed, count=3, states=3):
    rng = np.random.default_rng(seed)
    return ModelDraws.from_models([sticky_model(rng, states) for _ in range(count)])


def some_rewards(seed, draws, count=3):
    rng = np.random.default_rng(seed)
    x = np.sort(rng.uniform(40, 70, draws.n_states))
    names = draws.protocol.action_names
    return [
        Reward(tuple(x), float(rng.uniform(0, 0.09)), {a: float(rng.uniform(0, 20)) for a in names})
        for _ in range(count)
    ]


def cases_of(draws, rewards, discount=1.0):
    return Cases.of(draws.n_draws, rewards, draws.protocol, discount)


@st.composite
def settings(draw, max_states=3):
    """Draws of a random protocol, rewards, discount."""
    protocol = draw(protocols())
    seed = draw(st.integers(0, 2**32 - 1))
    draws = some_draws(seed, draw(st.integers(1, 3)), draw(st.integers(2, max_states)), protocol)
    return draws, some_rewards(seed + 1, draws, 2), draw(st.sampled_from([0.0, 0.5, 0.95, 1.0]))
