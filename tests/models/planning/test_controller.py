"""Finite-state controllers: compiled from alpha vectors, valued exactly in any model."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.alpha_policy import AlphaPolicy
from models.planning.baselines import Reciprocal, always, myopic, never, uniformly_random
from models.planning.controller import FiniteStateController, controller_of
from models.planning.evaluation import evaluate_schedule
from models.planning.finite_memory import infinite_value
from models.planning.latent import latent_problem
from models.planning.mode_process import alternating, bernoulli
from models.planning.policies import Vocabulary
from models.planning.problems import tag
from models.planning.solver import solve
from models.planning.textbook import textbook_problem
from models.protocol import PUBLISHED
from tests.models.planning.policy_cases import alpha, person, policy, problem
from tests.models.planning.schedule_cases import random_model

HUMAN, ROBOT = 0, 1


def by_sweeps(p, world, horizon=400):
    """Value of a finite-memory policy by plain recursion on (memory, belief-free joint vectors)."""
    holds = {}
    for x, share, belief in world.starts():
        holds[p.begin(x)] = share * belief
    total, weight = 0.0, 1.0
    for _ in range(horizon):
        after = {}
        for memory, joint in holds.items():
            x = p.mode_of(memory)
            for c, share in enumerate(p.probabilities(memory)):
                if share == 0:
                    continue
                total += weight * share * float(joint @ world.choices[x][c].reward)
                for branch in world.choices[x][c].branches:
                    for j, o in enumerate(branch.observations):
                        reached = share * (joint @ branch.transition)
                        if branch.emission is not None:
                            reached = reached * branch.emission[:, [j]].toarray().ravel()
                        if reached.any():
                            key = p.observe(memory, c, o, branch.mode)
                            after[key] = after.get(key, 0.0) + reached
        holds, weight = after, weight * world.discount
    return total


@pytest.mark.parametrize("kind", ["always", "never", "reactive", "literal", "random", "controller"])
def test_value_by_linear_solve_is_that_of_sweeps(kind):
    found = infinite_value(policy(kind), problem())
    assert found.value == pytest.approx(by_sweeps(policy(kind), problem()), rel=1e-9)
    assert found.error < 1e-8
    assert sum(found.frequencies.values()) == pytest.approx(1)
    assert f"{found.value:.4g}" in found.sentence
    assert len(found.table) == 1
    assert sum(found.by_start.values()) == pytest.approx(found.value)


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1))
def test_controller_keeps_what_its_vectors_promise(seed):
    world = latent_problem(random_model(np.random.default_rng(seed), PUBLISHED, 3), alternating(PUBLISHED), 0.8)
    solution = solve(world)
    compiled = controller_of(solution.policy)
    value = infinite_value(compiled, world).value
    slack = 1e-9 * max(1, abs(solution.upper))
    assert solution.lower - slack <= value <= solution.upper + slack
    assert compiled.n_nodes <= solution.alpha_vectors


@settings(max_examples=8)
@given(st.integers(0, 2**32 - 1))
def test_no_policy_is_worth_more_than_the_upper_bound(seed):
    model = random_model(np.random.default_rng(seed), PUBLISHED, 3)
    world = latent_problem(model, bernoulli(PUBLISHED, 0.4), 0.8)
    upper = solve(world).upper
    for p in (always(PUBLISHED), never(PUBLISHED), Reciprocal(PUBLISHED), uniformly_random(PUBLISHED)):
        assert infinite_value(p, world).value <= upper + 1e-9 * max(1, abs(upper))


def test_value_in_another_model():
    """Long discounted schedules: the exact sum over histories, in a model the controller was not made for."""
    other = random_model(np.random.default_rng(3), PUBLISHED, 4)
    world = latent_problem(other, alternating(PUBLISHED, "H"), 0.9)
    compiled = policy("controller")
    found = infinite_value(compiled, world)
    short = evaluate_schedule(compiled, other, "HR" * 12, 0.9)
    rest = 0.9**24 * np.abs(other.reward_table()).max() / 0.1
    assert abs(found.value - short.value) <= rest
    assert found.value == pytest.approx(by_sweeps(compiled, world), rel=1e-9)


def test_textbook_problem_and_many_modes():
    listen, door = np.eye(2), np.full((2, 2), 0.5)
    hear = [[0.85, 0.15], [0.15, 0.85]]
    tiger = textbook_problem(
        [listen, door, door], [hear, door, door], [[-1, -1], [-100, 10], [10, -100]], 0.95,
        observations=("left", "right"), actions=("listen", "open_left", "open_right"),
    )  # fmt: skip
    solution = solve(tiger, 1e-5)
    value = infinite_value(controller_of(solution.policy), tiger).value
    assert solution.lower - 1e-9 <= value <= solution.upper + 1e-9
    assert value == pytest.approx(19.3714, rel=1e-4)


def test_pruned_to_what_is_reached():
    compiled = policy("controller")
    n = compiled.n_nodes
    more = FiniteStateController(
        compiled.vocabulary, np.append(compiled.mode, HUMAN), np.append(compiled.choice, 0),
        np.concatenate([compiled.follow, np.full((1, *compiled.follow.shape[1:]), -1)]), compiled.start,
    )  # fmt: skip
    assert more.n_nodes == n + 1
    again = more.reachable()
    assert again.n_nodes == n
    assert np.array_equal(again.follow, compiled.follow)


def test_start_in_a_belief_of_ones_own():
    a = alpha()
    compiled = controller_of(a, {ROBOT: [0, 0, 1], HUMAN: [1, 0, 0]})
    assert compiled.start.min() >= 0
    sure = problem().started([np.zeros(3), np.array([0.0, 0.0, 1.0])])
    assert infinite_value(compiled, sure).value >= a.value([0, 0, 1], ROBOT) - 1e-9


def test_where_nothing_follows():
    for impossible in ("error", "keep", "reset"):
        compiled = controller_of(alpha(), impossible=impossible)
        memory = compiled.begin(ROBOT)
        if impossible == "error":
            with pytest.raises(InputError, match="nothing follows 'none' with mode 'human_needs_help'"):
                compiled.observe(memory, 0, 0, HUMAN)
            with pytest.raises(InputError, match="a response not recorded"):
                compiled.observe(memory, 0, None, HUMAN)
        elif impossible == "keep":
            assert compiled.mode_of(compiled.observe(memory, 0, None, HUMAN)) == HUMAN
        else:
            after = compiled.observe(memory, 0, 1, HUMAN)
            assert compiled.observe(after, 0, None, ROBOT) == compiled.begin(ROBOT)


# -- refusals ------------------------------------------------------------------------------------------------------
def test_discount_one_has_no_value_without_horizon():
    with pytest.raises(InputError, match=r"interaction, discount: found 1\.0, wanted below 1"):
        infinite_value(never(PUBLISHED), problem().with_discount(1.0))


def test_beliefs_are_no_finite_memory(monkeypatch):
    import models.planning.finite_memory as module

    monkeypatch.setattr(module, "MOST_MEMORIES", 200)
    with pytest.raises(InputError, match="found more than 200 memories, wanted a finite memory"):
        infinite_value(myopic(person()), problem())


def test_other_names():
    other = textbook_problem([np.eye(2)], [np.eye(2)], [[0, 1]], 0.9)
    with pytest.raises(InputError, match="modes, actions and observations"):
        infinite_value(never(PUBLISHED), other)


def test_vectors_without_followers():
    a = alpha()
    with pytest.raises(InputError, match="follow: found None"):
        controller_of(AlphaPolicy(problem(), a.alpha, a.mode, a.choice))


def test_arrays_that_do_not_fit():
    words = Vocabulary.of(PUBLISHED)
    follow = np.full((2, 2, 3), -1)
    good = {"mode": [0, 1], "choice": [0, 0], "follow": follow, "start": [0, 1]}
    FiniteStateController(words, **good)
    stray = follow.copy()
    stray[0, 1, 0] = 0
    for change, message in (
        ({"mode": [0, 3]}, "node 1, mode: found 3"),
        ({"choice": [0, 2]}, "node 1, choice: found 2"),
        ({"start": [1, 1]}, "start node in mode human_needs_help: found 1"),
        ({"start": [0]}, "start nodes"),
        ({"follow": stray}, "followers in mode robot_needs_help: found 0"),
        ({"follow": follow[:1]}, "at least one node"),
        ({"impossible": "no"}, "impossible observations: found 'no'"),
    ):
        with pytest.raises(InputError, match=message):
            FiniteStateController(words, **{**good, **change})


@pytest.mark.slow
def test_tag_controller():
    world = tag()
    solution = solve(world, time_limit=10)
    value = infinite_value(controller_of(solution.policy), world).value
    assert solution.lower - 1e-6 <= value <= solution.upper + 1e-6
