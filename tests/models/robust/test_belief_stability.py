"""Decision stability: action values by loops and by brute force, shares that sum to one, study histories."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.alpha_policy import AlphaPolicy
from models.planning.baselines import Reciprocal, never, uniformly_random
from models.planning.batch import solve_draws
from models.planning.latent import LatentBatch
from models.planning.mode_process import alternating
from models.protocol import PUBLISHED
from models.reward import Reward, default_x
from models.robust import belief_stability as module
from models.robust.belief_stability import (
    UNDECIDED,
    belief_stability,
    draw_action_values,
    edge_walk,
    face_grid,
    start_stability,
)
from models.robust.history_stability import _in_percent, history_stability
from tests.models.robust.endless_cases import batches, solved
from tests.reference import controllers as reference
from tests.reference import planning as brute

R, H = 0, 1


def dirichlet(seed, *shape, n=3):
    return np.random.default_rng(seed).dirichlet(np.ones(n), shape)


# -- action values ---------------------------------------------------------------------------------
@given(batches(), st.integers(0, 2**32 - 1))
def test_loops_say_the_same(batch, seed):
    batch = replace(batch, discount=0.5)
    s = solve_draws(batch, 1e-2, threads=1)
    beliefs = dirichlet(seed, 3, n=batch.draws.n_states)
    for mode in range(len(batch.draws.protocol.modes)):
        found = draw_action_values(s, beliefs, mode)
        for d in range(len(batch)):
            expected = [reference.action_values(batch, s.solutions[d], d, b, mode) for b in beliefs]
            np.testing.assert_allclose(found[d], expected, rtol=1e-12, atol=1e-10)


def test_the_same_as_the_policy_of_the_planner():
    s = solved()
    beliefs = dirichlet(0, 10)
    for mode in (R, H):
        found = draw_action_values(s, beliefs, mode)
        for d in range(0, 24, 7):
            one = s.solutions[d]
            policy = AlphaPolicy(s.batch.problem(d), one.alpha, one.mode, one.choice, one.follow)
            np.testing.assert_allclose(found[d], policy.action_values_many(beliefs, mode), rtol=1e-12)


def test_brute_force():
    """Every history to a depth where what is left hardly counts: decided preferences are the true ones."""
    s = solved(8, 2, "alternating", 0.4)
    beliefs = np.array([[1.0, 0.0], [0.5, 0.5], [0.1, 0.9]])
    depth = 6
    for mode in (R, H):
        found = draw_action_values(s, beliefs, mode)
        stable = belief_stability(s, beliefs, mode)
        rest = 0.4**depth * np.abs(s.batch.template.reward).max() / 0.6
        preferred = np.zeros((3, 2))
        for d in range(8):
            problem = s.batch.problem(d)
            exact = np.array([brute.action_values(problem, mode, b, depth) for b in beliefs])
            gap = s.upper[d] - s.lower[d]
            # Lower bounds, and close to the truth although the certificate is about the start only.
            assert np.all(found[d] <= exact + rest)
            assert np.all(found[d] >= exact - rest - max(gap, 1e-3 * np.abs(exact).max()))
            margin = np.abs(exact[:, 1] - exact[:, 0])
            decided = np.abs(found[d, :, 1] - found[d, :, 0]) > gap
            sure = decided & (margin > 2 * rest)
            np.testing.assert_array_equal(found[d].argmax(axis=1)[sure], exact.argmax(axis=1)[sure])
            for g in range(3):
                if decided[g]:
                    preferred[g, found[d, g].argmax()] += s.batch.draws.weight[d]
        np.testing.assert_allclose(stable.share, preferred, atol=1e-12)


# -- shares and losses -----------------------------------------------------------------------------
@given(st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
def test_shares_losses_values(seed, own, weighted):
    s = solved()
    beliefs = dirichlet(seed, 24, 4) if own else dirichlet(seed, 4)
    weight = np.random.default_rng(seed).random((24, 4)) if weighted else None
    found = belief_stability(s, beliefs, H, weight=weight)
    assert found.whose == ("each draw's own belief" if own else "one belief for all draws")
    np.testing.assert_allclose(found.share.sum(axis=1) + found.undecided, 1, atol=1e-12)
    np.testing.assert_allclose(found.leaning.sum(axis=1), 1, atol=1e-12)
    q = draw_action_values(s, beliefs, H)
    w = np.broadcast_to(s.batch.draws.weight[:, None], (24, 4)) if weight is None else weight / weight.sum(axis=0)
    best = q.max(axis=2)
    np.testing.assert_allclose(found.value, (w * best).sum(axis=0))
    np.testing.assert_allclose(found.loss, np.einsum("dg,dgc->gc", w, best[:, :, None] - q), atol=1e-12)
    assert np.all(found.loss >= 0)
    lead = np.abs(q[:, :, 1] - q[:, :, 0])
    near = lead <= (s.upper - s.lower)[:, None]
    np.testing.assert_allclose(found.undecided, (w * near).sum(axis=0), atol=1e-12)


def test_chunks_change_nothing(monkeypatch):
    s = solved()
    own, fixed = dirichlet(4, 24, 3), dirichlet(5, 3)
    whole = [belief_stability(s, b, H) for b in (own, fixed)]
    monkeypatch.setattr(module, "CHUNK", 7)
    with ThreadPoolExecutor(2) as threads:
        parts = [belief_stability(s, b, H, executor=threads) for b in (own, fixed)]
    for a, b in zip(whole, parts, strict=True):
        for name in ("share", "undecided", "loss", "value"):
            np.testing.assert_allclose(getattr(a, name), getattr(b, name), rtol=1e-12, atol=1e-14)


def test_wide_bounds_decide_nothing():
    s = solved()
    wide = tuple(replace(one, upper=one.upper + 1e6) for one in s.solutions)
    found = belief_stability(replace(s, solutions=wide), dirichlet(1, 3), R)
    np.testing.assert_array_equal(found.share, 0)
    assert found.shares()[UNDECIDED] == pytest.approx(1)
    np.testing.assert_array_equal(found.leaning, 0.5)


def test_at_the_start():
    s = solved()
    found = start_stability(s)
    assert list(found) == ["human_needs_help", "robot_needs_help"]
    for mode, stable in found.items():
        assert sum(stable.shares().values()) == pytest.approx(1)
        q = draw_action_values(s, s.batch.draws.initial[:, None, :], mode)
        assert stable.value[0] == pytest.approx(float(s.batch.draws.weight @ q[:, 0].max(axis=1)))
    # The best action at the start is worth what the draw is worth, up to its gap.
    q = draw_action_values(s, s.batch.draws.initial[:, None, :], R)[:, 0].max(axis=1)
    assert np.all(q >= s.lower - 1e-9)
    assert np.all(q <= s.upper + 1e-9)


def test_grids():
    walk = edge_walk(4, 5)
    assert walk.shape == (16, 4)
    np.testing.assert_array_equal(walk[[0, 5, 10, 15]], np.eye(4))
    face = face_grid(5, (0, 2, 4), 6)
    assert len(np.unique(face, axis=0)) == len(face) == 28
    np.testing.assert_allclose(face.sum(axis=1), 1)
    np.testing.assert_array_equal(face[:, [1, 3]], 0)


def test_refusals():
    s = solved()
    good = dirichlet(0, 2)
    with pytest.raises(InputError, match="mode: found 'sleep', wanted one of human_needs_help"):
        belief_stability(s, good, "sleep")
    with pytest.raises(InputError, match="beliefs, shape"):
        belief_stability(s, good[:, :2], R)
    with pytest.raises(InputError, match="belief 1"):
        belief_stability(s, good * [[1], [2]], R)
    with pytest.raises(InputError, match="weights at beliefs"):
        belief_stability(s, good, R, weight=np.ones((24, 5)))


# -- along a study ---------------------------------------------------------------------------------
def test_histories_by_filtering():
    s = solved()
    draws = s.batch.draws
    found = history_stability(s, "HRHH", Reciprocal(PUBLISHED)).events
    assert [len(e.histories) for e in found] == [1, 2, 2, 4]
    last = found[3]
    assert last.histories[2] == ("no_signal: help", "help", "no_signal: no_help")
    chance = np.empty(24)
    for d in range(24):
        model = draws.model(d)
        b, p = model.initial, 1.0
        for action, response in (("no_signal", "help"), ("help", None), ("no_signal", "no_help")):
            if response is not None:
                p *= model.response_probability(b, action)[PUBLISHED.response_names.index(response)]
            b = model.update(b, action, response)
        np.testing.assert_allclose(last.stability.beliefs[d, 2], b, rtol=1e-10)
        chance[d] = p
    assert last.probability[2] == pytest.approx(draws.weight @ chance)
    w = draws.weight * chance
    again = belief_stability(s, last.stability.beliefs[:, 2:3], H, weight=w)
    assert last.stability.shares(2) == pytest.approx(again.shares())
    for e in found:
        assert e.probability.sum() == pytest.approx(1)
        assert sum(e.mean_shares.values()) == pytest.approx(1)
    whole = history_stability(s, "HRHH", Reciprocal(PUBLISHED))
    assert whole.letters == "HRHH"
    assert len(whole.rows()) == sum(len(e.histories) for e in found)
    assert whole.table["event"].tolist() == [1, 2, 3, 4]
    event, g = whole.most_divided
    least = min(
        e.stability.share[i].max() + e.stability.undecided[i]
        for e in found for i in range(len(e.histories)) if e.probability[i] >= 0.01
    )  # fmt: skip
    assert event.stability.share[g].max() + event.stability.undecided[g] == least
    assert f"event {event.event + 1} ({event.stability.mode})" in whole.sentence
    assert "each draw's own belief" in whole.sentence
    rows = last.rows()
    assert rows[2]["history"] == "no_signal: help, help, no_signal: no_help"
    assert rows[2]["loss of signal"] >= 0


def test_a_tie_in_every_draw_is_no_division():
    """Where a signal changes nothing and is free, all draws are undecided, and none disagrees with another."""
    draws = solved().batch.draws
    signal, quiet = (PUBLISHED.action_names.index(a) for a in ("signal", "no_signal"))
    transition, emission = draws.transition.copy(), draws.emission.copy()
    transition[:, signal] = transition[:, quiet]
    shown = [PUBLISHED.emission_actions.index(a) for a in ("signal", "no_signal")]
    emission[:, shown[0]] = emission[:, shown[1]]
    reward = replace(draws.reward or Reward(default_x(draws.n_states)), costs={"signal": 0.0, "help": 4.0})
    same = replace(draws, transition=transition, emission=emission, reward=reward)
    found = history_stability(solve_draws(LatentBatch(same, alternating(PUBLISHED))), "HRH", never(PUBLISHED))
    assert found.events[0].stability.undecided == pytest.approx(np.ones(1))
    event, _ = found.most_divided
    assert event.event == 1


def test_percents_sum_to_a_hundred():
    assert _in_percent({"a": 0.986, "b": 0.014, "c": 0.0}) == "a 99%, b 1%, c 0%"
    assert _in_percent({"a": 0.985, "b": 0.015, "c": 0.0}).count(" 0%") == 1
    for seed in range(50):
        shares = np.random.default_rng(seed).dirichlet(np.full(4, 0.3))
        told = _in_percent(dict(zip("abcd", shares.tolist(), strict=True)))
        whole = np.array([int(part.split()[1][:-1]) for part in told.split(", ")])
        assert whole.sum() == 100
        assert np.all(np.abs(whole - 100 * shares) < 1)


def test_one_belief_for_all_draws():
    s = solved()
    tracker = s.batch.draws.model(5)
    found = history_stability(s, "HRH", never(PUBLISHED), tracker=tracker).events
    b = tracker.update(tracker.update(tracker.initial, "no_signal", "help"), "no_help")
    np.testing.assert_allclose(found[2].stability.beliefs[1], b, rtol=1e-12)
    own = history_stability(s, "HRH", never(PUBLISHED)).events
    np.testing.assert_allclose(found[2].probability, own[2].probability)
    np.testing.assert_allclose(own[2].stability.beliefs[5, 1], b, rtol=1e-12)


def test_impossible_histories_are_left_out():
    s = solved()
    d = s.batch.draws
    sure = np.zeros_like(d.emission)
    sure[..., 1] = 1.0
    batch = LatentBatch(replace(d, emission=sure), s.batch.process, 0.9)
    found = history_stability(solve_draws(batch, 1e-2), "HRHRH", never(PUBLISHED)).events
    assert [len(e.histories) for e in found] == [1] * 5
    # Impossible in one draw only: there it has no weight.
    sure[3:] = d.emission[3:]
    batch = LatentBatch(replace(d, emission=sure), s.batch.process, 0.9)
    found = history_stability(solve_draws(batch, 1e-2), "HR", never(PUBLISHED)).events
    assert found[1].stability.beliefs[0, 0] == pytest.approx(np.full(3, 1 / 3))


def test_histories_need_a_policy_and_a_tracker_that_fit():
    s = solved()
    with pytest.raises(InputError, match="actions left to chance"):
        history_stability(s, "HR", uniformly_random(PUBLISHED))
    with pytest.raises(InputError, match="tracker"):
        history_stability(s, "HR", never(PUBLISHED), tracker=solved(3, 2).batch.draws.model(0))
