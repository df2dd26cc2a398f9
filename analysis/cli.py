"""The command `prosocial`: one contract for people and programs.

A command is a function in a `cli_*` module; adding one is one line here. Modules of the workbench are imported
inside the functions, so that ``prosocial --help`` does not wait for them.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

from models.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import typer


def build() -> typer.Typer:
    """Make the command line; all imports are in here, so that an early Ctrl-C is met inside `main`."""
    import typer

    from analysis import cli_bayes, cli_bench, cli_calibrate, cli_compare, cli_data, cli_em, cli_report

    app = typer.Typer(
        name="prosocial",
        help="Learn how a robot's help and signals change people's willingness to help, how sure that knowledge "
        "is, and what the robot should do given the doubt.\n\nExample: prosocial data list",
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    app.add_typer(cli_data.data, name="data")
    app.add_typer(cli_data.simulate, name="simulate")
    app.command("em")(cli_em.em_command)
    app.command("bayes")(cli_bayes.bayes_command)
    app.command("calibrate")(cli_calibrate.calibrate_command)
    app.command("compare")(cli_compare.compare_command)
    app.command("report")(cli_report.report_command)
    app.command("bench")(cli_bench.bench_command)
    return app


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; exit status 0 done, 2 unusable input or arguments, 130 interrupted, 1 otherwise.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process by default.
    """
    try:
        build()(args=None if arguments is None else list(arguments), prog_name="prosocial")
    except InputError as error:
        print(f"prosocial: {error}", file=sys.stderr)
        sys.exit(2)
    except KeyboardInterrupt:
        sys.exit(130)


if __name__ == "__main__":
    main()
