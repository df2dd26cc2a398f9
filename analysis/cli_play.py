"""The command ``play``: the token game for people, in a browser."""

from __future__ import annotations

import sys
from pathlib import Path
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
from analysis.wording import counted
from models.errors import InputError, Phrase, located
from models.text_files import LARGEST_SETTINGS, limited_bytes

if TYPE_CHECKING:
    from models.game.layout import Layout
    from models.game.parameters import GameParameters

DEFAULT_LOG = "play.csv"

PREPARING = "preparing the game and the robot's policies; the first time on a machine this may take some minutes"


def play_command(
    policy: Annotated[
        list[str] | None,
        typer.Option(
            "--policy", metavar="FILE|NAME",
            help="What drives the robot: ls-POMDP (the default), exact plan, always, never, myopic, reactive, "
            "random, or a policy file (Bayes-adaptive and cautious plans rest on a posterior: prosocial robust "
            "FIT --policy FILE writes them). Given several times, people are assigned at random in equal groups.",
        ),
    ] = None,
    learned: Annotated[
        str | None,
        typer.Option(metavar="MODEL", help="Model file: what the robot has learned of people."),
    ] = None,
    schedule: Annotated[str, typer.Option(help="Letters of the rounds, H: the human may help.")] = "HRHRHRHRH",
    out: Annotated[
        str, typer.Option(metavar="LOG.csv", help="Event log; gone on with if it is there already.")
    ] = DEFAULT_LOG,
    study: Annotated[str, typer.Option(metavar="NAME", help="The study column of the log.")] = "token_game",
    participant: Annotated[
        int, typer.Option(metavar="ID", min=0, help="Number of the first person; the next ones count on from it.")
    ] = 1,
    consent: Annotated[
        str | None, typer.Option(metavar="TEXTFILE", help="Consent text, paragraphs separated by empty lines.")
    ] = None,
    withdrawal: Annotated[
        str, typer.Option(help="What becomes of the rounds of who withdraws: delete or keep. The page says it.")
    ] = "delete",
    layout: Annotated[
        str | None, typer.Option("--map", metavar="FILE|NAME", help="Map of the game; the packaged one by default.")
    ] = None,
    parameters: Annotated[
        str | None, typer.Option(metavar="FILE.json", help="Game parameters that differ from the defaults.")
    ] = None,
    countdown: Annotated[float, typer.Option(help="Seconds before a round starts.")] = 3.0,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port; 0 for any free one.")] = 8000,
    host: Annotated[str, typer.Option(help="Address to listen on; only this machine by default.")] = "127.0.0.1",
    site: Annotated[
        str | None, typer.Option(metavar="URL", help="Public address, where a web server passes requests on.")
    ] = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:  # fmt: skip
    """Let people play the token game in a browser; every finished round is written to the log at once.

    Ctrl-C ends it. Started again with the same options it goes on where people left. Once somebody has agreed, the
    consent text, the withdrawal rule and what drives the robot of a condition stay as they are.

    Example: prosocial play --policy ls-POMDP --policy never --out study.csv
    """
    from analysis.play.log_lock import LogLock

    report = Report(json, quiet)
    check_output("--out", out)
    read = {"--learned": learned, "--consent": consent, "--map": layout, "--parameters": parameters}
    distinct_files({**read, "--out": out, "--json": json})
    text = "" if consent is None else _text("--consent", consent)
    if consent is not None and not text.strip():
        raise located(f"--consent {consent}", Phrase("nothing"), "a text")
    if site is not None:
        _check_site(site)
    # First of all, since compiling the game and solving the policies may take minutes.
    lock = LogLock(out)
    try:
        report.say(PREPARING)
        sys.stdout.flush()
        from analysis.play.run import address_of, check_installed, is_loopback, reserve, serve, warm_up

        check_installed()
        from analysis.play.robot_mind import policy_by_name, source_of
        from analysis.play.settings import PlaySettings
        from analysis.play.study import Study
        from analysis.simulate import CALIBRATED_TRUTH
        from models.model_files import read_model

        taken = reserve(host, port)
    except BaseException:
        lock.close()
        raise
    try:
        model = read_model(CALIBRATED_TRUTH if learned is None else learned)
        policies, robots = [], {}
        for given in policy or ["ls-POMDP"]:
            chosen, notes = policy_by_name(given, model, schedule)
            policies.append(chosen)
            robots[chosen.name] = source_of(given, model, learned or CALIBRATED_TRUTH.name)
            for note in notes:
                report.say(f"note: {note}")
        settings = PlaySettings(
            tuple(policies), schedule, study=study, seed=seed, first_participant=participant, consent=text,
            withdrawal=withdrawal, layout=_map(layout), parameters=_parameters(parameters), countdown=countdown,
            robots=robots,
        )  # fmt: skip
        warm_up(settings)
        running = Study(settings, out, lock)
    except BaseException:
        taken.close()
        lock.close()
        raise
    address = address_of(taken, host)
    started = running.summary
    if running.log.mended:
        report.say(f"note: {out}: cut off an unfinished last line, {running.log.mended!r}")
    if learned is None:
        report.say(
            "note: the robot's model of people is the bundled calibrated truth, nobody's estimate (--learned)"
        )
    if not is_loopback(taken):
        report.say(
            "note: others on the network can open this page, and what they send is not encrypted (see --site)"
        )

    def ready() -> None:
        report.say(
            f"{study}: {settings.n_rounds} rounds {schedule} of {settings.parameters.seconds:g} s, robot by "
            f"{', '.join(settings.policy_names)}, seed {seed}\n"
            f"log: {out} ({counted(started['rounds'], 'round')} of "
            f"{counted(started['people'], 'person', 'people')} so far)\n"
            f"records of rounds, and who takes part: {running.folder}\n"
            f"play at {site or address} (Ctrl-C ends)"
        )
        sys.stdout.flush()

    serve(running, taken, host, site, ready)
    ended = running.summary
    report.say(
        f"\n{out}: {counted(running.played, 'round')} played; in all "
        f"{counted(ended['rounds'], 'round')} of {counted(ended['people'], 'person', 'people')}, "
        f"{ended['finished']} finished, {ended['withdrawn']} withdrew"
    )
    odd = [f"nobody got trapped in {counted(ended['untrapped'], 'round')}"] if ended["untrapped"] else []
    if ended["too_late"]:
        odd.append(f"in {counted(ended['too_late'], 'round')} there was no time left to help")
    if odd:
        report.say(f"note: {', and '.join(odd)}; the log says what people saw (data/README.md)")
    report.finish(
        {**ended, "played": running.played, "address": address, "site": site, "study": study, "schedule": schedule,
         "policies": settings.policy_names, "learned": learned or "calibrated_truth", "withdrawal": withdrawal,
         "robots": {name: {"name": r.name, "sha256": r.sha256} for name, r in robots.items()},
         "map": settings.layout.name, "parameters": settings.parameters.to_dict(), "seed": seed}
    )  # fmt: skip


def _map(given: str | None) -> Layout:
    from models.game.layout import Layout, packaged, packaged_names

    if given is None:
        return packaged()
    if given in packaged_names():
        return packaged(given)
    if not Path(given).exists():
        raise located("--map", given, f"a file with a map, or one of {', '.join(packaged_names())}")
    return Layout.from_file(given)


def _parameters(path: str | None) -> GameParameters:
    from models.game.parameters import GameParameters
    from models.model_files import read_json

    return GameParameters() if path is None else GameParameters.from_dict(read_json(path), path)


def _text(option: str, path: str) -> str:
    try:
        return limited_bytes(path, LARGEST_SETTINGS).decode()
    except OSError as error:
        raise InputError(f"{option} {path}: cannot be read: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise located(f"{option} {path}, byte {error.start}", Phrase("no UTF-8"), "a text file") from None


def _check_site(site: str) -> None:
    from urllib.parse import urlsplit

    try:
        parts = urlsplit(site)
        bad = parts.scheme not in ("http", "https") or not parts.hostname or parts.path not in ("", "/")
        bad = bad or bool(parts.query or parts.fragment or parts.username)
    except ValueError:
        bad = True
    if bad:
        raise located("--site", site, "an address such as https://study.example.org")
