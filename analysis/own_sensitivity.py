"""What decisions depend on where the reward was stated: costs, what states are worth, discount, belief, prior.

The paper's grid moves its steepness r and two costs (`analysis.sensitivity`). A reward of one's own has no
steepness; here everything that somebody had to say is moved instead, one thing at a time, by multiples of itself.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from analysis.sensitivity import READINGS, decider_of, discounts_of
from analysis.sensitivity_variants import Beside, Variant, belief_variants, discount_variants
from analysis.sensitivity_variants import table as variant_table
from models.errors import InputError
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView
from models.reward import Reward
from models.sensitivity.endless_steps import INFINITE
from models.sensitivity.reward_grid import RewardGrid, decide_grid, reward_of

MULTIPLES = (0.0, 0.5, 2.0, 4.0)
"""Of the costs of a mode, and but for zero of what states are worth."""

MOVED = 0.25
"""By which part of their range what a state is worth is moved."""

COSTS, WORTH, DISCOUNT, BELIEF, PRIOR = "cost", "worth", "discount", "belief", "beside"
KINDS = (COSTS, WORTH, DISCOUNT, BELIEF, PRIOR)

AS_GIVEN = "as given"

Told = Callable[[str, int, int], None]


@dataclass(frozen=True)
class OwnSensitivity(NotebookView):
    """What draws decide under other rewards, discounts, beliefs and priors.

    Attributes
    ----------
    rows : mapping of str to tuple of rows
        By kind (`KINDS`): one row a variant, reading and step (`analysis.sensitivity_variants.table`).
    draws : mapping of str to int
        Draws that were asked, by reading.
    cautions : tuple of str
        Those of the draws (`models.cautions`).
    """

    rows: Mapping[str, tuple[dict[str, Any], ...]]
    draws: Mapping[str, int]
    cautions: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """In which variants what most draws do first is something else than as given."""
        parts = []
        for reading in self.draws:
            own = [r for rows in self.rows.values() for r in rows if r["reading"] == reading and r["k"] == 0]
            base = next(r["action"] for r in own if r["variant"] == AS_GIVEN)
            other = [r for r in own if r["action"] != base]
            named = ", ".join(f"{r['variant']} ({r['action']})" for r in other)
            told = f"{len(other)} of {len(own)} variants change it: {named}" if other else "no variant changes it"
            parts.append(f"{reading}: {base} first, {told}")
        return "; ".join(parts) + "."


def own_sensitivity(
    draws: ModelDraws, *, beside: Sequence[Beside] = (), endless_draws: int = 60, few_draws: int = 2000,
    readings: Sequence[str] = READINGS, progress: Told | None = None,
) -> OwnSensitivity:  # fmt: skip
    """Ask draws with a reward of one's own what their decisions depend on.

    Parameters
    ----------
    draws : ModelDraws
        With their reward.
    beside : sequence of Beside
        Fits with other priors, of as many states.
    endless_draws, few_draws : int
        Evenly spaced draws that are asked without a horizon and over few steps.
    readings : sequence of str
        Of `analysis.sensitivity.READINGS`.
    progress : callable, optional
        Called with the step, pieces done and pieces in all.

    Raises
    ------
    InputError
        On one state, where nothing moves anybody, or an unknown reading.
    """
    if draws.n_states < 2:
        raise InputError("sensitivity: with one state nothing the robot does changes anybody")
    base = reward_of(draws)
    kinds: dict[str, list[Variant]] = {
        COSTS: [Variant(AS_GIVEN, draws, base), *cost_variants(draws, base)],
        WORTH: worth_variants(draws, base),
        DISCOUNT: discount_variants(draws, base),
        BELIEF: belief_variants(draws, base),
        PRIOR: [Variant(other.name, other.draws, base) for other in beside],
    }
    used = discounts_of(readings, None)
    rows: dict[str, list[dict[str, Any]]] = {kind: [] for kind in kinds}
    asked: dict[str, int] = {}
    for kind, variants in kinds.items():
        for i, variant in enumerate(variants):
            for reading, usual in used.items():
                discount = usual if variant.discount is None else variant.discount
                if reading == INFINITE and discount >= 1:
                    continue
                own = variant.draws.thin(endless_draws if reading == INFINITE else few_draws)
                asked.setdefault(reading, own.n_draws)
                cell = RewardGrid.point(own.protocol, variant.reward)
                rows[kind] += variant_table(variant, decide_grid(decider_of(reading, own), cell, discount))
            if progress is not None:
                progress(f"what decisions depend on: {kind}", i + 1, len(variants))
    return OwnSensitivity({kind: tuple(own) for kind, own in rows.items()}, asked, draws.cautions)


def cost_variants(draws: ModelDraws, base: Reward) -> list[Variant]:
    """The costs of one mode at a time, and of all modes, at multiples of what they are."""
    own = {a: base.costs.get(a, c) for a, c in draws.protocol.costs.items()}
    groups = {m.name: [a.name for a in m.actions if own[a.name]] for m in draws.protocol.modes}
    groups = {name: actions for name, actions in groups.items() if actions}
    if len(groups) > 1:
        groups["all modes"] = [a for actions in groups.values() for a in actions]
    return [
        Variant(
            f"costs of {name} x {by:g}", draws, replace(base, costs={**own, **{a: by * own[a] for a in actions}})
        )
        for name, actions in groups.items()
        for by in MULTIPLES
    ]


def worth_variants(draws: ModelDraws, base: Reward) -> list[Variant]:
    """What states are worth: all of them at multiples, and each moved by a part of their range."""
    worth = base.prosocial()
    step = MOVED * float(np.ptp(worth))
    out = [(f"all states x {by:g}", by * worth) for by in MULTIPLES if by]
    out += [
        (f"s{s} {move:+.3g}", worth + move * np.eye(len(worth))[s])
        for s in range(len(worth))
        for move in (-step, step)
    ]
    return [Variant(name, draws, Reward.of_values(v, base.costs, base.unit)) for name, v in out]
