"""Every kind of policy: the conformance test, baselines, beliefs, alpha vectors, files."""

import json
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.alpha_policy import AlphaPolicy
from models.planning.baselines import ModePolicy, Reciprocal, always, myopic, never, uniformly_random
from models.planning.belief_model import BeliefModel
from models.planning.mode_process import schedule_modes
from models.planning.policies import Vocabulary
from models.planning.policy_files import policy_from_dict, policy_to_dict, read_policy, write_policy
from models.planning.textbook import textbook_problem
from models.protocol import PUBLISHED
from tests.models.planning.policy_cases import KINDS, SCHEDULE, alpha, person, policy, problem
from tests.models.planning.policy_conformance import conforms
from tests.models.planning.schedule_cases import random_model
from tests.random_cases import protocols

HUMAN, ROBOT = 0, 1
NONE, NO_HELP, HELP = 0, 1, 2


@pytest.mark.parametrize("kind", KINDS)
def test_conformance(kind, tmp_path):
    conforms(policy(kind), person(), schedule_modes(PUBLISHED, SCHEDULE), tmp_path)


# -- baselines -----------------------------------------------------------------------------------------------------
def follow(p, *steps):
    """Actions of a policy along steps (mode, observation); the last mode without one."""
    memory, done = p.begin(steps[0][0]), []
    for k, (mode, seen) in enumerate(steps):
        done.append(p.vocabulary.actions[mode][p.act(memory)])
        if k + 1 < len(steps):
            memory = p.observe(memory, p.act(memory), seen, steps[k + 1][0])
    return done


def test_always_and_never():
    rounds = ((ROBOT, HELP), (HUMAN, NONE), (ROBOT, NO_HELP), (HUMAN, NONE))
    assert follow(always(PUBLISHED), *rounds) == ["signal", "help", "signal", "help"]
    assert follow(never(PUBLISHED), *rounds) == ["no_signal", "no_help", "no_signal", "no_help"]


def test_reactive_answers_the_last_observed_response():
    rounds = (
        (HUMAN, NONE),
        (ROBOT, HELP),
        (HUMAN, NONE),
        (HUMAN, NONE),
        (ROBOT, NO_HELP),
        (ROBOT, None),
        (HUMAN, NONE),
    )
    done = follow(Reciprocal(PUBLISHED), *rounds)
    assert done == ["no_help", "no_signal", "help", "help", "no_signal", "signal", "no_help"]
    literal = follow(Reciprocal(PUBLISHED, literal=True), *rounds)
    assert literal == ["no_help", "no_signal", "help", "no_help", "no_signal", "signal", "no_help"]


@given(protocols(), st.integers(0, 2**32 - 1), st.integers(1, 4))
def test_myopic_is_the_printed_formula(protocol, seed, n):
    model = random_model(np.random.default_rng(seed), protocol, n)
    p = myopic(model)
    belief = np.random.default_rng(seed + 1).dirichlet(np.ones(n))
    table, prosocial = model.reward_table(), model.reward.prosocial()
    for mode in protocol.modes:
        wanted = {}
        for action in mode.actions:
            a = protocol.action(action.name)
            wanted[action.name] = belief @ table[a] + belief @ model.transition[a] @ prosocial
        assert p.action_values(belief, mode.name) == pytest.approx(wanted)


@given(protocols())
def test_baselines_of_any_protocol(protocol):
    for m, mode in enumerate(protocol.modes):
        names = [a.name for a in mode.actions]
        assert names[never(protocol).act(never(protocol).begin(m))] == mode.null_action
        if len(names) > 1:
            assert names[always(protocol).act(always(protocol).begin(m))] != mode.null_action
        assert uniformly_random(protocol).probabilities(uniformly_random(protocol).begin(m)) == pytest.approx(
            1 / len(names)
        )


def test_reactive_needs_two_actions():
    from tests.random_cases import make_protocol

    with pytest.raises(InputError, match="3 actions in mode mode0"):
        Reciprocal(make_protocol([True], [3], 2))


def test_random_shares_are_what_happens():
    p, rng = uniformly_random(PUBLISHED), np.random.default_rng(3)
    drawn = [p.act(p.begin(ROBOT), rng) for _ in range(4000)]
    assert np.mean(drawn) == pytest.approx(0.5, abs=0.03)


# -- beliefs -------------------------------------------------------------------------------------------------------
@given(st.integers(0, 2**32 - 1))
def test_belief_of_the_policy_is_that_of_the_model(seed):
    rng = np.random.default_rng(seed)
    model = random_model(rng, PUBLISHED, 3)
    tracker = BeliefModel.of_latent(model)
    belief = model.initial
    memory = belief
    for mode in rng.integers(2, size=6):
        c, o = int(rng.integers(2)), int(rng.integers(2))
        action = PUBLISHED.modes[mode].actions[c].name
        response = PUBLISHED.response_names[o] if mode == ROBOT else None
        belief = model.update(belief, action, response)
        memory = tracker.update(mode, memory, c, o + 1 if mode == ROBOT else NONE, int(rng.integers(2)))
        assert memory == pytest.approx(belief)
        # Not recorded: as without a response.
        assert tracker.update(mode, memory, c, None, 0) == pytest.approx(model.update(memory, action))
        belief = memory


def test_problem_and_belief_model_agree():
    own, b = BeliefModel.of_problem(problem()), np.array([0.2, 0.5, 0.3])
    for seen in (NO_HELP, HELP):
        wanted, _ = problem().update(ROBOT, b, 1, seen, HUMAN)
        assert own.update(ROBOT, b, 1, seen, HUMAN) == pytest.approx(wanted)
    table = textbook_problem(
        np.array([[[0.7, 0.3], [0.4, 0.6]]]), [[[0.9, 0.1], [0.2, 0.8]]], [[0.0, 1.0]], 0.9, [0.5, 0.5]
    )
    wanted, _ = table.update(0, np.array([0.5, 0.5]), 0, 1, 0)
    assert BeliefModel.of_problem(table).update(0, np.array([0.5, 0.5]), 0, 1, 0) == pytest.approx(wanted)


def sure_model():
    from models.lspomdp import LatentStatePOMDP

    return LatentStatePOMDP([1.0, 0.0], [np.eye(2)] * 4, [[[1.0, 0.0], [0.0, 1.0]]] * 2)


def test_impossible_observation():
    for impossible, wanted in (("error", None), ("keep", [1.0, 0.0]), ("reset", [0.5, 0.5])):
        from dataclasses import replace

        model = replace(BeliefModel.of_latent(sure_model(), impossible=impossible), initial=(np.full(2, 0.5),) * 2)
        b = np.array([1.0, 0.0])
        if wanted is None:
            with pytest.raises(InputError, match="'help', then mode 'human_needs_help': has probability zero"):
                model.update(ROBOT, b, 0, HELP, HUMAN)
            with pytest.raises(InputError, match="probability zero"):
                model.update_many(ROBOT, b[None], 0, HELP, HUMAN)
        else:
            assert model.update(ROBOT, b, 0, HELP, HUMAN) == pytest.approx(wanted)
            assert model.update_many(ROBOT, b[None], 0, HELP, HUMAN)[0] == pytest.approx(wanted)
    with pytest.raises(InputError, match="wanted error, keep or reset"):
        BeliefModel.of_latent(sure_model(), impossible="ignore")


def test_a_mode_that_cannot_follow():
    b = np.array([0.2, 0.5, 0.3])
    strict = BeliefModel.of_problem(problem())
    with pytest.raises(InputError, match="probability zero"):
        strict.update(ROBOT, b, 0, HELP, ROBOT)
    keeps = BeliefModel.of_problem(problem(), impossible="keep")
    assert keeps.update(ROBOT, b, 0, HELP, ROBOT) == pytest.approx(strict.update(ROBOT, b, 0, HELP, HUMAN))
    p = policy("tracked")
    memory = p.observe(p.begin(ROBOT), 0, HELP, ROBOT)
    assert memory.belief == pytest.approx(person().update(person().initial, "no_signal", "help"))


@pytest.mark.parametrize(
    ("belief", "words"),
    [
        ([0.5, 0.4, 0.2], "belief in mode robot_needs_help, sum: found '1.1', wanted 1 within 1e-9"),
        ([0.5, 0.5], r"shape: found (2,), wanted (3,)"),
        ([1.5, -0.5, 0.0], "wanted probabilities between 0 and 1"),
        ([float("nan"), 0.5, 0.5], "wanted probabilities between 0 and 1"),
    ],
)
@pytest.mark.parametrize("kind", ["alpha", "myopic"])
def test_beliefs_that_are_none(kind, belief, words):
    for ask in ("action", "action_values", "why"):
        with pytest.raises(InputError) as caught:
            getattr(policy(kind), ask)(belief, "robot_needs_help")
        assert words in str(caught.value)
    with pytest.raises(InputError, match="mode: found 'somewhere', wanted one of human_needs_help"):
        policy(kind).action([1, 0, 0], "somewhere")


# -- alpha vectors -------------------------------------------------------------------------------------------------
@given(st.integers(0, 2**32 - 1), st.integers(0, 1))
def test_look_ahead_is_worth_the_best_vector_at_least(seed, mode):
    p, b = alpha(), np.random.default_rng(seed).dirichlet(np.ones(3))
    values = p.action_values(b, mode)
    assert max(values.values()) >= p.value(b, mode) - 1e-9
    for c, name in enumerate(p.vocabulary.actions[mode]):
        wanted = b @ problem().choices[mode][c].reward + 0.9 * sum(
            chance * p.value(after, x) for x, _, chance, after in problem().outcomes(mode, c, b)
        )
        assert values[name] == pytest.approx(wanted)
    assert p.action(b, mode) == max(values, key=values.get)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"alpha": [[1.0, 2.0]]}, "alpha, shape"),
        ({"mode": [0]}, "shape of mode"),
        ({"mode": [0, 2]}, "vector 1, mode: found 2"),
        ({"mode": [0, 0]}, "vectors of mode robot_needs_help: found 0, wanted at least one"),
        ({"choice": [0, 5]}, "vector 1, choice: found 5, wanted 0 to 1 in mode robot_needs_help"),
        ({"follow": [[1, 0], [1, 0]]}, "vector 1, follower of outcome 0: found 1, wanted a vector of mode human"),
        ({"follow": [[1], [0]]}, "follow, outcomes: found 1, wanted at least 2"),
    ],
)
def test_alpha_vectors_that_do_not_fit(change, words):
    good = {"alpha": np.zeros((2, 3)), "mode": [0, 1], "choice": [0, 0], "follow": [[1, 0], [0, 0]]}
    AlphaPolicy(problem(), **good)
    with pytest.raises(InputError) as caught:
        AlphaPolicy(problem(), **{**good, **change})
    assert words in str(caught.value)


# -- the plan ------------------------------------------------------------------------------------------------------
def test_plan_goes_on_when_overruled_or_blind():
    from models.planning.exact import history_values

    plan = policy("plan")
    for history in (
        (("signal", "help"),),
        (("no_signal", None),),
        (("signal", "no_help"), ("no_help", None), ("signal", None)),
    ):
        memory = plan.memory_after(history)
        values = history_values(plan.schedule, history)
        k = len(history)
        assert plan.vocabulary.actions[plan.modes[k]][plan.act(memory)] == max(values, key=values.get)


def test_plan_refusals():
    plan = policy("plan")
    with pytest.raises(InputError, match="event 1, mode: found 'human_needs_help', wanted robot_needs_help"):
        plan.begin(HUMAN)
    with pytest.raises(InputError, match="event 2, mode: found 'robot_needs_help', wanted human_needs_help"):
        plan.observe(plan.begin(ROBOT), 0, HELP, ROBOT)
    with pytest.raises(InputError, match="event 1, observation: found 'none', wanted a response"):
        plan.observe(plan.begin(ROBOT), 0, NONE, HUMAN)
    over = plan.memory_after((("signal", "help"), ("help", None)) * 2 + (("signal", "help"),))
    with pytest.raises(InputError, match="the schedule is over"):
        plan.probabilities(over)
    content = policy_to_dict(plan)
    bare = policy_from_dict({**content, "schedule": None})
    assert bare.act(bare.begin(ROBOT)) == plan.act(plan.begin(ROBOT))
    left = bare.observe(bare.begin(ROBOT), 1 - bare.act(bare.begin(ROBOT)), HELP, HUMAN)
    with pytest.raises(InputError, match="the models to plan anew are not here"):
        bare.act(left)


# -- files ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", KINDS)
def test_damaged_files_are_refused_by_place(kind):
    """Every entry of a file replaced by nonsense: an error of ours that names the file, or no harm."""
    content = json.loads(json.dumps(policy_to_dict(policy(kind))))

    def walk(value, path):
        yield path
        inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
        for key, entry in list(inner)[:3]:
            yield from walk(entry, (*path, key))

    paths = [p for p in walk(content, ()) if p][:160]
    for path in paths:
        for nonsense in ("wrong", -7, None, [], 0.5, {"a": 1}):
            damaged = json.loads(json.dumps(content))
            place = damaged
            for key in path[:-1]:
                place = place[key]
            place[path[-1]] = nonsense
            try:
                policy_from_dict(damaged, "file.json")
            except InputError as error:
                assert "file.json" in str(error), (path, nonsense, str(error))  # noqa: PT017


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ([], "wanted a JSON object"),
        ({"schema": "other/1"}, "key schema: found 'other/1'"),
        ({"schema": "prosocial-policy/1", "kind": "tree"}, "key kind: found 'tree', wanted one of alpha, by_mode"),
        ({"schema": "prosocial-policy/1", "kind": "plan"}, "key name: found None, wanted text"),
    ],
)
def test_files_of_another_kind(content, words):
    with pytest.raises(InputError) as caught:
        policy_from_dict(content, "file.json")
    assert words in str(caught.value)


def test_missing_and_broken_files(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_policy(tmp_path / "none.json")
    (tmp_path / "half.json").write_text('{"schema": ')
    with pytest.raises(InputError, match="line 1, column 12: not valid JSON"):
        read_policy(tmp_path / "half.json")


def test_a_robot_needs_numpy_only(checkout, tmp_path):
    write_policy(policy("alpha"), tmp_path / "policy.json")
    code = """
import sys
from models.planning.policy_files import read_policy
policy = read_policy(sys.argv[1])
memory = policy.begin(1)
for _ in range(4):
    memory = policy.observe(memory, policy.act(memory), 2 if memory.mode else 0, 1 - memory.mode)
    assert policy.reason(memory)
print([m for m in ('scipy', 'numba', 'pandas', 'pymc') if m in sys.modules])
"""
    command = [sys.executable, "-c", code, str(tmp_path / "policy.json")]
    ran = subprocess.run(command, cwd=checkout, capture_output=True, check=True, text=True)
    assert ran.stdout.strip() == "[]"


def test_large_matrices_are_sparse_and_the_same(monkeypatch):
    import models.planning.belief_model as module

    beliefs = np.random.default_rng(1).dirichlet(np.ones(3), size=5)
    dense = BeliefModel.of_problem(problem()).update_many(ROBOT, beliefs, 1, HELP, HUMAN)
    monkeypatch.setattr(module, "MOST_DENSE", 0)
    assert BeliefModel.of_problem(problem()).update_many(ROBOT, beliefs, 1, HELP, HUMAN) == pytest.approx(dense)


def test_shares_must_be_probabilities():
    with pytest.raises(InputError, match="mode human_needs_help, shares"):
        ModePolicy(Vocabulary.of(PUBLISHED), [[0.5, 0.6], [1.0, 0.0]], "half")
