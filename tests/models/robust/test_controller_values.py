"""The value matrix: the same as dense systems, in any chunks and on any executor."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.batch import solve_draws
from models.planning.latent import LatentBatch
from models.robust import controller_values as module
from models.robust.controller_values import value_matrix
from models.robust.elimination import elimination
from tests.models.robust.endless_cases import batches, random_controller, solved
from tests.planning_cases import mode_processes, sticky_draws
from tests.reference.controllers import controller_value


@given(batches(), st.integers(0, 12), st.integers(0, 2**32 - 1))
def test_dense_systems(batch, nodes, seed):
    rng = np.random.default_rng(seed)
    controllers = [random_controller(batch, rng, n) for n in (0, nodes)]
    found = value_matrix(batch, controllers)
    for p, controller in enumerate(controllers):
        expected = [controller_value(batch, controller, d) for d in range(len(batch))]
        np.testing.assert_allclose(found.values[p], expected, rtol=1e-10, atol=1e-9)
    assert found.error <= 1e-9 * max(1, np.abs(found.values).max())


def test_a_long_horizon_and_many_nodes():
    """Near discount one, with a controller whose elimination fills in."""
    batch = LatentBatch(sticky_draws(5, 2, 4), mode_processes()["bernoulli"], 0.9999)
    controller = random_controller(batch, np.random.default_rng(3), 40)
    assert elimination(batch.template, controller).blocks > 4 * controller.n_nodes
    found = value_matrix(batch, [controller])
    expected = [controller_value(batch, controller, d) for d in range(5)]
    np.testing.assert_allclose(found.values[0], expected, rtol=1e-10)


def test_values_by_playing_on():
    """The value of a controller is what its rewards add up to: the chain of nodes and states, step by step."""
    s = solved(6)
    batch = s.batch
    controller = random_controller(batch, np.random.default_rng(0), 4, mixed=0.0)
    value = value_matrix(batch, [controller]).values[0]
    policy = controller.policy(batch)
    for d in range(3):
        model = batch.draws.model(d)
        reward = model.reward_table()
        level = {0: (policy.begin(0), model.initial)}
        level = {level[0][0]: level[0][1]}
        total = 0.0
        for k in range(250):
            after: dict = {}
            for memory, w in level.items():
                choice = policy.act(memory)
                a = batch.template.mode_choice[memory.mode] + choice
                total += batch.discount**k * float(w @ reward[a])
                row = model.emission_index[a]
                for o in [None] if row < 0 else range(2):
                    moved = (w if o is None else w * model.emission[row, :, o]) @ model.transition[a]
                    node = policy.observe(memory, choice, 0 if o is None else o + 1, 1 - memory.mode)
                    after[node] = after.get(node, 0) + moved
            level = after
        assert total == pytest.approx(value[d], rel=1e-9)


def test_chunks_and_executors_change_nothing(monkeypatch):
    batch = solved().batch
    pool = [random_controller(batch, np.random.default_rng(i), 5) for i in range(3)]
    seen = []
    plain = value_matrix(batch, pool, progress=lambda done, total: seen.append((done, total)))
    assert seen == [(1, 1)]
    monkeypatch.setattr(module, "CHUNK", 7)
    with ThreadPoolExecutor(2) as threads:
        np.testing.assert_array_equal(plain.values, value_matrix(batch, pool, threads).values)
    # What is handed to other processes can be pickled.
    pickle.loads(pickle.dumps((module._evaluate, [elimination(batch.template, c) for c in pool])))


def test_refusals():
    batch = solved().batch
    controller = random_controller(batch, np.random.default_rng(0), 2)
    with pytest.raises(InputError, match="discount of the batch: found 1"):
        value_matrix(replace(batch, discount=1.0), [controller])
    other = replace(batch, process=mode_processes()["bernoulli"])
    with pytest.raises(InputError, match="start node in mode robot_needs_help: found -1"):
        value_matrix(other, [controller])
    assert value_matrix(batch, []).values.shape == (0, 24)


@pytest.mark.slow
def test_a_whole_posterior_in_a_second():
    import time

    batch = LatentBatch(sticky_draws(4000, 1, 4), mode_processes()["alternating"], 0.95)
    few = LatentBatch(batch.draws.thin(30), batch.process)
    pool = [random_controller(batch, np.random.default_rng(i), 6, mixed=0.0).compact() for i in range(30)]
    solve_draws(few, 1e-2, threads=1)
    value_matrix(few, pool[:1])
    began = time.process_time()
    value_matrix(batch, pool)
    assert time.process_time() - began < 2
