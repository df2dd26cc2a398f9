"""What is done as r and the costs are moved: sliders over a grid worked out before, and all of it in print.

The page holds the decisions of every cell and works out none. It fetches nothing. Where scripts are not run, the
decisions at the first setting stay as a sentence, and `whole_grid` shows every cell at once.
"""

from __future__ import annotations

import base64
import hashlib
import html
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import to_hex
from matplotlib.patches import Patch, PathPatch
from matplotlib.path import Path as Outline
from numpy.typing import NDArray

from analysis.figures.axis_names import with_unit
from analysis.figures.notebook import TRUTH
from analysis.figures.style import FAINT, SEQUENTIAL, axes, spoken, styled
from analysis.report.section import Origin
from models.errors import Phrase, located
from models.sensitivity.reward_grid import LEANING, UNDECIDED, GridDecisions, RewardGrid, chosen, reward_at, verdict

TEMPLATE = Path(__file__).with_suffix(".html")

TOSS = 128
"""Added to the percentage of a cell that is a toss, or undecided."""

SHADES = 11
"""Colours from nobody acts to all draws act."""

GAP = 0.8
"""Between the blocks of the whole grid, in cells."""


def slider_html(layers: Mapping[str, GridDecisions], *, start: tuple[float, float, float] | None = None) -> str:
    """Make the sliders: one element of HTML that can stand in any page, any number of times.

    Parameters
    ----------
    layers : mapping of str to GridDecisions
        What can be chosen between, by name: readings, or one model and the draws of a fit. All of one grid.
    start : tuple of float, optional
        `r` and the two costs that are shown at first, or the values of the grid nearest to them; by default those
        of the reward that the grid varies.

    Raises
    ------
    InputError
        On no layers, on layers of different grids or steps, or on a grid that varies other than two costs.
    """
    first = _alike(layers)
    grid, nodes = first.grid, first.answers.nodes
    acts = {axis.mode: axis.name for axis in grid.axes}
    steps = [k for k in range(nodes.n_steps) if nodes.modes[k] in acts]
    values = [sorted(grid.r), *(sorted(c) for c in grid.costs)]
    shown = [int(np.abs(np.array(own) - v).argmin()) for own, v in zip(values, start or _own(grid), strict=True)]
    codes = {name: np.stack([_codes(found, k) for k in steps], axis=-1) for name, found in layers.items()}
    data: dict[str, Any] = {
        "r": values[0], "costs": values[1:], "actions": [spoken(axis.name) for axis in grid.axes],
        "steps": [
            {"title": f"Step {k}, {spoken(nodes.protocol.modes[nodes.modes[k]].name)}",
             "acts": spoken(acts[nodes.modes[k]]), "null": spoken(nodes.action_names(k)[nodes.null_choice(k)])}
            for k in steps
        ],
        "layers": [
            {"name": name, "draws": layers[name].n_draws, "cells": base64.b64encode(own.tobytes()).decode()}
            for name, own in codes.items()
        ],
        "shades": [to_hex(SEQUENTIAL(i / (SHADES - 1))) for i in range(SHADES)], "toss": TOSS,
    }  # fmt: skip
    at = next(iter(codes.values()))[tuple(shown)].tolist()
    said = [_said(step, code, first.n_draws) for step, code in zip(data["steps"], at, strict=True)]
    setting = [f"{v[i]:g}" for v, i in zip(values, shown, strict=True)]
    costs = [f"cost of {a} {c}" for a, c in zip(data["actions"], setting[1:], strict=True)]
    text = json.dumps(data, separators=(",", ":")).replace("</", "<\\/")
    words = {
        "@ID@": "reward-" + hashlib.sha256(text.encode()).hexdigest()[:12],
        "@SAID@": html.escape(" ".join(said)),
        "@AT@": html.escape(", ".join([f"At r {setting[0]}", *costs])),
        "@AGREE@": f"{LEANING:.0%}",
        **{f"@LAST{i}@": str(len(own) - 1) for i, own in enumerate(values)},
        **{f"@SHOWN{i}@": str(own) for i, own in enumerate(shown)},
        **{f"@ACTION{i}@": html.escape(own) for i, own in enumerate(data["actions"])},
        "@DATA@": text,
    }  # fmt: skip
    out = TEMPLATE.read_text(encoding="utf-8")
    for mark, content in words.items():
        out = out.replace(mark, content)
    return out.rstrip("\n")


def show_slider(layers: Mapping[str, GridDecisions], kind: str, caption: str) -> None:
    """Display the sliders in a notebook, with the caption below and whose data they show.

    Parameters
    ----------
    layers : mapping of str to GridDecisions
    kind : str
        As `analysis.figures.notebook.show` takes it.
    caption : str
        Markdown.
    """
    from IPython.display import HTML, Markdown, display

    shown: Any = display
    label = TRUTH[0] if kind == "truth" else Origin.of_kind(kind).label
    shown(HTML(slider_html(layers)))
    shown(Markdown(f"*{label.capitalize()}.* {caption}"))


def _alike(layers: Mapping[str, GridDecisions]) -> GridDecisions:
    """The first layer, once all are of one grid of two costs."""
    if not layers:
        raise located("sliders, layers", 0, "at least one")
    first = next(iter(layers.values()))
    grid, nodes = first.grid, first.answers.nodes
    if len(grid.axes) != 2:
        raise located("sliders, costs that are varied", len(grid.axes), "two")
    for name, found in layers.items():
        if (found.grid.protocol, found.grid.cells) != (grid.protocol, grid.cells):
            raise located(
                f"sliders, layer {name}", Phrase("another grid"), "the same values of r and costs as the first"
            )
        if found.answers.nodes.modes != nodes.modes:
            raise located(f"sliders, layer {name}, steps", found.answers.nodes.modes, str(nodes.modes))
    return first


@styled
def whole_grid(layers: Mapping[str, GridDecisions], *, ax: Axes | None = None) -> Axes:
    """Every cell of every layer at once, as the sliders show it: `r` across, layers and steps down.

    Parameters
    ----------
    layers : mapping of str to GridDecisions
        As `slider_html` takes them.
    ax : Axes, optional

    Raises
    ------
    InputError
        As `slider_html` does.
    """
    first = _alike(layers)
    grid, modes = first.grid, first.answers.nodes.modes
    acts = {axis.mode: spoken(axis.name) for axis in grid.axes}
    steps = [k for k in range(len(modes)) if modes[k] in acts]
    r, across, up = sorted(grid.r), *(sorted(own) for own in grid.costs)
    wide, high, heading = len(across) + GAP, len(up) + GAP, 1.4
    if ax is None:
        ax = axes(1.6 + 0.18 * wide * len(r), 1.0 + 0.17 * len(layers) * (high * len(steps) + heading))
    boxes: dict[tuple[int, bool], list[tuple[float, ...]]] = {}
    y, rows, ticks = 0.0, list[float](), dict[float, float]()
    for name, found in layers.items():
        ax.text(-0.5, y - 0.6, name, fontsize=8.5, fontweight="bold", va="center")
        y -= heading
        for k in steps:
            y -= high - GAP
            rows.append(y)
            for box in _runs(_codes(found, k)):
                boxes.setdefault(box[:2], []).append((box[2] * wide + box[3], y + box[4], box[5]))
            ticks |= {y + j + 0.5: cost for j, cost in enumerate(up)}
            text = f"step {k}: {acts[modes[k]]}"
            ax.text(wide * len(r) - GAP + 0.4, y + len(up) / 2, text, va="center", fontsize=8)
            y -= GAP
    for (shade, toss), own in boxes.items():
        path = Outline.make_compound_path(
            *(Outline([(x, v), (x + w, v), (x + w, v + 1), (x, v + 1), (x, v)], closed=True) for x, v, w in own)
        )
        colour = SEQUENTIAL(shade / (SHADES - 1))
        ax.add_patch(PathPatch(path, facecolor=colour, linewidth=0, hatch="xxxx" if toss else None))
    lines = [
        line for x in (i * wide for i in range(len(r))) for v in rows
        for line in (
            *([(x + j, v), (x + j, v + len(up))] for j in range(len(across) + 1)),
            *([(x, v + j), (x + len(across), v + j)] for j in range(len(up) + 1)),
        )
    ]  # fmt: skip
    grid_lines = Outline.make_compound_path(*(Outline(line) for line in lines))
    ax.add_patch(PathPatch(grid_lines, facecolor="none", edgecolor=FAINT, linewidth=0.3))
    for i, value in enumerate(r):
        ax.text(i * wide, 0.3, f"r = {value:g}", fontsize=8, va="bottom")
    places = [i * wide + j + 0.5 for i in range(len(r)) for j in range(len(across))]
    ax.set_xticks(places, [f"{v:g}" for v in across] * len(r), fontsize=6.5)
    ax.set_yticks(list(ticks), [f"{v:g}" for v in ticks.values()], fontsize=6.5)
    ax.set_xlim(-0.5, wide * len(r) + 6)
    ax.set_ylim(y, 1.6)
    ax.tick_params(length=0, pad=1)
    for spine in ax.spines.values():
        spine.set_visible(False)
    ax.set_xlabel(with_unit(f"cost of {spoken(grid.axes[0].name)}", grid.base.unit))
    ax.set_ylabel(with_unit(f"cost of {spoken(grid.axes[1].name)}", grid.base.unit))
    several = any(found.n_draws > 1 for found in layers.values())
    words = (
        ["no draw acts", "all draws act", f"fewer than {LEANING:.0%} agree"]
        if several
        else ["does nothing", "acts", "undecided"]
    )
    looks: list[dict[str, Any]] = [
        {"facecolor": SEQUENTIAL(0.0)},
        {"facecolor": SEQUENTIAL(1.0)},
        {"facecolor": "white", "hatch": "xxxx"},
    ]
    shown = looks if any(toss for _, toss in boxes) else looks[:2]
    handles = [Patch(edgecolor=FAINT, label=text, **look) for text, look in zip(words, shown, strict=False)]
    ax.legend(handles=handles, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=3, borderaxespad=0.2)
    return ax


def _runs(codes: NDArray[np.uint8]) -> list[tuple[int, bool, int, int, int, int]]:
    """Neighbours alike: shade, toss, number of `r`, first cell across, cell up, cells across."""
    out = []
    for i, j in np.ndindex(codes.shape[0], codes.shape[2]):
        row = codes[i, :, j]
        starts = [0, *(np.flatnonzero(np.diff(row.astype(int))) + 1).tolist()]
        for start, end in zip(starts, [*starts[1:], len(row)], strict=True):
            code = int(row[start])
            shade = round(code % TOSS / 100 * (SHADES - 1))
            out.append((shade, code >= TOSS, i, start, j, end - start))
    return out


def _own(grid: RewardGrid) -> list[float]:
    """Steepness and costs of the reward that the grid varies."""
    table = reward_at(grid.base).costs
    own = [table.get(axis.actions[0], grid.protocol.costs[axis.actions[0]]) for axis in grid.axes]
    return [grid.base.r, *own]


def _codes(found: GridDecisions, k: int) -> NDArray[np.uint8]:
    """Percentage of the draws that act at a step, `TOSS` added where it is one; by rising `r` and costs."""
    names = (*found.answers.nodes.action_names(k), UNDECIDED)
    percent = np.rint(100 * (found.acting(k) @ found.weight)).astype(np.uint8)
    toss = [
        verdict(*chosen(dict(zip(names, row, strict=True))), found.n_draws) in ("coin toss", UNDECIDED)
        for row in found.shares(k).tolist()
    ]
    table = (percent + TOSS * np.array(toss, dtype=np.uint8)).astype(np.uint8).reshape(found.grid.shape)
    return table[np.ix_(*(np.argsort(own) for own in (found.grid.r, *found.grid.costs)))]


def _said(step: Mapping[str, str], code: int, draws: int) -> str:
    """What is done at a step, in words; the page says the same."""
    share, toss = code % TOSS, code >= TOSS
    if draws == 1:
        done = "undecided" if toss else step["acts"] if share > 50 else step["null"]
    else:
        done = f"{step['acts']} in {share}% of {draws} draws" + (", a toss" if toss else "")
    return f"{step['title']}: {done}."
