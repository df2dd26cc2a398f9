"""The command ``solve``: any planning problem from a file, with a certificate."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Annotated

import typer

from analysis.cli_options import (
    DEFAULT_SEED,
    JsonOption,
    QuietOption,
    Report,
    SeedOption,
    check_output,
    distinct_files,
)
from models.errors import InputError, located

if TYPE_CHECKING:
    from models.planning.solution import Solution, TracePoint

PrecisionOption = Annotated[float, typer.Option(help="Gap wanted between the bounds, relative to their size.")]
AbsoluteOption = Annotated[bool, typer.Option("--absolute", help="The precision is absolute.")]
TimeLimitOption = Annotated[float, typer.Option(metavar="SECONDS", help="Stop after that, with the best so far.")]
PolicyOption = Annotated[
    str | None, typer.Option("--policy", metavar="FILE.json", help="Write the policy that was found.")
]


def solve_command(
    problem: Annotated[
        str,
        typer.Argument(
            metavar="PROBLEM", help="A .pomdp or .pomdpx file (also .gz), or a standard problem by name."
        ),
    ],
    precision: PrecisionOption = 1e-3,
    absolute: AbsoluteOption = False,
    time_limit: TimeLimitOption = 60.0,
    policy: PolicyOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Solve a planning problem without a horizon: a policy, and bounds that prove how good it is.

    Standard problems: tiger, crying_baby, rock_sample_4_4, rock_sample_5_5, rock_sample_5_7, rock_sample_7_8 and
    tag. Ctrl-C ends the search with the best so far. Nothing is random, whatever the seed.

    Example: prosocial solve tiger --precision 1e-4 --policy tiger.json
    """
    from models.planning.formats import SUFFIXES, read_problem
    from models.planning.policy_files import write_policy
    from models.planning.problems import PROBLEMS
    from models.planning.problems import problem as standard
    from models.planning.solver import solve

    report = Report(json, quiet)
    if policy is not None:
        check_output("--policy", policy)
    distinct_files({"PROBLEM": problem, "--policy": policy, "--json": json})
    if problem not in PROBLEMS and not problem.endswith(SUFFIXES):
        wanted = f"a file that ends in {', '.join(SUFFIXES)}, or one of {', '.join(sorted(PROBLEMS))}"
        if problem.endswith(".json"):
            wanted += "; a model file is for the command plan"
        raise located("PROBLEM", problem, wanted)
    chosen = standard(problem) if problem in PROBLEMS else read_problem(problem)
    with gap_shown(quiet) as watch:
        solution = solve(chosen, precision, relative=not absolute, time_limit=time_limit, progress=watch)
    if policy is not None:
        try:
            write_policy(solution.policy, policy, solution.cautions)
        except OSError as error:
            raise InputError(f"--policy {policy}: cannot be written: {error.strerror}") from None
    report.say(solution.sentence)
    report.say(
        f"{solution.seconds:.3g} s (and {solution.compile_seconds:.3g} s to load kernels), "
        f"{solution.alpha_vectors} alpha vectors, {solution.beliefs} beliefs; discount {chosen.discount:g}"
    )
    if solution.status != "converged":
        print(f"prosocial: {problem}: {solution.status} before the gap was {precision:g}", file=sys.stderr)
    report.finish({"problem": problem, "discount": chosen.discount, **solution_to_dict(solution), "policy": policy})


def solution_to_dict(solution: Solution) -> dict[str, object]:
    """Bounds, status and trace as the command's JSON gives them."""
    return {
        "lower": solution.lower, "upper": solution.upper, "gap": solution.gap,
        "relative_gap": solution.relative_gap, "status": solution.status, "precision": solution.precision,
        "relative": solution.relative, "seconds": solution.seconds, "compile_seconds": solution.compile_seconds,
        "alpha_vectors": solution.alpha_vectors, "beliefs": solution.beliefs,
        "trace": [vars(point) for point in solution.trace],
    }  # fmt: skip


@contextlib.contextmanager
def gap_shown(quiet: bool = False) -> Iterator[Callable[[TracePoint], None] | None]:
    """Give a callback that keeps one line with the bounds on standard error, or None when nobody watches."""
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.live import Live
    from rich.text import Text

    with Live(Text(""), console=Console(stderr=True), transient=True, refresh_per_second=8) as live:

        def update(point: TracePoint) -> None:
            gap = point.upper - point.lower
            live.update(
                Text(
                    f"{point.seconds:6.1f} s  {point.lower:.6g} to {point.upper:.6g}  gap {gap:.3g}  "
                    f"({point.method}: {point.beliefs} beliefs, {point.vectors} vectors)"
                )
            )

        yield update
