"""What the commands ``power ...`` share: blocks of options, and the figure that each can draw.

A block is a dataclass whose fields are options; `with_options` puts them behind a command's own, so that each
option is written once and read from one object.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from analysis.cli_options import (
    DEFAULT_SEED,
    JsonOption,
    QuietOption,
    Report,
    SeedOption,
    check_output,
    distinct_files,
    plain,
    write_output,
)
from analysis.cli_workers import SchedulerOption, WorkersOption

if TYPE_CHECKING:
    import pandas as pd

AlphaOption = Annotated[float, typer.Option("--alpha", help="Level of the test.")]
WantedOption = Annotated[float, typer.Option("--power", help="Power wanted.")]
TimesOption = Annotated[int, typer.Option(min=2, help="Measurements a person.")]
RhoOption = Annotated[float, typer.Option(help="Correlation between two measurements of a person; no default.")]
EpsilonOption = Annotated[
    float, typer.Option(help="Sphericity, from 1/(times - 1) to 1; below 1 where correlations differ.")
]


@dataclass(frozen=True, kw_only=True)
class OutputOptions:
    """Where results go, and the seed."""

    figure: Annotated[str | None, typer.Option("--figure", metavar="FILE.svg", help="Also draw the curve.")] = None
    json: JsonOption = None
    quiet: QuietOption = False
    seed: SeedOption = DEFAULT_SEED

    def report(self, read: str | None = None) -> Report:
        """Check what is to be written, and begin; `read` is a file that the command reads."""
        report = Report(self.json, self.quiet)
        if self.figure is not None:
            check_output("--figure", self.figure)
        distinct_files({"FILE": read, "--figure": self.figure, "--json": self.json})
        return report

    def draw(
        self,
        series: Mapping[str, pd.DataFrame],
        wanted: float,
        reached: Mapping[str, float],
        ylabel: str = "power",
        log_x: bool = False,
    ) -> None:
        """Draw the curves into the file of ``--figure``, if one is asked for."""
        if self.figure is None:
            return
        from analysis.figures.power import power_by_people
        from analysis.figures.style import to_svg

        ax = power_by_people(series, wanted, reached=reached, ylabel=ylabel, log_x=log_x)
        write_output("--figure", self.figure, to_svg(ax).encode())


@dataclass(frozen=True, kw_only=True)
class EvidenceOptions(OutputOptions):
    """Of commands whose result may be stored with what is needed to repeat it."""

    out: Annotated[
        str | None, typer.Option("--out", metavar="FILE", help="Also write the result as evidence, JSON.")
    ] = None
    workers: WorkersOption = None
    scheduler: SchedulerOption = None

    def report(self, read: str | None = None) -> Report:
        """As of `OutputOptions`, the evidence file among what is written."""
        report = super().report(read)
        if self.out is not None:
            check_output("--out", self.out)
        distinct_files({"FILE": read, "--figure": self.figure, "--json": self.json, "--out": self.out})
        return report

    def finish(
        self,
        report: Report,
        content: Mapping[str, Any],
        what: str,
        words: Mapping[str, object],
        modules: Sequence[str],
    ) -> None:
        """Write the evidence, if it is asked for, and the command's JSON.

        Parameters
        ----------
        report : Report
        content : mapping
            The result, with its ``sentence``.
        what : str
            What it is, saying that it is simulated.
        words : mapping
            The command under the empty key, then options and their values: None for none, lists repeated.
        modules : sequence of str
            What the result rests on.
        """
        if self.out is not None:
            import json
            import shlex

            from analysis.evidence import record

            command = ["prosocial", *str(words[""]).split()]
            for option, value in words.items():
                for one in value if isinstance(value, list | tuple) else [value]:
                    command += [option, str(one)] if option and one is not None else []
            evidence = record(what, shlex.join([*command, "--seed", str(self.seed)]), self.seed, content, modules)
            text = json.dumps(plain(evidence), indent=1, allow_nan=False, ensure_ascii=False) + "\n"
            write_output("--out", self.out, text.encode())
        report.finish({**content, "out": self.out})


@dataclass(frozen=True, kw_only=True)
class FormulaOptions(OutputOptions):
    """Of the commands by formula: the effect, the test, and power or people."""

    f: Annotated[float, typer.Option("--f", help="Cohen's f: sd of cell means over sd within.")] = 0.25
    alpha: AlphaOption = 0.05
    wanted: WantedOption = 0.95
    people: Annotated[
        int | None, typer.Option("--people", min=2, help="Give the power of that many people instead.")
    ] = None


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options of the block that its last parameter, `options`, is annotated with.

    Examples
    --------
    >>> @with_options
    ... def plan(rho: RhoOption, options: OutputOptions) -> None:
    ...     print(rho, options.seed)
    >>> list(inspect.signature(plan).parameters)
    ['rho', 'figure', 'json', 'quiet', 'seed']
    >>> plan(rho=0.5, seed=3)
    0.5 3
    """
    hints = get_type_hints(command, include_extras=True)
    block: Any = hints.pop("options")
    own = [
        part.replace(annotation=hints[name], kind=inspect.Parameter.KEYWORD_ONLY)
        for name, part in inspect.signature(command).parameters.items()
        if name != "options"
    ]
    kinds = get_type_hints(block, include_extras=True)
    # Options of a block come before those of the block it builds on: where results go stands last in the help.
    base = {field.name for field in fields(OutputOptions)} | {"out"}
    shared = sorted((field for field in fields(block)), key=lambda field: field.name in base)
    of_block = [
        inspect.Parameter(f.name, inspect.Parameter.KEYWORD_ONLY, default=f.default, annotation=kinds[f.name])
        for f in shared
    ]

    def run(**given: Any) -> None:
        options = block(**{field.name: given.pop(field.name) for field in shared if field.name in given})
        command(**given, options=options)

    run.__name__, run.__doc__, run.__module__ = command.__name__, command.__doc__, command.__module__
    run.__annotations__ = {part.name: part.annotation for part in (*own, *of_block)} | {"return": None}
    run.__signature__ = inspect.Signature([*own, *of_block])  # type: ignore[attr-defined]
    return run
