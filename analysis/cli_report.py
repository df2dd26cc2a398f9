"""Command ``report``: the whole report on one data set as one HTML file."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import typer

from analysis.cli_options import (
    DEFAULT_SEED,
    JsonOption,
    ProtocolOption,
    QuietOption,
    Report,
    SeedOption,
    check_output,
    load_protocol,
)
from models.errors import InputError

if TYPE_CHECKING:
    from analysis.em_study import Progress

DEFAULT_DATA = "simulated_study1"
ALL, NONE = "all", "none"


def report_command(
    data: Annotated[
        str, typer.Option("--data", metavar="NAME|FILE", help="Registered data set or event file.")
    ] = DEFAULT_DATA,
    condition: Annotated[
        list[str] | None,
        typer.Option(help=f"Condition to select, repeatable; the card's by default, '{ALL}' for all."),
    ] = None,
    states: Annotated[
        str | None, typer.Option(metavar="2-5", help="Numbers of states; the card's by default, else 2-5.")
    ] = None,
    pin: Annotated[
        list[str] | None,
        typer.Option(
            metavar="ACTION",
            help="Hold this action's transition table at the identity, repeatable; the card's by default, "
            f"'{NONE}' for none.",
        ),
    ] = None,
    quick: Annotated[bool, typer.Option("--quick", help="Fewer restarts; marked as not for citation.")] = False,
    pdf: Annotated[bool, typer.Option("--pdf", help="Also write a PDF (needs the extra `pdf`).")] = False,
    out: Annotated[str, typer.Option(metavar="DIR", help="Folder to write into.")] = "reports/build",
    json: JsonOption = None,
    quiet: QuietOption = False,
    protocol: ProtocolOption = None,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Write the report on a data set: who responded how, how many states, what was learned, what was not.

    Example: prosocial report --data frd2012 --states 2-4 --out reports/build/frd2012
    """
    from analysis import datasets
    from analysis.em_study import parse_states
    from analysis.report.build import HTML_NAME, build_report

    report = Report(json, quiet)
    check_output("--out", f"{out}/{HTML_NAME}")
    counts = None if states is None else parse_states(states)
    loaded = datasets.load(data, load_protocol(protocol))
    for note in loaded.notes:
        report.say(f"note: {note}")
    with _progress(quiet) as progress:
        try:
            result = build_report(
                loaded, states=counts, seed=seed, quick=quick, out=out, condition=_listed(condition, ALL),
                pins=_listed(pin, NONE), pdf=pdf, command=shlex.join(["prosocial", *sys.argv[1:]]),
                progress=progress,
            )  # fmt: skip
        except OSError as error:
            raise InputError(f"--out {out}: cannot be written: {error.strerror}") from None
    for section in result.sections:
        if section.omitted:
            report.say(f"left out: {section.title}: {section.omitted}")
    report.say(f"{result.html} ({'quick, not for citation, ' if quick else ''}{result.seconds:.1f} s)")
    if result.pdf is not None:
        report.say(str(result.pdf))
    report.finish(
        {
            "html": result.html,
            "pdf": result.pdf,
            "sections": [{"key": s.key, "title": s.title, "omitted": s.omitted} for s in result.sections],
            "seconds": result.seconds,
            "compile_seconds": result.study.compile_seconds,
            "data": loaded.card.name,
            "kind": loaded.card.kind,
            "states": list(result.study.states),
            "best_by_bic": result.study.best_by_bic,
            "quick": quick,
            "seed": seed,
        }
    )


def _listed(values: list[str] | None, nothing: str) -> list[str] | None:
    """None for the card's default, an empty list for the word that switches it off."""
    return [] if values == [nothing] else values


@contextmanager
def _progress(quiet: bool) -> Iterator[Progress | None]:
    """A bar on standard error while somebody is watching, nothing otherwise."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress as Bars
    from rich.progress import TaskID

    with Bars(console=Console(stderr=True), transient=True) as bars:
        tasks: dict[str, TaskID] = {}

        def tell(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bars.add_task(what, total=total)
            bars.update(tasks[what], completed=done)

        show: Callable[[str, int, int], None] = tell
        yield show
