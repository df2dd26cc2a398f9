"""Controllers of draws: smallest of their behaviour, equal ones found once, worth what they are worth elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.alpha_policy import AlphaPolicy
from models.planning.baselines import always, baselines, uniformly_random
from models.planning.controller import controller_of
from models.planning.finite_memory import infinite_value
from models.planning.solver import solve
from models.protocol import PUBLISHED
from models.reward import Reward, default_x
from models.robust.candidates import posterior_mean
from models.robust.controller_values import value_matrix
from models.robust.controllers import by_mode, merged, of_draw, own_controllers
from models.robust.named_controllers import NODES, baseline_controllers, model_controller, policy_controller
from tests.models.robust.endless_cases import batches, doubled, random_controller, solved
from tests.reference.controllers import same_behaviour


@given(batches(), st.integers(0, 8), st.integers(0, 2**32 - 1))
def test_the_smallest_of_its_behaviour(batch, nodes, seed):
    rng = np.random.default_rng(seed)
    controller = random_controller(batch, rng, nodes)
    small = controller.compact()
    for i in range(small.n_nodes):
        for j in range(i):
            assert not same_behaviour(small, i, j)
    again = small.compact()
    assert again.key == small.key
    assert doubled(controller, rng).compact().key == small.key
    plain, smaller = value_matrix(batch, [controller, small]).values
    np.testing.assert_allclose(plain, smaller, rtol=0, atol=1e-9 * max(1, np.abs(plain).max()))


def test_nodes_are_numbered_as_they_are_met():
    follow = np.array([[2, 2], [0, -1], [3, 1], [2, 2]], dtype=np.int32)
    kept, number = merged(np.array([0, 1, 2, 0]), follow, np.array([-1, 3]))
    # From node 3 to 2, from there to 3 and 1, from 1 to 0, which acts like 3.
    np.testing.assert_array_equal(kept, [3, 2, 1])
    np.testing.assert_array_equal(number, [0, 2, 1, 0])


def test_own_controllers_share_the_weight():
    s = solved()
    own = own_controllers(s)
    assert len({c.key for c in own.controllers}) == len(own.controllers) < len(s.solutions)
    assert own.shares.sum() == pytest.approx(1, abs=1e-12)
    assert np.all(np.diff(own.shares) <= 0)
    for d in range(len(s.solutions)):
        assert of_draw(s.batch, d, s.solutions[d]).key == own.controllers[own.which[d]].key


@pytest.mark.parametrize("kind", ["alternating", "bernoulli", "table"])
def test_own_controllers_are_worth_what_their_draw_promises(kind):
    s = solved(12, 3, kind)
    own = own_controllers(s)
    values = value_matrix(s.batch, own.controllers).values[own.which, np.arange(12)]
    assert np.all(values >= s.lower - 1e-9 * np.abs(s.lower))
    assert np.all(values <= s.upper + 1e-7 * np.abs(s.upper))


def test_a_controller_for_the_robot():
    s = solved()
    own = own_controllers(s)
    for c in own.controllers[:6]:
        policy = c.policy(s.batch)
        values = value_matrix(s.batch, [c]).values[0]
        for d in range(0, 24, 6):
            assert infinite_value(policy, s.batch.problem(d)).value == pytest.approx(values[d], abs=1e-9)
    with pytest.raises(InputError, match="actions left to chance"):
        by_mode(s.batch.template, {0: [0.5, 0.5], 1: [1, 0]}, s.batch.process.start, "x").policy(s.batch)


def test_the_same_as_the_planner_compiles():
    s = solved()
    for d in range(0, 24, 5):
        problem, own = s.batch.problem(d), s.solutions[d]
        theirs = controller_of(AlphaPolicy(problem, own.alpha, own.mode, own.choice, own.follow))
        ours = of_draw(s.batch, d, own)
        assert ours.n_nodes <= theirs.n_nodes
        value = value_matrix(s.batch, [ours]).values[0]
        for other in (d, (d + 7) % 24):
            expected = infinite_value(theirs, s.batch.problem(other)).value
            assert value[other] == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("kind", ["alternating", "bernoulli"])
def test_baselines(kind):
    s = solved(12, 3, kind)
    model = posterior_mean(s.batch.draws)
    found = baseline_controllers(s.batch, model)
    assert [name.split(" (")[0] for name in found] == [p.name for p in baselines(model)]
    values = dict(zip(found, value_matrix(s.batch, list(found.values())).values, strict=True))
    for policy in baselines(model):
        if policy.name != "myopic":  # what beliefs reach has no end: the controller is near the policy only
            for d in (0, 5):
                exact = infinite_value(policy, s.batch.problem(d)).value
                assert values[policy.name][d] == pytest.approx(exact, abs=1e-9)
    assert not found["random"].certain
    assert found["reactive"].certain


def test_a_myopic_robot_that_never_acts():
    batch = solved().batch
    dear = Reward(default_x(3), costs={"help": 1e3, "signal": 1e3})
    found = baseline_controllers(batch.with_reward(dear), replace(batch.draws.model(0), reward=dear))
    myopic = next(c for name, c in found.items() if name.startswith("myopic"))
    assert myopic.key == found["never"].key
    assert myopic.n_nodes == 2


def test_beliefs_merged_coarsely_are_named_so():
    s = solved(12, 3, "bernoulli")
    found = policy_controller(s.batch, baselines(s.batch.draws.model(0))[2])
    assert found.n_nodes <= NODES
    assert found.name.startswith("myopic (beliefs to 0.")


def test_a_mode_policy_two_ways():
    s = solved()
    t, start = s.batch.template, s.batch.process.start
    same = by_mode(t, {0: [0, 1], 1: [0, 1]}, start, "x"), by_mode(t, {0: [0.5, 0.5], 1: [0.5, 0.5]}, start, "y")
    assert same[0].key == policy_controller(s.batch, always(PUBLISHED)).key
    assert same[1].key == policy_controller(s.batch, uniformly_random(PUBLISHED)).key


def test_a_policy_on_beliefs_becomes_a_controller_close_to_it():
    """Following the best look-ahead of an optimal policy is worth its value, up to what merging beliefs costs."""
    s = solved()
    problem = s.batch.problem(3)
    solution = solve(problem, 1e-5)
    controller = policy_controller(s.batch, solution.policy)
    value = value_matrix(s.batch, [controller]).values[0, 3]
    assert value <= solution.upper + 1e-9 * abs(solution.upper)
    assert value >= solution.lower - 1e-3 * abs(solution.lower)


def test_one_model_plugged_in():
    s = solved()
    model = s.batch.draws.model(2)
    controller = model_controller(s.batch, model, "second", 1e-5)
    value = value_matrix(s.batch, [controller]).values[0, 2]
    exact = solve(s.batch.problem(2), 1e-5)
    assert exact.lower - 1e-4 * abs(exact.lower) <= value <= exact.upper + 1e-9 * abs(exact.upper)
    with pytest.raises(InputError, match="model other: found 2 states"):
        model_controller(s.batch, solved(3, 2).batch.draws.model(0), "other")
