"""Sentences and views speak of the reward's own unit."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.policy_study import policy_study
from analysis.simulate import calibrated_truth
from models.model_draws import ModelDraws
from models.notebook_view import unit_of
from models.planning.baselines import always, never
from models.planning.budget_plan import budget_values, solve_with_budget
from models.planning.budget_problem import budget_problem
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import solve_schedule
from models.planning.expected_cost import cost_frontier
from models.planning.finite_memory import infinite_value
from models.planning.latent import LatentBatch, latent_problem
from models.planning.mode_process import alternating
from models.planning.rollouts import simulate_policy
from models.planning.schedule import Schedule
from models.planning.solver import solve
from models.reward import UNIT
from models.robust.candidates import standard_candidates
from models.robust.frontier import frontier
from models.robust.information import perfect_information
from models.robust.partial_information import partial_information
from models.robust.people_draws import personalised
from models.robust.pricing import price
from models.robust.sample_information import sample_information
from models.robust.study_design import Arm, NextStudy

TRUTH = calibrated_truth()


def in_points(model):
    return replace(model, reward=replace(model.reward, unit="points"))


def doubtful():
    """Two equally probable models: the truth, and one in which help brings everybody down."""
    down = TRUTH.transition.copy()
    down[TRUTH.protocol.action("help")] = np.eye(TRUTH.n_states)[0]
    return [TRUTH, replace(TRUTH, transition=down)]


def schedules():
    usual = doubtful()
    return [Schedule.of(ModelDraws.from_models(own), "HRHRHR") for own in (usual, [in_points(m) for m in usual])]


def every_block(schedule):
    return partial_information(schedule, perfect=perfect_information(schedule, sampled=False))


def says_points(result, own):
    """Two results that differ in the word alone; the first says it in its sentence."""
    said, again = result.sentence, own.sentence
    assert UNIT in said
    assert again == said.replace(UNIT, "points")
    assert UNIT not in own._repr_html_()
    assert own._repr_html_() == result._repr_html_().replace(UNIT, "points")


@pytest.mark.parametrize(
    "work", [solve_schedule, cost_frontier, budget_values, lambda s: solve_with_budget(s, 15.0),
             lambda s: evaluate_schedule(never(s.protocol), s)]
)  # fmt: skip
def test_of_a_schedule(work):
    says_points(*(work(Schedule.of(model, "HRH")) for model in (TRUTH, in_points(TRUTH))))


@pytest.mark.parametrize(
    "work", [lambda s: price(s, standard_candidates(s)), perfect_information, every_block,
             lambda s: max(every_block(s).rows, key=lambda r: r.worth), lambda s: personalised(s, 2)]
)  # fmt: skip
def test_of_doubt(work):
    says_points(*map(work, schedules()))


def test_of_caution():
    """Where caution changes nothing there is no number and so no unit."""
    found, own = (frontier(s, (1.0, 0.5)) for s in schedules())
    assert own.sentence == found.sentence.replace(UNIT, "points")
    paid = replace(found, bayes_tail=tuple(v - 5.0 for v in found.bayes_tail))
    says_points(paid, replace(own, bayes_tail=paid.bayes_tail))


def test_of_further_people():
    arm = Arm.random(TRUTH.protocol, "HRH")
    told = [
        sample_information(s, NextStudy.of_arms("at random", [arm]), (20,), replicates=4, seed=1)
        for s in schedules()
    ]
    assert [r.unit for found in told for r in found.rows] == [UNIT, "points"]
    enough = [replace(found, rows=(replace(found.rows[0], effective=500.0),)) for found in told]
    says_points(*(found.rows[0] for found in enough))
    says_points(*enough)


@pytest.mark.parametrize(
    "work", [lambda p: infinite_value(always(TRUTH.protocol), p),
             lambda p: simulate_policy(always(TRUTH.protocol), p, runs=20, steps=3)]
)  # fmt: skip
def test_without_horizon(work):
    says_points(*(work(latent_problem(model, discount=0.9)) for model in (TRUTH, in_points(TRUTH))))


def test_problems_carry_the_word():
    own = in_points(TRUTH)
    assert latent_problem(own).unit == "points"
    assert budget_problem(own, alternating(own.protocol), 0.9, 30)[0].unit == "points"
    batch = LatentBatch(ModelDraws.from_models([own]), alternating(own.protocol))
    assert {batch.unit, batch.problem(0).unit} == {"points"}


def test_a_result_is_in_the_unit_of_what_it_was_made_from():
    """Headings of columns, also where a sentence names no unit: what is solved for a problem, or inside a study."""
    own = in_points(TRUTH)
    solution = solve(latent_problem(own, discount=0.9), 1e-2)
    draws = ModelDraws.from_models([own])
    batch = LatentBatch(draws, alternating(own.protocol))
    assert [unit_of(made) for made in (solution, draws, batch, own, own.reward)] == ["points"] * 5
    assert "points" in own.reward._repr_html_()
    study = policy_study(own, "HRH")
    assert unit_of(study) == "points"
    assert 'value <span class="faint">(points)' in study._repr_html_()
    assert UNIT not in study._repr_html_()
    assert unit_of(TRUTH.protocol) is None
