"""Planning with a learned model: what is left out, where policies lead, and how it is drawn."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.figures.planning import gap_over_time, value_slices
from analysis.figures.planning_beliefs import belief_trajectory
from analysis.figures.style import to_svg
from analysis.learned_policy import learned_policy, without
from analysis.policy_study import LEARNED, OPTIMAL, belief_paths, infinite_baselines, policy_study
from analysis.simulate import calibrated_truth
from models.errors import InputError
from models.planning.baselines import Reciprocal, always, baselines, myopic, never, uniformly_random
from models.planning.evaluation import evaluate_schedule
from models.planning.exact import solve_schedule
from models.planning.finite_memory import infinite_value
from models.planning.latent import latent_problem
from models.planning.mode_process import alternating
from models.planning.schedule import Schedule
from models.planning.solver import solve
from models.protocol import PUBLISHED
from tests.analysis.test_figures import words
from tests.models.planning.policy_cases import person

SCHEDULE = "HRHRH"


# -- actions that are left out ---------------------------------------------------------------------
@pytest.mark.parametrize("action", ["signal", "help"])
def test_without_an_action_is_as_if_it_cost_a_fortune(action):
    model = person()
    fewer = without(model, [action])
    assert action not in fewer.protocol.action_names
    dear = replace(model, reward=replace(model.reward, costs={action: 1e9}))
    plans = [solve_schedule(Schedule.of(m, SCHEDULE)) for m in (fewer, dear)]
    assert plans[0].value == pytest.approx(plans[1].value, rel=1e-12)
    problems = [latent_problem(m, alternating(m.protocol, "H"), 0.9) for m in (fewer, dear)]
    for problem in problems:
        assert solve(problem, 1e-5).lower == pytest.approx(solve(problems[0], 1e-5).lower, rel=1e-4)


def test_no_action_left_out_is_the_same_model():
    assert without(person(), ()) is person()


@pytest.mark.parametrize(
    ("actions", "words"),
    [(["no_signal"], "no_signal, the null action of robot_needs_help"), (["dance"], "dance")],
)
def test_what_cannot_be_left_out(actions, words):
    with pytest.raises(InputError, match=words):
        without(person(), actions)


def test_the_reactive_baseline_of_a_robot_that_cannot_signal():
    fewer = without(person(), ["signal"])
    assert {p.name for p in baselines(fewer)} == {p.name for p in baselines(person())}
    # Where nobody can signal it does what the full one does, whose signals change nothing if they do nothing.
    dumb = person()
    same = replace(dumb, transition=dumb.transition[[0, 1, 2, 2]], emission=dumb.emission[[0, 0]])
    own = evaluate_schedule(Reciprocal(fewer.protocol), without(same, ["signal"]), SCHEDULE)
    full = evaluate_schedule(Reciprocal(PUBLISHED), same, SCHEDULE)
    assert own.help_rate == pytest.approx(full.help_rate)
    assert np.allclose(own.state_path, full.state_path)


# -- both horizons ---------------------------------------------------------------------------------
def test_learned_policy_beside_a_truth():
    truth = calibrated_truth()
    found = learned_policy(person(), ["signal"], "HRHRH", truth=truth, runs=500)
    known = without(truth, ["signal"])
    assert found.study.values[OPTIMAL].value == pytest.approx(found.study.plan.value)
    assert found.in_truth.values[OPTIMAL].value >= found.in_truth.values[LEARNED].value
    assert found.in_truth.values["never"].value == pytest.approx(
        evaluate_schedule(never(known.protocol), known, "HRHRH").value
    )
    assert found.policy_in_truth <= found.solution_of_truth.upper + 1e-9
    assert found.solution.problem.initial[0].sum() == 0
    assert found.graph.starts == (int(found.graph.controller.start[1]),)
    for name, v in found.baselines.items():
        assert v["low"] <= v["value"] <= v["high"], name
        assert v["low"] <= found.solution.upper + 1e-9
    assert learned_policy(person(), (), "HRH", runs=200).in_truth is None


def test_a_truth_that_does_what_the_learned_model_takes_for_impossible():
    helps = (person().emission[..., 1:] >= 0.5).astype(float)
    sure = replace(person(), emission=np.concatenate([1 - helps, helps], axis=-1))
    found = learned_policy(sure, (), "HRH", truth=person(), runs=200)
    assert np.isfinite(found.policy_in_truth)


def test_baselines_without_horizon():
    problem = latent_problem(person(), alternating(PUBLISHED, "H"), 0.8)
    found = infinite_baselines(person(), problem, seed=1, runs=4000)
    assert found["always"]["value"] == infinite_value(always(PUBLISHED), problem).value
    assert found["random"]["low"] == found["random"]["high"]
    assert found["myopic"]["low"] < found["myopic"]["high"]
    more = infinite_baselines(person(), problem, seed=2, runs=40_000)["myopic"]
    assert found["myopic"]["low"] - 0.5 < more["value"] < found["myopic"]["high"] + 0.5


# -- where policies lead ---------------------------------------------------------------------------
@pytest.mark.parametrize("kind", ["always", "reactive", "myopic", "random"])
def test_a_robot_whose_model_is_true_believes_what_is_so_on_average(kind):
    policy = {p.name: p for p in baselines(person())}[kind]
    states, believed = belief_paths(policy, person(), person(), SCHEDULE)
    assert states == pytest.approx(believed, abs=1e-12)
    assert states == pytest.approx(evaluate_schedule(policy, person(), SCHEDULE).state_path, abs=1e-12)
    assert states.shape == (6, 3)


def test_a_robot_with_another_model_believes_by_its_own():
    truth, own = calibrated_truth(), myopic(person())
    states, believed = belief_paths(own, truth, person(), SCHEDULE)
    value = evaluate_schedule(own, truth, SCHEDULE)
    assert states == pytest.approx(value.state_path, abs=1e-12)
    assert believed[:-1] == pytest.approx(value.belief_path, abs=1e-12)
    assert believed.sum(axis=1) == pytest.approx(1)
    # A policy that holds no belief: then it is the filter's, averaged over what people do.
    _, other = belief_paths(uniformly_random(PUBLISHED), truth, person(), "HR")
    by_hand = np.zeros(3)
    for action in ("no_signal", "signal"):
        chance = truth.response_probability(truth.initial, action)
        for response, p in zip(PUBLISHED.response_names, chance, strict=True):
            by_hand += 0.5 * p * person().update(person().initial, action, response)
    assert other[1] == pytest.approx(by_hand)


def test_impossible_responses_leave_the_belief_to_itself():
    sure = replace(person(), initial=[1.0, 0.0, 0.0], emission=[[[1.0, 0.0]] * 3] * 2)
    _, believed = belief_paths(never(PUBLISHED), person(), sure, "H")
    assert believed[1] == pytest.approx(sure.transition[2][0])


# -- pictures --------------------------------------------------------------------------------------
def test_belief_trajectory():
    states, believed = belief_paths(never(PUBLISHED), person(), person(), SCHEDULE)
    names = ("s0", "s1", "s2")
    plain = belief_trajectory(states, SCHEDULE, names, title="never")
    both = belief_trajectory(states, SCHEDULE, names, believed=believed)
    assert len(plain.lines) == 0
    assert len(both.lines) == 4
    assert np.allclose(both.lines[1].get_ydata(), believed[:, 0])
    assert "never" in words(plain)
    assert [t.get_text() for t in plain.get_xticklabels()] == [*SCHEDULE, ""]
    assert to_svg(plain) == to_svg(belief_trajectory(states, SCHEDULE, names, title="never"))


def test_value_slices_names_every_action_once():
    solution = solve(latent_problem(person(), alternating(PUBLISHED, "H"), 0.9))
    figure = value_slices(solution)
    assert len(figure.axes) == 2
    for x, ax in enumerate(figure.axes):
        own = np.unique(solution.choice[solution.mode == x])
        shown = [t.get_text() for t in ax.get_legend().get_texts()]
        offered = [c.action.replace("_", " ") for c in solution.problem.choices[x]]
        assert set(shown) <= {offered[c] for c in own}
        # The line is the value at each corner.
        line = ax.lines[0]
        for s in range(3):
            at = np.argmin(np.abs(line.get_xdata() - s))
            assert line.get_ydata()[at] == pytest.approx(solution.alpha[solution.mode == x, s].max())


def test_value_slices_of_a_problem_with_one_state():
    alone = replace(
        person(), initial=[1.0], transition=np.ones((4, 1, 1)), emission=person().emission[:, :1],
        state_names=("s0",), reward=replace(person().reward, x=(45.0,)),
    )  # fmt: skip
    assert value_slices(solve(latent_problem(alone))).axes


def test_gap_over_time_is_written_in_plain_figures():
    problems = {"one": latent_problem(person()), "two": latent_problem(calibrated_truth())}
    ax = gap_over_time({name: solve(problem, 1e-6) for name, problem in problems.items()})
    ax.figure.canvas.draw()
    labels = [t.get_text() for axis in (ax.xaxis, ax.yaxis) for t in axis.get_ticklabels()]
    assert len(labels) >= 4
    assert all(label and "$" not in label for label in labels)
    assert "converged" in words(ax)


def test_policy_study_of_a_learned_model_says_what_is_lost():
    study = policy_study(calibrated_truth(), SCHEDULE, learned=person())
    assert "instead of the truth loses" in study.sentence
    assert study.table["lost"].min() == pytest.approx(0, abs=1e-9)
