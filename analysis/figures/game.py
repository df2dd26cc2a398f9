"""Pictures of the token game: the paper's moments, the course of one round, tokens by kind of round."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from analysis.figures.axis_names import with_unit
from analysis.figures.several import Panels, panels
from analysis.figures.style import (
    FAINT,
    INK,
    OKABE_ITO,
    PRINTED_COLOUR,
    PRINTED_MARKER,
    RULE,
    axes,
    short_state,
    styled,
)
from analysis.game_scenes import Scene
from models.game.parameters import TICKS_A_SECOND
from models.game.record import RoundRecord, replay
from models.game.render import Painter
from models.game.render_sprites import sprite
from models.game.rounds import RoundOutcomes
from models.game.state import PLAYERS

COLOUR = {"human": OKABE_ITO["vermillion"], "robot": OKABE_ITO["blue"]}
LINE = {"human": "-", "robot": "--"}
HATCH = {"human": "", "robot": "////"}

CELL, DPI = 40, 170
"""Pixels a cell of the frames in figures, and about what they come to an inch."""

LEGEND = (
    ("human", "human"), ("human_token", "its token"), ("red", "lets it pass"),
    ("robot", "robot"), ("robot_token", "its token"), ("blue", "lets it pass"),
    ("cage", "trapped"), ("flash", "room flashes"),
)  # fmt: skip

WITHIN = 0.9
"""Share of rounds within the lines of `tokens_by_kind`."""


@styled
def trap_panels(scenes: Sequence[Scene], *, ax: Any = None) -> Panels:
    """Moments of the game side by side, each with its caption, and what the signs mean.

    Parameters
    ----------
    scenes : sequence of Scene
    ax : array of Axes, shape [scenes + 1], optional
        The last one is for what the signs mean, and should be wide and low.

    Raises
    ------
    InputError
        If what is given as `ax` has another shape.
    """
    n = len(scenes)
    if ax is None:
        # Frames are brought to this resolution here: embedded as they are, browsers would drop pixels of them.
        figure = Figure(figsize=(2.5 * n, 4.1), layout="constrained", dpi=DPI)
        grid = figure.add_gridspec(2, n, height_ratios=(3.4, 0.42))
        ax = [*(figure.add_subplot(grid[0, i]) for i in range(n)), figure.add_subplot(grid[1, :])]
    made, _ = panels("moments of the game", ax, (n + 1,), (0, 0))
    for i, (one, scene) in enumerate(zip(made, scenes, strict=False)):
        painter = Painter(scene.layout, scene.round_ticks, CELL)
        one.imshow(painter.frame(scene.view), aspect="equal")
        one.set_title(f"{'abcdefgh'[i % 8]}  {scene.title}")
        one.set_xlabel(textwrap.fill(scene.caption, 40), fontsize=8.0, labelpad=5)
        _bare(one)
    row = made[-1]
    row.set_xlim(0, len(LEGEND))
    row.set_ylim(-1, 1)
    for i, (name, meaning) in enumerate(LEGEND):
        inset = row.inset_axes((i + 0.02, -0.5, 0.24, 1.0), transform=row.transData)
        inset.imshow(sprite(name, 2 * CELL), aspect="equal")
        _bare(inset)
        row.text(i + 0.29, 0, meaning, va="center", fontsize=7.5)
    row.axis("off")
    return made


@styled
def round_course(played: RoundRecord, title: str = "", ax: Axes | None = None) -> Axes:
    """Tokens of both players over one round; the time somebody is trapped is shaded.

    Parameters
    ----------
    played : RoundRecord
    title : str
    ax : Axes, optional
    """
    ax = axes(3.6, 2.8) if ax is None else ax
    views = list(replay(played))
    seconds = np.arange(len(views)) / TICKS_A_SECOND
    ends = played.outcome["human_tokens"] - played.outcome["robot_tokens"]
    close = abs(ends) < 0.06 * max(played.outcome["human_tokens"], played.outcome["robot_tokens"], 1)
    for player, side in zip(PLAYERS, (1, -1) if ends > 0 else (-1, 1), strict=True):
        counts = np.array([getattr(view, f"{player}_collected") for view in views])
        ax.step(seconds, counts, where="post", color=COLOUR[player], linestyle=LINE[player])
        ax.annotate(
            f"{player} {counts[-1]}", (seconds[-1], counts[-1]), (4, 5 * side * close), textcoords="offset points",
            va="center", fontsize=8.0, color=INK, annotation_clip=False,
        )  # fmt: skip
    begun, over = played.outcome["trapped_tick"], played.outcome["freed_tick"]
    if begun >= 0:
        start, end = begun / TICKS_A_SECOND, (over / TICKS_A_SECOND if over >= 0 else seconds[-1])
        ax.axvspan(start, end, color=RULE, zorder=0, linewidth=0)
        words = f"{played.trapped} trapped" + ("" if over >= 0 else "\nto the end")
        left = start < seconds[-1] / 2
        ax.text(
            start if left else end, 0.98, f" {words} ", transform=ax.get_xaxis_transform(), va="top",
            ha="left" if left else "right", fontsize=7.5, color=FAINT,
        )  # fmt: skip
    ax.set(xlabel=with_unit("time", "s"), ylabel="tokens collected", title=title)
    ax.set_xlim(0, seconds[-1] * 1.22 if len(seconds) > 1 else 1)
    ax.set_ylim(bottom=0)
    # At the most seven labels, at round seconds.
    ax.set_xticks(np.arange(0, seconds[-1] + 1, 20 * max(1, int(np.ceil(seconds[-1] / 120)))))
    return ax


@styled
def tokens_by_kind(
    outcomes: RoundOutcomes, kinds: Mapping[str, NDArray[np.bool_]], *, ax: Axes | None = None
) -> Axes:
    """Mean tokens a round of both players, one bar a kind of round; lines hold most rounds' sums.

    Parameters
    ----------
    outcomes : RoundOutcomes
    kinds : mapping of str to bool[n]
        Which rounds are of each kind; empty ones are left out, and their names say so.
    ax : Axes, optional
    """
    ax = axes(5.6, 0.8 + 0.38 * len(kinds)) if ax is None else ax
    tail = 100 * (1 - WITHIN) / 2
    for at, chosen in enumerate(kinds.values()):
        if not np.any(chosen):
            ax.text(0.3, at, "no such round", va="center", fontsize=8.0, color=FAINT)
            continue
        human, robot = (float(np.mean(v[chosen])) for v in (outcomes.human_tokens, outcomes.robot_tokens))
        ax.barh(at, human, 0.62, color=COLOUR["human"], edgecolor="white", linewidth=0.6)
        ax.barh(
            at,
            robot,
            0.62,
            left=human,
            color=COLOUR["robot"],
            edgecolor="white",
            linewidth=0.6,
            hatch=HATCH["robot"],
        )
        low, high = np.percentile(outcomes.team_tokens[chosen], [tail, 100 - tail])
        ax.plot([low, high], [at, at], color=INK, linewidth=1.1, marker="|", markersize=7)
        ax.annotate(
            f"{human + robot:.1f}", (max(high, human + robot), at), (6, 0), textcoords="offset points", va="center",
            fontsize=8.0,
        )  # fmt: skip
    ax.set_yticks(range(len(kinds)), list(kinds))
    ax.set_ylim(len(kinds) - 0.5, -0.5)
    ax.tick_params(axis="y", length=0)
    ax.set_xlabel("tokens a round")
    ax.margins(x=0.12)
    ax.set_xlim(left=0)
    swatches = [
        Rectangle((0, 0), 1, 1, facecolor=COLOUR[p], edgecolor="white", linewidth=0.6, hatch=HATCH[p], label=p)
        for p in PLAYERS
    ]
    ax.legend(handles=swatches, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=2, borderaxespad=0.1)
    return ax


@styled
def state_scores_plot(table: pd.DataFrame, state_names: Sequence[str], *, ax: Axes | None = None) -> Axes:
    """Tokens a round by state as measured in the game, with the printed scores beside them.

    Parameters
    ----------
    table : DataFrame
        Of `analysis.game_calibration.GameCalibration`: ``quantity, printed, measured, sd``.
    state_names : sequence of str
        Lowest state first.
    ax : Axes, optional
    """
    ax = axes(4.4, 2.9) if ax is None else ax
    rows = table[table["quantity"].str.startswith("x_s")]
    at = np.arange(len(rows))
    ax.errorbar(
        at, rows["measured"], 2 * rows["sd"], color=COLOUR["robot"], marker="o", linestyle="", capsize=3,
        elinewidth=1.2, label="measured in the game",
    )  # fmt: skip
    ax.plot(
        at, rows["printed"], color=PRINTED_COLOUR, marker=PRINTED_MARKER, markersize=9, linestyle="",
        label="printed in the paper",
    )  # fmt: skip
    ax.set_xticks(at, [short_state(name, i) for i, name in enumerate(state_names)])
    ax.set_xlim(-0.5, len(rows) - 0.5)
    ax.set_ylabel("team tokens a round")
    ax.grid(axis="y")
    ax.legend(loc="upper left")
    return ax


def _bare(ax: Axes) -> None:
    """Neither ticks nor frame; labels stay."""
    ax.set_xticks([])
    ax.set_yticks([])
    for spine in ax.spines.values():
        spine.set_visible(False)
