"""What every value must be: convex over beliefs, and at any history what plain enumeration says."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.model_draws import ModelDraws
from models.planning.alpha_policy import AlphaPolicy
from models.planning.exact import history_values, solve_schedule
from models.planning.plan_policy import PlanPolicy
from models.planning.schedule import Schedule
from models.planning.solver import solve
from tests.models.planning.schedule_cases import schedules
from tests.planning_cases import CASES, dense_problem, latent_case, modal_problem
from tests.reference.finite_horizon import policy_value
from tests.reference.planning import action_values

SEEDS = st.integers(0, 2**32 - 1)


def solved(seed):
    """A small problem of one of three kinds, its solution, and random numbers."""
    kinds = (
        lambda s: dense_problem(s, 3, 2, 2, 0.6), lambda s: modal_problem(s, (2, 3, 1), 0.6),
        lambda s: latent_case(s, "table", 3, 0.6),
    )  # fmt: skip
    rng = np.random.default_rng(seed)
    return (problem := kinds[seed % 3](seed % 997)), solve(problem, 1e-4), rng


def started(problem, mode, belief):
    """The same problem from a belief in a mode."""
    return problem.started([belief if x == mode else np.zeros(len(s)) for x, s in enumerate(problem.states)])


def slack(solution):
    return 1e-9 * max(1.0, abs(solution.lower), abs(solution.upper))


# -- convex over beliefs -------------------------------------------------------------------------------
@settings(max_examples=25)
@given(schedules(max_events=5), SEEDS, st.floats(0, 1))
def test_the_exact_value_is_convex_in_the_beliefs_of_all_draws(schedule, seed, t):
    """Policies are linear in the initial beliefs of the draws together, and the best of them is their maximum."""
    shape = (2, schedule.draws.n_draws)
    one, two = np.random.default_rng(seed).dirichlet(np.ones(schedule.n_states), size=shape)

    def value(initial):
        return solve_schedule(replace(schedule, draws=replace(schedule.draws, initial=initial))).value

    ends = (1 - t) * value(one) + t * value(two)
    assert value((1 - t) * one + t * two) <= ends + 1e-9 * max(1.0, abs(ends))


@settings(max_examples=12)
@given(SEEDS)
def test_vectors_bound_the_value_from_below_at_every_belief(seed):
    """Not only where the search began: the bound, its look-ahead, and the upper bound stand in order everywhere."""
    problem, solution, rng = solved(seed)
    policy = solution.policy
    mode = int(rng.integers(problem.n_modes))
    belief = rng.dirichlet(np.full(len(problem.states[mode]), 0.5))
    there = solve(started(problem, mode, belief), 1e-4)
    worth = policy.value(belief, mode)
    ahead = max(policy.action_values(belief, mode).values())
    assert worth <= ahead + slack(solution)
    assert ahead <= there.upper + slack(there)


@settings(max_examples=12)
@given(SEEDS, st.floats(0, 1))
def test_bounds_and_look_ahead_are_convex(seed, t):
    problem, solution, rng = solved(seed)
    policy = solution.policy
    mode = int(rng.integers(problem.n_modes))
    one, two = rng.dirichlet(np.full(len(problem.states[mode]), 0.5), size=2)
    mixed = (1 - t) * one + t * two
    vectors = policy.values_many(np.stack([one, two, mixed]), mode)
    actions = policy.action_values_many(np.stack([one, two, mixed]), mode)
    for at in (vectors, actions.max(axis=1), *actions.T):
        assert at[2] <= (1 - t) * at[0] + t * at[1] + slack(solution)
    ends = [solve(started(problem, mode, b), 1e-4) for b in (one, two)]
    between = solve(started(problem, mode, mixed), 1e-4)
    assert between.lower <= (1 - t) * ends[0].upper + t * ends[1].upper + slack(between)


# -- at any history ------------------------------------------------------------------------------------
def posterior(schedule, choices, responses):
    """P(draw, state | history) by a sum over every path of states, or None for a history that cannot be."""
    joint = np.zeros((schedule.draws.n_draws, schedule.n_states))
    for d, path in product(
        range(len(joint)), product(range(schedule.n_states), repeat=len(choices) + 1)
    ):  # fmt: skip
        chance = schedule.draws.weight[d] * schedule.draws.initial[d, path[0]]
        for k, (c, seen) in enumerate(zip(choices, responses, strict=True)):
            a = schedule.first_action(k) + c
            row = schedule.protocol.emission_index[a]
            chance *= schedule.draws.transition[d, a, path[k], path[k + 1]]
            chance *= 1.0 if row < 0 or seen is None else schedule.draws.emission[d, row, path[k], seen]
        joint[d, path[-1]] += chance
    return joint / joint.sum() if joint.sum() > 0 else None


def from_here(schedule, joint, k):
    """The rest of a schedule from what is known of draw and state."""
    weight = joint.sum(axis=1)
    sure = weight > 0
    d = schedule.draws
    draws = ModelDraws(
        d.protocol, joint[sure] / weight[sure, None], d.transition[sure], d.emission[sure], weight[sure],
        reward=d.reward,
    )  # fmt: skip
    return Schedule(draws, schedule.modes[k:], schedule.discount, schedule.terminal)


def best_with_first(rest, choice):
    """Value of the best of all policies that begin with a choice, each followed path by path."""
    shown = [rest.mode(k).shows_response for k in range(rest.n_events)]
    tables = []
    for k in range(rest.n_events):
        histories = list(product(range(rest.protocol.n_responses), repeat=sum(shown[:k])))
        actions = range(len(rest.mode(k).actions)) if k else [choice]
        tables.append([dict(zip(histories, t, strict=True)) for t in product(actions, repeat=len(histories))])
    return max(policy_value(rest, policy) for policy in product(*tables))


@settings(max_examples=30)
@given(schedules(max_events=3, max_states=2, max_draws=2), st.data())
def test_exact_values_after_any_history_are_those_of_the_best_of_all_policies(schedule, data):
    """Histories that the plan would never make included; beliefs by sums over paths of states."""
    past = data.draw(st.integers(0, schedule.n_events - 1))
    choices, responses, named = [], [], []
    for k in range(past):
        mode = schedule.mode(k)
        choices.append(data.draw(st.integers(0, len(mode.actions) - 1)))
        kinds = [None, *range(schedule.protocol.n_responses)] if mode.shows_response else [None]
        responses.append(data.draw(st.sampled_from(kinds)))
        seen = responses[-1]
        names = schedule.protocol.response_names
        named.append((mode.actions[choices[-1]].name, None if seen is None else names[seen]))
    joint = posterior(schedule, choices, responses)
    if joint is None:
        return
    rest = from_here(schedule, joint, past)
    branching = sum(
        np.log(max(1, len(rest.mode(k).actions))) * rest.protocol.n_responses**k for k in range(1, rest.n_events)
    )
    if branching > np.log(3000):
        rest_values = solve_schedule(rest).first_values
    else:
        rest_values = [best_with_first(rest, c) for c in range(len(rest.mode(0).actions))]
    found = history_values(schedule, named)
    assert list(found.values()) == pytest.approx(rest_values, rel=1e-9, abs=1e-9)
    plan = PlanPolicy.of(solve_schedule(schedule))
    memory = plan.memory_after(tuple(named))
    best = max(rest_values)
    assert rest_values[plan.act(memory)] == pytest.approx(best, rel=1e-9, abs=1e-9)


def joint_after(problem, start, steps):
    """Unnormalised P(history, hidden state) from dense tables, one step after the other."""
    mode, joint = start
    for choice, seen, after in steps:
        reached = np.zeros(len(problem.states[after]))
        for branch in problem.choices[mode][choice].branches:
            for j, o in enumerate(branch.observations):
                if (branch.mode, o) == (after, seen):
                    table = branch.transition.toarray()
                    if branch.emission is not None:
                        table = table * branch.emission.toarray()[:, j]
                    reached += joint @ table
        mode, joint = after, reached
    return mode, joint


@settings(max_examples=20)
@given(SEEDS)
def test_action_values_after_any_history_stay_below_brute_force(seed):
    """Any choices and whatever they may lead to, five steps deep: memory, belief and values by other means.

    Five rounds of brute force and the most that can follow bound every policy's values from above.
    """
    problem, solution, rng = solved(seed)
    policy: AlphaPolicy = solution.policy
    starts = list(problem.starts())
    mode, _, belief = starts[int(rng.integers(len(starts)))]
    memory, start, steps = policy.begin(mode), (mode, belief), []
    for _ in range(int(rng.integers(6))):
        mode, joint = joint_after(problem, start, steps)
        choice = int(rng.integers(len(problem.choices[mode])))
        options = problem.outcomes(mode, choice, joint / joint.sum())
        after, seen, _, _ = options[int(rng.integers(len(options)))]
        memory = policy.observe(memory, choice, seen, after)
        steps.append((choice, seen, after))
    mode, joint = joint_after(problem, start, steps)
    belief = joint / joint.sum()
    assert policy.mode_of(memory) == mode
    assert policy.belief_of(memory) == pytest.approx(belief, abs=1e-10)
    found = list(policy.action_values(belief, mode).values())
    horizon = 3
    most = max(float(np.max(c.reward)) for offered in problem.choices for c in offered)
    later = problem.discount**horizon * most / (1 - problem.discount)
    wanted = np.array(action_values(problem, mode, belief, horizon)) + later
    assert np.all(np.array(found) <= wanted + slack(solution))
    # One step by hand: the reward, and after every outcome the best of the vectors.
    for c, choice in enumerate(problem.choices[mode]):
        worth = float(belief @ choice.reward)
        for after, _, p, reached in problem.outcomes(mode, c, belief):
            own = solution.alpha[solution.mode == after, : len(reached)]
            worth += problem.discount * p * float(np.max(own @ reached))
        assert found[c] == pytest.approx(worth, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("name", CASES)
def test_the_value_at_the_start_is_its_look_ahead(name):
    """At the start both bounds are within the precision, so the best action value lies between them as well."""
    problem = CASES[name]
    solution = solve(problem, 1e-3)
    total = sum(p * max(solution.policy.action_values(b, x).values()) for x, p, b in problem.starts())
    assert solution.lower - slack(solution) <= total <= solution.upper + slack(solution)
