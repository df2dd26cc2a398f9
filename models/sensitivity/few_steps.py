r"""A few steps planned for exactly, in many cases at once: the two-step readings of the paper's plan.

With the joint vectors :math:`j_h(s) = P(h, s)` of all histories `h` of actions and responses, which do not depend
on the reward, what is to come is worth

.. math::
   Q_k(h, a) = \sum_s j_h(s) R(s, a) + g \sum_o V_{k+1}(h, a, o), \qquad V_k(h) = \max_a Q_k(h, a)

and after the last step nothing, or :math:`V_K(h) = \sum_s j_h(s) R_{prosocial}(s)`. So every reward costs some
products with vectors that were worked out once.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from models.errors import located
from models.model_draws import ModelDraws
from models.sensitivity.cases import Answers, Array, Cases, Index, Nodes, joined, steps_in_order
from models.spread_out import chunks

TWO_STEP, TWO_STEP_TERMINAL = "two-step", "two-step-terminal"
"""Names of the readings; the published protocol has two modes, and so two steps."""

TIE = 1e-12
"""Actions whose values differ by less than this share of the largest reward are equal: the null action is taken."""

PORTION = 20_000
"""Cases that are worked out at a time."""

MOST_HISTORIES = 4096
"""Histories of actions and responses at most."""


class FewSteps:
    """The exact plan of a few steps.

    Parameters
    ----------
    draws : ModelDraws
        Its reward is not used: cases bring theirs.
    terminal : bool
        Whether the prosocial reward is paid once more for the state after the last step.
    modes : tuple of int, optional
        Mode of each step; the protocol's in order by default.

    Raises
    ------
    InputError
        If there are too many steps.
    """

    def __init__(self, draws: ModelDraws, terminal: bool, modes: tuple[int, ...] | None = None) -> None:
        self.draws, self.terminal = draws, terminal
        self.nodes = Nodes(draws.protocol, steps_in_order(draws.protocol) if modes is None else modes)
        count = np.prod([a * self.nodes.outcomes(k) for k, a in enumerate(self.nodes.actions)], dtype=float)
        if count > MOST_HISTORIES:
            raise located("steps, histories", int(count), f"at most {MOST_HISTORIES}")
        self.reading = TWO_STEP_TERMINAL if terminal else TWO_STEP

    @cached_property
    def _joint(self) -> list[Array]:
        """Joint vectors before each step and after the last, ``[d, h, s]`` each; last responses summed over."""
        protocol, level = self.draws.protocol, self.draws.initial[:, None, :]
        out = [level]
        for k, count in enumerate(self.nodes.actions):
            first = self.nodes.first_action(k)
            after = []
            for a in range(first, first + count):
                row = protocol.emission_index[a]
                seen = [level]
                if row >= 0 and k + 1 < self.nodes.n_steps:
                    seen = [level * self.draws.emission[:, None, row, :, o] for o in range(protocol.n_responses)]
                after.append(np.stack([np.matmul(v, self.draws.transition[:, a]) for v in seen], axis=2))
            following = np.stack(after, axis=2)
            level = np.ascontiguousarray(following.reshape(len(following), -1, following.shape[-1]))
            out.append(level)
        return out

    def decide(self, cases: Cases) -> Answers:
        """What the exact plan does in every case.

        Equal actions count as the null action: leaving people alone needs no reason.

        Parameters
        ----------
        cases : Cases
        """
        return joined([self._portion(cases.some(span)) for span in chunks(len(cases), PORTION)])

    def action_values(self, cases: Cases) -> list[Array]:
        """Worth of each action after every history, times the probability of the history; ``[m, h, c]`` by step."""
        d, g = cases.draw, cases.discount[:, None]
        last = self.nodes.n_steps
        joint = self._joint
        value = np.zeros((len(cases), joint[last].shape[1]))
        if self.terminal:
            value = np.einsum("mhs,ms->mh", joint[last][d], cases.prosocial)
        out = []
        for k in range(last - 1, -1, -1):
            first, count = self.nodes.first_action(k), self.nodes.actions[k]
            before = joint[k][d]
            now = np.einsum("mhs,mas->mha", before, cases.reward[:, first : first + count])
            shown = value.shape[1] // (before.shape[1] * count)
            after = value.reshape(len(cases), before.shape[1], count, shown).sum(axis=3)
            q = now + g[:, :, None] * after
            value = q.max(axis=2)
            out.append(q)
        return out[::-1]

    def _portion(self, cases: Cases) -> Answers:
        nodes, values, m = self.nodes, self.action_values(cases), len(cases)
        small = TIE * np.abs(cases.reward).max(axis=(1, 2))[:, None]
        choice = np.zeros((m, nodes.n_nodes), dtype=np.int8)
        chance = np.zeros((m, nodes.n_nodes))
        worth = np.full((m, nodes.n_nodes, max(nodes.actions)), np.nan)
        place: Index = np.zeros((m, 1), dtype=np.int64)
        for k, count in enumerate(nodes.actions):
            at = list(nodes.of_step(k))
            q = np.take_along_axis(values[k], place[:, :, None], axis=1)
            mass = self._joint[k][cases.draw[:, None], place].sum(axis=2)
            null = nodes.null_choice(k)
            tied = q[:, :, null] >= q.max(axis=2) - small
            best = np.where(tied, null, q.argmax(axis=2))
            choice[:, at], chance[:, at] = best, mass / mass.sum(axis=1, keepdims=True)
            with np.errstate(invalid="ignore", divide="ignore"):
                worth[:, at, :count] = np.where(mass[:, :, None] > 0, q / mass[:, :, None], 0.0)
            shown = nodes.outcomes(k)
            place = ((place * count + best) * shown)[:, :, None] + np.arange(shown)
            place = place.reshape(m, -1)
        return Answers(nodes, choice, chance, worth, worth)
