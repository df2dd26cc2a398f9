"""The command ``recover``: what the learners make of studies whose truth is known."""

from __future__ import annotations

import shlex
from typing import Annotated

import typer

from analysis.cli_evidence import OutOption, begin_evidence, finish_evidence
from analysis.cli_options import DEFAULT_SEED, JsonOption, QuietOption, SeedOption
from analysis.cli_workers import SchedulerOption, WorkersOption, workers_of

PRIOR = "prior"

SHOWN = (
    "states", "table", "entry", "truth", "em_bias", "em_rmse", "bias", "rmse", "prior_rmse", "coverage_50",
    "coverage_90", "contraction",
)  # fmt: skip
"""Columns printed for people; the JSON has all."""


def recover_command(
    states: Annotated[
        str | None,
        typer.Option("--states", metavar="1-4", help="Numbers of states to fit; the true one by default."),
    ] = None,
    replicates: Annotated[int, typer.Option(min=1, help="Simulated studies.")] = 20,
    participants: Annotated[int, typer.Option(min=1, help="People in each simulated study.")] = 540,
    truth: Annotated[
        str | None,
        typer.Option(
            "--truth",
            metavar="MODEL|prior",
            help="Model file of the truth (the calibrated one by default), or prior: a fresh draw for every study.",
        ),
    ] = None,
    true_states: Annotated[
        int | None,
        typer.Option("--true-states", min=1, max=12, help="States of truths drawn from the prior; 3 by default."),
    ] = None,
    select: Annotated[
        bool, typer.Option("--select", help="Also count how often the true number of states is found.")
    ] = False,
    bootstrap: Annotated[
        int, typer.Option(min=0, help="Bootstrap replicates of EM at the true number of states (slow).")
    ] = 0,
    kappa: Annotated[float, typer.Option(min=0, help="Stickiness: pseudo-counts on staying.")] = 2.0,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    out: OutOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """How well EM and the posterior recover a known truth under the published design.

    Reports bias, error, coverage and contraction of every entry and of the effects of the robot's actions, and with
    --select how often the true number of states is found. The default takes two to three minutes of processor time.

    Example: prosocial recover --states 1-5 --select --replicates 50 --out recovery.json
    """
    from analysis import progress
    from analysis.em_study import parse_states
    from analysis.evidence import record
    from analysis.recovery import recover
    from analysis.recovery_study import RecoverySettings
    from analysis.simulate import calibrated_truth
    from models.errors import located
    from models.model_files import read_model
    from models.parameters import DirichletPrior

    drawn = truth == PRIOR
    report = begin_evidence(json, quiet, out, truth=None if drawn else truth)
    if true_states is not None and not drawn:
        raise located("--true-states", true_states, f"--truth {PRIOR} beside it: a model file says how many it has")
    model = None if drawn else calibrated_truth() if truth is None else read_model(truth)
    known = (true_states or 3) if model is None else model.n_states
    sizes = (known,) if states is None else parse_states(states)
    if select and len(sizes) < 2:
        raise located("--states", states or str(known), "at least two numbers of states to --select from")
    if bootstrap == 1:
        raise located("--bootstrap", 1, "0 for none, or at least 2 replicates")
    settings = RecoverySettings(
        sizes, replicates, participants, model, known, prior=DirichletPrior(stay=kappa), bootstrap=bootstrap,
        select=select, seed=seed,
    )  # fmt: skip
    name = "drawn from the prior" if drawn else "the calibrated truth" if truth is None else f"model file {truth}"
    with progress.shown(quiet) as watch, workers_of(workers, scheduler) as executor:
        result = recover(settings, truth_name=name, executor=executor, progress=watch)
    words = ["prosocial", "recover", "--states", ",".join(map(str, sizes)), "--replicates", str(replicates)]
    words += ["--participants", str(participants), "--kappa", f"{kappa:g}", "--seed", str(seed)]
    words += ["--truth", truth] if truth is not None else []
    words += ["--true-states", str(known)] if drawn else []
    words += ["--select"] if select else []
    words += ["--bootstrap", str(bootstrap)] if bootstrap else []
    what = "Recovery of a known truth by EM and the Bayesian model: simulated people, simulated truths."
    content = record(what, shlex.join(words), seed, result.to_dict())
    columns = [*SHOWN, *(("boot_coverage_50", "boot_coverage_90") if bootstrap else ())]
    report.say(result.table[columns].to_string(index=False, float_format=lambda v: f"{v:.3f}"))
    if select:
        chosen = result.chosen.pivot_table(index="name", columns="states", values="studies", sort=False)
        report.say(f"\nStudies in which each number of states is chosen:\n{chosen.astype(int).to_string()}")
    report.say(f"\n{result.sentence} Seed {seed}; {result.seconds:.0f} s.")
    finish_evidence(report, out, content)
