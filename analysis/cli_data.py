"""Commands about data: ``data list``, ``data card``, ``data check``, ``data import``, ``simulate study1``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from analysis.cli_options import (
    DEFAULT_SEED,
    JsonOption,
    ProtocolOption,
    QuietOption,
    Report,
    SeedOption,
    check_output,
    distinct_files,
    load_protocol,
    write_output,
)
from analysis.cli_stream_options import StreamOption, in_parts, memory_allowed, reading_sentence
from analysis.wording import counted
from models.errors import InputError

if TYPE_CHECKING:
    from models.compressed_log import CompressedLog
    from models.events import EventLog

data = typer.Typer(
    help="Data sets and event files.\n\nExample: prosocial data check events.csv",
    no_args_is_help=True,
    rich_markup_mode=None,
)
simulate = typer.Typer(
    help="Simulated studies.\n\nExample: prosocial simulate study1 --out study1.csv.gz",
    no_args_is_help=True,
    rich_markup_mode=None,
)

AllOption = Annotated[
    bool, typer.Option("--all", help="Of a file that breaks rules: every line by itself, not lines by cause.")
]
_ENDINGS = "ends in .csv, .csv.gz or .parquet"


@data.command("list")
def list_command(json: JsonOption = None, quiet: QuietOption = False, seed: SeedOption = DEFAULT_SEED) -> None:
    """List the registered data sets.

    Example: prosocial data list --json -
    """
    from analysis import datasets

    report = Report(json, quiet)
    cards = [datasets.card(name) for name in datasets.names()]
    for card in cards:
        report.say(f"{card.name}: {card.title}\n  {_sizes(card.rows, card.participants, card.sequences)}")
    entries: list[dict[str, Any]] = [
        {"name": c.name, "title": c.title, "kind": c.kind, "licence": c.licence,
         "rows": c.rows, "participants": c.participants, "sequences": c.sequences, "problems": []}
        for c in cards
    ]  # fmt: skip
    totals = {key: sum(entry[key] or 0 for entry in entries) for key in ("rows", "participants", "sequences")}
    report.finish({"datasets": entries, **totals, "problems": []})


@data.command("card")
def card_command(
    name: Annotated[str, typer.Argument(metavar="NAME", help="A registered data set.")],
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Show what a data set is, and what it is not.

    Example: prosocial data card frd2012
    """
    from dataclasses import asdict

    from analysis import datasets

    report = Report(json, quiet)
    card = datasets.card(name)
    report.say(card.text())
    report.finish({**asdict(card), "problems": []})


@data.command("check")
def check_command(
    file: Annotated[str, typer.Argument(metavar="DATA", help="An event file, or a registered data set.")],
    every: AllOption = False,
    json: JsonOption = None,
    quiet: QuietOption = False,
    protocol: ProtocolOption = None,
    seed: SeedOption = DEFAULT_SEED,
    stream: StreamOption = None,
) -> None:
    """Check an event file against every rule; exit status 2 if it breaks one.

    Lines that break a rule in the same way are told together, the first of them by number. A large file is read in
    parts, in bounded memory; what is found is the same.

    Example: prosocial data check events.csv.gz --json report.json
    """
    from analysis import datasets, progress
    from analysis.problem_causes import told
    from models.events import EventLogError

    report = Report(json, quiet)
    distinct_files({"DATA": file, "--protocol": protocol, "--json": json})
    rules = load_protocol(protocol)
    parts = in_parts(file, stream)
    try:
        log: EventLog | CompressedLog
        if parts:
            from analysis.event_stream import compress_events

            with progress.shown(quiet) as watch:
                found = compress_events(file, rules, memory=memory_allowed(), progress=watch)
            log, notes, digest = found.log, found.notes, found.log.digest
            report.say(reading_sentence(file, found.resorted, stream))
        else:
            loaded = datasets.load(file, rules)
            log, notes, digest = loaded.log, loaded.notes, loaded.digest
    except InputError as error:
        report.finish(_refused(file, error))
        if isinstance(error, EventLogError):
            raise InputError(told(error.place, error.problems, error.total, every=every)) from None
        raise
    for note in notes:
        report.say(f"note: {note}")
    report.say(f"{file}: {_sizes(*_counts(log).values())}; no problems")
    report.finish(
        {"file": file, **_counts(log), "problems": [], "total_problems": 0, "notes": notes,
         "conditions": log.conditions, "missing_responses": log.n_missing, "digest": digest, "in_parts": parts}
    )  # fmt: skip


@data.command("import")
def import_command(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A raw export: one row a round, with a header.")],
    column_map: Annotated[str, typer.Option("--map", metavar="MAP.toml", help="How its columns are to be read.")],
    out: Annotated[str, typer.Option("--out", metavar="FILE", help=f"Event file to write; {_ENDINGS}.")],
    key: Annotated[
        str | None,
        typer.Option("--key", metavar="FILE", help="Also write who is who (personal ids) as CSV."),
    ] = None,
    every: AllOption = False,
    json: JsonOption = None,
    quiet: QuietOption = False,
    protocol: ProtocolOption = None,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Turn a raw export into an event file, with a column map.

    Nothing is written while a line breaks a rule; such lines are told by cause, the first of them by number.

    Example: prosocial data import raw.csv --map data/maps/osf_study1_example.toml --out study1.csv.gz
    """
    from analysis.event_files import write_events
    from analysis.event_import import import_events, key_text
    from analysis.problem_causes import told
    from models.events import EventLogError

    report = Report(json, quiet)
    distinct_files(
        {"FILE": file, "--map": column_map, "--protocol": protocol, "--out": out, "--key": key, "--json": json}
    )
    check_output("--out", out)
    if key is not None:
        check_output("--key", key)
    try:
        imported = import_events(file, column_map, load_protocol(protocol))
    except EventLogError as error:
        report.finish(_refused(file, error))
        raise InputError(told(error.place, error.problems, error.total, every=every)) from None
    write_events(imported.log, out)
    if key is not None:
        write_output("--key", key, key_text(imported.key).encode())
    for note in imported.notes:
        report.say(f"note: {note}")
    report.say(f"{out}: {_sizes(*_counts(imported.log).values())}")
    report.finish(
        {"file": file, "out": out, "key": key, **_counts(imported.log), "problems": [], "notes": imported.notes,
         "conditions": imported.log.conditions, "missing_responses": imported.log.n_missing}
    )  # fmt: skip


@simulate.callback()
def simulate_group() -> None:
    """Simulated studies."""


@simulate.command("study1")
def study1_command(
    out: Annotated[str, typer.Option("--out", metavar="FILE", help=f"Event file to write; {_ENDINGS}.")],
    participants: Annotated[int, typer.Option(min=1, help="Simulated people.")] = 540,
    truth: Annotated[
        str | None,
        typer.Option(metavar="MODEL", help="Model file of the truth; the calibrated one by default."),
    ] = None,
    game: Annotated[
        bool,
        typer.Option(
            "--game", help="Play every round in the token game: adds tokens; a response is what was seen."
        ),
    ] = False,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Simulate the published study 1 with people of a known truth.

    Example: prosocial simulate study1 --out study1.csv.gz --participants 540 --seed 1
    """
    from analysis.event_files import write_events
    from analysis.simulate import simulate_study1
    from models.model_files import read_model

    report = Report(json, quiet)
    distinct_files({"--out": out, "--truth": truth, "--json": json})
    check_output("--out", out)
    people = None if truth is None else read_model(truth)
    where, told = "", ""
    if game:
        from analysis.game_study import play_study1

        played = play_study1(people, participants, seed)
        log, where, told = played.log, " in the token game", f". {played.rounds.sentence}"
    else:
        log = simulate_study1(people, participants, seed)
    write_events(log, out)
    report.say(f"{out}: {_sizes(*_counts(log).values())}; simulated{where}, seed {seed}{told}")
    report.finish(
        {"out": out, "participants": log.n_participants, "events": log.n_events, "seed": seed,
         "truth": truth or "calibrated_truth", "conditions": log.conditions, "game": game,
         "mean_tokens": {name: float(values.mean()) for name, values in sorted(log.tokens.items())}}
    )  # fmt: skip


def _counts(log: EventLog | CompressedLog) -> dict[str, int]:
    return {"rows": log.n_events, "participants": log.n_participants, "sequences": log.n_runs}


def _sizes(rows: Any, participants: Any, sequences: Any) -> str:
    return (
        f"{counted(rows, 'event')}, {counted(participants, 'person', 'people')}, {counted(sequences, 'sequence')}"
    )


def _refused(file: str, error: InputError) -> dict[str, Any]:
    """What ``--json`` says of a file that breaks rules: every line, and the lines by cause."""
    from analysis.problem_causes import causes
    from models.events import EventLogError

    known = error.problems if isinstance(error, EventLogError) else []
    problems = [
        {"line": p.line, "column": p.column or None, "value": p.value, "wanted": p.wanted, "message": str(p)}
        for p in known
    ] or [{"line": None, "column": None, "value": None, "wanted": None, "message": str(error)}]
    return {
        "file": file, "rows": None, "participants": None, "sequences": None, "problems": problems,
        "causes": [cause.to_dict() for cause in causes(known)],
        "total_problems": error.total if isinstance(error, EventLogError) else 1,
    }  # fmt: skip
