"""One small case of every plot, by the plot's name: `CASES[name](ax=None)` draws it."""

from functools import cache

import numpy as np
import pandas as pd

from analysis.anova import mixed_anova
from analysis.figures import (
    belief_path,
    beliefs,
    chain_ranks,
    checks,
    comparison,
    comparisons,
    contraction,
    coverage,
    critical_values,
    curves,
    draw_solutions,
    effects,
    flow,
    forest,
    game,
    held_out,
    information,
    odds,
    paper,
    planning,
    planning_beliefs,
    planning_graph,
    power,
    quadrature,
    rank_ecdf,
    recovered,
    recovery,
    responses,
    reward,
    reward_slider,
    robust,
    safeguards,
    sensitivity,
    side_by_side,
    signal_by_state,
    state_graph,
    state_number,
    study2,
    transitions,
)
from analysis.game_scenes import paper_scenes, simulated_round
from analysis.policy_graph import policy_graph_of
from analysis.posthoc import PersonValues, tukey
from analysis.power_printed import printed_sizes
from analysis.repeated_measures import RepeatedMeasures
from analysis.safeguard_study import Wanted, safeguard_study
from analysis.sensitivity import SensitivityEffort, decider_of, sensitivity_study
from analysis.simulate import calibrated_truth
from models.baum_welch import BaumWelch
from models.game.layout import packaged
from models.game.parameters import GameParameters
from models.game.rounds import play_rounds
from models.glmm_marginal import Estimate
from models.model_draws import ModelDraws
from models.planning.baselines import never
from models.planning.exact import solve_schedule
from models.planning.latent import latent_problem
from models.planning.schedule import Schedule
from models.planning.solver import solve
from models.protocol import PUBLISHED
from models.robust.candidates import posterior_mean, standard_candidates
from models.robust.controller_pool import controller_pool
from models.robust.frontier import frontier
from models.robust.history_stability import history_stability
from models.robust.named_controllers import baseline_controllers
from models.robust.pricing import price
from models.robust.stability import decision_stability
from models.robust.wider_solution import widened
from models.safeguards.influence_report import ALL, NONE
from models.sensitivity.reward_grid import RewardGrid, decide_grid
from tests.analysis.anova_cases import COLUMNS, study
from tests.analysis.report_cases import random_log
from tests.analysis.test_information_figures import BLOCKS
from tests.analysis.test_information_figures import curves as worth_curves
from tests.models.robust.endless_cases import solved
from tests.models.safeguards.guard_cases import doubt
from tests.planning_cases import sticky_draws

NAMES = ("non-prosocial", "low-prosocial", "mid-prosocial", "high-prosocial")
TABLE = np.random.default_rng(1).dirichlet(np.ones(4), 4)
LEARNED = transitions.RowEvidence(silent=False, pinned=False, visits=np.array([50.0, 4.9, 12.0, 1000.0]), weak=5.0)
PROBABILITIES = (0.0, 1.0)


def intervals(n, **columns):
    """A table of estimates in the middle of their intervals and of their priors'."""
    mean = np.linspace(0.2, 0.8, n)
    own = {"mean": mean, "low": mean - 0.1, "high": mean + 0.1, "prior_low": mean - 0.2, "prior_high": mean + 0.2}
    return pd.DataFrame({**own, **columns})


@cache
def schedule():
    return Schedule.of(sticky_draws(8, 3), "HRHR")


@cache
def prices():
    return price(schedule(), standard_candidates(schedule()))


@cache
def wide():
    return widened(solved())


@cache
def guarded():
    wanted = Wanted(30.0, 20.0, 4.0, 0.8, 0.5, {"human_needs_help": "no_help"})
    return safeguard_study(Schedule.of(doubt(), "HRHR"), wanted)


@cache
def grid():
    one = ModelDraws.from_models([calibrated_truth()])
    return decide_grid(decider_of("two-step-terminal", one), RewardGrid.of(one, (0.06, 0.08), (0.0, 15.0)), 1.0)


@cache
def flips():
    effort = SensitivityEffort(scan=5, endless_scan=3, moved=False, variants=False)
    found = sensitivity_study(ModelDraws.from_models([calibrated_truth()]), effort=effort)
    return [found.flips(reading, "r")[0] for reading in found.maps]


@cache
def solution():
    return solve(latent_problem(calibrated_truth()), 1e-2)


@cache
def fits():
    log = random_log(PUBLISHED)
    return BaumWelch(2, restarts=4, finalists=2).fit(log), BaumWelch.paper(2).fit(log)


@cache
def anova():
    return RepeatedMeasures.from_frame(study(), **COLUMNS)


@cache
def rounds():
    trapped, willing = np.repeat([0, 1], 20), np.repeat([False, True], 20)
    return play_rounds(packaged(), GameParameters(), trapped, True, willing, np.arange(40))


def effect_rows():
    own = intervals(4, round=["1", "2", "3", "all"], carried=0.1, raw=0.3, raw_low=0.2, raw_high=0.4)
    return own


def held_out_rows(**columns):
    rows = [
        {"cell": "a", "contender": name, "observed": 0.5, "observed_low": 0.4, "observed_high": 0.6, "low": 0.3,
         "high": 0.7, "expected": 0.45, "expected_low": 0.4, "expected_high": 0.5, "inside": name == "x",
         "prior": ""}
        for name in ("x", "y")
    ]  # fmt: skip
    return pd.DataFrame(rows).assign(**columns)


def power_rows():
    return pd.DataFrame({"people": [50, 100, 200], "value": [0.4, 0.6, 0.9]})


CHOSEN = pd.DataFrame({"name": ["LOO", "LOO", "BIC"], "states": [2, 3, 2], "share": [0.25, 0.75, 1.0]})
RECOVERY = pd.DataFrame(
    {"table": ["moves: help", "effects"], "em_rmse": [0.3, 0.1], "rmse": [0.1, 0.05], "prior_rmse": 0.2,
     "coverage_50": [0.4, 0.5], "coverage_90": [0.8, 0.9]}
)  # fmt: skip
RATES = pd.DataFrame({"k": range(4), "responses": 9, "rate": 0.5, "low": 0.3, "high": 0.7})
CLAIMS = pd.DataFrame(
    [{"claim": c, "name": c, "planner": p, "whole": c == "a", "share": 0.5, "low": 0.4, "high": 0.6}
     for c in "ab" for p in ("one", "two")]
)  # fmt: skip
SPREAD = pd.DataFrame(
    [{"label": "x", "learning": k, "q05": 1, "q25": 2, "q50": 3.0, "q75": 4, "q95": 50, "printed": 7.0}
     for k in ("em", "truth")]
)  # fmt: skip
OUTCOMES = pd.DataFrame(
    [
        {"policy": p, "round": k, "mean": 50.0 + k, "low": 48.0 + k, "high": 52.0 + k}
        for p in ("a", "b")
        for k in (1, 2)
    ]
)
SCORES = pd.DataFrame({"quantity": ["x_s0", "x_s1"], "measured": [46.0, 60.0], "sd": 0.5, "printed": [45.0, 67.0]})
ODDS = pd.DataFrame(
    [("signal", s, 1.5, 1.1, 2.0) for s in ("printed", "AGHQ")],
    columns=["term", "source", "estimate", "low", "high"],
)
SIDES = pd.DataFrame(
    {"entry": ["a", "b"], "a": [0.2, 0.5], "low_a": [0.1, 0.4], "high_a": [0.3, 0.6], "b": [0.3, 0.5],
     "low_b": [0.2, 0.4], "high_b": [0.4, 0.6], "apart": [True, False]}
)  # fmt: skip
CASES = {
    "belief_path": lambda **o: belief_path.belief_path(TABLE, ["start", "help", "no help", "help"], NAMES, **o),
    "observation_curves": lambda **o: beliefs.observation_curves(
        {"signal": TABLE[0], "no_signal": TABLE[1]}, {"signal": (TABLE[0] - 0.1, TABLE[0] + 0.1)}, NAMES,
        measure="probability of help", limits=PROBABILITIES, **o,
    ),
    "initial_belief": lambda **o: beliefs.initial_belief(TABLE[0], (TABLE[0] - 0.1, TABLE[0] + 0.1), NAMES, **o),
    "chain_ranks": lambda **o: chain_ranks.chain_ranks(np.random.default_rng(1).normal(size=(4, 100)), title="a",
        **o),
    "predictive_checks": lambda **o: checks.predictive_checks(
        pd.DataFrame({"family": "f", "check": ["a", "b"], "observed": [0.1, 9.0], "mean": 0.1, "sd": 0.1,
        "low": 0.0,
                      "high": 0.2, "p": [0.5, 0.01], "outside": [False, True]}), title="checks", **o),
    "elpd_differences": lambda **o: comparison.elpd_differences(
        pd.DataFrame({"model": ["a", "b"], "elpd_diff": [0.0, -20.0], "dse": [0.0, 4.0], "kfold_diff": [0.0, -18.0],
                      "kfold_dse": [0.0, 4.0]}), {"a": ["BIC"]}, **o),
    "cell_means": lambda **o: comparisons.cell_means(
        mixed_anova(anova()).cells, xlabel="time", ylabel="score", title="means", **o),
    "compared_groups": lambda **o: comparisons.compared_groups(tukey(PersonValues.mean(anova())), xlabel="score",
        **o),
    "contraction_dots": lambda **o: contraction.contraction_dots(
        pd.DataFrame({"table": ["moves: help", "moves: help", "initial"], "contraction": [0.2, 0.6, np.nan]}),
        known=0.75, partly=0.25, title="a", **o),
    "coverage_by_parameter": lambda **o: coverage.coverage_by_parameter(
        pd.DataFrame([{"rule": r, "parameter": p, "interval": i, "share": 0.93, "studies": 100, "low": 90,
        "high": 99}
                      for r in ("AGHQ", "Laplace") for p in ("a", "b") for i in ("profile", "Wald")]),
        0.95, title="a", **o),
    "critical_values": lambda **o: critical_values.critical_values(flips(), **o),
    "curves": lambda **o: curves.curves(
        {"a": ([1.0, 10.0, 1000.0], [1.0, 2.0, 3.0]), "b": ([1.0, 10.0], [2.0, 1.0])}, xlabel="people",
        ylabel="power", log_x=True, title="a", **o),
    "stability_map": lambda **o: draw_solutions.stability_map(wide(), points=4, **o),
    "stability_walk": lambda **o: draw_solutions.stability_walk(wide(), points=5, **o),
    "stability_along": lambda **o: draw_solutions.stability_along(
        history_stability(wide(), "HRHR", never(PUBLISHED)), **o),
    "value_distribution": lambda **o: draw_solutions.value_distribution(
        controller_pool(solved(), baseline_controllers(solved().batch, posterior_mean(solved().batch.draws)),
        size=4),
        **o),
    "effect_by_round": lambda **o: effects.effect_by_round(
        effect_rows(), scale=100, unit="percentage points", title="a", **o),
    "contrast_by_state": lambda **o: effects.contrast_by_state(
        intervals(2, positive=0.9, state=["s0", "s1"]), scale=100, unit="percentage points", title="a", **o),
    "distances_from_print": lambda **o: paper.distances_from_print(
        pd.DataFrame({"quantity": ["x", "y", "z"], "distance": [0.5, -2.0, 9.0], "differs": [False, True, True]}),
        title="a", **o),
    "still_going": lambda **o: flow.still_going(
        pd.DataFrame({"condition": ["a", "a", "b"], "k": [0, 1, 0], "share": [1.0, 0.5, 1.0]}), **o),
    "forest": lambda **o: forest.forest(
        intervals(2, em=0.5, boot_low=0.4, boot_high=0.6), ["s0", "s1"], title="initial", **o),
    "trap_panels": lambda **o: game.trap_panels(paper_scenes(), **o),
    "round_course": lambda **o: game.round_course(simulated_round("robot", True, True, 4), "a round", **o),
    "tokens_by_kind": lambda **o: game.tokens_by_kind(
        rounds(), {"human": rounds().trapped == 0, "robot": rounds().trapped == 1, "none": np.zeros(40, bool)},
        **o),
    "state_scores_plot": lambda **o: game.state_scores_plot(SCORES, ("non-prosocial", "prosocial"), **o),
    "held_out_rates": lambda **o: held_out.held_out_rates(
        held_out_rows(), measure="help rate", limits=PROBABILITIES, level=0.9, **o),
    "held_out_by_round": lambda **o: held_out.held_out_by_round(
        pd.concat([held_out_rows(at=k) for k in (0, 1, 2)]), shown="x", order=("x", "y"), measure="help rate",
        limits=PROBABILITIES, title="a", **o),
    "information_by_block": lambda **o: information.information_by_block(BLOCKS, title="a", **o),
    "information_by_people": lambda **o: information.information_by_people(worth_curves(), title="a", **o),
    "odds_forest": lambda **o: odds.odds_forest(ODDS, sources=["printed", "AGHQ"], title="a", **o),
    "rates_beside": lambda **o: odds.rates_beside(
        pd.DataFrame({"condition": ["a", "b"], "rate": 0.5, "low": 0.4, "high": 0.6, "predicted": 0.55,
                      "predicted_low": 0.5, "predicted_high": 0.6}), measure="help rate", title="a", **o),
    "residual_classes": lambda **o: odds.residual_classes(
        pd.DataFrame({"grouping": ["round", "condition"], "value": ["1", "a"], "z": [0.5, -1.0]}), limit=2.5,
        title="a",
        **o),
    "gap_over_time": lambda **o: planning.gap_over_time({"truth": solution()}, **o),
    "value_slices": lambda **o: planning.value_slices(solution(), points=10, **o),
    "belief_trajectory": lambda **o: planning_beliefs.belief_trajectory(
        TABLE, "HRH", NAMES, believed=TABLE[::-1], title="never", **o),
    "policy_graph": lambda **o: planning_graph.policy_graph(policy_graph_of(solution()), **o),
    "power_by_people": lambda **o: power.power_by_people(
        {"a": power_rows(), "b": power_rows().assign(low=0.3, high=0.95)}, 0.8, reached={"a": 160.0, "b": np.inf},
        printed=120, title="a", **o),
    "printed_beside_formulas": lambda **o: power.printed_beside_formulas(printed_sizes().table, title="a", **o),
    "rules_near_ceiling": lambda **o: quadrature.rules_near_ceiling(
        pd.DataFrame([{"rule": r, "always": a, "sd": 2.0, "sd_low": 1.5, "sd_high": 2.5}
                      for r in ("AGHQ", "Laplace") for a in (0.1, 0.5)]), "sd", truth=2.0, ylabel="sd",
                      title="a", **o),
    "rank_ecdf": lambda **o: rank_ecdf.rank_ecdf(
        {"even": np.arange(100), "low": np.arange(100) // 2}, 99, level=0.01, tests=2, title="a", **o),
    "beside_truth": lambda **o: recovered.beside_truth(
        ["a", "b"], np.array([0.2, 0.6]), (np.array([0.1, 0.5]), np.array([0.3, 0.7])), np.array([0.25, 0.65]),
        measure="probability", title="a", **o),
    "recovery_errors": lambda **o: recovery.recovery_errors(RECOVERY, title="Errors", **o),
    "recovery_coverage": lambda **o: recovery.recovery_coverage(RECOVERY, 20, title="Coverage", **o),
    "states_found": lambda **o: recovery.states_found(CHOSEN, 3, title="Found", **o),
    "rate_by_round": lambda **o: responses.rate_by_round(RATES, measure="help rate", limits=PROBABILITIES,
        title="a", **o),
    "rate_heat_map": lambda **o: responses.rate_heat_map(
        pd.DataFrame({"condition": ["a", "b"], "schedule": ["HR", "RH"], "rate": [0.1, 0.9], "people": [3, 4]}),
        rows="condition", columns="schedule", limits=PROBABILITIES, row_order=["a", "b"], column_order=["HR",
        "RH"], **o),
    "reward_by_state": lambda **o: reward.reward_by_state((45, 48, 56, 67), (0.001, 0.06, 0.09), NAMES, cost=15,
        **o),
    "whole_grid": lambda **o: reward_slider.whole_grid({"truth": grid()}, **o),
    "value_distributions": lambda **o: robust.value_distributions(
        {p.name: p.values for p in prices().prices[:3]}, schedule().draws.weight, **o),
    "plan_comparison": lambda **o: robust.plan_comparison(prices(), **o),
    "caution": lambda **o: robust.caution({"these": frontier(schedule(), (1.0, 0.2))}, **o),
    "stability_tree": lambda **o: robust.stability_tree(
        decision_stability(schedule(), solve_schedule(schedule())), **o),
    "value_and_cost": lambda **o: safeguards.value_and_cost(
        guarded().frontier, guarded().budgets, guarded().report, guarded().drawn, **o),
    "stricter": lambda **o: safeguards.stricter([guarded().tolerance, guarded().threshold], **o),
    "who_is_influenced": lambda **o: safeguards.who_is_influenced(guarded().report, guarded().drawn, (NONE, ALL),
        **o),
    "action_panel": lambda **o: sensitivity.action_panel(grid(), 0, 0.06, **o),
    "share_panel": lambda **o: sensitivity.share_panel(grid(), 0, 0.06, **o),
    "action_map": lambda **o: sensitivity.action_map(grid(), **o),
    "share_map": lambda **o: sensitivity.share_map(grid(), **o),
    "entries_side_by_side": lambda **o: side_by_side.entries_side_by_side(SIDES, title="a", **o),
    "rates_side_by_side": lambda **o: side_by_side.rates_side_by_side(
        pd.DataFrame({"k": [0, 1], "rate_a": 0.5, "low_a": 0.4, "high_a": 0.6, "rate_b": 0.6, "low_b": 0.5,
                      "high_b": 0.7}), "help rate", PROBABILITIES, title="a", **o),
    "plans_exchanged": lambda **o: side_by_side.plans_exchanged(
        pd.DataFrame([{"plan": p, "world": w, "value": 10.0, "low": 9.0,
        "high": 11.0} for p in "AB" for w in "AB"]),
        title="a", **o),
    "signal_effects": lambda **o: signal_by_state.signal_effects(
        intervals(2, state=["s0", "s1"]), regression=Estimate(0.3, 0.1, 0.5), title="a", **o),
    "state_graph": lambda **o: state_graph.state_graph(TABLE, NAMES, "help", LEARNED, **o),
    "log_likelihoods": lambda **o: state_number.log_likelihoods({2: -9.0, 3: -8.0}, {2: -9.5, 3: -8.0}, (3,
        -7.0), **o),
    "information_criteria": lambda **o: state_number.information_criteria({2: 9.0, 3: 8.0}, {2: 7.0, 3: 9.0}, **o),
    "optima": lambda **o: state_number.optima(*fits(), **o),
    "four_panels": lambda **o: study2.four_panels([(f"t{i}", "team tokens a round", OUTCOMES) for i in range(4)],
        "HR", **o),
    "claim_shares": lambda **o: study2.claim_shares(CLAIMS, title="Planner:", **o),
    "printed_in_place": lambda **o: study2.printed_in_place(SPREAD, xlabel="F", log=True, title="a", **o),
    "transition_table": lambda **o: transitions.transition_table(TABLE, NAMES, "no_help", LEARNED, **o),
}  # fmt: skip
"""By the name of the plot function."""
