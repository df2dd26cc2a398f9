"""The command ``report``: everything about one data set in one HTML file."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
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
from analysis.cli_planning_options import CostOption, costs_of
from analysis.cli_stream_options import held_sentence
from analysis.wording import counted
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
    compare: Annotated[
        tuple[str, str] | None,
        typer.Option("--compare", metavar="A B", help="Instead: compare two data sets, or stored fits (netCDF)."),
    ] = None,
    schedule: Annotated[
        str | None, typer.Option("--schedule", help="With --values or --compare: rounds that plans are made for.")
    ] = None,
    values: Annotated[
        list[str] | None,
        typer.Option(
            "--values",
            metavar="LIST|FILE|measured",
            help="What a round is worth by state: 12,15.5,30, a JSON file, or measured by the team's tokens.",
        ),
    ] = None,
    cost: CostOption = None,
    unit: Annotated[
        str | None, typer.Option("--unit", metavar="WORD", help="With --values: what they are in, such as points.")
    ] = None,
    kind: Annotated[
        list[str] | None,
        typer.Option(
            "--kind",
            metavar="real|simulated",
            help="Of a file: whether its people exist, on your word. With --compare: of every side without a card; "
            "twice: of A, then of B.",
        ),
    ] = None,
    title: Annotated[str | None, typer.Option("--title", help="Of a file: what the report calls it.")] = None,
    pdf: Annotated[bool, typer.Option("--pdf", help="Also write a PDF (needs the extra `pdf`).")] = False,
    parts: Annotated[
        bool,
        typer.Option("--parts/--no-parts", help="Also every table as CSV and LaTeX, every figure as SVG and PNG."),
    ] = True,
    plan: Annotated[
        str | None,
        typer.Option("--plan", metavar="FILE.toml", help="Analysis plan: marks results planned or exploratory."),
    ] = None,
    out: Annotated[str, typer.Option("--out", metavar="DIR", help="Folder to write into.")] = "reports/build",
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
    protocol: ProtocolOption = None,
    workers: Annotated[
        int | None,
        typer.Option(
            "--workers",
            metavar="N",
            min=0,
            help="Processes that make sections beside this one (0: none); one where there is a second processor.",
        ),
    ] = None,
) -> None:
    """Write the report on a data set: who responded how, how many states, what was learned, what was not.

    Condition, states and pins are those of the data card unless given.

    Every table and figure is also a file under parts/ (--no-parts: none of them).

    Plans for a protocol of your own want what a round is worth: --values 0,18 (above the lowest state; again for
    another number of states) or --values measured. A file holds values, or an object with values, costs, unit.

    An analysis plan has title, date and [[planned]] tables, each with results = [keys of parts/index.csv] and why.

    A file is read at once, for a report needs every person; em and bayes read large files in parts.

    Example: prosocial report --data frd2012 --states 2-4 --out reports/build/frd2012
    """
    if compare is not None:
        unfit = {"--data": data if data != DEFAULT_DATA else None, "--run-length": run_length, "--plan": plan,
                 "--title": title, "--pdf": "given" if pdf else None,
                 "--values": values and ", ".join(values), "--cost": cost and ", ".join(cost),
                 "--unit": unit, "--workers": workers}  # fmt: skip
        for option, value in unfit.items():
            if value is not None:
                raise located(option, value, "no value: it does not go with --compare")
        _compare(
            compare, condition, states, pin, schedule, kind or [], quick, parts, out, json, quiet, seed, protocol
        )  # fmt: skip
        return
    given_with = {"--schedule": schedule, "--cost": cost and ", ".join(cost), "--unit": unit}
    for option, value in given_with.items():
        if value is not None and not values:
            wanted = "no value: it belongs to --values" + (" or --compare" if option == "--schedule" else "")
            raise located(option, value, wanted)
    from dataclasses import replace
    from pathlib import Path

    from analysis import datasets, progress
    from analysis.report.analysis_plan import read_analysis_plan
    from analysis.report.build import HTML_NAME, PARTS_NAME, PDF_NAME, build_report
    from analysis.report.parts import INDEX, check_parts_folder
    from analysis.report.pdf import check_available
    from analysis.report.summary import summarised
    from analysis.side_by_side import word_of_user
    from analysis.stated_reward import read_values

    report = Report(json, quiet)
    if run_length not in (None, "random", "fixed"):
        raise located("--run-length", run_length, "random or fixed")
    stated = _one_kind(kind)
    for option, value in (("--kind", stated), ("--title", title)):
        if value is not None and data in datasets.names():
            raise located(option, value, f"no value: {data} has a card of its own")
    check_output_folder("--out", out)
    if parts:
        check_parts_folder(Path(out) / PARTS_NAME)
    planned = None if plan is None else read_analysis_plan(plan)
    names = (HTML_NAME, PDF_NAME) if pdf else (HTML_NAME,)
    for name in names:
        check_output("--out", Path(out) / name)
    distinct_files(
        {"--data": data, "--protocol": protocol, "--plan": plan, "--out": out, "--json": json}
        | {f"--values {text}": text for text in values or [] if Path(text).is_file()}
        | {f"--out, {name}": Path(out) / name for name in names}
    )
    if pdf:
        check_available()
    given = {"--data": [data], "--condition": condition, "--states": states and [states], "--pin": pin,
             "--run-length": run_length and [run_length], "--kind": kind, "--title": title and [title],
             "--protocol": protocol and [protocol], "--plan": plan and [plan], "--values": values, "--cost": cost,
             "--unit": unit and [unit], "--schedule": schedule and [schedule], "--seed": [str(seed)]}  # fmt: skip
    command = ["prosocial", "report", *(["--quick"] if quick else [])]
    command += [word for option, several in given.items() for value in several or [] for word in (option, value)]
    rules = load_protocol(protocol)
    if note := held_sentence(data, "report"):
        report.say(note)
    loaded = datasets.load(data, rules)
    reward = read_values(values, loaded.log.protocol, _numbers(cost), unit) if values else None
    card = loaded.card
    card = replace(
        card, run_length=run_length or card.run_length, kind=stated or card.kind, title=title or card.title
    )  # fmt: skip
    loaded = replace(loaded, card=card)
    if stated is not None:
        loaded = replace(loaded, notes=(*loaded.notes, word_of_user(stated)))
    with progress.shown(quiet) as watch:
        try:
            result = build_report(
                loaded, states=states, seed=seed, quick=quick, out=out, condition=condition, pins=pin, pdf=pdf,
                parts=parts, plan=planned, reward=reward, schedule=schedule, command=shlex.join(command),
                progress=watch, workers=usual_workers() if workers is None else workers,
            )  # fmt: skip
        except OSError as error:
            raise InputError(f"--out {out}: cannot be written: {error.strerror}") from None
    report.say(f"{data} ({loaded.card.kind}): {result.selection.sentence}; seed {seed}")
    for note in loaded.notes:
        report.say(f"note: {note}")
    for section in result.sections:
        if section.omitted:
            report.say(f"left out: {section.title}: {section.omitted}")
    report.say(_found(result.found, result.drawn_before))
    written = ", ".join(str(path) for path in (result.html, result.pdf) if path is not None)
    if result.parts is not None:
        figures, tables = counted(result.parts.figures, "figure"), counted(result.parts.tables, "table")
        report.say(f"{result.parts.folder}: {figures} and {tables}, each a file; {INDEX} lists them")
    report.say(f"{written}{'; QUICK: fewer restarts, not for citation' if quick else ''}; {result.seconds:.1f} s")
    report.finish(
        {
            "html": result.html, "pdf": result.pdf, "parts": result.parts and result.parts.folder,
            "sections": [{"key": s.key, "title": s.title, "omitted": s.omitted} for s in result.sections],
            "summary": [answer.line for answer in summarised(result.sections)],
            "seconds": result.seconds, "compile_seconds": result.study.compile_seconds,
            "found_in_store": [what for what, found in result.found.items() if found],
            "computed": [what for what, found in result.found.items() if not found],
            "figures_found_in_store": sum(result.drawn_before.values()),
            "data": data, "kind": loaded.card.kind, "digest": loaded.digest,
            "conditions": result.selection.conditions, "pins": result.selection.pins,
            "states": result.selection.states, "best_by_bic": result.study.best_by_bic, "quick": quick,
            "seed": seed, "reward": None if result.reward is None else result.reward.to_dict(),
        }
    )  # fmt: skip


def usual_workers() -> int:
    """One, where there is a processor for it: a second one would mostly wait for the longest section."""
    return min(1, (os.cpu_count() or 1) - 1)


def _numbers(cost: list[str] | None) -> dict[str, float]:
    return {name: value for name, value in costs_of(cost).items() if value is not None}


def _one_kind(kind: list[str] | None) -> str | None:
    """What the user says of the one data set; None if nothing."""
    from analysis.side_by_side import check_kind

    if not kind:
        return None
    if len(kind) > 1:
        raise located("--kind", ", ".join(kind), "one value, without --compare")
    check_kind(kind[0])
    return kind[0]


def _found(results: Mapping[str, bool], figures: Mapping[str, bool]) -> str:
    """What was found in the store, and what was computed."""
    text = (
        f"Found in the store: {sum(results.values())} of {counted(len(results), 'result')}, "
        f"{sum(figures.values())} of {counted(len(figures), 'figure')}."
    )
    anew = [what for what, found in results.items() if not found]
    return text + (f" Computed: {'; '.join(anew)}." if 0 < len(anew) < len(results) / 2 else "")


def _compare(
    names: tuple[str, str], condition: list[str] | None, states: str | None, pin: list[str] | None,
    schedule: str | None, kind: list[str], quick: bool, parts: bool, out: str, json: str | None, quiet: bool,
    seed: int, protocol: str | None,
) -> None:  # fmt: skip
    from pathlib import Path

    from analysis import progress
    from analysis.report.compare import HTML_NAME, compare_report
    from analysis.report.summary import summarised

    report = Report(json, quiet)
    check_output_folder("--out", out)
    check_output("--out", Path(out) / HTML_NAME)
    files = dict(zip(("--compare, A", "--compare, B"), names, strict=True))
    distinct_files(files | {"--protocol": protocol, "--json": json, f"--out, {HTML_NAME}": Path(out) / HTML_NAME})
    options = {"--condition": condition, "--states": states and [states], "--pin": pin,
               "--schedule": schedule and [schedule], "--kind": kind, "--seed": [str(seed)]}  # fmt: skip
    command = ["prosocial", "report", "--compare", *names, *(["--quick"] if quick else [])]
    command += [word for option, values in options.items() for value in values or [] for word in (option, value)]
    with progress.shown(quiet) as watch:
        try:
            result = compare_report(
                *names, states=states, condition=condition, pins=pin, schedule=schedule, seed=seed, quick=quick,
                out=out, parts=parts, protocol=load_protocol(protocol) if protocol else None, kind=kind,
                command=shlex.join(command), progress=watch,
            )  # fmt: skip
        except OSError as error:
            raise InputError(f"--out {out}: cannot be written: {error.strerror}") from None
    for side in result.sides:
        report.say(f"{side.label}: {side.name} ({side.kind}), {side.doubt}")
        for warning in side.warnings:
            report.say(f"note: {side.label}: {warning}")
    for section in result.sections:
        if section.omitted:
            report.say(f"left out: {section.title}: {section.omitted}")
        elif section.key in ("one-model", "plans"):
            for sentence in section.sentences:
                report.say(sentence)
    report.say(
        f"{result.html}{'; QUICK: fewer restarts, not for citation' if quick else ''}; {result.seconds:.1f} s"
    )
    report.finish(
        {
            "html": result.html, "pdf": None, "parts": result.parts and result.parts.folder,
            "sections": [{"key": s.key, "title": s.title, "omitted": s.omitted} for s in result.sections],
            "summary": [answer.line for answer in summarised(result.sections)],
            "seconds": result.seconds, "sides": [
                {"label": s.label, "name": s.name, "kind": s.kind, "digest": s.digest, "doubt": s.doubt}
                for s in result.sides
            ],
            "states": result.states, "quick": quick, "seed": seed,
        }
    )  # fmt: skip
