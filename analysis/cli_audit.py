"""The command ``audit verify``: whether a robot's log is as it was written, and its decisions are its policy's."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from analysis.cli_options import DEFAULT_SEED, JsonOption, QuietOption, Report, SeedOption, distinct_files
from analysis.wording import counted
from models.errors import InputError

audit = typer.Typer(
    help="Logs of robots.\n\nExample: prosocial audit verify person-7.log",
    no_args_is_help=True,
    rich_markup_mode=None,
)

MOST_SHOWN = 20
"""Problems that are written out."""


@audit.callback()
def audit_group() -> None:
    """Logs of robots."""


@audit.command("verify")
def verify_command(
    log: Annotated[str, typer.Argument(metavar="LOG", help="The log of a session.")],
    last_hash: Annotated[
        str | None,
        typer.Option(metavar="HASH", help="The last hash, kept elsewhere: shows whether the end was cut off."),
    ] = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Recompute a log's chain of hashes and make every decision again; exit status 2 if something is wrong.

    An end that was cut off, and a log rewritten with all its hashes, show only beside the last hash.

    Example: prosocial audit verify person-7.log --last-hash "$(cat person-7.hash)"
    """
    from models.cautions import caution_line, uncautioned
    from models.safeguards.replay import verify

    report = Report(json, quiet)
    distinct_files({"LOG": log, "--json": json})
    found = verify(log, last_hash)
    if found.cautions:
        print(f"prosocial: {log}: {caution_line(found.cautions)}", file=sys.stderr)
    # Once is enough.
    said = uncautioned(found.sentence, found.cautions)
    report.finish({"log": log, **found.to_dict()})
    if not found.ok:
        lines = [f"{log}: {said.rstrip('.')}", *(f"  {f}" for f in found.findings[:MOST_SHOWN])]
        hidden = len(found.findings) - MOST_SHOWN
        raise InputError("\n".join([*lines, f"  and {counted(hidden, 'more', 'more')}"] if hidden > 0 else lines))
    report.say(f"{log}: {said}")
    report.say(f"last hash: {found.last_hash}")
