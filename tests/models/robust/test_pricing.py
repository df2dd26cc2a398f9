"""What plans are worth under doubt, the frontier of caution, contested costs, and persons as draws."""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.simulate import calibrated_truth
from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.planning.exact import solve_schedule
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.reward import Reward
from models.robust import candidates
from models.robust.candidates import Candidate, one, posterior_mean, standard_candidates
from models.robust.cautious import cautious_plan
from models.robust.contested import LARGEST, contested, flip_points, with_costs
from models.robust.frontier import frontier
from models.robust.open_loop import open_loop
from models.robust.own_plans import own_plans
from models.robust.people_draws import personalised
from models.robust.plan_table import PlanEvaluator, PlanTable
from models.robust.pricing import price
from models.robust.risk import cvar, weighted_quantiles
from models.robust.stability import decision_stability
from tests.models.planning.schedule_cases import telling_tables
from tests.planning_cases import sticky_draws


@pytest.fixture(scope="module")
def schedule():
    draws = sticky_draws(60, 17)
    weight = np.random.default_rng(1).dirichlet(np.ones(60))
    return Schedule.of(draws, "HRHRH", weight=weight)


@pytest.fixture(scope="module")
def prices(schedule):
    return price(schedule, standard_candidates(schedule, plug_in=schedule.draws.model(3)), alpha=0.2)


def test_scores_follow_from_values(schedule, prices):
    weight, own = schedule.draws.weight, own_plans(schedule)
    never = prices["never"].values
    for p in prices.prices:
        v = p.values
        assert p.mean == pytest.approx(weight @ v)
        assert p.cvar == pytest.approx(cvar(v, weight, 0.2))
        assert p.worst == pytest.approx(v.min())
        assert p.max_regret == pytest.approx((own.values - v).max())
        assert p.mean_regret == pytest.approx(weight @ (own.values - v))
        assert p.gain_mean == pytest.approx(weight @ (v - never))
        assert p.gain_q05 <= p.gain_q95
        assert 0 <= p.gain_probability <= 1
        assert p.chosen.values(schedule) == pytest.approx(v)
    assert prices["never"].gain_probability == 0


def test_no_shortcut_beats_the_exact_plans(schedule, prices):
    bayes, careful, regret = (prices[n] for n in ("Bayes-adaptive", "cautious", "minimax regret"))
    slack = 1e-9 * abs(bayes.mean)
    for p in prices.prices:
        assert p.mean <= bayes.mean + slack
        assert p.cvar <= careful.cvar + slack
        assert p.max_regret >= regret.max_regret - slack
    assert bayes.mean <= own_plans(schedule).mean


def test_that_the_best_plan_is_a_simple_rule_is_said(prices, schedule):
    assert prices.best.name == "Bayes-adaptive"
    assert prices.best_baseline == "never"
    assert set(np.concatenate(solve_schedule(schedule).decisions)) == {0}  # in truth it never acts
    assert "just what 'never' is worth: under all this doubt the best plan is 'never'. Lost by" in prices.sentence
    assert "it gains" not in prices.sentence
    assert "never 0" not in prices.sentence


def test_plans_that_are_no_simple_rule_are_not_called_one():
    schedule = Schedule.of(ModelDraws.from_models([calibrated_truth()]), "HRHRH")
    found = price(schedule, standard_candidates(schedule))
    baselines = [p for p in found.prices if p.about.startswith("baseline")]
    assert len(baselines) >= 4
    assert max(p.mean for p in baselines) < found.best.mean
    assert found.best_baseline == ""
    assert "; against never helping it gains" in found.sentence


def test_held_out_scores_come_from_the_other_half(schedule):
    seen = []

    def choose(own):
        seen.append(own.draws.n_draws)
        return one(solve_schedule(own).decisions)

    found = price(schedule, [Candidate("Bayes-adaptive", "", choose), Candidate("fixed", "", choose, looks=False)])
    assert sorted(seen) == [30, 30, 60, 60]
    first = found.prices[0]
    assert first.held_out_mean <= first.mean + 1e-9
    assert found.prices[1].held_out_mean == found.prices[1].mean


def test_the_optimiser_s_curse_shows():
    """Few draws that differ much: the plan chosen on them looks better than it is."""
    lost = []
    for seed in range(8):
        draws = sticky_draws(4, 100 + seed)
        schedule = Schedule.of(draws, "HRHRHRH")
        p = price(schedule, [Candidate("b", "", lambda s: one(solve_schedule(s).decisions))]).prices[0]
        lost.append(p.mean - p.held_out_mean)
    assert min(lost) >= -1e-9
    assert max(lost) > 0


def test_nothing_depends_on_the_executor():
    schedule = Schedule.of(sticky_draws(12, 17), "HRH")
    told = []
    plain = price(schedule, standard_candidates(schedule), progress=lambda *x: told.append(x))
    assert told[-1] == (len(plain.prices), len(plain.prices))
    line = frontier(schedule, (1.0, 0.5, 0.3, 0.2, 0.1, 0.05, 0.01))
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        other = price(schedule, standard_candidates(schedule), executor=pool)
        again = frontier(schedule, (1.0, 0.5, 0.3, 0.2, 0.1, 0.05, 0.01), executor=pool)
    for a, b in zip(plain.prices, other.prices, strict=True):
        assert a.values == pytest.approx(b.values, abs=0)
        assert a.held_out_mean == b.held_out_mean
    assert line.rows() == again.rows()


def test_the_best_fixed_model_is_found_among_many(monkeypatch):
    schedule = Schedule.of(sticky_draws(40, 17), "HRHRH")
    everything = next(c for c in standard_candidates(schedule) if c.name == "best fixed model")
    values = everything.choose(schedule).values(schedule)
    table = PlanTable.of(schedule, own_plans(schedule).plans)
    assert schedule.draws.weight @ values >= table.means.max() - 1e-12
    monkeypatch.setattr(candidates, "SCREENED", 20)
    monkeypatch.setattr(candidates, "KEPT", 3)
    some = everything.choose(schedule).values(schedule)
    assert schedule.draws.weight @ values - 0.02 * abs(values).max() <= schedule.draws.weight @ some
    assert schedule.draws.weight @ some <= schedule.draws.weight @ values + 1e-12


def test_a_headline_says_what_is_in_doubt():
    """Where every draw agrees with the first decision, the least sure one is named beside it."""
    draws = sticky_draws(60, 17)
    dear = replace(
        draws, reward=replace(draws.reward or Reward((0.0, 1.0, 2.0)), costs={"help": 4.0, "signal": 1e4})
    )
    schedule = Schedule.of(dear, "HRHRHR")
    found = decision_stability(schedule, solve_schedule(schedule))
    assert found.standings[0].share["no_signal"] == pytest.approx(1)
    least = found.least_sure
    assert least.share[least.action] < 0.99
    assert found.headline.startswith("no_signal first is right in every draw, ")
    assert f"in {least.share[least.action]:.0%}; being wrong there costs" in found.headline


def test_names_must_differ(schedule):
    choose = Candidate("same", "", lambda s: one(open_loop(s)))
    with pytest.raises(InputError, match="different names"):
        price(schedule, [choose, choose])


def test_the_mean_model_has_the_mean_tables():
    draws = sticky_draws(5, 2)
    weight = np.array([0.4, 0.3, 0.2, 0.1, 0.0])
    mean = posterior_mean(replace(draws, weight=weight))
    assert mean.transition == pytest.approx(np.einsum("d,dast->ast", weight, draws.transition))
    assert mean.initial == pytest.approx(weight @ draws.initial)


@given(st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_quantiles_with_equal_weights_are_the_inverted_distribution(n, seed):
    values = np.random.default_rng(seed).normal(size=n)
    levels = (0.05, 0.5, 0.95, 1.0)
    wanted = np.quantile(values, levels, method="inverted_cdf")
    assert weighted_quantiles(values, np.full(n, 1.0 / n), levels) == pytest.approx(wanted.tolist())


def test_the_frontier_gives_up_mean_for_tail(schedule):
    found = frontier(schedule, (1.0, 0.5, 0.1, 0.02))
    rows = found.rows()
    means, criteria = [r["mean"] for r in rows], [r["criterion"] for r in rows]
    assert rows[0]["mean"] == pytest.approx(solve_schedule(schedule).value)
    assert all(r["certified"] for r in rows)
    assert max(means) == pytest.approx(means[0])
    assert criteria == sorted(criteria, reverse=True)
    assert all(r["cvar"] >= r["bayes_cvar"] - 1e-9 for r in rows)


def test_mean_and_tail_trade_off_along_the_shares_of_the_mean(schedule):
    found = frontier(schedule, (0.1,), mean_shares=(0.0, 0.25, 0.5, 0.75, 1.0)).rows()
    means, tails = [r["mean"] for r in found], [r["cvar"] for r in found]
    assert np.all(np.diff(means) >= -1e-8)
    assert np.all(np.diff(tails) <= 1e-8)


def test_one_plan_best_at_every_level_is_said():
    schedule = Schedule.of(sticky_draws(1, 4), "HRH")
    assert "changes nothing" in frontier(schedule, (1.0, 0.1)).sentence


def test_the_first_decision_flips_at_the_flip_point(schedule):
    flips = flip_points(schedule)
    assert [f.mode for f in flips] == ["robot_needs_help", "human_needs_help"]
    # The second decision is looked at as if the schedule began there, and says so.
    assert [f.event for f in flips] == [0, 1]
    assert ", were the schedule to begin with event 2: " in flips[1].sentence
    assert flips[0].sentence.startswith("robot_needs_help: ")
    found = [f for f in flips if f.multiple is not None]
    assert found
    for f in found:
        k = [schedule.mode(i).name for i in range(schedule.n_events)].index(f.mode)
        from_there = replace(schedule, modes=schedule.modes[k:])
        null = schedule.mode(k).null_action
        if f.multiple == 0:
            continue
        below = {a: c * (1 - 1e-6) for a, c in f.costs.items()}
        above = {a: c * (1 + 1e-6) for a, c in f.costs.items()}
        assert solve_schedule(with_costs(from_there, below)).first_action == f.action != null
        assert solve_schedule(with_costs(from_there, above)).first_action != f.action


def test_contested_costs_make_every_first_decision_a_toss_up(schedule):
    flipped, flips = contested(schedule)
    assert any(f.multiple for f in flips)
    for f in flips:
        if f.multiple:
            k = [schedule.mode(i).name for i in range(schedule.n_events)].index(f.mode)
            values = np.sort(solve_schedule(replace(flipped, modes=flipped.modes[k:])).first_values)
            assert values[-1] - values[-2] == pytest.approx(0, abs=1e-6)
            for action, cost in f.costs.items():
                assert flipped.draws.reward.costs[action] == pytest.approx(cost)


def test_a_decision_without_a_flip_point():
    """Free actions cost nothing at every multiple."""
    schedule = with_costs(Schedule.of(sticky_draws(3, 4), "RH"), {"help": 0.0, "no_help": 0.0})
    flip = flip_points(schedule)[0]
    assert flip.multiple is None
    assert "every multiple" in flip.sentence
    assert LARGEST > 100


def test_kinds_of_people_are_no_draws_of_their_own():
    """Values, regret and held-out halves go by draws: two kinds in each, together in one half."""
    draws = sticky_draws(6, 21)
    schedule = Schedule.of(draws, "HRHR")
    seen = []

    def choose(own):
        seen.append(own.draws.n_draws)
        return one(solve_schedule(own).decisions)

    found = price(schedule, [Candidate("b", "", choose)], kinds=2)
    assert seen == [6, 2, 4] or sorted(seen[1:]) == [2, 4]
    p = found.prices[0]
    assert p.values.shape == found.optima.shape == (3,)
    values = PlanEvaluator(schedule).values(solve_schedule(schedule).decisions)
    assert p.values == pytest.approx((values[::2] + values[1::2]) / 2)
    assert np.all(found.optima <= (own_plans(schedule).values.reshape(3, 2)).mean(axis=1) + 1e-9)
    assert np.all(found.optima >= p.values - 1e-9)
    careful = cautious_plan(schedule, 0.0, kinds=2)
    assert careful.values.shape == (3,)
    assert careful.lower >= p.values.min() - 1e-9
    stability = decision_stability(schedule, solve_schedule(schedule), kinds=2)
    assert stability.standings[0].weight.shape == (3,)


def test_some_draws_keep_their_relative_weights(schedule):
    kept = schedule.draws.some(np.array([3, 7]))
    before = schedule.draws.weight[[3, 7]]
    assert kept.weight == pytest.approx(before / before.sum())


def test_learning_whom_one_faces():
    """Two kinds of people in every draw: knowing that they differ is worth something, never less than nothing."""
    rng = np.random.default_rng(3)
    gains = []
    for seed in range(12):
        own = np.random.default_rng(seed)
        reward = Reward((0.0, 1.0, 2.0), 1.2, {"help": 0.2, "signal": 0.2})
        models = [LatentStatePOMDP(*telling_tables(own, PUBLISHED, 3), reward=reward) for _ in range(3)]
        draws, kinds = ModelDraws.from_models(models), 2
        tilt = np.exp(np.array([-2.5, 2.5])[:, None] * np.asarray(draws.protocol.scores))
        emission = draws.emission[:, None] * tilt[None, :, None, None, :]
        emission /= emission.sum(axis=-1, keepdims=True)
        weight = np.repeat(rng.dirichlet(np.ones(3)), kinds) / kinds
        people = replace(
            draws, initial=np.repeat(draws.initial, kinds, 0), transition=np.repeat(draws.transition, kinds, 0),
            emission=emission.reshape(-1, *draws.emission.shape[1:]), weight=weight,
        )  # fmt: skip
        found = personalised(Schedule.of(people, "HHRHR"), kinds)
        assert found.value == pytest.approx(found.plan.value)
        assert found.impersonal <= found.value + 1e-9
        gains.append(found.gain)
        values = PlanEvaluator(Schedule.of(people, "HHRHR")).values(found.plan.decisions)
        assert people.weight @ values == pytest.approx(found.value)
    assert max(gains) > 1e-3


def test_people_who_are_alike_have_nothing_to_learn():
    draws = sticky_draws(4, 8)
    twice = replace(
        draws, initial=np.repeat(draws.initial, 2, 0), transition=np.repeat(draws.transition, 2, 0),
        emission=np.repeat(draws.emission, 2, 0), weight=np.repeat(draws.weight, 2) / 2,
    )  # fmt: skip
    assert personalised(Schedule.of(twice, "HRHR"), 2).gain == pytest.approx(0, abs=1e-9)
