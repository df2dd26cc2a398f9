"""Variants of a model that decisions may depend on: discount, scores of the states, belief, and other fits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.evidence import read_evidence
from analysis.wording import counted
from models.errors import located
from models.model_draws import ModelDraws
from models.reward import Reward, default_x
from models.sensitivity.cases import believing
from models.sensitivity.reward_grid import GridDecisions

DISCOUNTS = (0.0, 0.5, 0.7, 0.8, 0.9, 0.95, 0.98, 0.99, 1.0)

MOVED = 2.0
"""Tokens by which the score of each state is moved."""

CURRENCIES = (
    "Values of models with different numbers of states are in different currencies: scores for other numbers than "
    "four are spread evenly and printed nowhere. Actions stand side by side, values never do."
)
"""What has to stand beside every comparison of numbers of states."""


@dataclass(frozen=True)
class Variant:
    """One variant: its name, draws and reward, its discount if it has its own, and the number that was moved."""

    name: str
    draws: ModelDraws
    reward: Reward
    discount: float | None = None
    value: float | None = None


@dataclass(frozen=True)
class Beside:
    """Another model or fit to stand beside the one that is asked about."""

    name: str
    draws: ModelDraws


def discount_variants(draws: ModelDraws, base: Reward) -> list[Variant]:
    """Other discounts; 1 only where there is a horizon."""
    return [Variant(f"discount {g:g}", draws, base, g, g) for g in DISCOUNTS]


def x_variants(draws: ModelDraws, base: Reward, scores: Mapping[str, Sequence[float]]) -> list[Variant]:
    """Other scores of the states: each moved by `MOVED` tokens, evenly spread, and any that are given.

    Raises
    ------
    InputError
        On given scores that are not one a state.
    """
    x = np.asarray(base.x)
    out = [Variant("as given", draws, base)]
    for s in range(len(x)):
        for move in (-MOVED, MOVED):
            moved = x.copy()
            moved[s] += move
            reward = replace(base, x=tuple(moved.tolist()))
            out.append(Variant(f"x_{s} {move:+g}", draws, reward, value=float(moved[s])))
    even = tuple(np.linspace(x[0], x[-1], len(x)).tolist())
    if not np.allclose(even, x):
        out.append(Variant("evenly spread", draws, replace(base, x=even)))
    for name, own in scores.items():
        if len(own) != len(x):
            raise located(f"scores of the states, {name}", len(own), f"{len(x)}, one a state")
        out.append(Variant(name, draws, replace(base, x=tuple(float(v) for v in own))))
    return out


def belief_variants(draws: ModelDraws, base: Reward) -> list[Variant]:
    """Other initial beliefs, the same for all draws: no idea at all, and certainty of each state."""
    n = draws.n_states
    names = draws.model(0).state_names
    out = [Variant("own", draws, base), Variant("uniform", believing(draws, np.full(n, 1 / n)), base)]
    return [*out, *(Variant(f"certain of {names[s]}", believing(draws, np.eye(n)[s]), base) for s in range(n))]


def beside_variant(other: Beside, base: Reward) -> Variant:
    """Another model under the same steepness and costs; evenly spread scores for another number of states."""
    n = other.draws.n_states
    x = base.x if n == len(base.x) else default_x(n)
    costs = {a: c for a, c in base.costs.items() if a in other.draws.protocol.action_names}
    name = other.name if n == len(base.x) else f"{other.name} ({counted(n, 'state')})"
    return Variant(name, other.draws, replace(base, x=x, costs=costs))


def table(variant: Variant, found: GridDecisions) -> list[dict[str, Any]]:
    """One row a step of one variant in one reading."""
    return [
        {
            "variant": variant.name, "value": variant.value, "reading": found.reading, "discount": found.discount,
            "states": variant.draws.n_states, "x": list(variant.reward.x), "k": row["k"], "mode": row["mode"],
            "action": row["action"], "share": row["share"], "shares": row["shares"], "verdict": row["verdict"],
            "agree": row["agree"], "draws": found.n_draws,
        }
        for row in found.rows()
    ]  # fmt: skip


def game_scores(states: int) -> dict[str, tuple[float, ...]]:
    """Scores that the token game gives the states, from stored evidence; none if there is none for that many.

    Parameters
    ----------
    states : int
    """
    stored = read_evidence("game")
    if stored is None:
        return {}
    rows = {row["quantity"]: row["measured"] for row in stored.content["table"]}
    found = [rows.get(f"x_s{s}") for s in range(states)]
    if f"x_s{states}" in rows or any(v is None for v in found):
        return {}
    return {"measured in the token game": tuple(float(v) for v in found if v is not None)}
