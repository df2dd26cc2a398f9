r"""Minimum necessary influence: no more of a push than the reward needs.

How much an action moves a person is told by the total variation between where they go with it and where they would
have gone left alone, :math:`TV(T(\cdot \mid s, a), T(\cdot \mid s, null)) = \tfrac12 \sum_{s'} |T(s' \mid s, a) -
T(s' \mid s, null)|`: the share of people in state `s` who end up somewhere else. It exists where the
Kullback-Leibler divergence is infinite, as it is with the zeros that maximum likelihood produces.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from models.errors import Phrase, located
from models.model_draws import ModelDraws
from models.planning.baselines import ModePolicy
from models.planning.policies import Array, Vocabulary
from models.safeguards.safeguard import Proposal, Safeguard, Verdict, check_number, null_choices
from models.safeguards.worth import Worth, WorthSource, rounding

SAME = 1e-12
"""Influences that differ by no more count as equal: they are shares, rounded in their last digits."""


def influence_table(draws: ModelDraws) -> Array:
    """Share of the people in each state whom an action moves elsewhere, beside the null action of its mode.

    Parameters
    ----------
    draws : ModelDraws

    Returns
    -------
    float64[d, a, s]
        From 0 to 1; zero for null actions.
    """
    protocol = draws.protocol
    null = [protocol.action(protocol.modes[m].null_action) for m in protocol.mode_of_action]
    return np.asarray(0.5 * np.abs(draws.transition - draws.transition[:, null]).sum(axis=-1))


class MinimumInfluence(Safeguard):
    """Among the actions worth nearly as much as the best, the one that moves people least.

    Of the actions whose mean worth is within the tolerance of the best, one with the least expected influence is
    done if that is less than the influence of what was proposed; else the proposal stands. So it never adds
    influence, whatever the policy, and ties are the policy's to decide.

    Parameters
    ----------
    tolerance : float
        In the unit of the reward, at least 0.
    tables : sequence of float64[d, c, s]
        Influence of the actions of each mode in each draw and state, from 0 to 1.
    words : Vocabulary
    null : tuple of int

    Raises
    ------
    InputError
        On a tolerance that is none, tables that do not fit, or entries that are no shares.
    """

    name = "influence"
    needs_worth = True

    def __init__(
        self, tolerance: float, tables: Sequence[ArrayLike], words: Vocabulary, null: tuple[int, ...]
    ) -> None:
        self.words, self.null = words, tuple(null)
        wanted = "a number of at least 0, in the unit of the reward"
        self.tolerance = check_number("influence, tolerance", tolerance, 0.0, 1e15, wanted)
        self.tables = tuple(np.asarray(t, dtype=np.float64) for t in tables)
        if len(self.tables) != len(words.modes):
            raise located("influence, tables", len(self.tables), f"{len(words.modes)}, one a mode")
        d, s = self.tables[0].shape[0], self.tables[0].shape[-1]
        for mode, actions, table in zip(words.modes, words.actions, self.tables, strict=True):
            if table.shape != (d, len(actions), s) or table.size == 0:
                wanted = f"({d}, {len(actions)}, {s}): draws, actions, states"
                raise located(f"influence, mode {mode}, shape", table.shape, wanted)
            if not np.all((table >= 0) & (table <= 1 + 1e-9)):
                raise located(f"influence, mode {mode}", Phrase("an entry that is none"), "shares from 0 to 1")
        self._by_action = [np.moveaxis(t, 1, 0).reshape(t.shape[1], -1) for t in self.tables]

    @classmethod
    def of(cls, draws: ModelDraws, tolerance: float) -> MinimumInfluence:
        """By the transition tables of draws: those that the worth of actions is told in."""
        table, p = influence_table(draws), draws.protocol
        modes = np.asarray(p.mode_of_action)
        tables = [table[:, modes == m] for m in range(len(p.modes))]
        return cls(tolerance, tables, Vocabulary.of(p), null_choices(p))

    def fits(self, worth: WorthSource | None, fallback: ModePolicy) -> None:
        """Refuse a source of worth with other draws or states.

        Raises
        ------
        InputError
        """
        super().fits(worth, fallback)
        d, _, s = self.tables[0].shape
        if worth is not None and (worth.n_draws, len(worth.states)) != (d, s):
            found = Phrase(f"{worth.n_draws} draws of {len(worth.states)} states")
            raise located(
                "influence, what actions are worth", found, f"{d} draws of {s} states, as its tables have"
            )

    def expected(self, mode: int, worth: Worth) -> Array:
        r""":math:`\sum_d w_d \sum_s b_d(s) TV_d(s, a)` of each action of a mode, shape ``[c]``."""
        return np.asarray(self._by_action[mode] @ (worth.weight[:, None] * worth.belief).ravel())

    def review(self, state: None, proposal: Proposal) -> Verdict:
        """The least influence that the reward leaves; the null action if nobody can say what actions are worth."""
        if proposal.worth is None:
            return nobody_can_say(self, proposal)
        mean = proposal.worth.mean
        if np.isnan(mean).all():
            return nobody_can_say(self, proposal)
        influence = self.expected(proposal.mode, proposal.worth)
        own = float(influence[proposal.choice])
        best = np.nanmax(mean)
        near = np.flatnonzero(mean >= best - self.tolerance - rounding(best))
        least = int(near[np.argmin(influence[near])]) if near.size else proposal.choice
        numbers = {"expected": own, "least": min(own, float(influence[least])), "tolerance": self.tolerance}
        if influence[least] >= own - SAME:
            return Verdict(proposal.choice, None, numbers)
        names = self.words.actions[proposal.mode]
        less = float(best - mean[least])
        reason = f"{names[least]} moves {influence[least]:.2g} of a person instead of {own:.2g} and is worth " + (
            f"only {less:.3g} less than the best" if less > rounding(best) else "most"
        )
        return Verdict(least, reason, {**numbers, "less_than_best": less})

    def to_dict(self) -> dict[str, Any]:
        """Plain content."""
        return {"kind": "influence", "tolerance": self.tolerance, "tables": [t.tolist() for t in self.tables]}


def nobody_can_say(guard: Safeguard, proposal: Proposal) -> Verdict:
    """The null action: what nobody can judge is not done to a person."""
    null = guard.null[proposal.mode]
    return Verdict(null, None if null == proposal.choice else "nobody can say what actions are worth here")
