"""Minimum influence and confidence: against brute force, against evaluation in each draw, and what they cost."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.baselines import uniformly_random
from models.planning.evaluation import evaluate_schedule
from models.planning.policies import Vocabulary
from models.planning.schedule_vectors import schedule_vectors
from models.protocol import PUBLISHED
from models.safeguards.confidence import Confidence
from models.safeguards.consent import fallback_of
from models.safeguards.guarded import Guarded
from models.safeguards.influence import MinimumInfluence, influence_table
from models.safeguards.safeguard import Proposal, null_choices
from models.safeguards.schedule_worth import ScheduleWorth
from models.safeguards.worth import Worth
from tests.models.planning.schedule_cases import schedules
from tests.models.safeguards.guard_cases import direct_worth, doubt, guarded, policy, rounds, walked
from tests.random_cases import protocols


@st.composite
def situations(draw):
    """A protocol, its influence tables, and what its actions are worth somewhere."""
    protocol = draw(protocols())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    d, s = draw(st.integers(1, 4)), draw(st.integers(1, 4))
    tables = [rng.choice([0.0, 0.25, 0.5, 1.0], size=(d, len(m.actions), s)) for m in protocol.modes]
    mode = draw(st.integers(0, len(protocol.modes) - 1))
    n = len(protocol.modes[mode].actions)
    values = rng.integers(0, 6, size=(d, n)).astype(float)
    if draw(st.booleans()) and n > 1:
        values[:, rng.integers(1, n)] = np.nan
    worth = Worth(values, rng.dirichlet(np.ones(d)), rng.dirichlet(np.ones(s), size=d))
    choice = draw(st.integers(0, n - 1))
    return protocol, tables, worth, Proposal(mode, 0, choice, choice, worth)


@given(situations(), st.sampled_from([0.0, 0.5, 1.0, 2.5, 100.0]))
def test_minimum_influence_is_brute_force(case, tolerance):
    protocol, tables, worth, proposal = case
    guard = MinimumInfluence(tolerance, tables, Vocabulary.of(protocol), null_choices(protocol))
    d, s = worth.belief.shape
    moved = []
    for c in range(worth.values.shape[1]):
        total = 0.0
        for i, y in product(range(d), range(s)):
            total += worth.weight[i] * worth.belief[i, y] * tables[proposal.mode][i, c, y]
        moved.append(total)
    mean = [sum(worth.weight[i] * worth.values[i, c] for i in range(d)) for c in range(len(moved))]
    possible = [c for c in range(len(mean)) if not np.isnan(mean[c])]
    best = max(mean[c] for c in possible)
    near = [c for c in possible if mean[c] >= best - tolerance]
    least = min(moved[c] for c in near)
    found = guard.review(None, proposal)
    if least < moved[proposal.choice] - 1e-9:
        assert found.choice in near
        assert moved[found.choice] == pytest.approx(least, abs=1e-12)
        assert found.reason
    elif least > moved[proposal.choice] - 1e-13:
        assert found.choice == proposal.choice
        assert found.reason is None
    assert moved[found.choice] <= moved[proposal.choice] + 1e-12, "it never adds influence"


def test_influence_is_total_variation():
    draws = doubt(4)
    table = influence_table(draws)
    for d, (a, name), s in product(range(4), enumerate(PUBLISHED.action_names), range(3)):
        null = PUBLISHED.modes[PUBLISHED.mode_of_action[a]].null_action
        left_alone = draws.transition[d, PUBLISHED.action(null), s]
        # The largest difference in the probability of any set of states.
        sets = [
            abs(sum(draws.transition[d, a, s, list(i)]) - sum(left_alone[list(i)]))
            for i in ([], [0], [1], [2], [0, 1], [0, 2], [1, 2])
        ]
        assert table[d, a, s] == pytest.approx(max(sets))
        if name == null:
            assert table[d, a, s] == 0


def test_it_exists_where_the_divergence_is_infinite():
    sure = LatentStatePOMDP([0.5, 0.5], [np.eye(2), np.eye(2)[::-1], np.eye(2), np.eye(2)], [[[0.5, 0.5]] * 2] * 2)
    table = influence_table(ModelDraws.from_models([sure]))
    assert table[0].tolist() == [[0, 0], [1, 1], [0, 0], [0, 0]]


def test_nobody_can_say():
    for guard in (MinimumInfluence.of(doubt(2), 1.0), Confidence.of(PUBLISHED, 0.5)):
        found = guard.review(None, Proposal(0, 0, 1, 1, None))
        assert (found.choice, found.reason) == (0, "nobody can say what actions are worth here")
        assert guard.review(None, Proposal(0, 0, 0, 0, None)).reason is None
    nothing = Worth(np.full((2, 2), np.nan), np.full(2, 0.5), np.full((2, 3), 1 / 3))
    assert MinimumInfluence.of(doubt(2), 1.0).review(None, Proposal(0, 0, 1, 1, nothing)).choice == 0


def test_without_tolerance_it_takes_nothing_from_the_best_plan_and_with_any_it_leaves_nothing():
    s, own = rounds("HRHRHRHRH"), policy("vectors", "HRHRHRHRH")
    alone = evaluate_schedule(own, s)
    values = [alone.value]
    for tolerance in (0.0, 2.0, 10.0, 1e6):
        guard = Guarded(own, [MinimumInfluence.of(s.draws, tolerance)], fallback_of(PUBLISHED))
        values.append(evaluate_schedule(guard, s).value)
    assert values[1] == pytest.approx(values[0])
    assert values[-1] == pytest.approx(evaluate_schedule(policy("never"), s).value)
    assert values[0] > values[-1] + 1


@given(schedules(max_events=4, max_draws=2, zeros=0.0), st.integers(0, 2**32 - 1), st.sampled_from([0.0, 0.3, 1.0]))
def test_what_it_takes_is_the_sum_of_what_decisions_take(s, seed, tolerance):
    """The performance difference: value lost = expected sum of V - Q(what is done) along the guarded runs."""
    own = schedule_vectors(s) if seed % 2 else uniformly_random(s.protocol)
    source = ScheduleWorth(own, s)
    guard = Guarded(own, [MinimumInfluence.of(s.draws, tolerance)], fallback_of(s.protocol), source)
    lost = 0.0
    holds = [(0, guard.begin(s.modes[0]), s.start())]
    while holds:
        k, memory, joint = holds.pop()
        share, wanted = guard.probabilities(memory), own.probabilities(memory.policy)
        lost += joint.sum() * s.discount**k * float((wanted - share) @ memory.worth.mean)
        for c, p in enumerate(share):
            for o in range(s.n_outcomes(k)) if p > 0 and k + 1 < s.n_events else ():
                seen = o + 1 if s.n_outcomes(k) > 1 or s.mode(k).shows_response else 0
                reached = s.after(p * joint, s.first_action(k) + c, o if s.mode(k).shows_response else None)
                if reached.sum() > 0:
                    holds.append((k + 1, guard.observe(memory, c, seen, s.modes[k + 1]), reached))
    before, after = evaluate_schedule(own, s).value, evaluate_schedule(guard, s).value
    assert before - after == pytest.approx(lost, abs=1e-8)


# -- confidence ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["vectors", "always", "reactive", "myopic", "tracked"])
def test_confidence_is_the_weight_of_the_draws_that_agree(kind):
    s = rounds("HRHRH")
    rng = np.random.default_rng(5)
    changed = 0
    for threshold, margin in ((0.3, 0.0), (0.6, 1.0), (0.95, 0.5)):
        own = guarded(kind, [Confidence.of(PUBLISHED, threshold, margin)])
        for steps in (0, 1, 2, 3, 4, 4):
            memory, history = walked(own, s, rng, steps)
            values, weight, _ = direct_worth(own.policy, memory.policy, s, history)
            proposed = own.policy.act(memory.policy)
            sure = sum(w for w, v in zip(weight, values, strict=True) if v[proposed] - v[0] > margin)
            wanted = proposed if proposed == 0 or sure > threshold else 0
            assert own.act(memory) == wanted
            changed += wanted != proposed
            if proposed:
                assert own.decide(memory).numbers["confidence.probability"] == pytest.approx(sure)
    assert changed > 0 or kind in ("vectors", "myopic", "tracked", "reactive")


def test_with_one_draw_it_asks_whether_the_action_pays():
    s = rounds("HRHRH", 1)
    own, alone = policy("vectors", "HRHRH", 1), evaluate_schedule(policy("vectors", "HRHRH", 1), s)
    guard = Guarded(own, [Confidence.of(PUBLISHED, 0.9)], fallback_of(PUBLISHED))
    assert evaluate_schedule(guard, s).value == pytest.approx(alone.value)
