"""The command ``bench``: speed against peers, measured in one run, and what larger work will cost."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from analysis.cli_options import DEFAULT_SEED, JsonOption, QuietOption, Report, SeedOption, check_output

if TYPE_CHECKING:
    from analysis.bench.timing import Row

NAMES = "em, bayes, glmm, planning, robust, game, runtime, scale, startup, end_to_end, curves, all, or predict."

PREDICT = ("people", "rounds", "states", "draws", "horizon", "game_rounds", "nodes")


def bench_command(
    name: Annotated[str, typer.Argument(metavar="[NAME]", help=NAMES)] = "all",
    quick: Annotated[bool, typer.Option("--quick", help="Fewer repeats and smaller sizes.")] = False,
    out: Annotated[
        str | None,
        typer.Option("--out", metavar="FILE", help="Results to add to, suite by suite (made if missing)."),
    ] = None,
    people: Annotated[float, typer.Option("--people", min=0, help="predict: people (1e8 is fine).")] = 0,
    rounds: Annotated[int, typer.Option("--rounds", min=0, help="predict: rounds of each person.")] = 0,
    states: Annotated[int, typer.Option("--states", min=1, help="predict: latent states.")] = 4,
    nodes: Annotated[
        float,
        typer.Option(
            "--nodes", min=0, help="predict: events of distinct histories; the most there can be if not given."
        ),
    ] = 0,
    draws: Annotated[float, typer.Option("--draws", min=0, help="predict: draws that are planned for.")] = 0,
    horizon: Annotated[int, typer.Option("--horizon", min=0, help="predict: events of the plan.")] = 0,
    game_rounds: Annotated[float, typer.Option("--game-rounds", min=0, help="predict: rounds of the game.")] = 0,
    curves: Annotated[
        str | None,
        typer.Option("--curves", metavar="FILE", help="predict: results to fit, instead of the stored ones."),
    ] = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Measure speed against peers (those that are installed: `make bench` has them all), or predict costs.

    Example: prosocial bench em --json bench.json

    What will a hundred million people cost?: prosocial bench predict --people 1e8 --rounds 20 --states 4
    """
    from analysis.bench.results import suites
    from models.errors import located

    report = Report(json, quiet)
    sizes = dict(zip(PREDICT, (people, rounds, states, draws, horizon, game_rounds, nodes), strict=True))
    if name == "predict":
        _predict(sizes, curves, report)
        return
    known = suites()
    if name != "all" and name not in known:
        raise located("bench", name, f"one of {', '.join(known)}, all, or predict")
    if any(value for key, value in sizes.items() if key != "states") or curves is not None:
        raise located("bench", name, "predict, where sizes of work are given")
    _measure(list(known) if name == "all" else [name], quick, out, report, seed)


def _measure(names: list[str], quick: bool, out: str | None, report: Report, seed: int) -> None:
    import json
    import sys

    from analysis.bench.results import added, judged, measure, read_results, sentence
    from analysis.bench.timing import environment
    from analysis.cli_options import write_output

    before = None
    if out is not None:
        check_output("--out", out)
        before = read_results(out) if Path(out).exists() else None
    watching = sys.stderr.isatty() and not report.quiet
    watch = (lambda text: print(f"... {text}", file=sys.stderr)) if watching else None
    measured: dict[str, Any] = {}
    for name in names:
        measured[name] = found = measure(name, quick=quick, progress=watch, each=lambda row: _say(row, report))
        if found["points"]:
            report.say(f"{name}: {len(found['points'])} points of cost curves")
        if out is not None:
            # After every suite: an interruption leaves what was measured.
            before = added(before, {name: found}, seed)
            write_output("--out", out, (json.dumps(before, indent=1, allow_nan=False) + "\n").encode())
    if len(names) > 1:
        content = {"suites": measured}
        report.say(sentence(content))
        for suite, row in judged(content)["missed"]:
            report.say(f"    missed, {suite}: {row['name']}")
    rows = [{"suite": name, **row} for name, suite in measured.items() for row in suite["rows"]]
    points = [point for suite in measured.values() for point in suite["points"]]
    loads = {name: suite["load"] for name, suite in measured.items()}
    report.finish({"rows": rows, "points": points, "environment": environment(), "load": loads, "quick": quick})


def _say(row: Row, report: Report) -> None:
    ratio = "" if row.ratio is None else f"  ratio {row.ratio:.4g}"
    peer = "" if row.peer is None else f"  {row.peer_name} {row.peer:.4g}"
    mark = {True: "  target met", False: "  TARGET MISSED", None: "  target not judged" if row.target else ""}[
        row.met
    ]
    report.say(f"{row.name}: {row.ours:.4g} {row.unit}{peer}{ratio}{mark} {row.target}".rstrip())
    if row.note:
        report.say(f"    {row.note}")


def _predict(sizes: dict[str, Any], curves: str | None, report: Report) -> None:
    from analysis.bench.cost_model import WORDS
    from analysis.bench.cost_prediction import amount, interval, predictions
    from analysis.bench.results import STORED, points_of, read_results

    content = read_results(STORED if curves is None else curves)
    found = predictions(points_of(content), **sizes)
    made = content["suites"]["curves"]
    report.say(f"Fitted to {len(points_of(content))} points measured on {made['date']}, load {made['load'][0]:g}.")
    for row in found:
        report.say(f"{WORDS[row['operation']]}: {row['words']}")
        for quantity in ("seconds", "memory"):
            cost = row[quantity]
            report.say(f"    {amount(cost['value'], quantity)} {interval(cost, quantity)}")
    report.finish({"predictions": found, "sizes": sizes, "date": made["date"], "environment": made["environment"]})
