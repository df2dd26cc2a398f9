"""The command ``solve-draws``: every draw of a posterior solved without horizon, each with its certificate."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Annotated, Any

import typer

from analysis.cli_options import (
    DEFAULT_SEED,
    JsonOption,
    ProtocolOption,
    QuietOption,
    Report,
    SeedOption,
    distinct_files,
)
from analysis.cli_plan import STUDY_SCHEDULE, mode_process_of
from analysis.cli_planning_options import (
    AllowUnseenOption,
    CostHelpOption,
    CostOption,
    CostSignalOption,
    DrawsOption,
    FitArgument,
    ForceOption,
    GroupOption,
    PersonOption,
    PrecisionOption,
    RewardSteepness,
    check_tail,
    draws_asked,
)
from analysis.cli_solve import TimeLimitOption
from analysis.cli_workers import SchedulerOption, WorkersOption, workers_of

if TYPE_CHECKING:
    from models.planning.batch import BatchSolution
    from models.robust.belief_stability import BeliefStability
    from models.robust.controller_pool import ControllerPool
    from models.robust.risk import Outcome

FEWEST_HELD_OUT = 20
"""Draws below which nothing is said of draws that had no part in a choice."""


def solve_draws_command(
    fit: FitArgument,
    draws: DrawsOption = None,
    precision: PrecisionOption = 1e-3,
    start_mode: Annotated[
        str | None, typer.Option(help="First mode, name or letter; else the protocol's first.")
    ] = None,
    mode_process: Annotated[
        str, typer.Option(metavar="PROCESS", help="alternating, or bernoulli:p, p for the first mode.")
    ] = "alternating",
    discount: Annotated[float, typer.Option(help="Below 1: there is no horizon.")] = 0.95,
    r: RewardSteepness = None,
    cost_help: CostHelpOption = None,
    cost_signal: CostSignalOption = None,
    cost: CostOption = None,
    allow_unseen: AllowUnseenOption = False,
    force: ForceOption = False,
    group: GroupOption = None,
    person: PersonOption = None,
    time_limit: TimeLimitOption = 60.0,
    pool: Annotated[
        bool, typer.Option("--pool", help="Also value controllers of the draws and baselines in every draw.")
    ] = False,
    alpha: Annotated[
        float, typer.Option(help="With --pool: share of the draws in the lower tail.")
    ] = 0.1,
    along: Annotated[
        str | None,
        typer.Option(metavar="SCHEDULE", help=f"Also what draws prefer along a study: {STUDY_SCHEDULE}."),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
    protocol: ProtocolOption = None,
) -> None:  # fmt: skip
    """How uncertain the plan is: every draw of a posterior solved without horizon, with bounds that prove it.

    The action shares say which action draws prefer at their own initial belief; a draw whose best actions differ by
    no more than the gap between its bounds is undecided. With --along the robot follows the plan of the mean tables
    through a study, and after every history each draw says what it would do next, at its own belief. The time limit
    is that of a draw which the first attempt leaves unsolved. Nothing is random, whatever the seed.

    Example: prosocial solve-draws fit.nc --draws 400 --pool
    """
    from analysis import progress
    from analysis.cli_options import plain
    from analysis.endless_study import compared_controllers, decisions_along, told_of
    from models.errors import located
    from models.planning.batch import solve_draws
    from models.planning.latent import LatentBatch
    from models.planning.mode_process import schedule_modes
    from models.robust.belief_stability import start_stability
    from models.robust.wider_solution import widened

    report = Report(json, quiet)
    distinct_files({"FIT": fit, "--protocol": protocol, "--json": json})
    check_tail(alpha)
    if not time_limit > 0:
        raise located("--time-limit", time_limit, "above 0 seconds")
    source = draws_asked(
        fit, draws=draws, allow_unseen=allow_unseen, force=force, group=group, person=person, people=False, r=r,
        cost_help=cost_help, cost_signal=cost_signal, cost=cost, protocol=protocol,
    )  # fmt: skip
    if along is not None:
        schedule_modes(source.draws.protocol, along)
    process = mode_process_of(source.draws.protocol, mode_process, start_mode)
    batch = LatentBatch(source.draws, process, discount)
    with workers_of(workers, scheduler) as executor:
        with progress.shown(quiet) as watch:
            told = told_of(watch, "draws solved")
            solution = solve_draws(batch, precision, time_limit=time_limit, executor=executor, progress=told)
        compared = histories = None
        if pool:
            with progress.shown(quiet) as watch:
                told = told_of(watch, "controllers valued")
                compared = compared_controllers(solution, executor=executor, progress=told)
        if along is not None:
            with progress.shown(quiet) as watch:
                told = told_of(watch, "draws solved from the corners")
                wide = widened(solution, time_limit=time_limit, executor=executor, progress=told)
            histories = decisions_along(wide, along, executor=executor)
    stability = start_stability(solution)
    report.say(f"{source.sentence}. {process.words}; discount {discount:g}.")
    report.say(solution.sentence)
    report.say(_values_in_words(solution))
    for found in stability.values():
        report.say(_shares_in_words(found))
    left = len(batch) - int(solution.certified.sum())
    if left:
        print(
            f"prosocial: {fit}: {left} of {len(batch)} draws were not solved to a relative gap of {precision:g}",
            file=sys.stderr,
        )
    if compared is not None:
        report.say(compared.sentence)
        report.say(compared.table(alpha).head(10).to_string(index=False, float_format=lambda v: f"{v:.3f}"))
    if histories is not None:
        report.say(histories.table.to_string(index=False))
        report.say(histories.sentence)
    report.finish(
        plain({
            **solution_to_dict(solution), **stability_to_dict(stability), **source.to_dict(),
            "discount": discount, "mode_process": process.words, "precision": precision,
            "pool": None if compared is None else pool_to_dict(compared, alpha), "seed": seed,
            "along": None if histories is None else {
                "schedule": histories.letters, "policy": histories.policy, "decisions": histories.rows(),
                "sentence": histories.sentence,
            },
        })
    )  # fmt: skip


def solution_to_dict(solution: BatchSolution) -> dict[str, Any]:
    """Certificates, times and values of all draws as commands give them in their JSON."""
    import numpy as np

    ms = 1e3 * solution.draw_seconds
    bounds = {"lower": solution.lower, "upper": solution.upper}
    return {
        "solved": len(solution.solutions), "certified": int(solution.certified.sum()),
        "max_relative_gap": float(solution.relative_gap.max()), "median_ms": float(np.median(ms)),
        "q90_ms": float(np.quantile(ms, 0.9)), "seconds": solution.seconds,
        "compile_seconds": solution.compile_seconds,
        "values": {name: _spread(v, solution) for name, v in bounds.items()},
        "sentence": solution.sentence,
    }  # fmt: skip


def stability_to_dict(stability: dict[str, BeliefStability]) -> dict[str, Any]:
    """Shares and losses of the actions at the draws' own initial beliefs, by mode."""
    return {
        "action_shares": {mode: found.shares() for mode, found in stability.items()},
        "action_losses": {mode: found.losses() for mode, found in stability.items()},
        "beliefs": {mode: found.whose for mode, found in stability.items()},
    }


def pool_to_dict(pool: ControllerPool, alpha: float) -> dict[str, Any]:
    """The pool with its certificate and best mixtures as commands give it in their JSON."""
    from models.robust.pool_mixture import best_mixture, held_out

    criteria: dict[str, tuple[float, Outcome]] = {
        "mean": (1.0, "value"), "cvar": (alpha, "value"), "worst": (0.0, "value"), "regret": (0.0, "regret"),
        "regret-cvar": (alpha, "regret"),
    }  # fmt: skip
    mixtures = {name: best_mixture(pool, level, outcome=outcome) for name, (level, outcome) in criteria.items()}
    half = float(pool.weight[: (len(pool.weight) + 1) // 2].sum())
    few = len(pool.weight) < FEWEST_HELD_OUT or not 0 < half < 1
    scores = {
        name: None if few else held_out(pool, level, outcome=outcome) for name, (level, outcome) in criteria.items()
    }
    return {
        "distinct": pool.distinct, "best": pool.names[pool.best], "ceiling": pool.ceiling,
        "evpi_upper_bound": pool.evpi_bound, "alpha": alpha, "rounding": pool.error,
        "controllers": pool.table(alpha).to_dict("records"),
        "mixtures": {
            name: {
                "criterion": m.criterion, "held_out": scores[name], "gap": m.gap, "mean": m.mean,
                "largest_regret_at_most": m.regret_bound, "shares": m.shares, "single": pool.names[m.single],
                "single_criterion": m.single_criterion,
            }
            for name, m in mixtures.items()
        },
        "sentence": pool.sentence,
    }  # fmt: skip


def _spread(values: Any, solution: BatchSolution) -> dict[str, float]:
    from models.robust.risk import weighted_quantiles

    w = solution.batch.draws.weight
    low, mid, high = weighted_quantiles(values, w, (0.05, 0.5, 0.95))
    return {"mean": float(w @ values), "q05": low, "q50": mid, "q95": high}


def _values_in_words(solution: BatchSolution) -> str:
    v = _spread(solution.lower, solution)
    return (
        f"Values of the draws: mean {v['mean']:.5g}, from {v['q05']:.5g} to {v['q95']:.5g} in the middle 90% "
        f"({solution.batch.unit}, lower bounds)."
    )


def _shares_in_words(found: BeliefStability) -> str:
    shares = ", ".join(f"{name} {100 * share:.1f}%" for name, share in found.shares().items())
    losses = ", ".join(f"{name} {loss:.3g}" for name, loss in found.losses().items())
    return f"{found.mode}, at {found.whose} at the start: {shares} of the draws; expected loss: {losses}."
