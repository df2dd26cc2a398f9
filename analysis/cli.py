"""The command `prosocial`: one contract for people and programs.

A command is a function in a `cli_*` module; adding one is one line here. Modules of the workbench are imported
inside the functions, so that ``prosocial --help`` does not wait for them. This module imports nothing that takes
time, so that even the earliest Ctrl-C is met inside `main`.
"""

from __future__ import annotations

import sys

TYPE_CHECKING = False  # as `typing` has it, without the time that importing it takes
if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any, NoReturn

    import typer

INTERRUPTED = 130
"""Exit status after Ctrl-C."""

_built: list[Any] = []


def command_line() -> Any:
    """The command line, made when first asked for: reading the options of all commands costs .06 s of CPU."""
    if not _built:
        import typer

        _built.append(typer.main.get_command(_declared()))
    return _built[0]


def _declared() -> typer.Typer:
    # Once a process: groups keep what is added to them.
    import typer

    from analysis import (
        cli_anova,
        cli_audit,
        cli_bayes,
        cli_bench,
        cli_calibrate,
        cli_compare,
        cli_coverage,
        cli_data,
        cli_em,
        cli_fits,
        cli_game,
        cli_glmm,
        cli_plan,
        cli_play,
        cli_power,
        cli_recover,
        cli_replicate,
        cli_report,
        cli_robust,
        cli_safeguard,
        cli_sensitivity,
        cli_session,
        cli_solve,
        cli_solve_draws,
        cli_study2,
    )

    # typer looks annotations up in this module, which must not import it.
    _next.__annotations__["context"] = typer.Context
    app = typer.Typer(
        name="prosocial",
        help="Learn how a robot's help and signals change people's willingness to help, how sure that knowledge "
        "is, and what the robot should do given the doubt.\n\nExample: prosocial data list",
        invoke_without_command=True,
        callback=_next,
        pretty_exceptions_enable=False,
        rich_markup_mode=None,
    )
    app.add_typer(cli_data.data, name="data")
    app.add_typer(cli_data.simulate, name="simulate")
    app.command("em")(cli_em.em_command)
    app.command("bayes")(cli_bayes.bayes_command)
    app.command("calibrate")(cli_calibrate.calibrate_command)
    app.command("recover")(cli_recover.recover_command)
    app.command("coverage")(cli_coverage.coverage_command)
    app.add_typer(cli_fits.fits, name="fits")
    app.command("compare")(cli_compare.compare_command)
    app.command("glmm")(cli_glmm.glmm_command)
    app.command("anova")(cli_anova.anova_command)
    app.command("plan")(cli_plan.plan_command)
    app.command("solve")(cli_solve.solve_command)
    app.command("robust")(cli_robust.robust_command)
    app.command("solve-draws")(cli_solve_draws.solve_draws_command)
    app.command("sensitivity")(cli_sensitivity.sensitivity_command)
    app.command("safeguard")(cli_safeguard.safeguard_command)
    app.command("session")(cli_session.session_command)
    app.add_typer(cli_audit.audit, name="audit")
    app.command("study2")(cli_study2.study2_command)
    cli_data.simulate.command("study2")(cli_study2.simulate_study2_command)
    app.command("play")(cli_play.play_command)
    app.add_typer(cli_power.power, name="power")
    cli_replicate.replicate.command("game")(cli_game.replicate_game_command)
    cli_replicate.replicate.command("study2")(cli_study2.replicate_study2_command)
    app.add_typer(cli_replicate.replicate, name="replicate")
    app.command("report")(cli_report.report_command)
    app.command("bench")(cli_bench.bench_command)
    return app


def _next(context) -> None:  # type: ignore[no-untyped-def]
    if context.invoked_subcommand is None:
        from analysis.next_steps import next_steps

        print(next_steps())


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line; exit status 0 done, 2 unusable input or arguments, 130 interrupted, 1 otherwise.

    Parameters
    ----------
    arguments : sequence of str, optional
        Those of the process by default.
    """
    try:
        from models.errors import InputError

        try:
            command_line()(args=None if arguments is None else list(arguments), prog_name="prosocial")
        except InputError as error:
            print(f"prosocial: {error}", file=sys.stderr)
            sys.exit(2)
    except KeyboardInterrupt as interrupt:
        _interrupted(interrupt, arguments is None)
    except SystemExit as stop:
        if stop.code != INTERRUPTED:
            raise
        # typer turns an interruption within a command into this exit, and keeps it as the cause.
        _interrupted(getattr(stop.__context__, "__cause__", None), arguments is None)


def _interrupted(interrupt: BaseException | None, leaving: bool) -> NoReturn:
    """Say it in one line and exit; what a command gave its `KeyboardInterrupt` to say is said."""
    told = "".join(f"; {word}" for word in getattr(interrupt, "args", ()))
    print(f"prosocial: interrupted{told}", file=sys.stderr)
    if leaving:
        # Threads may need a moment to notice. A second Ctrl-C in that time ends the process, without a traceback.
        import signal

        signal.signal(signal.SIGINT, signal.SIG_DFL)
    sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
