"""The commands ``replicate ...``: whole studies run again and again on simulated truths, to test claims."""

from __future__ import annotations

import shlex
from typing import Annotated

import typer

from analysis.cli_evidence import OutOption, begin_evidence, finish_evidence
from analysis.cli_options import DEFAULT_SEED, JsonOption, QuietOption, SeedOption
from analysis.cli_plan import STUDY_SCHEDULE
from analysis.cli_workers import SchedulerOption, WorkersOption, workers_of

replicate = typer.Typer(
    no_args_is_help=True, help="Run whole studies again and again on simulated truths, to test what is claimed."
)

RESTS_ON = (
    "models.baum_welch",
    "models.fit_tree",
    "models.nuts",
    "models.planning.exact",
    "models.robust.own_plans",
)
"""Modules whose kernels the result rests on."""


@replicate.command("plans")
def plans_command(
    states: Annotated[int, typer.Option(min=1, max=12, help="Latent states of truths and fits.")] = 2,
    replicates: Annotated[int, typer.Option(min=2, help="Simulated truths.")] = 100,
    participants: Annotated[int, typer.Option(min=1, help="People in each simulated study.")] = 540,
    schedule: Annotated[str, typer.Option(help="Letters of the rounds that are planned for.")] = STUDY_SCHEDULE,
    alpha: Annotated[
        float, typer.Option(help="Level of the cautious plan, and share of truths in the tail.")
    ] = 0.1,
    kappa: Annotated[float, typer.Option(min=0, help="Stickiness: pseudo-counts on staying.")] = 2.0,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    out: OutOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Whether plans that reckon with doubt do better in truth than plans of a point estimate.

    Truths are drawn from the prior, study 1 is simulated in each, everything is learned from it, and the plans are
    valued in the truth, exactly: about five seconds of processor time a truth.

    Example: prosocial replicate plans --replicates 400 --out plans.json
    """
    import pandas as pd

    from analysis import progress
    from analysis.evidence import record
    from analysis.plan_replicates import PlanReplicates, replicate_plans
    from models.parameters import DirichletPrior

    report = begin_evidence(json, quiet, out)
    settings = PlanReplicates(
        states, replicates, participants, schedule, alpha, prior=DirichletPrior(stay=kappa), seed=seed
    )
    with progress.shown(quiet) as watch, workers_of(workers, scheduler) as executor:
        result = replicate_plans(settings, executor=executor, progress=watch)
    words = ["prosocial", "replicate", "plans", "--states", str(states), "--replicates", str(replicates)]
    words += ["--participants", str(participants), "--schedule", schedule, "--alpha", f"{alpha:g}"]
    words += ["--kappa", f"{kappa:g}", "--seed", str(seed)]
    what = "Plans valued in simulated truths: simulated people, truths drawn from the prior."
    content = record(what, shlex.join(words), seed, result.to_dict(), RESTS_ON)
    shown = ["setting", "plan", "mean", "tail", "mean_regret", "tail_regret", "gain", "gain_low", "gain_high"]
    report.say(pd.DataFrame(result.rows())[shown].to_string(index=False, float_format=lambda v: f"{v:.2f}"))
    report.say(f"\n{result.sentence} Seed {seed}.")
    finish_evidence(report, out, content)
