"""The command ``calibrate``: whether the Bayesian model's doubt is what it claims to be."""

from __future__ import annotations

from typing import Annotated

import typer

from analysis.cli_evidence import OutOption, begin_evidence, finish_evidence
from analysis.cli_options import DEFAULT_SEED, JsonOption, QuietOption, SeedOption
from analysis.cli_people_options import PeopleDifferOption, PersonScaleOption, person_offset, refuse_without
from analysis.cli_workers import SchedulerOption, WorkersOption, workers_of

PUBLISHED_PEOPLE = 540
DIFFERING_PEOPLE, DIFFERING_RUNS = 300, 3
"""Where people differ each needs several runs for sigma to be learned, and a study costs more time."""


def calibrate_command(
    states: Annotated[str, typer.Option(metavar="2,3", help="Numbers of states: 2, 2-3 or 2,3.")] = "2",
    replicates: Annotated[
        str, typer.Option(metavar="200,100", help="Simulated studies; one number, or one for each of the states.")
    ] = "200",
    participants: Annotated[
        int | None,
        typer.Option(
            min=1, help=f"People in each simulated study; {PUBLISHED_PEOPLE}, or {DIFFERING_PEOPLE} who differ."
        ),
    ] = None,
    people_differ: PeopleDifferOption = False,
    person_scale: PersonScaleOption = None,
    runs_per_person: Annotated[
        int | None,
        typer.Option(min=1, metavar="3", help="Runs of each person who differs, schedules drawn anew for each."),
    ] = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    out: OutOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Simulation-based calibration of the posterior under the published design.

    Truths come from the prior, each with a simulated study and its posterior; ranks of the truths must be uniform.

    Example: prosocial calibrate --states 2,3 --replicates 200,100 --out calibration.json

    People who differ: prosocial calibrate --people-differ --replicates 100 --out calibration_people.json
    """
    from analysis import progress
    from analysis.calibration import calibrate
    from analysis.calibration_replicate import CalibrationSettings
    from analysis.em_study import parse_states
    from analysis.evidence import record
    from models.errors import located

    report = begin_evidence(json, quiet, out)
    sizes = parse_states(states)
    counts = [int(part) if part.strip().isdecimal() else 0 for part in replicates.split(",")]
    if len(counts) == 1:
        counts *= len(sizes)
    if len(counts) != len(sizes) or min(counts) < 1:
        raise located(
            "--replicates", replicates, f"one positive number, or {len(sizes)}: one for each of the states"
        )
    people = person_offset(people_differ, person_scale)
    refuse_without(people_differ, "--people-differ", {"--runs-per-person": runs_per_person})
    runs = (DIFFERING_RUNS if runs_per_person is None else runs_per_person) if people_differ else 1
    if participants is None:
        participants = DIFFERING_PEOPLE if people_differ else PUBLISHED_PEOPLE
    settings = [
        CalibrationSettings(k, n, participants, seed=seed, people=people, runs_per_person=runs)
        for k, n in zip(sizes, counts, strict=True)
    ]
    with progress.shown(quiet) as watch, workers_of(workers, scheduler) as executor:
        result = calibrate(settings, executor=executor, progress=watch)
    command = (
        f"prosocial calibrate --states {','.join(map(str, sizes))} --replicates {','.join(map(str, counts))} "
        f"--participants {participants} --seed {seed}"
    )
    model = "Bayesian model"
    if people is not None:
        command += f" --people-differ --person-scale {people.scale:g} --runs-per-person {runs}"
        model += " where people differ"
    what = f"Simulation-based calibration of the {model}: simulated people, simulated truths."
    content = record(what, command, seed, result.to_dict())
    report.say(result.sentence)
    for run in result.runs:
        report.say(run.sentence)
    columns = [c for c in result.table.columns if not c.startswith("p_")] + ["p_uniform"]
    report.say(result.table[columns].round(3).to_string())
    finish_evidence(report, out, content)
