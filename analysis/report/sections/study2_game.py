"""Part of study 2: what the token game measures beside what the paper prints, and the settings that were tried."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import pandas as pd

from analysis.evidence import Evidence
from analysis.figures.game import state_scores_plot
from analysis.game_calibration import MARGIN, in_words
from analysis.game_settings import narrow
from analysis.report.section import Block, Figure, Origin, Table, Text
from analysis.study2_evidence import game_settings
from models.lspomdp import PUBLISHED_STATE_NAMES

SIMULATED = (Origin.SIMULATED,)
BESIDE = (Origin.SIMULATED, Origin.PRINTED)


def other_game(content: Mapping[str, Any]) -> tuple[Block, ...]:
    """Say so where stored numbers were made with another map or other settings than the present ones."""
    if content["game"] == game_settings():
        return ()
    words = "The game's map or settings have changed since: these numbers are of another game."
    return (Text(words, "warning"),)


def game_blocks(found: Evidence) -> tuple[Block, ...]:
    """Scores and costs simulated and printed, settings tried, and what is learned from a study played in the game.

    Parameters
    ----------
    found : Evidence
        Of `prosocial replicate game`.
    """
    content = found.content
    table = pd.DataFrame(content["table"])
    blocks: list[Block] = [
        Text(
            "The paper prints neither map nor length of a round, nor how fast and attentive people are. Here they "
            "are chosen so that the lowest and the highest state bracket the printed scores; the four scores and "
            "both costs are then outcomes of the game, measured as the paper says it did. Policies are planned "
            "with the printed ones."
        ),
        *other_game(content), _measured(table, content), _scores(table),
    ]  # fmt: skip
    if content["search"]:
        blocks.append(_tried(pd.DataFrame(content["search"]), table, content["search_studies"]))
    blocks.append(_learned(content))
    return tuple(blocks)


def _measured(table: pd.DataFrame, content: Mapping[str, Any]) -> Table:
    return Table(
        "study2-game-table", in_words(table),
        f"The game beside the paper. Simulated: mean of {content['studies']} studies 1 of "
        f"{content['participants']} people played in the game, with its standard error (s.e.) and the standard "
        "deviation between studies (s.d.). x: the team's mean tokens a round, weighted by the smoothed state "
        "probabilities. C: the robot's interruption by helping or signalling, in seconds and in tokens by which it "
        "falls short of a round without one; the printed costs have no named unit.",
        BESIDE, printed=("printed",),
        headings={"se": "s.e.", "sd": "s.d.", "difference": "tokens or s", "percent": "%"},
        formats={"simulated": ".1f", "printed": "g", "difference": "+.1f", "percent": "+.0f", "se": ".2f",
                 "sd": ".2f"},
        groups=(("", 3), ("simulated less printed", 2), ("simulated", 2)),
    )  # fmt: skip


def _scores(table: pd.DataFrame) -> Figure:
    rows = table[table["quantity"].str.startswith("x_s")]
    names = PUBLISHED_STATE_NAMES if len(rows) == len(PUBLISHED_STATE_NAMES) else [""] * len(rows)
    told = "; ".join(
        f"state {s}: simulated {r.measured:.1f}, printed {r.printed:g}" for s, r in enumerate(rows.itertuples())
    )
    return Figure(
        "study2-game-scores", (partial(state_scores_plot, table, names),),
        "Team tokens a round by state: simulated in the game, with twice the standard deviation between studies, "
        "and printed (stars).", (f"{told}.",), BESIDE,
    )  # fmt: skip


def _tried(search: pd.DataFrame, table: pd.DataFrame, studies: int) -> Table:
    printed = ", ".join(f"{v:g}" for v in table.loc[table["quantity"].str.startswith("x_s"), "printed"])
    frame = narrow(search)
    scores = [name for name in frame if name.startswith("x")]
    return Table(
        "study2-game-settings", frame,
        f"Settings tried, all simulated: {studies} studies 1 each. Length of a round, time of a person's step, and "
        "in how many of 100 steps attention lapses; then what is measured: x of each state, whether they bracket "
        f"the lowest and highest printed one (printed: {printed}), both by {MARGIN:g} standard errors, their root "
        "mean square distance (RMS) from all of them, and the robot's interruption by helping and by signalling.",
        BESIDE,
        headings={"brackets": "bracket", "rms": "RMS", **{name: name.removeprefix("x") for name in scores}},
        formats={"round": "g", "step": "g", "lapses": "g", **dict.fromkeys(scores, ".1f"), "rms": ".1f",
                 "help": ".1f", "signal": ".1f"},
        groups=(("", 1), ("seconds", 2), ("%", 1), ("x of state", len(scores)), ("", 2), ("C, seconds", 2)),
    )  # fmt: skip


def _learned(content: Mapping[str, Any]) -> Table:
    rates = pd.DataFrame(content["learning"]["rates"])
    return Table(
        "study2-game-learning", rates,
        "Does it matter for learning that it is played? Mean help rate of each condition of study 1, by the truth "
        "and as Baum-Welch learns it from the same people: simulated without a game, seen in the game, and seen in "
        "rounds too short for everybody to come.",
        SIMULATED, formats=dict.fromkeys(rates.columns.drop("condition"), ".3f"),
    )  # fmt: skip
