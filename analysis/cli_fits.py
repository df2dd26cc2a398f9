"""The commands about stored fits and results: ``fits list``, ``fits clean``."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from analysis.cli_options import DEFAULT_SEED, JsonOption, QuietOption, Report, SeedOption
from analysis.wording import counted

if TYPE_CHECKING:
    from analysis.fits_inventory import StoreEntry

fits = typer.Typer(
    help="Posteriors and results that were computed before and are found again.\n\nExample: prosocial fits list",
    no_args_is_help=True,
    rich_markup_mode=None,
)


@fits.command("list")
def list_command(json: JsonOption = None, quiet: QuietOption = False, seed: SeedOption = DEFAULT_SEED) -> None:
    """List what is in the store: fits, chains of interrupted runs, results of reports; newest first.

    Drawings of reports are counted only; --json names them.

    Example: prosocial fits list --json -
    """
    from analysis.fits import store_folder
    from analysis.fits_inventory import STATUS, entries

    report = Report(json, quiet)
    found = entries()
    for line in _lines(found):
        report.say(line)
    for status in dict.fromkeys(entry.status for entry in found):
        report.say(f"{status}: {STATUS[status]}")
    report.say(f"{store_folder()}: {counted(len(found), 'entry', 'entries')}, {_size(found)}")
    report.finish(
        {"folder": store_folder(), "bytes": sum(e.bytes for e in found), "fits": [_to_dict(e) for e in found]}
    )


@fits.command("clean")
def clean_command(
    older_than: Annotated[
        float | None, typer.Option("--older-than", min=0, metavar="DAYS", help="What was written longer ago.")
    ] = None,
    everything: Annotated[bool, typer.Option("--all", help="Everything.")] = False,
    dry_run: Annotated[bool, typer.Option("--dry-run", help="Only say what would be removed.")] = False,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Remove stored fits and results: by default those that can never be used again.

    These are fits and results made by other code or other versions, damaged files and half-written ones. Whatever
    is removed is computed anew when it is asked for. Results beyond 1.5 GB go by themselves, longest unused first.

    Example: prosocial fits clean --older-than 30
    """
    from analysis.fits import store_folder
    from analysis.fits_inventory import entries, remove, to_clear
    from models.errors import InputError, located

    report = Report(json, quiet)
    if everything and older_than is not None:
        raise located("--older-than", older_than, "nothing beside --all, which removes everything")
    found = entries()
    chosen = to_clear(found, older_than=older_than, everything=everything)
    for entry in chosen:
        if not dry_run:
            try:
                remove(entry)
            except OSError as error:
                raise InputError(f"{entry.path}: cannot be removed: {error.strerror}") from None
    for line in _lines(chosen):
        report.say(f"{'would remove' if dry_run else 'removed'} {line}")
    kept = len(found) - len(chosen)
    report.say(
        f"{store_folder()}: {counted(len(chosen), 'entry', 'entries')} ({_size(chosen)}) "
        f"{'would be ' if dry_run else ''}removed, {kept} kept"
    )
    report.finish(
        {"folder": store_folder(), "dry_run": dry_run, "removed": [_to_dict(e) for e in chosen], "kept": kept,
         "bytes": sum(e.bytes for e in chosen)}
    )  # fmt: skip


def _lines(found: list[StoreEntry]) -> list[str]:
    """One line an entry; one for all drawings of a status, of which a report has a hundred."""
    lines = [_line(entry) for entry in found if entry.kind != "drawing"]
    drawings = [entry for entry in found if entry.kind == "drawing"]
    for status in dict.fromkeys(entry.status for entry in drawings):
        own = [entry for entry in drawings if entry.status == status]
        lines.append(f"{counted(len(own), 'drawing')} of reports  {_size(own)}  {status}")
    return lines


def _line(entry: StoreEntry) -> str:
    about = entry.about
    words = [entry.key, _date(entry), f"{entry.bytes / 1e6:.1f} MB", entry.status]
    if "what" in about:
        words.append(str(about["what"]))
    if "states" in about:
        words.append(f"{about.get('study', 'unknown study')}, {counted(about['states'], 'state')}")
    if "kappa" in about:
        words.append(f"kappa {about['kappa']:g}")
    if about.get("groups"):
        words.append(f"tables by group of {about['groups']}")
    if about.get("hierarchical"):
        words.append("people differ")
    if about.get("pins"):
        words.append(f"held {', '.join(about['pins'])}")
    if "engine" in about:
        words.append(f"{about['engine']}, {about['chains']} x {about['draws']} draws, seed {about.get('seed')}")
    if "chains_done" in about:
        words.append(f"{about['chains_done']} of {about.get('chains', '?')} chains done")
    if "gate" in about:
        words.append(f"gate {'passed' if about['gate'] else 'FAILED'}")
    return "  ".join(words)


def _date(entry: StoreEntry) -> str:
    import datetime

    return datetime.datetime.fromtimestamp(entry.modified).astimezone().strftime("%Y-%m-%d %H:%M")


def _size(entries: list[StoreEntry]) -> str:
    return f"{sum(e.bytes for e in entries) / 1e6:.1f} MB"


def _to_dict(entry: StoreEntry) -> dict[str, Any]:
    return {
        "key": entry.key, "kind": entry.kind, "status": entry.status, "bytes": entry.bytes,
        "modified": _date(entry), "age_days": entry.age_days, "path": entry.path, **entry.about,
    }  # fmt: skip
