"""What actions are worth: every source against direct evaluation of 'do that, then follow the policy'."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.baselines import Reciprocal, myopic, uniformly_random
from models.planning.controller import FiniteStateController, controller_of
from models.planning.exact import solve_schedule
from models.planning.finite_memory import infinite_value
from models.planning.latent import latent_problem
from models.planning.mode_process import alternating, bernoulli
from models.planning.plan_policy import PlanPolicy
from models.planning.schedule import Schedule
from models.planning.schedule_vectors import schedule_vectors
from models.protocol import PUBLISHED
from models.safeguards.controller_worth import ControllerWorth
from models.safeguards.schedule_worth import ScheduleWorth
from models.safeguards.worth import OwnWorth, VectorWorth, own_worth
from tests.models.planning.policy_cases import alpha, policy
from tests.models.planning.schedule_cases import schedules
from tests.models.safeguards.guard_cases import HELP, HUMAN, NONE, ROBOT, direct_worth, doubt, rounds, walked


def followed(source, policy, s, history):
    """State and memory of a source after a history."""
    memory = policy.begin(s.modes[0])
    state = source.begin(memory)
    for k, (choice, seen) in enumerate(history):
        after = policy.observe(memory, choice, seen, s.modes[k + 1])
        state = source.observe(state, s.modes[k], choice, seen, after)
        memory = after
    return state, memory


def same(found, direct):
    values, weight, belief = direct
    held = weight > 1e-14
    assert found.weight == pytest.approx(weight)
    assert found.belief[held] == pytest.approx(belief[held])
    assert found.values[held] == pytest.approx(values[held], abs=1e-9)


@given(
    schedules(max_events=4, zeros=0.0),
    st.integers(0, 2**32 - 1),
    st.sampled_from(["plan", "myopic", "random", "rule"]),
)
def test_schedule_worth_is_direct_evaluation(s, seed, kind):
    rng = np.random.default_rng(seed)
    if kind == "plan":
        own = PlanPolicy.of(solve_schedule(s))
    elif kind == "myopic":
        own = myopic(s.draws.model(0))
    elif kind == "rule" and all(len(m.actions) <= 2 for m in s.protocol.modes):
        own = Reciprocal(s.protocol)
    else:
        own = uniformly_random(s.protocol)
    source = ScheduleWorth(own, s)
    for steps in range(s.n_events):
        memory, history = walked(own, s, rng, steps)
        state, memory = followed(source, own, s, history)
        same(source.worth(state, memory), direct_worth(own, memory, s, history))


@given(schedules(max_events=4, zeros=0.0), st.integers(0, 2**32 - 1))
def test_vectors_say_the_same(s, seed):
    rng, own = np.random.default_rng(seed), schedule_vectors(s)
    by_vectors, by_walk = VectorWorth(own), ScheduleWorth(own, s)
    for steps in range(s.n_events):
        memory, history = walked(own, s, rng, steps)
        state, memory = followed(by_walk, own, s, history)
        found = by_vectors.worth(None, memory)
        # Vectors of equal mean worth may be told apart by draw; what they are worth together must agree.
        assert found.mean == pytest.approx(by_walk.worth(state, memory).mean, abs=1e-8)
        assert found.weight == pytest.approx(by_walk.worth(state, memory).weight)


def test_plan_and_vectors_agree_in_every_draw():
    s = rounds("HRHRHRHRH")
    own, plan = schedule_vectors(s), PlanPolicy.of(solve_schedule(s))
    source = ScheduleWorth(plan, s)
    rng = np.random.default_rng(1)
    for steps in range(9):
        memory, history = walked(own, s, rng, steps, overrule=0.2)
        state, place = followed(source, plan, s, history)
        found = VectorWorth(own).worth(None, memory)
        assert found.values == pytest.approx(source.worth(state, place).values, abs=1e-8)


def test_worth_ends_with_the_schedule():
    s = rounds("HR")
    own = schedule_vectors(s)
    source = ScheduleWorth(own, s)
    state, memory = followed(source, own, Schedule.of(doubt(), "HRH"), ((0, HELP), (1, NONE)))
    assert source.worth(state, memory) is None
    assert VectorWorth(own).worth(None, memory) is None


def test_a_response_that_no_draw_knows_is_passed_over():
    from models.lspomdp import LatentStatePOMDP

    sure = LatentStatePOMDP([0.4, 0.6], [np.eye(2)] * 4, [[[1.0, 0.0], [1.0, 0.0]]] * 2)
    s = Schedule.of(sure, "HRH")
    own = myopic(sure, impossible="keep")
    source = ScheduleWorth(own, s)
    state, memory = followed(source, own, s, ((0, HELP),))
    assert source.worth(state, memory).belief == pytest.approx(np.array([[0.4, 0.6]]))


# -- without horizon -----------------------------------------------------------------------------------------------
def first_forced(controller: FiniteStateController, mode, node, choice) -> FiniteStateController:
    """Does one thing first and then what follows it; where that is another one, as if its own had been done."""
    follow = np.concatenate([controller.follow, controller.follow[[node]]])
    start = controller.start.copy()
    start[mode] = controller.n_nodes
    return FiniteStateController(
        controller.vocabulary, [*controller.mode, mode], [*controller.choice, choice], follow, start,
        "keep", "forced",
    )  # fmt: skip


@pytest.mark.parametrize("process", [alternating(PUBLISHED, "H"), bernoulli(PUBLISHED, 0.4, "H")])
def test_controller_worth_is_that_of_the_controller_after_the_action(process):
    own, draws, discount = policy("controller"), doubt(3), 0.9
    own = FiniteStateController(own.vocabulary, own.mode, own.choice, _filled(own), own.start, "keep", own.name)
    source = ControllerWorth.of(own, draws, process, discount)
    mode = ROBOT
    memory = own.begin(mode)
    found = source.worth(source.begin(memory), memory)
    assert found.weight == pytest.approx(draws.weight)
    for c in range(2):
        forced = first_forced(own, mode, memory.node, c)
        for d in range(3):
            problem = latent_problem(draws.model(d), process, discount)
            assert found.values[d, c] == pytest.approx(infinite_value(forced, problem).value, rel=1e-9)


def _filled(controller):
    """Followers in modes that cannot follow under alternation: the first node of the mode."""
    follow = controller.follow.copy()
    for x in range(2):
        block = follow[:, x]
        block[block < 0] = int(np.flatnonzero(controller.mode == x)[0])
    return follow


def test_vectors_without_horizon_are_the_look_ahead_in_their_own_model():
    from models.model_draws import ModelDraws
    from tests.models.planning.policy_cases import person

    own = alpha()
    source = ControllerWorth.of(own, ModelDraws.from_models([person()]), alternating(PUBLISHED, "H"), 0.9)
    memory = own.begin(ROBOT)
    state = source.begin(memory)
    for seen, mode in ((HELP, HUMAN), (NONE, ROBOT)):
        found = source.worth(state, memory)
        wanted = own.action_values_many(memory.belief[None], memory.mode)
        assert found.belief[0] == pytest.approx(memory.belief)
        # Vectors bound what following them is worth from below, within the precision of the solver.
        assert np.all(found.values >= wanted - 1e-9)
        assert found.values == pytest.approx(wanted, rel=1e-3)
        after = own.observe(memory, 1, seen, mode)
        state, memory = source.observe(state, memory.mode, 1, seen, after), after


def test_controller_and_draws_must_fit():
    draws = doubt(2)
    process = alternating(PUBLISHED, "H")
    with pytest.raises(InputError, match="discount"):
        ControllerWorth(alpha(), draws, process.table, 1.0, np.zeros((2, len(alpha().alpha), 3)))
    with pytest.raises(InputError, match="vectors, shape"):
        ControllerWorth(alpha(), draws, process.table, 0.9, np.zeros((2, 1, 3)))
    with pytest.raises(InputError, match="alpha vectors or a controller"):
        ControllerWorth(policy("always"), draws, process.table, 0.9, np.zeros((2, 1, 3)))
    with pytest.raises(InputError, match="a controller, or alpha vectors"):
        ControllerWorth.of(policy("always"), draws, process, 0.9)


# -- what policies bring along -------------------------------------------------------------------------------------
def other_states():
    """Vectors of a model whose modes differ in their hidden states."""
    from dataclasses import replace

    from models.planning.alpha_policy import AlphaPolicy

    model = alpha().model
    names = (model.states[0], tuple(f"other {s}" for s in model.states[1]))
    return AlphaPolicy(replace(model, states=names), alpha().alpha, alpha().mode, alpha().choice)


def test_own_worth():
    own = alpha()
    memory = own.begin(HUMAN)
    found = own_worth(own)
    assert isinstance(found, OwnWorth)
    assert found.worth(None, memory).mean == pytest.approx(list(own.action_values(memory.belief, HUMAN).values()))
    assert isinstance(own_worth(schedule_vectors(rounds())), VectorWorth)
    assert own_worth(policy("always")) is None
    assert own_worth(other_states()) is None
    with pytest.raises(InputError, match="hidden states: found others by mode, wanted the same"):
        OwnWorth(other_states())
    with pytest.raises(InputError, match="a policy on beliefs"):
        OwnWorth(policy("always"))
    with pytest.raises(InputError, match="as schedule_vectors makes them"):
        VectorWorth(own)


def test_schedule_worth_needs_the_same_names():
    from tests.random_cases import make_protocol

    other = make_protocol([True], [2], 2)
    with pytest.raises(InputError, match="modes, actions and observations"):
        ScheduleWorth(uniformly_random(other), rounds())


def test_controller_worth_of_a_controller_of_vectors():
    own = controller_of(alpha())
    draws = doubt(2)
    found = ControllerWorth.of(own, draws, alternating(PUBLISHED, "H"), 0.9)
    assert found.vectors.shape == (2, own.n_nodes, 3)
