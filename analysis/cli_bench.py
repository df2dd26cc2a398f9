"""The command ``bench``: speed against peers, measured in one run."""

from __future__ import annotations

from typing import Annotated

import typer

from analysis.cli_options import DEFAULT_SEED, JsonOption, QuietOption, Report, SeedOption


def bench_command(
    name: Annotated[
        str, typer.Argument(metavar="[NAME]", help="em, bayes, glmm, planning, robust, game, runtime, or all.")
    ] = "all",
    quick: Annotated[bool, typer.Option("--quick", help="Fewer repeats and smaller sizes.")] = False,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Measure speed against peers (those that are installed: `make bench` has them all).

    Example: prosocial bench em --json bench.json
    """
    import sys

    from analysis.bench import bayes, em, game, glmm, planning, robust, runtime
    from analysis.bench.timing import environment
    from models.errors import located

    suites = {
        "em": em.run, "bayes": bayes.run, "glmm": glmm.run,
        "planning": planning.run, "robust": robust.run, "game": game.run, "runtime": runtime.run,
    }  # fmt: skip
    if name != "all" and name not in suites:
        raise located("bench", name, f"one of {', '.join(suites)}, or all")
    report = Report(json, quiet)
    watch = (lambda text: print(f"... {text}", file=sys.stderr)) if sys.stderr.isatty() and not quiet else None
    rows = []
    for suite, run in suites.items():
        if name not in ("all", suite):
            continue
        for row in run(quick=quick, progress=watch):
            rows.append({"suite": suite, **row.to_dict()})
            ratio = "" if row.ratio is None else f"  ratio {row.ratio:.4g}"
            peer = "" if row.peer is None else f"  {row.peer_name} {row.peer:.4g}"
            mark = {True: "  target met", False: "  TARGET MISSED", None: ""}[row.met]
            report.say(f"{row.name}: {row.ours:.4g} {row.unit}{peer}{ratio}{mark} {row.target}".rstrip())
            if row.note:
                report.say(f"    {row.note}")
    report.finish({"rows": rows, "environment": environment(), "quick": quick})
