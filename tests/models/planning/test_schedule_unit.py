"""Sentences speak of the reward's own unit."""

from dataclasses import replace

from analysis.simulate import calibrated_truth
from models.planning.budget_plan import budget_values, solve_with_budget
from models.planning.exact import solve_schedule
from models.planning.expected_cost import cost_frontier
from models.planning.schedule import Schedule


def test_the_unit_of_the_reward_is_named():
    truth = calibrated_truth()
    usual = Schedule.of(truth, "HRH")
    own = Schedule.of(replace(truth, reward=replace(truth.reward, unit="points")), "HRH")
    for work in (solve_schedule, cost_frontier, budget_values, lambda s: solve_with_budget(s, 15.0)):
        said, again = work(usual).sentence, work(own).sentence
        assert "reward units" in said
        assert again == said.replace("reward units", "points")
