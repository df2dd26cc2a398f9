r"""What a plan does at a belief: a triangle of beliefs to move about in, and Bayes' rule a button away.

A plan given by alpha vectors looks one step ahead. What it takes an action to be worth is the largest of finitely
many linear functions of the belief, so that each action is best in a union of convex polygons, found here exactly.
The page holds those functions and the joint tables of responses and moves; it multiplies, adds and takes the
largest. It fetches nothing. Where scripts are not run, the triangle at the start stays, with what is said of it.
"""

from __future__ import annotations

import hashlib
import html
import json
from collections.abc import Mapping
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linprog

from analysis.figures.notebook import TRUTH
from analysis.figures.style import short_state, spoken
from analysis.report.section import Origin
from models.errors import located
from models.planning.alpha_policy import AlphaPolicy
from models.planning.policies import Array, Index
from models.protocol import NO_RESPONSE

TEMPLATE = Path(__file__).with_suffix(".html")

CORNERS = np.array([[30.0, 292.0], [330.0, 292.0], [180.0, 292.0 - 150.0 * 3**0.5]])
"""Where the three states of the triangle stand on the picture: left, right, above."""

FILLS = ("#f3f4f6", "#9cc6e4", "#f3c98b", "#a9dcc5", "#dcb0d6")
"""Of the actions of a mode, the first doing nothing; all others are hatched as well, each in its own direction."""

MOST = 4_000
"""Sums of vectors that are compared for one action."""

ROUNDING = 1e-9
"""Share of the largest value below which a difference is none."""


ROOM = 0.04
"""Share of the triangle from which on a polygon has room for the action's name."""


class Pieces(NamedTuple):
    """Linear functions whose largest is what an action is worth: ``alpha[k, y]`` and the choice of each ``[k]``."""

    alpha: Array
    choice: Index


class Region(NamedTuple):
    """A convex polygon ``[corner, 3]``, by shares of the triangle's three states, and the choice made there."""

    choice: int
    corners: Array


def pieces(policy: AlphaPolicy, mode: int) -> Pieces:
    r"""Vectors of the one-step look-ahead: :math:`Q(b, a) = \max_k \beta_k \cdot b` over those of choice `a`.

    Each is :math:`\beta(y) = R(y, a) + \gamma \sum_z \sum_{y'} J_z(y, y')\, \alpha_z(y')` for one choice of vectors
    :math:`\alpha_z` after every outcome `z`. Those that are largest nowhere are left out.

    Parameters
    ----------
    policy : AlphaPolicy
    mode : int

    Raises
    ------
    InputError
        If an action has more than `MOST` sums of useful vectors.
    """
    model = policy.model
    found, choices = [], []
    for c, outcomes in enumerate(model.outcomes[mode]):
        after = []
        for z in outcomes:
            own = policy.alpha[policy.mode == z.mode, : len(model.states[z.mode])]
            joint = np.zeros((len(model.states[mode]), own.shape[1]))
            np.add.at(joint, (z.row, z.column), z.value)
            after.append(largest_somewhere(own @ joint.T))
        size = int(np.prod([len(own) for own in after]))
        if size > MOST:
            action = model.vocabulary.actions[mode][c]
            raise located(f"belief explorer, action {action}, sums of vectors", size, f"at most {MOST}")
        sums = np.array([np.sum(each, axis=0) for each in product(*after)])
        kept = largest_somewhere(model.rewards[mode][c] + model.discount * sums)
        found.append(kept)
        choices += [c] * len(kept)
    return Pieces(np.concatenate(found), np.array(choices, dtype=np.int64))


def largest_somewhere(vectors: Array) -> Array:
    """Rows of ``[k, y]`` that exceed all others at some belief by more than rounding; of equal rows one is kept."""
    kept = np.unique(vectors, axis=0)
    tolerance = ROUNDING * max(1.0, float(np.abs(vectors).max()))
    i = 0
    while len(kept) > 1 and i < len(kept):
        others = np.delete(kept, i, axis=0)
        n = kept.shape[1]
        # Over beliefs b and a margin d: the largest d with (row - other) b >= d for every other row.
        answer = linprog(
            np.r_[np.zeros(n), -1.0], np.column_stack([others - kept[i], np.ones(len(others))]),
            np.zeros(len(others)), np.r_[np.ones(n), 0.0][None], [1.0], [(0, 1)] * n + [(None, None)],
        )  # fmt: skip
        if -answer.fun <= tolerance:
            kept = others
        else:
            i += 1
    return kept


def regions(found: Pieces, held: int | None = None, share: float = 0.0) -> list[Region]:
    """Split a triangle of beliefs by what is best there, exactly.

    Parameters
    ----------
    found : Pieces
        Of three states; of four where one is `held`.
    held : int, optional
        State whose probability is the same all over the triangle.
    share : float
        That probability, below 1.

    Returns
    -------
    list of Region
        One polygon a vector that is largest in a part of the triangle that has an area.
    """
    shown = [y for y in range(found.alpha.shape[1]) if y != held]
    linear = (1 - share) * found.alpha[:, shown]
    if held is not None:
        linear = linear + share * found.alpha[:, [held]]
    tolerance = ROUNDING * max(1.0, float(np.abs(linear).max()))
    out = []
    for k, own in enumerate(linear):
        corners = np.eye(3)
        for other_k, other in enumerate(linear):
            margin = own - other
            if np.abs(margin).max() <= tolerance:  # the same all over the triangle: it belongs to the first
                corners = corners if k <= other_k else corners[:0]
            else:
                corners = _cut(corners, margin)
        if area(corners) > ROUNDING:
            out.append(Region(int(found.choice[k]), corners))
    return out


def _cut(corners: Array, margin: Array) -> Array:
    """The part of a convex polygon on which a linear function is not negative."""
    out = []
    for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        at_a, at_b = float(a @ margin), float(b @ margin)
        if at_a >= 0:
            out.append(a)
        if (at_a < 0) != (at_b < 0):
            out.append(a + (b - a) * at_a / (at_a - at_b))
    return np.array(out).reshape(-1, 3)


def area(corners: Array) -> float:
    """Area of a polygon as a share of the triangle's."""
    x, y = corners[:, 0], corners[:, 1]
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def explorer_html(
    plans: AlphaPolicy | Mapping[str, AlphaPolicy],
    *,
    belief: ArrayLike | None = None,
    mode: int | str | None = None,
    held: int = 0,
    unit: str = "reward units",
) -> str:
    """Make the explorer: one element of HTML that can stand in any page, any number of times.

    Parameters
    ----------
    plans : AlphaPolicy, or mapping of str to AlphaPolicy
        One plan, or several to choose between, by name; all about the same modes, actions and states.
    belief : float64[y], optional
        Where to start; the initial belief of the first plan's model by default.
    mode : int or str, optional
        Mode to start in; one that the problem starts in by default.
    held : int
        With four states, the one whose probability the first triangle leaves as it is.
    unit : str
        Of the values.

    Raises
    ------
    InputError
        On no plans, plans that are not alike, other than three or four states in every mode, a belief that is none,
        or what `pieces` refuses.
    """
    layers = {"plan": plans} if isinstance(plans, AlphaPolicy) else dict(plans)
    first = _alike(layers)
    words, model, n = first.vocabulary, first.model, len(first.model.states[0])
    start = model.starts[0] if mode is None else words.mode(mode)
    at = model.check_belief(start, model.initial[start] if belief is None else belief)
    if n == 4 and held not in range(n):
        raise located("belief explorer, state held", held, f"0 to {n - 1}")
    split = {name: [pieces(plan, m) for m in range(len(words.modes))] for name, plan in layers.items()}
    data: dict[str, Any] = {
        "states": [spoken(short_state(s, i)) for i, s in enumerate(model.states[0])],
        "modes": [spoken(m) for m in words.modes], "actions": [[spoken(a) for a in own] for own in words.actions],
        "start": {"belief": at.tolist(), "mode": start, "held": held if n == 4 else None},
        "corners": CORNERS.round(3).tolist(), "fills": FILLS, "unit": unit, "rounding": ROUNDING, "room": ROOM,
        "layers": [_layer(name, plan, split[name]) for name, plan in layers.items()],
    }  # fmt: skip
    text = json.dumps(data, separators=(",", ":")).replace("</", "<\\/")
    shown = regions(split[next(iter(layers))][start], data["start"]["held"], float(at[held]) if n == 4 else 0.0)
    marks = {
        "@ID@": "belief-" + hashlib.sha256(text.encode()).hexdigest()[:12],
        "@SAID@": html.escape(_said(first, start, at, unit)),
        "@SHARES@": html.escape(shares_in_words(shown, data["actions"][start])),
        "@POSTER@": _poster(shown, data, at),
        "@DATA@": text,
    }
    out = TEMPLATE.read_text(encoding="utf-8")
    for mark, content in marks.items():
        out = out.replace(mark, content)
    return out.rstrip("\n")


def show_explorer(
    plans: AlphaPolicy | Mapping[str, AlphaPolicy], kind: str, caption: str, **options: Any
) -> None:  # fmt: skip
    """Display the explorer in a notebook, with the caption below and whose data it shows.

    Parameters
    ----------
    plans, **options
        As `explorer_html` takes them.
    kind : str
        As `analysis.figures.notebook.show` takes it.
    caption : str
        Markdown.
    """
    from IPython.display import HTML, Markdown, display

    shown: Any = display
    label = TRUTH[0] if kind == "truth" else Origin.of_kind(kind).label
    shown(HTML(explorer_html(plans, **options)))
    shown(Markdown(f"*{label.capitalize()}.* {caption}"))


def shares_in_words(shown: list[Region], actions: list[str]) -> str:
    """How much of the triangle belongs to each action, for those who do not see it."""
    sizes = [sum(area(r.corners) for r in shown if r.choice == c) for c in range(len(actions))]
    parts = [f"{name} on {100 * size:.0f}%" for name, size in zip(actions, sizes, strict=True) if size > 0]
    return "Best in this triangle: " + ", ".join(parts) + " of its area."


def _alike(layers: Mapping[str, AlphaPolicy]) -> AlphaPolicy:
    """The first plan, once all are about the same three or four states."""
    if not layers:
        raise located("belief explorer, plans", 0, "at least one")
    first = next(iter(layers.values()))
    counts = {len(s) for s in first.model.states}
    if len(counts) != 1 or not counts <= {3, 4}:
        raise located("belief explorer, hidden states", sorted(counts), "three or four, in every mode alike")
    for name, plan in layers.items():
        if (plan.vocabulary, plan.model.states) != (first.vocabulary, first.model.states):
            raise located(
                f"belief explorer, plan {name}", plan.vocabulary.modes, "modes, actions, states as the first"
            )
    return first


def _layer(name: str, plan: AlphaPolicy, split: list[Pieces]) -> dict[str, Any]:
    """Numbers of one plan: linear functions and, for every outcome of every choice, the joint table."""
    words, outcomes = plan.vocabulary, []
    for offered in plan.model.outcomes:
        own = []
        for choice in offered:
            told = []
            several = len({z.mode for z in choice}) > 1
            for z in choice:
                joint = np.zeros((len(plan.model.states[0]),) * 2)
                np.add.at(joint, (z.row, z.column), z.value)
                seen = words.observations[z.observation]
                text = "nothing is seen" if seen == NO_RESPONSE else spoken(seen)
                text += f", then {spoken(words.modes[z.mode])}" if several else ""
                told.append({"words": text, "mode": z.mode, "joint": joint.tolist()})
            own.append(told)
        outcomes.append(own)
    vectors = [{"alpha": p.alpha.tolist(), "choice": p.choice.tolist()} for p in split]
    return {"name": name, "vectors": vectors, "outcomes": outcomes}


def _said(plan: AlphaPolicy, mode: int, belief: Array, unit: str) -> str:
    """Belief, action and value in words; the page says the same."""
    values = plan.action_values_many(belief[None], mode)[0]
    best = values.max()
    choice = int(np.flatnonzero(values >= best - ROUNDING * max(1.0, abs(best)))[0])
    shares = ", ".join(
        f"{spoken(short_state(s, i))} {100 * p:.1f}%"
        for i, (s, p) in enumerate(zip(plan.model.states[mode], belief, strict=True))
    )
    action = spoken(plan.vocabulary.actions[mode][choice])
    return (
        f"{spoken(plan.vocabulary.modes[mode]).capitalize()}. Believed: {shares}. Best: {action}, "
        f"worth {values[choice]:.2f} {unit} from here on."
    )


def _poster(shown: list[Region], data: Mapping[str, Any], belief: Array) -> str:
    """The triangle at the start, as the page draws it."""
    held, states, actions = data["start"]["held"], data["states"], data["actions"][data["start"]["mode"]]
    inside = [y for y in range(len(states)) if y != held]
    parts = []
    for region in shown:
        points = " ".join(f"{x:.2f},{y:.2f}" for x, y in region.corners @ CORNERS)
        parts.append(f'<polygon points="{points}" fill="{FILLS[region.choice % len(FILLS)]}" stroke="#fff"/>')
    for choice, name in enumerate(actions):
        own = [region.corners for region in shown if region.choice == choice]
        largest = max(own, key=area, default=None)
        if largest is not None and area(largest) > ROOM:
            x, y = largest.mean(axis=0) @ CORNERS
            parts.append(f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="middle">{html.escape(name)}</text>')
    outline = " ".join(f"{x:.2f},{y:.2f}" for x, y in CORNERS)
    parts.append(f'<polygon points="{outline}" fill="none" stroke="#5b6470"/>')
    places = ((-22, 18, "start"), (22, 18, "end"), (0, -9, "middle"))
    for (x, y), state, (aside, down, anchor) in zip(CORNERS, inside, places, strict=True):
        text = f'<text x="{x + aside:.1f}" y="{y + down:.1f}" text-anchor="{anchor}">'
        parts.append(text + html.escape(states[state]) + "</text>")
    here = belief[inside]
    x, y = (here / here.sum() if here.sum() > 0 else np.full(3, 1 / 3)) @ CORNERS
    parts.append(f'<circle cx="{x:.1f}" cy="{y:.1f}" r="7" fill="#fff" stroke="#D55E00" stroke-width="3"/>')
    return "".join(parts)
