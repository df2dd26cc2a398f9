"""The command ``anova``: mixed analysis of variance and comparisons of groups."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from analysis.cli_options import DEFAULT_SEED, JsonOption, QuietOption, Report, SeedOption, distinct_files

if TYPE_CHECKING:
    import pandas as pd


class Rows(StrEnum):
    """Which value of each person is compared between groups."""

    final = "final"
    mean = "mean"


class MissingTimes(StrEnum):
    """What happens to a person without a value at some time."""

    drop = "drop"
    refuse = "refuse"


def anova_command(
    file: Annotated[str, typer.Argument(metavar="FILE.csv", help="One row a person and time; CSV or Parquet.")],
    dv: Annotated[str, typer.Option("--dv", metavar="COLUMN", help="The measure.")],
    between: Annotated[str, typer.Option("--between", metavar="COLUMN", help="The group of each person.")],
    within: Annotated[str, typer.Option("--within", metavar="COLUMN", help="The time of each row.")],
    subject: Annotated[str, typer.Option("--subject", metavar="COLUMN", help="The person.")],
    ss_type: Annotated[
        int,
        typer.Option(
            "--type",
            min=2,
            max=3,
            help="Type of the tests: matters where groups differ in size, and for the logistic model.",
        ),
    ] = 3,
    times: Annotated[
        str | None,
        typer.Option(
            metavar="FIRST,...,LAST",
            help="Times that are used, in this order; by default all, numbers by value and words as they appear.",
        ),
    ] = None,
    posthoc: Annotated[
        Rows, typer.Option(help="Groups are compared on one value a person: the last time, or the mean.")
    ] = Rows.final,
    reference: Annotated[
        str | None, typer.Option(metavar="LEVEL", help="Also compare every group with this one (Dunnett).")
    ] = None,
    level: Annotated[float, typer.Option(help="Level of all intervals.")] = 0.95,
    missing: Annotated[
        MissingTimes, typer.Option(help="People without a value at some time: left out and named, or refused.")
    ] = MissingTimes.drop,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Mixed analysis of variance (a factor between people, one within), Tukey's and Dunnett's comparisons.

    Nothing here is random: the seed is accepted and not used. An outcome of 0 and 1 also gets the logistic mixed
    model that stands beside its analysis of variance.

    Example: prosocial anova study2.csv --dv tokens --between policy --within round --subject id
    """
    from analysis.anova import mixed_anova
    from analysis.anova_logistic import logistic_twin
    from analysis.posthoc import PersonValues, dunnett, tukey
    from analysis.repeated_measures import RepeatedMeasures, check_columns
    from analysis.table_files import read_table
    from models.errors import located

    report = Report(json, quiet)
    distinct_files({"FILE": file, "--json": json})
    if not 0 < level < 1:
        raise located("--level", level, "between 0 and 1")
    columns = {"dv": dv, "between": between, "within": within, "subject": subject}
    names = list(dict.fromkeys(columns.values()))
    frame = read_table(file, names)
    check_columns(frame, {f"--{role}": name for role, name in columns.items()}, file)
    wanted = None if times is None else [part.strip() for part in times.split(",")]
    data = RepeatedMeasures.from_frame(frame, **columns, times=wanted, missing=missing.value, place=file)
    if reference is not None and reference not in data.groups:
        raise located("--reference", reference, f"one of {', '.join(data.groups)}")
    result = mixed_anova(data, ss_type, level)
    people = PersonValues.at(data) if posthoc is Rows.final else PersonValues.mean(data)
    pairs = tukey(people, level)
    versus = None if reference is None else dunnett(people, reference, level)
    twin = logistic_twin(data, ss_type) if data.binary else None

    report.say(_shown(result.table))
    report.say(f"\n{result.sentence}")
    for note in result.notes:
        report.say(note)
    if twin is not None:
        report.say(f"\n{twin.title}:\n{_shown(twin.table[['effect', 'chi_squared', 'df', 'p']])}")
        for note in twin.notes:
            report.say(note)
    cells = result.cells.rename(columns={"group": between, "time": within})
    report.say(f"\nMeans of {dv} in each cell, {level:.0%} intervals:\n{_shown(cells)}")
    for compared in (pairs, versus):
        if compared is not None:
            report.say(f"\n{_shown(compared.table)}\n{compared.sentence}")
    report.finish(
        {
            "table": _rows(result.table), "tukey": _rows(pairs.table),
            "dunnett": [] if versus is None else _rows(versus.table),
            "columns": columns, "type": ss_type, "level": level, "compared": people.what, "reference": reference,
            "times": data.times, "times_by": data.times_by,
            "groups": {g: int(n) for g, n in zip(data.groups, data.group_sizes, strict=True)},
            "people": len(data.people), "left_out": data.left_out, "unused_rows": data.unused_rows,
            "sphericity": vars(result.sphericity), "cells": _rows(result.cells),
            "logistic": None if twin is None else {
                "table": _rows(twin.table), "type": twin.ss_type, "sd": twin.sd, "notes": twin.notes,
            },
            "sentence": result.sentence, "notes": result.notes,
        }
    )  # fmt: skip


def _rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [{str(key): value for key, value in row.items()} for row in table.to_dict("records")]


def _shown(table: pd.DataFrame) -> str:
    return str(table.to_string(index=False, float_format=lambda v: f"{v:.4g}", na_rep="-"))
