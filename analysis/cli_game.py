"""The command ``replicate game``: what the token game measures beside the paper, and which settings were tried."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Annotated, Any

import typer

from analysis.cli_evidence import OutOption, begin_evidence, finish_evidence
from analysis.cli_options import DEFAULT_SEED, JsonOption, QuietOption, SeedOption

if TYPE_CHECKING:
    import pandas as pd

RESTS_ON = ("models.baum_welch", "models.game.rounds", "models.inference")
"""Modules whose kernels the result rests on."""


def replicate_game_command(
    studies: Annotated[int, typer.Option(min=2, help="Studies 1 played with the default game.")] = 20,
    tried: Annotated[int, typer.Option(min=0, help="Studies 1 with each setting tried; 0 to try none.")] = 10,
    participants: Annotated[int, typer.Option(min=20, help="People of each study 1.")] = 540,
    out: OutOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Tokens by state and costs measured in the token game beside the printed ones, and settings that were tried.

    Also what is learned from a study 1 played in the game, beside the same people simulated directly: about two
    minutes of processor time.

    Example: prosocial replicate game --studies 20 --out game.json
    """
    import pandas as pd

    from analysis import progress
    from analysis.evidence import record
    from analysis.game_calibration import MARGIN, calibrate_game, in_words
    from analysis.game_settings import compare_settings, compared_sentence, narrow, settings_tried
    from analysis.game_study import learn_from_both
    from analysis.study2_evidence import game_settings
    from models.errors import located

    if tried == 1:
        raise located("--tried", tried, "0, or at least 2 studies, for standard errors")
    report = begin_evidence(json, quiet, out)
    with progress.shown(quiet) as watch:

        def step(what: str) -> Any:
            return None if watch is None else lambda done, total: watch(what, done, total)

        found = calibrate_game(studies=studies, participants=participants, seed=seed, progress=step("default game"))
        searched = pd.DataFrame()
        if tried:
            searched = compare_settings(
                settings_tried(),
                studies=tried,
                participants=participants,
                seed=seed,
                progress=step("settings tried"),
            )
        learned = learn_from_both(participants=participants, seed=seed, progress=step("learning from both"))
    words = ["prosocial", "replicate", "game", "--studies", str(studies), "--tried", str(tried)]
    words += ["--participants", str(participants), "--seed", str(seed)]
    told = [found.sentence, *([compared_sentence(searched)] if tried else []), learned.sentence]
    result = {
        **found.to_dict(), "game": game_settings(), "search": _rows(searched), "search_studies": tried,
        "learning": {"table": _rows(learned.table), "rates": _rows(learned.rates), "sentence": learned.sentence},
        "sentence": " ".join(told),
    }  # fmt: skip
    what = "Study 1 in the token game: simulated people of a known truth, beside numbers printed in the paper."
    content = record(what, shlex.join(words), seed, result, RESTS_ON)
    report.say(
        f"Simulated: {studies} studies 1 of {participants} people in the game. Printed: in the paper.\n"
        f"{_shown(in_words(found.table), 2)}"
    )
    if tried:
        report.say(
            f"\nSettings tried, simulated, {tried} studies each (round, step, help, signal in seconds; lapses in "
            f"% of steps; x by state; brackets: beyond lowest and highest printed x by {MARGIN:g} standard errors; "
            f"rms: distance from the printed x):\n{_shown(narrow(searched), 1)}"
        )
    report.say(f"\nHelp rates, true and as learned:\n{_shown(learned.rates, 3)}")
    report.say("\n" + "\n".join(told) + f" Seed {seed}.")
    finish_evidence(report, out, content)


def _rows(table: pd.DataFrame) -> list[dict[str, Any]]:
    """One dict a row; what is not there is None."""
    plain = table.astype(object).where(table.notna(), None)
    return [{str(key): value for key, value in row.items()} for row in plain.to_dict("records")]


def _shown(table: pd.DataFrame, digits: int) -> str:
    return str(table.to_string(index=False, float_format=lambda v: f"{v:.{digits}f}", na_rep="-"))
