"""The command ``report``: everything about one data set in one HTML file."""

from __future__ import annotations

import shlex
from typing import Annotated

import typer

from analysis.cli_em import ConditionOption, PinOption, StatesOption
from analysis.cli_options import (
    DEFAULT_SEED,
    JsonOption,
    ProtocolOption,
    QuietOption,
    Report,
    SeedOption,
    check_output,
    check_output_folder,
    distinct_files,
    load_protocol,
)
from models.errors import InputError, located

DEFAULT_DATA = "simulated_study1"


def report_command(
    data: Annotated[
        str, typer.Option("--data", metavar="DATA", help="A registered data set, or an event file.")
    ] = DEFAULT_DATA,
    condition: ConditionOption = None,
    states: StatesOption = None,
    pin: PinOption = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Fewer restarts and replicates; marked as not for citation.")
    ] = False,
    run_length: Annotated[
        str | None,
        typer.Option(
            "--run-length",
            metavar="random|fixed",
            help="Whether the design ended runs at random; fixed: every shorter run is somebody who left.",
        ),
    ] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Also write a PDF (needs the extra `pdf`).")] = False,
    out: Annotated[str, typer.Option("--out", metavar="DIR", help="Folder to write into.")] = "reports/build",
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
    protocol: ProtocolOption = None,
) -> None:
    """Write the report on a data set: who responded how, how many states, what was learned, what was not.

    Condition, states and pins are those of the data card unless given.

    Example: prosocial report --data frd2012 --states 2-4 --out reports/build/frd2012
    """
    from dataclasses import replace
    from pathlib import Path

    from analysis import datasets, progress
    from analysis.report.build import HTML_NAME, PDF_NAME, build_report
    from analysis.report.pdf import check_available

    report = Report(json, quiet)
    if run_length not in (None, "random", "fixed"):
        raise located("--run-length", run_length, "random or fixed")
    check_output_folder("--out", out)
    names = (HTML_NAME, PDF_NAME) if pdf else (HTML_NAME,)
    for name in names:
        check_output("--out", Path(out) / name)
    distinct_files(
        {"--data": data, "--protocol": protocol, "--out": out, "--json": json}
        | {f"--out, {name}": Path(out) / name for name in names}
    )
    if pdf:
        check_available()
    given = {"--data": [data], "--condition": condition, "--states": states and [states], "--pin": pin,
             "--run-length": run_length and [run_length],
             "--protocol": protocol and [protocol], "--seed": [str(seed)]}  # fmt: skip
    command = ["prosocial", "report", *(["--quick"] if quick else [])]
    command += [word for option, values in given.items() for value in values or [] for word in (option, value)]
    loaded = datasets.load(data, load_protocol(protocol))
    if run_length is not None:
        loaded = replace(loaded, card=replace(loaded.card, run_length=run_length))
    with progress.shown(quiet) as watch:
        try:
            result = build_report(
                loaded, states=states, seed=seed, quick=quick, out=out, condition=condition, pins=pin, pdf=pdf,
                command=shlex.join(command), progress=watch,
            )  # fmt: skip
        except OSError as error:
            raise InputError(f"--out {out}: cannot be written: {error.strerror}") from None
    report.say(f"{data} ({loaded.card.kind}): {result.selection.sentence}; seed {seed}")
    for note in loaded.notes:
        report.say(f"note: {note}")
    for section in result.sections:
        if section.omitted:
            report.say(f"left out: {section.title}: {section.omitted}")
    written = ", ".join(str(path) for path in (result.html, result.pdf) if path is not None)
    report.say(f"{written}{'; QUICK: fewer restarts, not for citation' if quick else ''}; {result.seconds:.1f} s")
    report.finish(
        {
            "html": result.html, "pdf": result.pdf,
            "sections": [{"key": s.key, "title": s.title, "omitted": s.omitted} for s in result.sections],
            "seconds": result.seconds, "compile_seconds": result.study.compile_seconds,
            "data": data, "kind": loaded.card.kind, "digest": loaded.digest,
            "conditions": result.selection.conditions, "pins": result.selection.pins,
            "states": result.selection.states, "best_by_bic": result.study.best_by_bic, "quick": quick,
            "seed": seed,
        }
    )  # fmt: skip
