"""What a study on the page is made of."""

import hashlib
import json
from dataclasses import replace

import pytest

from analysis.play.event_rows import EventRows, Row
from analysis.play.messages import BURST, Allowance, BadMessage, parse
from analysis.play.robot_mind import NAMES, Decision, RobotMind, check_policy, policy_by_name, source_of
from analysis.simulate import calibrated_truth
from models.errors import InputError
from models.game.parameters import GameParameters
from models.model_files import read_model
from models.planning.baselines import ModePolicy, Reciprocal, never, uniformly_random
from models.planning.plan_policy import PlanPolicy
from models.planning.policies import Vocabulary
from models.planning.policy_files import write_policy
from models.protocol import PUBLISHED


@pytest.mark.parametrize("first", [1, 2, 7])
def test_groups_are_equal_from_the_first_person_on(two_policies, opened, first):
    study = opened(two_policies.with_(first_participant=first))
    for many in range(1, 13):
        study.agree()
        counts = [m.condition for m in study.journal.members.values()]
        assert abs(counts.count("always") - counts.count("never")) == many % 2


def test_a_number_of_somebody_else_makes_no_hole_in_a_block(two_policies, opened, tmp_path):
    EventRows(tmp_path / "log.csv", "test").append(
        Row("test", 2, "x", 0, 0, "robot_needs_help", "signal", "help", 9, 4, 5)
    )
    study = opened(two_policies)
    people = [study.agree()[1] for _ in range(6)]
    assert [p.participant for p in people] == [1, 3, 4, 5, 6, 7]
    study.withdraw(people[0])
    people += [study.agree()[1] for _ in range(4)]
    met = [p.member.condition for p in people]
    assert all(sorted(met[i : i + 2]) == ["always", "never"] for i in range(0, 10, 2))


def test_people_are_assigned_in_equal_groups(two_policies):
    study = two_policies.with_(policies=(*two_policies.policies, uniformly_random(PUBLISHED)))
    met = [study.assigned(n) for n in range(30)]
    for first in range(0, 30, 3):
        assert sorted(met[first : first + 3]) == ["always", "never", "random"]
    assert len({tuple(met[first : first + 3]) for first in range(0, 30, 3)}) > 1
    assert met == [study.assigned(n) for n in range(30)]
    assert met != [study.with_(seed=2).assigned(n) for n in range(30)]


def test_every_round_has_a_seed_of_its_own(settings):
    seeds = {settings.round_seed(n, k) for n in range(20) for k in range(9)}
    assert len(seeds) == 180
    assert all(0 <= s < 2**64 for s in seeds)


def test_the_consent_text_states_the_rule(settings):
    text = " ".join(settings.consent_paragraphs)
    assert "3 rounds" in text
    assert "deleted at once; all that stays is your number" in text
    assert "the times at which you agreed, ended a round or left in the middle of one, and finished" in text
    assert "{" not in text
    assert "are kept without your name" in " ".join(settings.with_(withdrawal="keep").consent_paragraphs)
    own = settings.with_(consent="First\nparagraph.\n\nSecond {braces}.\n")
    assert own.consent_paragraphs == ("First paragraph.", "Second {braces}.")


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"policies": ()}, "policies: found none"),
        ({"policies": (never(PUBLISHED), never(PUBLISHED))}, "never twice"),
        ({"policies": (never(PUBLISHED, "a\nb"),)}, "name of the policy"),
        ({"study": " "}, "name of the study"),
        ({"schedule": "HX"}, "letter 2: found 'X'"),
        ({"withdrawal": "perhaps"}, "one of delete, keep"),
        ({"seed": -1}, "seed: found -1"),
        ({"first_participant": -1}, "participant: found -1"),
        ({"parameters": GameParameters(round_ticks=300, trap_tick=300)}, "trap_tick: found 300, wanted less than"),
    ],
)
def test_refused(settings, change, words):
    with pytest.raises(InputError, match=words):
        settings.with_(**change)


SEEN = ("none", "no_help", "help")


# -- policies --------------------------------------------------------------------------------------
@pytest.mark.parametrize("name", NAMES)
def test_named_policies_go_through_the_schedule(name):
    policy, notes = policy_by_name(name, calibrated_truth(), "HRHRHRHRH")
    assert policy.name == name
    assert notes == ()


def test_policy_files(tmp_path):
    policy, _ = policy_by_name("exact plan", calibrated_truth(), "HRH")
    path = tmp_path / "plan.json"
    write_policy(policy, path)
    assert policy_by_name(str(path), calibrated_truth(), "HRH")[0].name == "exact plan"
    with pytest.raises(InputError, match="on the schedule RHR"):
        policy_by_name(str(path), calibrated_truth(), "RHR")
    with pytest.raises(InputError, match="policy: found 'allways', wanted one of ls-POMDP"):
        policy_by_name("allways", calibrated_truth(), "HRH")
    with pytest.raises(InputError, match="no such file"):
        policy_by_name("nowhere.json", calibrated_truth(), "HRH")
    for name in NAMES:
        with pytest.raises(InputError, match="schedule: found ''"):
            policy_by_name(name, calibrated_truth(), "")


def test_a_file_that_is_not_to_be_trusted_is_noted(tmp_path):
    policy, _ = policy_by_name("exact plan", calibrated_truth(), "HRH")
    write_policy(policy, tmp_path / "plan.json", ["few draws"])
    again, notes = policy_by_name(str(tmp_path / "plan.json"), calibrated_truth(), "HRH")
    assert again.cautions == ("few draws",)
    assert notes == ("CAUTION: few draws; do not rely on these numbers.",)


def test_where_a_policy_comes_from(tmp_path):
    truth = calibrated_truth()
    path = tmp_path / "plan.json"
    write_policy(policy_by_name("exact plan", truth, "HRH")[0], path)
    found = source_of(str(path), truth, "m.json")
    assert (found.name, found.sha256) == ("plan.json", hashlib.sha256(path.read_bytes()).hexdigest())
    own = source_of("ls-POMDP", truth, "folder/m.json")
    assert own.name == "m.json"
    (tmp_path / "copy.json").write_bytes(own.content)
    assert source_of("myopic", read_model(tmp_path / "copy.json"), "copy.json").sha256 == own.sha256
    other = replace(truth, emission=truth.emission[:, ::-1])
    assert source_of("exact plan", other, "m.json").sha256 != own.sha256
    for name in ("always", "never", "reactive", "random"):
        assert source_of(name, truth, "m.json").sha256 == source_of(name, other, "x.json").sha256 == ""


def test_a_posteriors_plan_drives_the_robot(tmp_path):
    """What `prosocial robust --policy` writes for the mean and for the tail of a posterior."""
    from models.model_draws import ModelDraws
    from models.planning.mixed_policy import MixedPolicy
    from models.planning.schedule import Schedule
    from models.robust.cautious import cautious_plan

    truth = calibrated_truth()
    draws = ModelDraws.from_models([truth, replace(truth, transition=truth.transition[[1, 0, 3, 2]])])
    believed = Schedule.of(draws, "HRHRH")
    chosen = cautious_plan(believed, 0.5)
    write_policy(MixedPolicy.of(believed, chosen.plans, chosen.share, "cautious"), tmp_path / "cautious.json")
    assert policy_by_name(str(tmp_path / "cautious.json"), truth, "HRHRH")[0].name == "cautious"


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (Vocabulary(("left",), (("go",),), SEEN), "modes"),
        (
            Vocabulary(PUBLISHED.mode_names, (("help", "no_help"), ("signal",)), ("none", "no_help", "help")),
            "actions",
        ),
        (
            Vocabulary(PUBLISHED.mode_names, (("help", "no_help"), ("signal", "no_signal")), ("x", "y")),
            "observations",
        ),
    ],
)
def test_a_policy_of_another_world_is_refused(words, found):
    shares = [[1.0] + [0.0] * (len(a) - 1) for a in words.actions]
    with pytest.raises(InputError, match=found):
        check_policy(ModePolicy(words, shares, "other"), "HR")


def test_the_mind_is_a_function_of_the_rounds(settings):
    mind = RobotMind(Reciprocal(PUBLISHED), settings.modes)
    assert mind.act(settings.policy_rng(1, 0)) == "no_signal"
    mind.observe(Decision("no_signal", "help"))
    assert mind.act(settings.policy_rng(1, 1)) == "help"
    mind.observe(Decision("help", "none"))
    again = RobotMind(
        Reciprocal(PUBLISHED), settings.modes, [Decision("no_signal", "no_help"), Decision("help", "none")]
    )
    assert mind.act(settings.policy_rng(1, 2)) == "no_signal"
    assert again.act(settings.policy_rng(1, 2)) == "signal"
    # A response that was not recorded is no refusal.
    unseen = RobotMind(Reciprocal(PUBLISHED), settings.modes, [Decision("no_signal", "missing")])
    assert unseen.act(settings.policy_rng(1, 1)) == "no_help"


def test_responses_that_the_model_takes_for_impossible_are_ignored():
    from models.planning.baselines import myopic

    truth = calibrated_truth()
    sure = replace(truth, emission=truth.emission * 0 + [0.0, 1.0])
    mind = RobotMind(myopic(sure), ("robot_needs_help", "human_needs_help"))
    mind.observe(Decision("no_signal", "no_help"))
    assert mind.ignored == [0]
    assert mind.act(None) in ("help", "no_help")


def test_a_policy_that_cannot_follow_neither_helps_nor_signals():
    """A plan without its models cannot plan anew after a response that was not recorded."""
    plan, _ = policy_by_name("exact plan", calibrated_truth(), "HRHRH")
    alone = PlanPolicy(plan.vocabulary, plan.modes, plan.decisions, plan.outcomes, None)
    check_policy(alone, "HRHRH")
    modes = [m.name for m in PUBLISHED.modes_from_letters("HRHRH")]
    for policy, lost in ((plan, False), (alone, True)):
        mind = RobotMind(policy, modes)
        mind.observe(Decision(mind.act(None), "missing"))
        actions = []
        for observation in ("none", "help", "none"):
            actions.append(mind.act(None))
            mind.observe(Decision(actions[-1], observation))
        assert bool(mind.gave_up) == lost
        assert (actions == ["no_help", "no_signal", "no_help"]) == lost
        assert ("models to plan anew are not here" in mind.gave_up) == lost


# -- messages --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "text",
    [
        "", "x", "[]", "1", "null", "{}", '{"type": 1}', '{"type": ["key"]}', '{"type": "shout"}',
        '{"type": "key"}',
        '{"type": "key", "move": 5, "pressed": true}', '{"type": "key", "move": -1, "pressed": true}',
        '{"type": "key", "move": true, "pressed": true}', '{"type": "key", "move": 1.0, "pressed": true}',
        '{"type": "key", "move": 1, "pressed": 1}', '{"type": "start", "k": 3}', '{"type": "hello"}',
        '{"type": "hello", "token": 3}', '{"type": "hello", "token": "' + "x" * 300 + '"}', "[" * 190,
        '{"type": "hello", "token": "\\ud800"}', '{"type": "hello", "token": "é"}',
    ],
)  # fmt: skip
def test_bad_messages(text):
    with pytest.raises(BadMessage):
        parse(text)


def test_good_messages():
    for message in (
        {"type": "hello", "token": None}, {"type": "hello", "token": "x" * 32}, {"type": "consent"},
        {"type": "start"},
        {"type": "key", "move": 0, "pressed": False}, {"type": "withdraw"},
    ):  # fmt: skip
        assert parse(json.dumps(message)).type == message["type"]


def test_allowance():
    own = Allowance(0.0)
    assert all(own.spend(0.0) for _ in range(BURST))
    assert not own.spend(0.0)
    assert own.spend(1.0)
    assert sum(own.spend(1.0) for _ in range(1000)) < 50
