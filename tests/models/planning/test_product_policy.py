"""Vectors over product modes as a policy: the interface, files and what they must refuse, numpy alone, speed."""

import copy
import json
import subprocess
import sys
import time
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.budget_problem import budget_problem
from models.planning.evaluation import evaluate_schedule
from models.planning.mode_process import alternating, bernoulli, schedule_modes
from models.planning.policy_files import policy_from_dict, policy_to_dict, read_policy, write_policy
from models.planning.product_policy import ProductPolicy
from models.planning.schedule import Schedule
from models.planning.schedule_vectors import schedule_vectors
from models.planning.solver import solve
from models.protocol import PUBLISHED
from tests.models.planning.policy_cases import SCHEDULE, person
from tests.models.planning.policy_conformance import conforms
from tests.planning_cases import sticky_draws


def endless(budget=30, process=None):
    problem, product = budget_problem(person(), process or alternating(PUBLISHED, "H"), 0.9, budget)
    return ProductPolicy.of(solve(problem).policy, product, person())


CASES = {
    "plain": lambda: schedule_vectors(Schedule.of(person(), SCHEDULE)),
    "ends with a reward": lambda: schedule_vectors(Schedule.of(person(), SCHEDULE, 0.9, terminal=[0.0, 5.0, 20.0])),
    "budget": lambda: schedule_vectors(Schedule.of(person(), SCHEDULE), 20),
    "draws": lambda: schedule_vectors(Schedule.of(sticky_draws(5, 3, 3), SCHEDULE)),
    "draws, budget": lambda: schedule_vectors(Schedule.of(sticky_draws(5, 3, 3), SCHEDULE), 15),
    "endless": endless,
}


@pytest.mark.parametrize("case", CASES)
def test_conformance(case, tmp_path):
    conforms(CASES[case](), person(), schedule_modes(PUBLISHED, SCHEDULE), tmp_path)


@pytest.mark.parametrize("case", CASES)
def test_files_hold_the_same_numbers(case):
    policy = CASES[case]()
    again = policy_from_dict(json.loads(json.dumps(policy_to_dict(policy))))
    assert np.array_equal(again.alpha, policy.alpha)
    memory = policy.begin(1)
    assert np.array_equal(again.action_values(again.begin(1)), policy.action_values(memory), equal_nan=True)
    assert again.n_draws == policy.n_draws == len(policy.weights_of(memory))


@pytest.mark.parametrize(("x", "r"), [([-3.0, -2.0, -1.0], 1e308), ([0.0, 1.0, 709.5], 1.0)])
def test_numbers_too_large_are_refused_without_a_warning(x, r):
    """Products that overflow, and sums of five rewards that do; warnings are errors in tests."""
    content = json.loads(json.dumps(policy_to_dict(CASES["plain"]())))
    content["models"]["reward"].update(x=x, r=r)
    with suppress(InputError):
        assert np.isfinite(policy_from_dict(content).alpha).all()


def test_draws_are_weighted_by_what_was_seen():
    draws = sticky_draws(6, 1, 3)
    schedule = Schedule.of(draws, SCHEDULE, weight=[0.5, 0, 0.2, 0.1, 0.1, 0.1])
    policy = schedule_vectors(schedule)
    memory = policy.begin(1)
    assert policy.weights_of(memory) == pytest.approx(schedule.draws.weight)
    memory = policy.observe(memory, 0, 2, 0)
    likelihood = np.einsum("ds,ds->d", draws.initial, draws.emission[:, 0, :, 1])
    wanted = schedule.draws.weight * likelihood
    assert policy.weights_of(memory) == pytest.approx(wanted / wanted.sum())
    assert not policy.draw_beliefs(memory)[1].any()
    assert not policy.draw_action_values(memory)[1].any()
    given_draw = draws.initial * draws.emission[:, 0, :, 1]
    given_draw = np.einsum("ds,dst->dt", given_draw / given_draw.sum(axis=1)[:, None], draws.transition[:, 2])
    assert policy.draw_beliefs(memory)[0] == pytest.approx(given_draw[0])


def test_beliefs_cannot_be_changed():
    policy = CASES["plain"]()
    for memory in (policy.begin(1), policy.observe(policy.begin(1), 0, 1, 0)):
        with pytest.raises(ValueError, match="read-only"):
            memory.belief[0] = 1.0


def test_why():
    policy = CASES["budget"]()
    memory = policy.begin(1)
    found = policy.why(memory)
    assert found.values == pytest.approx(
        dict(zip(("no_signal", "signal"), policy.action_values(memory), strict=True))
    )
    assert set(found.belief) == set(person().state_names)
    spent = policy.observe(memory, 1, None, 0)
    assert policy.why(spent).other is None
    assert "nothing else" in policy.reason(spent)


def test_runs_together_with_impossible_responses():
    from dataclasses import replace

    sure = replace(person(), emission=np.array([[[1.0, 0.0]] * 3, [[0.5, 0.5]] * 3]))
    policy = schedule_vectors(Schedule.of(sure, "HRH"), impossible="keep")
    together = policy.observe_many(
        policy.begin_many(np.array([1, 1])), np.array([0, 0]), np.array([1, 2]), np.array([0, 0])
    )
    alone = [policy.observe(policy.begin(1), 0, o, 0).belief for o in (1, 2)]
    assert together.belief == pytest.approx(np.array(alone))


def test_endless_follows_a_random_process():
    policy = endless(45, bernoulli(PUBLISHED, 0.3))
    rng = np.random.default_rng(0)
    for _ in range(30):
        memory, spent = policy.begin(int(rng.integers(2))), 0.0
        for _ in range(40):
            c = policy.act(memory)
            spent += 15.0 * c
            assert policy.left_of(memory) == 45 - spent + 15.0 * c
            seen = 0 if memory.mode == 0 else int(rng.integers(1, 3))
            memory = policy.observe(memory, c, seen, int(rng.integers(2)))
        assert spent <= 45


# -- what files must not hold --------------------------------------------------------------------------
def small():
    return policy_to_dict(schedule_vectors(Schedule.of(person(), "HRH"), 15))


def changed(path, value):
    content = copy.deepcopy(json.loads(json.dumps(small())))
    *way, last = path
    inner = content
    for key in way:
        inner = inner[key]
    inner[last] = value
    return content


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        (("models",), None, "policy, models: found NoneType, wanted an object"),
        (("models", "protocol"), 3, "models, protocol: found 3"),
        (("models", "states"), ["a", "a", "b"], "models, states"),
        (("models", "states"), ["a", "b"], "initial, states: found 3, wanted 2"),
        (("models", "weight"), [0.9], "sum of weights"),
        (("models", "weight"), ["1"], "models, weight"),
        (("models", "initial"), [[0.5, 0.5, 0.5]], "initial"),
        (("models", "transition"), [[[1.0]]], "models, transition"),
        (("models", "emission"), [[[[0.5, 0.4]] * 3] * 2], "emission"),
        (("models", "reward"), {}, "models, reward"),
        (("models", "reward", "x"), [1.0], "reward, x: found 1, wanted 3"),
        (("models", "reward", "costs"), {"wave": 1}, "wave"),
        (("models", "impossible"), "ignore", "wanted error, keep or reset"),
        (("discount",), 1.5, "discount: found 1.5"),
        (("discount",), True, "discount: found True"),
        (("mode",), [0.5], "policy, mode: found 0.5, wanted whole numbers"),
        (("mode",), [99], "policy, mode: found 99"),
        (("choice",), [0], "follow, shape"),
        (("choice", 0), 7, "choice: found 7, wanted one that is allowed there"),
        (("follow", 0, 0), 0, "followers"),
        (("follow", 0, 0), 10**9, "followers"),
        (("follow",), "all", "policy, follow: found 'all'"),
        (("terminal",), [1.0], "terminal, shape"),
        (("product",), [], "product: found list, wanted an object"),
        (("product", "names"), ["a"], "product, shape of mode"),
        (("product", "names", 1), "event 1, robot_needs_help, 15 left", "wanted a list of different names"),
        (("product", "mode", 0), 5, "product, mode: found 5"),
        (("product", "allowed", 0), [False, False], "allowed"),
        (("product", "allowed"), [[1, 1]], "product, allowed"),
        (("product", "chance", 0), [0.5, 0.4], "chance, sum: found '0.9'"),
        (("product", "chance", 0), [-1.0, 2.0], "chance"),
        (("product", "follow", 0, 0, 0), -1, "wanted a product mode: it is possible"),
        (("product", "follow", 0, 0, 0), 99, "product, follow: found 99"),
        (("product", "start"), [-1, -1], "wanted at least one mode to start in"),
        (("product", "start"), [0, -1], "wanted a product mode of it"),
        (("product", "left"), [1.0], "shape of left"),
        (("product", "left", 0), -1.0, "left: found negative amounts"),
    ],
)
def test_files_that_are_none(path, value, words):
    with pytest.raises(InputError) as caught:
        policy_from_dict(changed(path, value))
    assert words in str(caught.value)


def test_vectors_that_do_not_fit(tmp_path):
    content = json.loads(json.dumps(policy_to_dict(endless())))
    write_policy(endless(), tmp_path / "p.json")
    assert read_policy(tmp_path / "p.json").left_of(endless().begin(1)) == 30
    for value, words in (([[1.0]], "alpha"), ([[[1.0]]], "alpha, shape"), (None, "alpha")):
        with pytest.raises(InputError, match=words):
            policy_from_dict({**content, "alpha": value})
    with pytest.raises(InputError, match="vectors: found 0, wanted at least one"):
        policy_from_dict({**content, "mode": [0] * len(content["mode"])})


def leaves(content, path=()):
    items = content.items() if isinstance(content, dict) else enumerate(content)
    for key, value in items:
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from leaves(value, (*path, key))


@given(st.data())
@settings(max_examples=150, deadline=None)
def test_anything_else_is_refused_or_works(data):
    path = data.draw(st.sampled_from(list(leaves(json.loads(json.dumps(small()))))))
    rubbish = st.one_of(
        st.none(), st.booleans(), st.integers(-3, 10**20), st.floats(), st.text(max_size=3),
        st.lists(st.integers(-2, 3), max_size=3), st.just({}),
    )  # fmt: skip
    content = changed(path, data.draw(rubbish))
    try:
        policy = policy_from_dict(content)
    except InputError:
        return
    if policy.product.start[1] >= 0:
        policy.act(policy.begin(1))


# -- on the robot --------------------------------------------------------------------------------------
def test_needs_numpy_only(tmp_path):
    write_policy(schedule_vectors(Schedule.of(sticky_draws(20, 3, 4), SCHEDULE), 30), tmp_path / "p.json")
    code = (
        "import sys; from models.planning.policy_files import read_policy\n"
        f"p = read_policy({str(tmp_path / 'p.json')!r}); m = p.begin(1)\n"
        "p.act(m); p.draw_action_values(m); p.reason(m); p.act(p.observe(m, 0, 1, 0))\n"
        "print([n for n in ('scipy', 'numba', 'pandas', 'pymc', 'xarray') if n in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.slow
def test_a_decision_takes_less_than_200_microseconds():
    schedule = Schedule.of(sticky_draws(200, 3, 4), "HRHRHRHRH")
    policy = schedule_vectors(schedule, 45)
    memory = policy.begin(1)

    def decide():
        policy.act(memory)
        policy.draw_action_values(memory)
        policy.observe(memory, 0, 1, 0)

    decide()
    best = min(_seconds(decide) for _ in range(200))
    assert best < 200e-6


def _seconds(work):
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def test_evaluates_as_any_policy():
    schedule = Schedule.of(person(), SCHEDULE)
    found = evaluate_schedule(schedule_vectors(schedule, 15), schedule)
    assert found.costly_actions <= 1
    assert found.value == pytest.approx(np.nanmax(CASES["budget"]().action_values(CASES["budget"]().begin(1))))
