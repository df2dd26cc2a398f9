"""Cautions of policies: what goes into a file, what comes back, what is refused."""

import json
from dataclasses import replace

import pytest

from models.errors import InputError
from models.planning.baselines import Reciprocal, always
from models.planning.exact import solve_schedule
from models.planning.mixed_policy import MixedPolicy
from models.planning.mixture import Mixture
from models.planning.plan_policy import PlanPolicy
from models.planning.policy_files import policy_from_dict, policy_to_dict, read_policy, write_policy
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.safeguards.consent import fallback_of
from models.safeguards.guarded import Guarded
from tests.models.session_cases import KINDS, make
from tests.planning_cases import sticky_draws


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_of_policy_keeps_its_cautions_in_its_file(kind, tmp_path):
    own = make(kind)
    assert own.cautions == ()
    assert "cautions" not in policy_to_dict(own), "files without any are as they always were"
    write_policy(own, tmp_path / "policy.json", ("few draws", "few draws", "b"))
    read = read_policy(tmp_path / "policy.json")
    assert read.cautions == ("few draws", "b")
    assert policy_to_dict(read) == policy_to_dict(own, ("few draws", "b"))
    write_policy(read, tmp_path / "again.json", ("c", "b"))
    assert read_policy(tmp_path / "again.json").cautions == ("few draws", "b", "c")


def test_policies_made_of_others_have_their_cautions():
    one, other = always(PUBLISHED), Reciprocal(PUBLISHED)
    one.cautions, other.cautions = ("a",), ("b", "a")
    assert Mixture([one, other], [0.5, 0.5]).cautions == ("a", "b")
    assert policy_from_dict(policy_to_dict(Mixture([one, other], [0.5, 0.5]))).cautions == ("a", "b")
    guarded = Guarded(one, [], fallback_of(PUBLISHED))
    assert policy_from_dict(policy_to_dict(guarded)).cautions == guarded.cautions == ("a",)


def test_plans_have_the_cautions_of_their_draws():
    draws = replace(sticky_draws(3, 1), cautions=("few draws",))
    schedule = Schedule.of(draws, "HR")
    plan = solve_schedule(schedule)
    for own in (PlanPolicy.of(plan), MixedPolicy.of(schedule, [plan.decisions], [1.0])):
        assert own.cautions == policy_from_dict(policy_to_dict(own)).cautions == ("few draws",)


@pytest.mark.parametrize(
    "cautions", ["a text", [""], [" "], [3], {"a": 1}, None, [["a"]], ["two\nlines"], ["\x1b[2Jgone"], [None]]
)
def test_cautions_of_a_policy_file_are_texts_of_one_line(cautions, tmp_path):
    content = json.loads(json.dumps(policy_to_dict(make("alpha")))) | {"cautions": cautions}
    (tmp_path / "policy.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"policy\.json, key cautions: .*wanted a list of texts of one line"):
        read_policy(tmp_path / "policy.json")
