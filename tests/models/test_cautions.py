"""Cautions travel: whatever is made from doubtful draws or models says so, once, in every way it shows itself."""

import json
from dataclasses import replace

import numpy as np
import pytest

from analysis.policy_study import policy_study
from analysis.simulate import calibrated_truth, simulate_study1
from models.baum_welch import BaumWelch
from models.cautions import BEGINS, caution_line, cautioned, together, told_once, uncautioned
from models.errors import InputError
from models.model_draws import ModelDraws
from models.model_files import model_from_dict, model_to_dict, read_model, write_model
from models.notebook_view import NotebookView
from models.planning.baselines import never
from models.planning.batch import solve_draws
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
from models.robust.candidates import posterior_mean, standard_candidates
from models.robust.cautious import cautious_plan
from models.robust.contested import contested, flip_points
from models.robust.controller_pool import controller_pool
from models.robust.frontier import frontier
from models.robust.history_stability import history_stability
from models.robust.information import perfect_information
from models.robust.partial_information import partial_information
from models.robust.people_draws import personalised
from models.robust.pricing import price
from models.robust.sample_information import sample_information
from models.robust.stability import decision_stability
from models.sensitivity.few_steps import FewSteps
from models.sensitivity.flips import find_flips
from models.sensitivity.moving import moving
from models.sensitivity.reward_grid import RewardGrid, decide_grid, reward_of
from models.unseen import without_actions
from tests.analysis.draws_cases import failed, fit_of, people
from tests.models.robust.information_cases import constant

GATE = "the posterior failed its convergence gate"
LINE = f"CAUTION: {GATE}; do not rely on these numbers."


@pytest.fixture(scope="module")
def doubtful():
    return fit_of(people(6), gate=failed()).draws()


def test_draws_of_a_failed_posterior_know_it_and_others_say_nothing(doubtful):
    assert doubtful.cautions == (GATE,)
    assert fit_of(people(6)).draws().cautions == ()
    for own in (doubtful.thin(2), doubtful.some(slice(1, 3)), without_actions(doubtful, ["signal"])):
        assert own.cautions == (GATE,)
    assert doubtful.model(3).cautions == posterior_mean(doubtful).cautions == (GATE,)
    other = replace(doubtful.model(0), cautions=("b", GATE))
    assert ModelDraws.from_models([doubtful.model(1), other]).cautions == (GATE, "b")
    assert Schedule.of(doubtful, "HR", weight=np.full(6, 1 / 6)).rest(1, np.ones((6, 3))).cautions == (GATE,)
    assert ModelDraws.from_json([model_to_dict(m) for m in doubtful]).cautions == (GATE,)


def everything_made_from(draws):
    """A result of every kind that planning makes of draws."""
    schedule = Schedule.of(draws, "HRHR")
    plan, process = solve_schedule(schedule), alternating(draws.protocol)
    model = draws.model(0)
    problem = latent_problem(model, process, 0.5)
    batch = solve_draws(LatentBatch(draws, process, 0.5), 1e-2)
    few = FewSteps(draws, True)
    studies = sample_information(schedule, constant("HR"), [3, 5], replicates=4)
    blocks = partial_information(schedule, ["initial"])
    every = {
        "draws": draws, "model": model, "schedule": schedule, "plan": plan,
        "value": evaluate_schedule(never(draws.protocol), schedule),
        "prices": price(schedule, standard_candidates(schedule)), "perfect": perfect_information(schedule),
        "partial": blocks, "block": blocks.rows[0], "studies": studies, "study": studies.rows[0],
        "cautious": cautious_plan(schedule, 0.3), "frontier": frontier(schedule, (1.0, 0.5)),
        "stability": decision_stability(schedule, plan), "flip": flip_points(schedule)[0],
        "contested": contested(schedule)[1][0], "personal": personalised(schedule, 2),
        "budget": solve_with_budget(schedule, 15.0), "budgets": budget_values(schedule),
        "cost frontier": cost_frontier(schedule), "solution": solve(problem, 1e-2),
        "budget problem": solve(budget_problem(model, process, 0.5, 15)[0], 1e-2), "batch": batch,
        "pool": controller_pool(batch, size=2),
        "along": history_stability(batch, "HR", never(draws.protocol)),
        "endless": infinite_value(never(draws.protocol), problem),
        "simulated": simulate_policy(never(draws.protocol), problem, runs=20),
        "grid": decide_grid(few, RewardGrid.point(draws.protocol, reward_of(draws)), 1.0),
        "flips": find_flips(few, "r", moving(draws.protocol, reward_of(draws), 1.0, r=True), [0.0, 0.1])[0],
        "policies": policy_study(model, "HRHR"),
        "learned": policy_study(replace(model, cautions=()), "HRHR", learned=model),
    }  # fmt: skip
    return every


def test_whatever_is_made_from_doubtful_draws_repeats_the_caution(doubtful):
    for name, made in everything_made_from(doubtful).items():
        assert isinstance(made, NotebookView), name
        assert made.cautions == (GATE,), name
        page = made._repr_html_()
        assert page.count(GATE) == 1, name
        assert f'role="note">Warning: {GATE}; do not rely on these numbers.</p>' in page, name
        assert str(made).startswith(f"<{type(made).__name__}: {LINE}"), name
        if isinstance(getattr(made, "sentence", None), str):
            assert made.sentence.endswith(LINE), name
            assert made.sentence.count(BEGINS) == 1, name


def test_what_is_made_from_good_draws_says_nothing_of_the_kind():
    for name, made in everything_made_from(fit_of(people(6)).draws()).items():
        assert made.cautions == (), name
        assert GATE not in made._repr_html_(), name
        assert BEGINS not in f"{made} {getattr(made, 'sentence', '')}", name


def test_a_search_that_did_not_converge_marks_its_model_and_the_files_of_it(tmp_path):
    log = simulate_study1(participants=40)
    short = BaumWelch(2, restarts=2, finalists=1, screening_maps=2, max_maps=3).fit(log)
    assert not short.converged
    said = "Baum-Welch did not converge within 3 EM maps"
    assert short.caution == said
    assert short.model.cautions == short.draws().cautions == (said,)
    study = policy_study(short.model)
    assert study.sentence.endswith(caution_line((said,)))
    assert said in study._repr_html_()
    assert policy_study(calibrated_truth(), learned=short.model).cautions == (said,)
    write_model(short.model, tmp_path / "model.json")
    assert read_model(tmp_path / "model.json").cautions == (said,)
    good = replace(short, converged=True)
    assert (good.caution, good.model.cautions) == ("", ())
    assert "cautions" not in model_to_dict(good.model)
    assert replace(good, converged=False).model.cautions == (said,)


@pytest.mark.parametrize("cautions", ["a text", [""], [3], {"a": 1}])
def test_cautions_of_a_model_file_are_texts(cautions):
    content = json.loads(json.dumps(model_to_dict(calibrated_truth()))) | {"cautions": cautions}
    with pytest.raises(InputError, match="wanted a list of texts"):
        model_from_dict(content)


def test_the_line_stands_once_and_last():
    cautions = ("a", "b")
    line = "CAUTION: a and b; do not rely on these numbers."
    assert caution_line(cautions) == line
    assert caution_line(()) == ""
    text = f"Worth 3. {line} The least bad: 2. {line}"
    assert cautioned(text, cautions) == f"Worth 3. The least bad: 2. {line}"
    assert uncautioned(text, cautions) == "Worth 3. The least bad: 2."
    assert cautioned("Worth 3.", ()) == uncautioned("Worth 3.", ()) == "Worth 3."
    assert cautioned("", cautions) == ""
    assert cautioned("first at 0.06", cautions) == cautioned("first at 0.06.", cautions) == f"first at 0.06. {line}"
    assert cautioned(f"first at 0.06 {line}", cautions) == f"first at 0.06. {line}"
    assert cautioned("first at 0.06", ()) == "first at 0.06"
    assert uncautioned(f"{cautioned('first at 0.06', cautions)}.", cautions) == "first at 0.06."
    for whole in ("Worth 3 (about.)", "Worth it?", "Plans:"):
        assert cautioned(whole, cautions) == f"{whole} {line}"
    assert told_once(["one", f"two. {line}", f"three. {line}"], cautions) == ["one", f"two. {line}", "three."]
    assert told_once(["one"], ()) == ["one"]
    assert together((), ("x",), ("y", "x")) == ("x", "y")
