"""Guarded policies: conformance, what changes nothing, budgets on every path, randomised ones, decisions."""

import re
import time
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.baselines import ModePolicy, never, uniformly_random
from models.planning.controller import FiniteStateController
from models.planning.evaluation import evaluate_schedule
from models.planning.finite_memory import infinite_value
from models.planning.mode_process import schedule_modes
from models.planning.policies import Vocabulary
from models.planning.rollouts import simulate_policies
from models.planning.schedule_vectors import schedule_vectors
from models.protocol import PUBLISHED
from models.safeguards.budget import CostBudget
from models.safeguards.confidence import Confidence
from models.safeguards.consent import fallback_of
from models.safeguards.guarded import Guarded, decide
from models.safeguards.influence import MinimumInfluence
from models.safeguards.safeguard import Proposal
from models.safeguards.worth import Worth
from tests.models.planning.policy_cases import KINDS, person, problem
from tests.models.planning.policy_cases import policy as bare
from tests.models.planning.policy_conformance import conforms
from tests.models.safeguards.guard_cases import (
    HELP,
    HUMAN,
    NO_HELP,
    NONE,
    ROBOT,
    all_guards,
    doubt,
    guarded,
    policy,
    rounds,
)
from tests.random_cases import make_protocol, protocols

WATCHED = (
    "always",
    "never",
    "myopic",
    "reactive",
    "random",
    "tracked",
    "controller",
    "plan",
    "followed",
    "vectors",
    "mixed",
)
NINE = "HRHRHRHRH"


@pytest.mark.parametrize("kind", [k for k in WATCHED if k != "plan"])
def test_conformance(kind, tmp_path):
    conforms(guarded(kind), person(), schedule_modes(PUBLISHED, "HRHRH"), tmp_path)


@pytest.mark.parametrize("kind", KINDS)
def test_conformance_of_a_budget_around_anything(kind, tmp_path):
    own = Guarded(bare(kind), [CostBudget.of(PUBLISHED, 15)], fallback_of(PUBLISHED))
    conforms(own, person(), schedule_modes(PUBLISHED, "HRHRH"), tmp_path)


# -- what changes nothing ------------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", WATCHED)
def test_a_guard_that_changes_nothing_gives_identical_values(kind):
    s, own = rounds(), policy(kind)
    alone = evaluate_schedule(own, s)
    found = evaluate_schedule(Guarded(own, [], fallback_of(PUBLISHED)), s)
    assert np.array_equal(found.values, alone.values)
    assert found.action_path == alone.action_path
    assert found.cost == alone.cost
    # Memories that know what was spent, or the history, are summed in another order.
    for more in (Guarded(own, [CostBudget.of(PUBLISHED, 75)], fallback_of(PUBLISHED)), guarded(kind, [])):
        assert evaluate_schedule(more, s).values == pytest.approx(alone.values, rel=1e-13)


def test_the_best_plan_passes_lax_safeguards():
    s = rounds()
    guards = [MinimumInfluence.of(s.draws, 0.0), Confidence.of(PUBLISHED, 0.0), CostBudget.of(PUBLISHED, 75)]
    found, alone = evaluate_schedule(guarded("vectors", guards), s), evaluate_schedule(policy("vectors"), s)
    assert found.values == pytest.approx(alone.values, abs=1e-12)
    assert found.cost > 0


# -- budgets -------------------------------------------------------------------------------------------------------
def histories(own, letters, limit, charges, overruled):
    """Every history of a policy, recorded or not, with null actions in its stead where that is asked for too."""
    modes, rng = schedule_modes(PUBLISHED, letters), np.random.default_rng(0)
    left = [(0, own.begin(modes[0]), Fraction(0))]
    decisions = refused = 0
    while left:
        k, memory, spent = left.pop()
        share = own.probabilities(memory)
        wanted = own.policy.probabilities(memory.policy)
        decisions += 1
        done = set(np.flatnonzero(share > 0).tolist())
        assert own.act(memory, rng) in done
        for c in np.flatnonzero(wanted > 0).tolist():
            charge = charges[modes[k]][c]
            if spent + charge <= limit:
                assert share[c] > 0, "what can be paid for is done"
            else:
                refused += 1
        for c in sorted(done | ({0} if overruled else set())):
            after = spent + charges[modes[k]][c]
            assert after <= limit, "the budget is exceeded"
            if k + 1 == len(modes):
                continue
            responses = (NO_HELP, HELP, None) if modes[k] == ROBOT else (NONE,)
            left += [(k + 1, own.observe(memory, c, seen, modes[k + 1]), after) for seen in responses]
    return decisions, refused


def over_nine(kind, overruled):
    own = policy(kind, NINE, 2)
    if kind == "controller":
        own = FiniteStateController(
            own.vocabulary, own.mode, own.choice, own.follow, own.start, "keep", "controller"
        )  # fmt: skip
    limited = Guarded(own, [CostBudget.of(PUBLISHED, 40)], fallback_of(PUBLISHED))
    return histories(limited, NINE, 40, ((Fraction(0), Fraction(15)),) * 2, overruled)


@pytest.mark.parametrize("kind", [k for k in WATCHED if k != "plan"])
@pytest.mark.parametrize("overruled", [False, True])
def test_budget_is_never_exceeded_over_nine_events(kind, overruled):
    decisions, refused = over_nine(kind, overruled)
    assert decisions >= sum(3 ** (k // 2 + k % 2) for k in range(9))
    if kind in ("always", "random", "reactive"):
        assert refused > 0


def test_budget_is_never_exceeded_by_the_plan():
    s = rounds("HRHRH", 2)
    own = Guarded(policy("plan", "HRHRH", 2), [CostBudget.of(PUBLISHED, 20)], fallback_of(PUBLISHED))
    decisions, _ = histories(own, s.letters, 20, ((0, 15), (0, 15)), overruled=False)
    assert decisions > 20


@given(st.lists(st.sampled_from([0.1, 0.2, 0.3, 0.7, 1.5]), min_size=2, max_size=2), st.integers(0, 30))
def test_charges_are_added_up_as_decimals(pair, tenths):
    limit = tenths / 10
    own = Guarded(
        bare("always"), [CostBudget.of(PUBLISHED, limit, {"help": pair[0], "signal": pair[1]})],
        fallback_of(PUBLISHED),
    )  # fmt: skip
    exact = tuple((Fraction(0), Fraction(str(c))) for c in pair)
    histories(own, "HRHRHR", Fraction(str(limit)), exact, overruled=False)


@given(protocols(), st.data())
def test_no_policy_of_any_protocol_exceeds_a_budget(protocol, data):
    """Uniform choices: every action of every mode is proposed after every history."""
    nulls = {m.null_action for m in protocol.modes}
    charge = st.sampled_from([0.0, 0.1, 0.25, 1.0, 2.5])
    charges = {a: 0.0 if a in nulls else data.draw(charge) for a in protocol.action_names}
    limit = data.draw(st.sampled_from([0.0, 0.3, 1.0, 1.25, 3.6]))
    own = Guarded(
        uniformly_random(protocol), [CostBudget.of(protocol, limit, charges)], fallback_of(protocol)
    )  # fmt: skip
    modes = data.draw(st.lists(st.integers(0, len(protocol.modes) - 1), min_size=1, max_size=5))
    left = [(0, own.begin(modes[0]), Fraction(0))]
    while left:
        k, memory, spent = left.pop()
        names = own.vocabulary.actions[modes[k]]
        share = own.probabilities(memory)
        assert share.sum() == pytest.approx(1)
        for c in np.flatnonzero(share > 0).tolist():
            after = spent + Fraction(str(charges[names[c]]))
            assert after <= Fraction(str(limit))
            if k + 1 < len(modes):
                left.append((k + 1, own.observe(memory, c, None, modes[k + 1]), after))
        for c, name in enumerate(names):
            if spent + Fraction(str(charges[name])) <= Fraction(str(limit)):
                assert share[c] > 0, "what can be paid for is done"


def test_charges_need_no_common_unit():
    own = CostBudget.of(PUBLISHED, 30.0, {"help": 1 / 3, "signal": 15.29837412345678})
    spent = own.observe(own.begin(HUMAN), HUMAN, 1, NONE, ROBOT)
    found = own.review(spent, Proposal(ROBOT, 1, 1, 1))
    assert (found.choice, found.numbers["left"]) == (1, 30 - 1 / 3)
    spent = own.observe(spent, ROBOT, 1, HELP, HUMAN)
    assert own.review(spent, Proposal(ROBOT, 2, 1, 1)).choice == 0


@given(
    st.floats(1e-3, 20.0), st.floats(1e-3, 20.0), st.integers(0, 3), st.integers(0, 3), st.integers(-1, 1),
)  # fmt: skip
def test_a_limit_printed_for_a_sum_pays_for_it(help_charge, signal_charge, helps, signals, step):
    """The sum as the nearest number is the limit, as plans with a budget count; one number below is too little."""
    exact = helps * Fraction(repr(help_charge)) + (signals + 1) * Fraction(repr(signal_charge))
    limit = float(exact) if step == 0 else float(np.nextafter(float(exact), np.inf if step > 0 else 0.0))
    guard = CostBudget.of(PUBLISHED, limit, {"help": help_charge, "signal": signal_charge})
    state = guard.begin(HUMAN)
    for mode, times in ((HUMAN, helps), (ROBOT, signals)):
        for _ in range(times):
            state = guard.observe(state, mode, 1, NONE, mode)
    assert (guard.review(state, Proposal(ROBOT, 9, 1, 1)).choice == 1) == (step >= 0)
    assert guard.review(state + 1000, Proposal(ROBOT, 9, 0, 0)).choice == 0


def test_rounding_is_no_gain():
    """Two actions worth the same but for the last digit: it does not pay to take one, nor to leave the other."""
    values = np.array([[-2.391763342, -2.391763342 + 4e-16], [5.0, 5.0]])
    worth = Worth(values, np.array([0.4, 0.6]), np.full((2, 3), 1 / 3))
    proposal = Proposal(ROBOT, 0, 1, 1, worth)
    verdict = Confidence.of(PUBLISHED, 0.0).review(None, proposal)
    assert (verdict.choice, verdict.numbers["probability"]) == (0, 0.0)
    more = replace(worth, values=values + np.array([[0.0, 1e-6], [0.0, 0.0]]))
    assert Confidence.of(PUBLISHED, 0.3).review(None, replace(proposal, worth=more)).choice == 1
    least = MinimumInfluence.of(rounds("HR", 2).draws, 0.0)
    found = least.review(None, proposal)
    assert found.choice == 0, "the action that moves nobody is worth as much"
    assert "is worth most" in found.reason
    assert least.review(None, replace(proposal, worth=replace(more, weight=np.array([1.0, 0.0])))).choice == 1


def test_a_probability_just_below_its_threshold_reads_so():
    weight = np.array([0.8996, 0.1004])
    worth = Worth(np.array([[0.0, 1.0], [0.0, -1.0]]), weight, np.full((2, 3), 1 / 3))
    verdict = Confidence.of(PUBLISHED, 0.9).review(None, Proposal(ROBOT, 0, 1, 1, worth))
    assert verdict.reason == (
        "signal is worth more than no_signal with probability 0.8996 only, not above 0.9"
    )  # fmt: skip


def test_what_cannot_be_paid_for_is_said():
    own = schedule_vectors(rounds(), 15.0)
    memory = own.begin(ROBOT)
    memory = own.observe(memory, 1, HELP, HUMAN)
    found = decide(own, memory)
    worth = own.action_values(memory)
    assert np.isnan(worth[1])
    assert found.explanation.startswith(f"no_help; no_help is worth {worth[0]:.4g}; help cannot be paid for; the")
    assert found.explanation.endswith("; it can still spend 0 of its budget.")
    belt = Guarded(own, [CostBudget.of(PUBLISHED, 15.0)], fallback_of(PUBLISHED))
    assert belt.decide(belt.observe(belt.begin(ROBOT), 1, HELP, HUMAN)).explanation == found.explanation
    assert "budget" not in decide(schedule_vectors(rounds()), schedule_vectors(rounds()).begin(ROBOT)).explanation


def test_budget_counts_what_was_really_done():
    own = Guarded(bare("never"), [CostBudget.of(PUBLISHED, 30)], fallback_of(PUBLISHED))
    memory = own.begin(HUMAN)
    for mode in (ROBOT, HUMAN, ROBOT):
        memory = own.observe(memory, 1, HELP if memory.mode == ROBOT else NONE, mode)
    assert own.decide(memory).numbers["budget.spent"] == 45
    assert own.decide(memory).numbers["budget.left"] == 0


def test_hard_safeguards_have_the_last_word():
    s = rounds()
    own = guarded("always", [CostBudget.of(PUBLISHED, 0), Confidence.of(PUBLISHED, 0.1)])
    assert [g.name for g in own.safeguards] == ["confidence", "budget"]
    assert evaluate_schedule(own, s).cost == 0


# -- randomised ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("letters", ["HRH", "RHR"])
def test_probability_moves_to_what_safeguards_make_of_it(letters):
    s = rounds(letters)
    own = guarded("random", all_guards(s, budget=15.0), letters)
    modes = s.modes
    memory = own.begin(modes[0])
    for k in range(3):
        wanted = np.zeros(2)
        for c, p in enumerate(own.policy.probabilities(memory.policy)):
            choice = c
            for guard, state in zip(own.safeguards, memory.states, strict=True):
                choice = guard.review(state, Proposal(memory.mode, k, choice, c, memory.worth)).choice
            wanted[choice] += p
        assert own.probabilities(memory) == pytest.approx(wanted)
        rng, again = np.random.default_rng(k), np.random.default_rng(k)
        drawn = [own.act(memory, rng) for _ in range(400)]
        assert drawn == [own.decide(memory, again).choice for _ in range(400)], "the same luck, the same action"
        assert np.mean(drawn) == pytest.approx(wanted[1], abs=0.09)
        if k < 2:
            memory = own.observe(memory, 1, HELP if modes[k] == ROBOT else NONE, modes[k + 1])


def test_randomised_policies_need_luck_also_where_they_are_sure():
    own = guarded("random", [CostBudget.of(PUBLISHED, 0)])
    with pytest.raises(InputError, match="rng: found None"):
        own.decide(own.begin(ROBOT))
    halves = ModePolicy(Vocabulary.of(PUBLISHED), [[0.5, 0.5]] * 2, "halves")
    own = Guarded(bare("always"), [], halves)
    with pytest.raises(InputError, match="rng"):
        own.act(own.begin(ROBOT))


# -- it is a policy ------------------------------------------------------------------------------------------------
def test_without_horizon_a_guarded_controller_is_a_controller():
    own = bare("controller")
    free = Guarded(own, [CostBudget.of(PUBLISHED, 0)], fallback_of(PUBLISHED))
    assert infinite_value(free, problem()).value == pytest.approx(infinite_value(never(PUBLISHED), problem()).value)
    values = []
    for limit in (0, 15, 30, 60, 1e6):
        one = Guarded(bare("always"), [CostBudget.of(PUBLISHED, limit)], fallback_of(PUBLISHED))
        if limit < 1e6:
            found = infinite_value(one, problem())
            assert found.memories <= 2 * (limit // 15 + 1)
            values.append(found.value)
    assert len(set(np.round(values, 9))) == len(values)


def test_simulation_takes_it():
    own = Guarded(bare("reactive"), [CostBudget.of(PUBLISHED, 30)], fallback_of(PUBLISHED))
    exact = infinite_value(own, problem()).value
    (found,) = simulate_policies([own], problem(), runs=4000, seed=1)
    assert abs(found.value - exact) < 4 * (found.high - found.low)


def test_the_policy_is_told_what_was_really_done():
    told = []

    class Spy(ModePolicy):
        def observe(self, memory, choice, observation, next_mode):
            told.append(choice)
            return super().observe(memory, choice, observation, next_mode)

    always = bare("always")
    own = Guarded(
        Spy(always.vocabulary, always.shares, "spy"), [CostBudget.of(PUBLISHED, 0)], fallback_of(PUBLISHED)
    )
    memory = own.begin(HUMAN)
    memory = own.observe(memory, own.act(memory), NONE, ROBOT)
    own.observe(memory, 1, HELP, HUMAN)
    assert told == [0, 1]


# -- decisions -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", WATCHED)
def test_every_decision_explains_itself_in_one_sentence(kind):
    own, rng = guarded(kind), np.random.default_rng(1)
    memory = own.begin(ROBOT)
    for k in range(5):
        for found in (own.decide(memory, rng), decide(own.policy, memory.policy, rng)):
            text = found.explanation
            assert text.endswith(".")
            assert not re.search(r"\.\s", text), "one sentence"
            assert text.startswith(found.action)
            assert found.action == own.vocabulary.actions[memory.mode][found.choice]
            assert all(np.isfinite(v) for v in found.numbers.values())
            assert found.to_dict()["action"] == found.action
        if own.decide(memory, rng).numbers:
            assert "worth" in own.decide(memory, rng).explanation
        if k < 4:
            memory = own.observe(
                memory, own.act(memory, rng), HELP if memory.mode == ROBOT else NONE, 1 - memory.mode
            )


def test_a_decision_names_who_changed_it_and_why():
    own = Guarded(bare("always"), [CostBudget.of(PUBLISHED, 20)], fallback_of(PUBLISHED))
    memory = own.observe(own.begin(HUMAN), 1, NONE, ROBOT)
    found = own.decide(memory)
    assert (found.action, found.proposed, found.changed_by) == ("no_signal", 1, ("budget",))
    assert found.explanation == (
        "no_signal instead of signal, because signal costs 15 and 5 of the budget of 20 is left (budget); always "
        "looks at the mode robot_needs_help only."
    )
    assert found.numbers == {"budget.limit": 20, "budget.spent": 15, "budget.left": 5, "budget.charge": 15}


@pytest.mark.parametrize("kind", ["vectors", "tracked", "controller", "always"])
def test_a_decision_takes_less_than_a_third_of_a_millisecond(kind):
    own = guarded(kind)
    memory = own.begin(ROBOT)
    best = np.inf
    for _ in range(20):
        begun = time.perf_counter()
        for _ in range(20):
            own.decide(memory)
        best = min(best, (time.perf_counter() - begun) / 20)
    assert best < 300e-6


# -- refusals ------------------------------------------------------------------------------------------------------
def test_refusals():
    fallback, always = fallback_of(PUBLISHED), bare("always")
    budget = CostBudget.of(PUBLISHED, 15)
    cases = [
        (lambda: Guarded(Guarded(always, [], fallback), [], fallback), "found a guarded policy"),
        (lambda: Guarded(always, [budget, budget], fallback), "wanted budget once"),
        (lambda: Guarded(always, [Confidence.of(PUBLISHED, 0.5)], fallback), "safeguard confidence, what actions"),
        (lambda: guarded("always", [MinimumInfluence.of(doubt(2), 1.0)]), "found 6 draws of 3 states, wanted 2"),
        (lambda: Guarded(always, [], bare("reactive")), "found reactive (Reciprocal), which may adapt"),
        (lambda: Guarded(always, [], bare("controller")), "may adapt to the person"),
        (lambda: Guarded(always, [budget], fallback_of(PUBLISHED, {"human_needs_help": "help"})),
         "found help in mode human_needs_help, charged 15, wanted free actions"),
        (lambda: CostBudget.of(PUBLISHED, -1), "budget, limit: found -1"),
        (lambda: CostBudget.of(PUBLISHED, 1, {"no_help": 1.0}), "it is the null action of mode human_needs_help"),
        (lambda: CostBudget.of(PUBLISHED, 1, {"hug": 1.0}), "budget, charges, action: found 'hug'"),
        (lambda: CostBudget.of(PUBLISHED, float("nan")), "budget, limit"),
        (lambda: Confidence.of(PUBLISHED, 1.0), "confidence, threshold: found 1.0, wanted from 0 to below 1"),
        (lambda: Confidence.of(PUBLISHED, 0.5, -1.0), "confidence, tolerance"),
        (lambda: MinimumInfluence.of(doubt(2), -1.0), "influence, tolerance"),
    ]  # fmt: skip
    for build, words in cases:
        with pytest.raises(InputError) as caught:
            build()
        assert words in str(caught.value)


def test_names_must_be_the_same():
    other = make_protocol([True, False], [2, 2], 2)
    with pytest.raises(InputError, match="fallback, modes, actions and observations"):
        Guarded(bare("always"), [], fallback_of(other))
    with pytest.raises(InputError, match="budget, modes, actions and observations"):
        Guarded(bare("always"), [CostBudget.of(other, 1)], fallback_of(PUBLISHED))
