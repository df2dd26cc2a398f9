"""Files of guarded policies: exact round trips, and malformed entries refused by their place."""

import json
import subprocess
import sys
from functools import cache

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.model_draws import ModelDraws
from models.planning.mode_process import alternating, schedule_modes
from models.planning.policy_files import policy_from_dict, policy_to_dict, write_policy
from models.protocol import PUBLISHED
from models.safeguards.budget import CostBudget
from models.safeguards.consent import fallback_of
from models.safeguards.controller_worth import ControllerWorth
from models.safeguards.guarded import Guarded
from models.safeguards.influence import MinimumInfluence
from tests.models.planning.policy_cases import alpha, person
from tests.models.planning.policy_conformance import conforms
from tests.models.safeguards.guard_cases import all_guards, doubt, guarded, rounds

WORTHS = ("schedule", "vectors", "own", "controller", "none", "consent")


@cache
def written(worth) -> Guarded:
    if worth == "schedule":
        return guarded("reactive")
    if worth == "vectors":
        return guarded("vectors")
    if worth == "own":
        own = MinimumInfluence.of(ModelDraws.from_models([person()]), 3.0)
        return Guarded(alpha(), [own, CostBudget.of(PUBLISHED, 45)], fallback_of(PUBLISHED))
    if worth == "controller":
        source = ControllerWorth.of(alpha(), doubt(3), alternating(PUBLISHED, "H"), 0.9)
        guards = all_guards(rounds("HRHRH", 3), tolerance=5.0)
        return Guarded(alpha(), guards, fallback_of(PUBLISHED), source, "for the robot")
    if worth == "consent":
        return Guarded(guarded("reactive").policy, [], fallback_of(PUBLISHED, {"human_needs_help": "help"}))
    return Guarded(guarded("always").policy, [CostBudget.of(PUBLISHED, 0.3, {"help": 0.1})], fallback_of(PUBLISHED))


@cache
def content(worth):
    return json.dumps(policy_to_dict(written(worth)))


@pytest.mark.parametrize("worth", WORTHS)
def test_round_trip_is_exact(worth, tmp_path):
    own = written(worth)
    found = policy_from_dict(json.loads(content(worth)))
    assert json.dumps(policy_to_dict(found)) == content(worth)
    assert type(found.worth_source) is type(own.worth_source)
    conforms(own, person(), schedule_modes(PUBLISHED, "HRHRH"), tmp_path)
    mine, theirs = own.begin(1), found.begin(1)
    for k in range(5):
        assert own.decide(mine) == found.decide(theirs)
        if k < 4:
            step = (own.act(mine), 2 if mine.mode == 1 else 0, 1 - mine.mode)
            mine, theirs = own.observe(mine, *step), found.observe(theirs, *step)


def places(value, path=()):
    yield path
    inner = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, entry in inner:
        yield from places(entry, (*path, key))


@cache
def paths(worth):
    found = [p for p in places(json.loads(content(worth))) if p]
    # Arrays are long and alike; entries near the top are few and differ.
    return [p for p in found if len(p) <= 3] + [p for p in found if len(p) > 3][:: max(1, len(found) // 300)]


NONSENSE = st.one_of(
    st.none(), st.booleans(), st.text(max_size=5), st.integers(-3, 10**20), st.floats(-2, 2),
    st.just([]), st.just({}), st.just([[1.0]]), st.just({"kind": "budget"}), st.just(["help", "help"]),
)  # fmt: skip


@settings(max_examples=200)
@given(st.data(), st.sampled_from(WORTHS))
def test_malformed_entries_are_refused_by_place(data, worth):
    path = data.draw(st.sampled_from(paths(worth)))
    damaged = json.loads(content(worth))
    place = damaged
    for key in path[:-1]:
        place = place[key]
    if data.draw(st.booleans()):
        place[path[-1]] = data.draw(NONSENSE)
    elif isinstance(place, dict):
        del place[path[-1]]
    else:
        place.pop(path[-1])
    try:
        found = policy_from_dict(damaged, "robot.json")
    except InputError as error:
        assert str(error).startswith("robot.json")  # noqa: PT017
    else:
        found.act(found.begin(1))


@pytest.mark.parametrize(
    ("worth", "path", "value", "words"),
    [
        ("none", ("safeguards", 0, "limit"), -1, "safeguard 0: budget, limit: found -1, wanted a number"),
        ("none", ("safeguards", 0, "charges"), {"hug": 1}, "safeguard 0: budget, charges, action: found 'hug'"),
        ("none", ("safeguards", 0, "charges", "help"), "x", "safeguard 0: budget, charge of help: found 'x'"),
        ("none", ("safeguards", 0, "kind"), "belt", "safeguard 0, key kind: found 'belt', wanted one of budget"),
        ("none", ("safeguards",), None, "key safeguards: found None, wanted a list"),
        ("none", ("null", 0), "help me", "null, mode human_needs_help: found 'help me', wanted one of no_help"),
        ("none", ("null",), ["no_help"], "null: found ['no_help'], wanted 2 actions, one a mode"),
        ("none", ("null",), ["help", "no_signal"], "it is the null action of mode human_needs_help"),
        ("none", ("fallback", "kind"), "reciprocal", "fallback"),
        ("none", ("policy", "kind"), "guarded", "policy, key kind: found 'guarded', wanted the kind of a policy"),
        ("schedule", ("worth", "modes", 2), "nowhere", "worth, modes, event 3: found 'nowhere'"),
        ("schedule", ("worth", "models", 1, "weight"), 0.9, "worth, models"),
        ("schedule", ("worth", "models", 1), 3, "worth, models, model 1: found 3, wanted a model object"),
        ("schedule", ("worth", "discount"), 1.5, "worth: schedule, discount: found 1.5"),
        ("schedule", ("worth", "terminal"), [1.0], "worth: terminal reward, shape"),
        ("schedule", ("worth", "kind"), "guess", "worth, key kind: found 'guess', wanted one of controller, own"),
        ("schedule", ("worth",), None, "safeguard influence, what actions are worth: found nothing that says so"),
        ("schedule", ("safeguards", 0, "tables", 0, 1, 1, 0), 7.0, "influence, mode human_needs_help: found an"),
        ("schedule", ("safeguards", 0, "tolerance"), "much", "influence, tolerance: found 'much'"),
        ("schedule", ("safeguards", 1, "threshold"), 1.0, "confidence, threshold: found 1.0"),
        ("controller", ("worth", "vectors", 0, 0), [1.0], "worth, vectors"),
        ("controller", ("worth", "discount"), 1, "discount: found 1"),
        ("controller", ("worth", "table", 0), [0.7, 0.7], "worth: model, mode process, mode 0, sum"),
        ("vectors", ("worth", "kind"), "own", "worth by policy exact plan by belief: found ProductPolicy"),
    ],
)  # fmt: skip
def test_messages(worth, path, value, words):
    damaged = json.loads(content(worth))
    place = damaged
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(InputError) as caught:
        policy_from_dict(damaged, "robot.json")
    assert words in str(caught.value)
    assert str(caught.value).startswith("robot.json")


@pytest.mark.parametrize("worth", ["schedule", "vectors", "controller", "own"])
def test_a_robot_needs_numpy_only(checkout, tmp_path, worth):
    write_policy(written(worth), tmp_path / "policy.json")
    code = """
import sys
from models.planning.policy_files import read_policy
policy = read_policy(sys.argv[1])
memory = policy.begin(1)
for k in range(5):
    assert policy.decide(memory).explanation
    if k < 4:
        memory = policy.observe(memory, policy.act(memory), 2 if memory.mode else 0, 1 - memory.mode)
policy.act(policy.withdraw(memory))
print([m for m in ('scipy', 'numba', 'pandas', 'pymc') if m in sys.modules])
"""
    command = [sys.executable, "-c", code, str(tmp_path / "policy.json")]
    ran = subprocess.run(command, cwd=checkout, capture_output=True, check=False, text=True)
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.strip() == "[]"
