r"""Confidence: a person is influenced only where the models that may be true agree well enough that it pays."""

from __future__ import annotations

from typing import Any

import numpy as np

from models.planning.policies import Vocabulary
from models.protocol import Protocol
from models.safeguards.influence import nobody_can_say
from models.safeguards.safeguard import Proposal, Safeguard, Verdict, check_number, null_choices
from models.safeguards.worth import rounding


class Confidence(Safeguard):
    r"""An action is taken only if :math:`P(Q_a - Q_{null} > \epsilon)` exceeds a threshold; else the null action.

    The probability is the weight, given the history, of the draws in which that is so; `Q` goes on with the
    committed policy, in each draw. A gain that may be rounding is none.

    Parameters
    ----------
    threshold : float
        From 0 to below 1.
    tolerance : float
        :math:`\epsilon`, in the unit of the reward.
    words : Vocabulary
    null : tuple of int

    Raises
    ------
    InputError
        On a threshold or tolerance out of range.
    """

    name = "confidence"
    needs_worth = True

    def __init__(self, threshold: float, tolerance: float, words: Vocabulary, null: tuple[int, ...]) -> None:
        self.words, self.null = words, tuple(null)
        self.threshold = check_number("confidence, threshold", threshold, 0.0, 1 - 1e-12, "from 0 to below 1")
        wanted = "a number of at least 0, in the unit of the reward"
        self.tolerance = check_number("confidence, tolerance", tolerance, 0.0, 1e15, wanted)

    @classmethod
    def of(cls, protocol: Protocol, threshold: float, tolerance: float = 0.0) -> Confidence:
        """With the null actions of a protocol."""
        return cls(threshold, tolerance, Vocabulary.of(protocol), null_choices(protocol))

    def review(self, state: None, proposal: Proposal) -> Verdict:
        """Null if too few draws say that the action pays, or nobody can say."""
        null = self.null[proposal.mode]
        if proposal.choice == null:
            return Verdict(null)
        worth = proposal.worth
        if worth is None:
            return nobody_can_say(self, proposal)
        own, left_alone = worth.values[:, proposal.choice], worth.values[:, null]
        gain = own - left_alone
        sure = float(worth.weight[gain > self.tolerance + rounding(own, left_alone)].sum())
        numbers = {"probability": sure, "threshold": self.threshold, "tolerance": self.tolerance}
        if sure > self.threshold:
            return Verdict(proposal.choice, None, numbers)
        names = self.words.actions[proposal.mode]
        more = f" by more than {self.tolerance:g}" if self.tolerance > 0 else ""
        told = next((t for t in (f"{sure:.{n}g}" for n in range(2, 17)) if float(t) < self.threshold), f"{sure:g}")
        reason = (
            f"{names[proposal.choice]} is worth more than {names[null]}{more} with probability {told} only, "
            f"not above {self.threshold:g}"
        )
        return Verdict(null, reason, {**numbers, "gain": float(np.dot(worth.weight, gain))})

    def to_dict(self) -> dict[str, Any]:
        """Plain content."""
        return {"kind": "confidence", "threshold": self.threshold, "tolerance": self.tolerance}
