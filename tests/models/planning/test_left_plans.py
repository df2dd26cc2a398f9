"""What plans do once somebody has left them: replan, follow or refuse; mixtures of plans and of policies."""

import json

import numpy as np
import pytest

from models.errors import InputError
from models.planning.baselines import Reciprocal, always, never, uniformly_random
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import history_values, solve_schedule
from models.planning.expected_cost import cost_frontier
from models.planning.mixed_policy import MixedPolicy
from models.planning.mixture import Mixture
from models.planning.plan_policy import PlanPolicy
from models.planning.policies import Vocabulary
from models.planning.policy_files import policy_from_dict, policy_to_dict
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from tests.models.planning.budget_cases import histories, memory_after, named
from tests.models.planning.policy_cases import SCHEDULE, person
from tests.models.planning.policy_conformance import conforms

HUMAN, ROBOT = 0, 1


@pytest.fixture(scope="module")
def plan():
    return solve_schedule(Schedule.of(person(), SCHEDULE))


def stored(policy):
    return policy_from_dict(json.loads(json.dumps(policy_to_dict(policy))))


def number(schedule, history):
    """Number of the responses, those not recorded counted as no help."""
    out = 0
    for k, (_, o) in enumerate(history):
        out = out * schedule.n_outcomes(k) + (o or 0)
    return out


# -- one plan ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("left", ["replan", "follow", "error"])
def test_conformance(plan, left, tmp_path):
    conforms(PlanPolicy.of(plan, left=left), person(), plan.schedule.modes, tmp_path)


def test_follows_by_the_responses(plan):
    policy = PlanPolicy.of(plan, left="follow")
    for p in (policy, stored(policy)):
        for k, found in histories(plan.schedule, missing=True):
            for h in found:
                assert p.act(memory_after(p, plan.schedule, h)) == plan.decisions[k][number(plan.schedule, h)]


def test_replans_after_any_history(plan):
    policy = PlanPolicy.of(plan)
    for _, found in histories(plan.schedule, missing=True):
        for h in found[::7]:
            values = list(history_values(plan.schedule, named(plan.schedule, h)).values())
            assert values[policy.act(memory_after(policy, plan.schedule, h))] == pytest.approx(max(values))


def test_refuses(plan):
    policy = PlanPolicy.of(plan, left="error")
    wrong = 1 - int(plan.decisions[0][0])
    for p in (policy, stored(policy)):
        for h in ([(wrong, 0)], [(1 - wrong, None)]):
            memory = memory_after(p, plan.schedule, h)
            with pytest.raises(
                InputError, match="found a history that left the plan before event 2, wanted one that"
            ):
                p.act(memory)
        assert p.act(memory_after(p, plan.schedule, [(1 - wrong, 1)])) == plan.decisions[1][1]


def test_nothing_to_count_a_missing_response_as(plan):
    words, outcomes = Vocabulary.of(PUBLISHED), tuple(plan.schedule.n_outcomes(k) for k in range(5))
    policy = PlanPolicy(words, plan.schedule.modes, plan.decisions, outcomes, left="follow")
    with pytest.raises(InputError, match="event 1, response: found none recorded"):
        policy.observe(policy.begin(ROBOT), 0, None, HUMAN)
    hopeful = PlanPolicy(words, plan.schedule.modes, plan.decisions, outcomes, left="follow", missing="help")
    assert hopeful.observe(hopeful.begin(ROBOT), 0, None, HUMAN).responses == 1


@pytest.mark.parametrize(
    ("key", "value"), [("left", "give up"), ("left", ["follow"]), ("missing", "none"), ("missing", 3)]
)
def test_words_that_are_none(plan, key, value):
    for policy in (PlanPolicy.of(plan), MixedPolicy.of(plan.schedule, [plan.decisions], [1.0])):
        content = json.loads(json.dumps(policy_to_dict(policy)))
        with pytest.raises(InputError, match=key):
            policy_from_dict({**content, key: value})


def test_files_of_before(plan):
    content = {k: v for k, v in policy_to_dict(PlanPolicy.of(plan)).items() if k not in ("left", "missing")}
    assert policy_from_dict(content).left == "replan"
    mixed = policy_to_dict(MixedPolicy.of(plan.schedule, [plan.decisions], [1.0]))
    policy = policy_from_dict({k: v for k, v in mixed.items() if k not in ("left", "missing")})
    assert policy.left == "follow"
    assert policy.missing is None


# -- mixtures of plans ---------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def mixed():
    schedule = Schedule.of(person(), SCHEDULE)
    frontier = cost_frontier(schedule)
    return schedule, frontier.mixture(0.6 * frontier.points[-1].cost)


def test_goes_on_after_any_history(mixed):
    schedule, policy = mixed
    for p in (policy, stored(policy)):
        for k, found in histories(schedule, missing=True):
            for h in found:
                memory = memory_after(p, schedule, h)
                wanted, possible = np.zeros(2), p.share > 0
                # Plans that did otherwise are out, unless all would have.
                for j, (c, _) in enumerate(h):
                    took = np.array([int(plan[j][number(schedule, h[:j])]) == c for plan in p.plans])
                    possible = possible & took if np.any(possible & took) else possible
                for i in np.flatnonzero(possible):
                    wanted[p.plans[i][k][number(schedule, h)]] += p.share[i]
                assert p.probabilities(memory) == pytest.approx(wanted / wanted.sum())


def test_told_to_give_up(mixed):
    schedule, policy = mixed
    strict = MixedPolicy.of(schedule, policy.plans, policy.share, left="error")
    first = {int(plan[0][0]) for plan in policy.plans}
    assert len(first) == 1
    for p in (strict, stored(strict)):
        start = p.begin(ROBOT)
        with pytest.raises(InputError, match="none of its plans takes"):
            p.observe(start, 1 - first.copy().pop(), 1, HUMAN)
        with pytest.raises(InputError, match="response: found none recorded"):
            p.observe(start, first.copy().pop(), None, HUMAN)
    with pytest.raises(InputError, match="left: found 'replan', wanted follow or error"):
        MixedPolicy.of(schedule, policy.plans, policy.share, left="replan")


def test_mixed_refuses_what_cannot_be(mixed):
    _, policy = mixed
    memory = policy.begin(ROBOT)
    with pytest.raises(InputError, match="observation: found 'none', wanted a response"):
        policy.observe(memory, 0, 0, HUMAN)
    memory = policy.observe(memory, 0, 1, HUMAN)
    with pytest.raises(InputError, match="shows no response"):
        policy.observe(memory, 0, 2, ROBOT)


# -- mixtures of policies ------------------------------------------------------------------------------
def lots(share=0.3):
    return Mixture([never(PUBLISHED), always(PUBLISHED), Reciprocal(PUBLISHED)], [share, 0.9 - share, 0.1])


def test_mixture_conforms(tmp_path):
    conforms(lots(), person(), Schedule.of(person(), SCHEDULE).modes, tmp_path)


def test_mixture_is_worth_the_mean():
    policy = lots()
    found = evaluate_schedule(policy, person(), SCHEDULE).value
    alone = [evaluate_schedule(p, person(), SCHEDULE).value for p in policy.policies]
    assert found == pytest.approx(policy.share @ alone)


def test_mixture_after_an_action_that_none_takes():
    policy = Mixture([never(PUBLISHED), Reciprocal(PUBLISHED)], [0.5, 0.5])
    memory = policy.observe(policy.begin(ROBOT), 1, 2, HUMAN)
    assert memory.possible == (0, 1)
    assert policy.probabilities(memory) == pytest.approx([0.5, 0.5])


def test_mixtures_that_are_none():
    with pytest.raises(InputError, match="shares: found"):
        Mixture([never(PUBLISHED)], [0.5])
    with pytest.raises(InputError, match="one that does not"):
        Mixture([never(PUBLISHED), uniformly_random(PUBLISHED)], [0.5, 0.5])
    content = policy_to_dict(lots())
    for change in ({"policies": []}, {"policies": [3]}, {"share": "all"}, {"share": [1.0]}, {"policies": [{}]}):
        with pytest.raises(InputError):
            policy_from_dict({**content, **change})
