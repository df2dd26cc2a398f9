"""Settings of the token game that were tried, and what each measures: why the defaults are what they are.

Map, length of a round, people's speed and attention are not printed. Lowest and highest state should bracket the
printed scores, 45 to 67, and of the settings that do, the default should be close to the scores between and near to
what a round is otherwise. `compare_settings` plays them all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import pandas as pd

from analysis.game_calibration import calibrate_game
from analysis.simulate import DEFAULT_SEED
from models.errors import Phrase, located
from models.game.layout import Layout, packaged
from models.game.parameters import TICKS_A_SECOND, GameParameters

MOST_CELLS = 40
"""Largest side of a room and widest corridor of `four_rooms`."""


@dataclass(frozen=True)
class GameSetting:
    """A map and parameters, by name.

    Attributes
    ----------
    name : str
    layout : Layout
    parameters : GameParameters
    """

    name: str
    layout: Layout = field(repr=False)
    parameters: GameParameters


def four_rooms(height: int = 3, width: int = 3, between_rows: int = 1, between_columns: int = 1) -> Layout:
    """Draw a map with four equal rooms like the packaged one.

    A corridor one cell wide goes all around. Blue doors are in the middle of the outer walls, red ones in that of
    the walls between left and right rooms.

    Parameters
    ----------
    height, width : int
        Of the inside of a room, in cells.
    between_rows, between_columns : int
        Width of the corridors between upper and lower, and left and right rooms, in cells.

    Raises
    ------
    InputError
        If a number is not in 1..40.

    Examples
    --------
    >>> four_rooms().lines == packaged().lines
    True
    """
    sizes = {
        "height": height, "width": width, "between_rows": between_rows, "between_columns": between_columns
    }  # fmt: skip
    for name, value in sizes.items():
        if not 1 <= value <= MOST_CELLS:
            raise located(f"map of four rooms, {name}", value, f"a whole number from 1 to {MOST_CELLS}")
    rows, columns = 2 * (height + 2) + between_rows + 4, 2 * (width + 2) + between_columns + 4
    grid = [
        ["#" if r in (0, rows - 1) or c in (0, columns - 1) else "." for c in range(columns)] for r in range(rows)
    ]
    for number in range(4):
        lower, right = divmod(number, 2)
        top, left = 2 + lower * (height + 2 + between_rows), 2 + right * (width + 2 + between_columns)
        for r in range(height + 2):
            for c in range(width + 2):
                wall = r in (0, height + 1) or c in (0, width + 1)
                grid[top + r][left + c] = "#" if wall else str(number + 1)
        grid[top + lower * (height + 1)][left + 1 + width // 2] = "b"
        grid[top + 1 + height // 2][left + (1 - right) * (width + 1)] = "r"
    grid[1][1], grid[-2][-2] = "H", "R"
    name = f"rooms {height}x{width}, corridors {between_rows} and {between_columns}"
    return Layout.from_text("\n".join("".join(row) for row in grid), name)


def settings_tried() -> tuple[GameSetting, ...]:
    """The default; other lengths of a round; people slower or less attentive than the robot; larger maps."""
    default, small = GameParameters(), packaged()
    # Attentive people who walk as fast as the robot: the game before anything is done about its span.
    alert = replace(default, human_lapse=0.01)
    hasty = replace(default, human_notice_ticks=10, human_notice_spread=20)
    changed: list[tuple[str, Layout, GameParameters]] = [("default", small, default)]
    changed += [
        (f"attentive, {length / 10:g} s", small, replace(alert, round_ticks=length))
        for length in (800, 1100, 1400, 1800)
    ]
    changed += [
        (f"lapses in {lapse:.0%} of steps", small, replace(default, round_ticks=length, human_lapse=lapse))
        for lapse, length in ((0.36, 1650), (0.55, 1830), (0.65, 1930))
    ]
    changed += [
        ("notices earlier", small, hasty),
        ("slow steps", small, replace(alert, round_ticks=1790, human_step_ticks=13)),
        (
            "rooms 5x5, lapses",
            four_rooms(5, 5),
            replace(hasty, round_ticks=2290, human_step_ticks=6, human_lapse=0.3),
        ),
        ("corridors of 10", four_rooms(3, 3, 10, 10), replace(alert, round_ticks=2680, human_step_ticks=10)),
        ("corridors of 18", four_rooms(3, 3, 18, 18), replace(alert, round_ticks=3400, human_step_ticks=10)),
        (
            "corridors of 18, longer",
            four_rooms(3, 3, 18, 18),
            replace(alert, round_ticks=3600, human_step_ticks=10),
        ),
        (
            "rooms 9x9, lapses",
            four_rooms(9, 9, 3, 3),
            replace(hasty, round_ticks=3580, human_lapse=0.25),
        ),
        ("rooms 7x7 far apart", four_rooms(7, 7, 9, 9), replace(alert, round_ticks=3920, human_step_ticks=10)),
    ]
    return tuple(GameSetting(*entry) for entry in changed)


def compare_settings(
    settings: Sequence[GameSetting] | None = None,
    *,
    studies: int = 10,
    participants: int = 540,
    seed: int = DEFAULT_SEED,
    progress: Callable[[int, int], None] | None = None,
) -> pd.DataFrame:
    """Calibrate several settings with the same simulated people.

    Parameters
    ----------
    settings : sequence of GameSetting, optional
        `settings_tried` unless given.
    studies, participants, seed : int
        As in `analysis.game_calibration.calibrate_game`.
    progress : callable, optional
        Called with settings done and settings in all.

    Returns
    -------
    DataFrame
        One row a setting, those that bracket the printed scores first, then by distance from them: ``setting, map,
        seconds`` (of a round), ``human_step_ticks, human_lapse``, measured ``x_s0 .. x_s3``, ``brackets, rms,
        largest`` (distances in tokens), ``C_help, C_signal`` in seconds, ``C_help_tokens, C_signal_tokens``,
        ``freed, not_freed`` (tokens of rounds) and ``unseen``.

    Raises
    ------
    InputError
        Without settings, or with fewer than 2 studies.
    """
    chosen = settings_tried() if settings is None else settings
    if not chosen:
        raise located("settings of the game", Phrase("none"), "at least one")
    rows = []
    for done, setting in enumerate(chosen, 1):
        p = setting.parameters
        found = calibrate_game(
            layout=setting.layout, parameters=p, studies=studies, participants=participants, seed=seed
        )
        cost = found.table.set_index(["quantity", "unit"])["measured"]
        rows.append(
            {
                "setting": setting.name, "map": setting.layout.name, "seconds": p.seconds,
                "human_step_ticks": p.human_step_ticks, "human_lapse": p.human_lapse,
                **{f"x_s{s}": float(v) for s, v in enumerate(found.scores)},
                "brackets": found.brackets, "rms": found.rms, "largest": found.tolerance,
                "C_help": float(cost["C_help", "seconds"]), "C_signal": float(cost["C_signal", "seconds"]),
                "C_help_tokens": float(cost["C_help", "tokens"]),
                "C_signal_tokens": float(cost["C_signal", "tokens"]),
                "freed": found.freed, "not_freed": found.not_freed, "unseen": found.unseen,
            }
        )  # fmt: skip
        if progress is not None:
            progress(done, len(chosen))
    table = pd.DataFrame(rows)
    return table.sort_values(["brackets", "rms"], ascending=[False, True], ignore_index=True)


def narrow(table: pd.DataFrame) -> pd.DataFrame:
    """The columns of a table of `compare_settings` that fit a page.

    Returns
    -------
    DataFrame
        ``setting, round`` (s), ``step`` (s, a person's), ``lapses`` (percent of steps), ``x0, x1, ..`` (scores by
        state), ``brackets, rms, help, signal`` (s).
    """
    scores = {name: name.replace("_s", "") for name in table.columns if name.startswith("x_s")}
    names = {"setting": "setting", "seconds": "round", "step": "step", "lapses": "lapses", **scores}
    names |= {"brackets": "brackets", "rms": "rms", "C_help": "help", "C_signal": "signal"}
    own = table.assign(step=table["human_step_ticks"] / TICKS_A_SECOND, lapses=100 * table["human_lapse"])
    return own[list(names)].rename(columns=names)


def compared_sentence(table: pd.DataFrame) -> str:
    """What the settings have in common, and what each gain costs; a table of `compare_settings`."""
    closest = table.loc[table["rms"].idxmin()]
    held = table[table["brackets"]]
    least = f"The closest to the printed scores, {closest['setting']!r}, has a root mean square distance of "
    words = f"{len(held)} of {len(table)} settings bracket the printed scores. {least}{closest['rms']:.1f}"
    if closest["brackets"]:
        words += " and brackets them"
    elif len(held):
        words += f", those that bracket them {held['rms'].min():.1f} to {held['rms'].max():.1f}"
    if len(held):
        short, costly = held.loc[held["seconds"].idxmin()], held.loc[held["C_help"].idxmax()]
        words += (
            f". Of those, helping costs {short['C_help']:.1f} s in the shortest rounds ({short['seconds']:g} s), "
            f"and at the most {costly['C_help']:.1f} s, {costly['setting']!r}, in rounds of {costly['seconds']:g} s"
        )
    return words + "."
