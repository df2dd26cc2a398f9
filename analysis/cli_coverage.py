"""The command ``coverage``: whether intervals of the mixed model hold the truth as often as they say."""

from __future__ import annotations

import shlex
from functools import partial
from typing import Annotated

import typer

from analysis.cli_evidence import begin_evidence, finish_evidence
from analysis.cli_options import DEFAULT_SEED, JsonOption, QuietOption, SeedOption
from analysis.cli_workers import SchedulerOption, WorkersOption, workers_of

SHOWN = ("intercept", "rule", "parameter", "interval", "truth", "median", "share", "exact", "below", "above")
"""Columns printed for people; the JSON has all."""


def coverage_command(
    studies: Annotated[int, typer.Option(min=2, help="Simulated studies at every rate of help.")] = 500,
    participants: Annotated[int, typer.Option(min=10, help="People in each simulated study.")] = 540,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    out: Annotated[
        str | None, typer.Option("--out", metavar="FILE", help="Write the result as evidence, JSON.")
    ] = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """How often profile and Wald intervals of the mixed model hold the truth, by quadrature and by Laplace's rule.

    Studies are drawn from the mixed model itself under the published design, where nine in ten responses are
    helping and near the ceiling; beside it, the estimates of both rules as more and more people always help. Takes
    two minutes.

    Example: prosocial coverage --studies 500 --out coverage.json
    """
    from analysis import progress
    from analysis.evidence import record
    from analysis.interval_coverage import ENGINE, CoverageSettings, interval_coverage
    from analysis.quadrature_study import CEILING, quadrature_study

    report = begin_evidence(json, quiet, out)
    settings = CoverageSettings(people=participants, studies=studies, seed=seed)
    with progress.shown(quiet) as watch, workers_of(workers, scheduler) as executor:
        result = interval_coverage(settings, executor=executor, progress=watch)
        tell = None if watch is None else partial(watch, "both rules near the ceiling")
        ceiling = quadrature_study(
            CEILING, people=participants, replicates=studies, seed=seed, progress=tell, executor=executor
        )
    words = ["prosocial", "coverage", "--studies", str(studies), "--participants", str(participants)]
    what = "Intervals and estimates of the logistic mixed model where the truth is known: simulated people."
    content = record(
        what, shlex.join([*words, "--seed", str(seed)]), seed, {**result.to_dict(), "ceiling": ceiling.to_dict()},
        ENGINE,
    )  # fmt: skip
    report.say(result.table[list(SHOWN)].to_string(index=False, float_format=lambda v: f"{v:.3f}"))
    report.say(f"\n{result.sentence}\n\n{ceiling.sentence} Seed {seed}; {result.seconds:.0f} s.")
    finish_evidence(report, out, content)
