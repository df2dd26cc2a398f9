"""Random schedules under random models, for property tests."""

import numpy as np
from hypothesis import strategies as st

from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.schedule import Schedule
from models.reward import Reward
from tests.random_cases import protocols, random_tables


def random_model(rng, protocol, n_states, zeros=0.0):
    costs = {a: float(rng.uniform(-1, 3)) for a in protocol.action_names}
    reward = Reward(tuple(np.sort(rng.uniform(0, 3, n_states)).tolist()), 0.8, costs)
    return LatentStatePOMDP(*random_tables(rng, protocol, n_states, zeros), protocol, reward=reward)


def telling_tables(rng, protocol, n_states):
    """Responses that tell much of the state, and actions that move it surely: plans that depend on responses."""

    def sure(*shape):
        table = np.full(shape, 0.1 / shape[-1])
        place = rng.integers(shape[-1], size=shape[:-1])
        np.put_along_axis(table, place[..., None], 0.9 + 0.1 / shape[-1], axis=-1)
        return table

    e, n = len(protocol.emission_actions), n_states
    return rng.dirichlet(np.full(n, 5.0)), sure(protocol.n_actions, n, n), sure(e, n, protocol.n_responses)


@st.composite
def schedules(draw, *, max_events=4, max_states=3, max_draws=3, zeros=0.2) -> Schedule:
    protocol = draw(protocols())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, d = draw(st.integers(1, max_states)), draw(st.integers(1, max_draws))
    telling = draw(st.booleans())
    reward = random_model(rng, protocol, n).reward
    if telling:
        reward = Reward(reward.x, 1.2, {a: 0.1 * c for a, c in reward.costs.items()})
    models = []
    for _ in range(d):
        tables = telling_tables(rng, protocol, n) if telling else random_tables(rng, protocol, n, zeros)
        models.append(LatentStatePOMDP(*tables, protocol, reward=reward))
    weight = rng.dirichlet(np.ones(d))
    modes = tuple(draw(st.lists(st.integers(0, len(protocol.modes) - 1), min_size=1, max_size=max_events)))
    terminal = rng.normal(size=n) if draw(st.booleans()) else None
    discount = draw(st.sampled_from([1.0, 0.8, 0.0]))
    return Schedule(ModelDraws.from_models(models, weight), modes, discount, terminal)
