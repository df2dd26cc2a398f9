"""Bounded cost: a hard limit on what the robot may spend on one person, whatever its policy wants.

Spending is added up exactly, as the decimals that charges are written as: 0.1 three times fits a budget of 0.3. It
is within the limit if, as the nearest floating-point number, it is not above it.

This is the seat belt. The best plan that knows of a limit is another matter (`models.planning.budget_plan`): it
saves for when it matters, where a guarded plan spends until nothing is left.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import Any

from models.errors import Phrase, located
from models.planning.baselines import ModePolicy
from models.planning.policies import Vocabulary
from models.protocol import Protocol
from models.safeguards.safeguard import Proposal, Safeguard, Verdict, check_number, null_choices
from models.safeguards.worth import WorthSource


class CostBudget(Safeguard):
    """An action that cannot be paid for becomes the null action of its mode.

    Parameters
    ----------
    limit : float
        What may be spent in all.
    charges : mapping of str to float
        What actions are charged; those not named are free. Null actions must be free.
    words : Vocabulary
    null : tuple of int
        The null action of each mode.

    Raises
    ------
    InputError
        On a negative or infinite limit or charge, an unknown action, or a null action that costs something.
    """

    name = "budget"
    hard = True

    def __init__(
        self, limit: float, charges: Mapping[str, float], words: Vocabulary, null: tuple[int, ...]
    ) -> None:  # fmt: skip
        self.words, self.null = words, tuple(null)
        self.limit = check_number("budget, limit", limit, 0.0, 1e15, "a number from 0 to 1e+15")
        known = [a for offered in words.actions for a in offered]
        for action, charge in charges.items():
            if action not in known:
                raise located("budget, charges, action", action, f"one of {', '.join(known)}")
            check_number(f"budget, charge of {action}", charge, 0.0, 1e15, "a number from 0 to 1e+15")
        self.charges = tuple(tuple(float(charges.get(a, 0.0)) for a in offered) for offered in words.actions)
        for x, c in enumerate(self.null):
            if self.charges[x][c] > 0:
                place = f"budget, charge of {words.actions[x][c]}"
                raise located(place, self.charges[x][c], f"0: it is the null action of mode {words.modes[x]}")
        self._exact = tuple(tuple(Fraction(repr(c)) for c in own) for own in self.charges)
        self._limit = Fraction(repr(self.limit))

    @classmethod
    def of(cls, protocol: Protocol, limit: float, charges: Mapping[str, float] | None = None) -> CostBudget:
        """A budget in the unit of the reward, by the protocol's costs, or by charges of one's own."""
        own = protocol.costs if charges is None else charges
        return cls(limit, own, Vocabulary.of(protocol), null_choices(protocol))

    def begin(self, mode: int) -> Fraction:
        """Nothing is spent."""
        return Fraction(0)

    def review(self, state: Fraction, proposal: Proposal) -> Verdict:
        """Null if the action costs more than is left."""
        charge = self._exact[proposal.mode][proposal.choice]
        left = max(Fraction(0), self._limit - state)
        numbers = {"limit": self.limit, "spent": float(state), "left": float(left), "charge": float(charge)}
        # As plans with a budget count (`models.planning.charges`): a sum that is rounded to the limit is within it.
        if charge == 0 or float(state + charge) <= self.limit:
            return Verdict(proposal.choice, None, numbers)
        action = self.words.actions[proposal.mode][proposal.choice]
        reason = (
            f"{action} costs {numbers['charge']:g} and {numbers['left']:g} of the budget of {self.limit:g} is left"
        )
        return Verdict(self.null[proposal.mode], reason, numbers)

    def observe(
        self, state: Fraction, mode: int, choice: int, observation: int | None, next_mode: int
    ) -> Fraction:  # fmt: skip
        """What was really done is paid for, also what somebody else ordered."""
        return state + self._exact[mode][choice]

    def fits(self, worth: WorthSource | None, fallback: ModePolicy) -> None:
        """Refuse a fallback that spends: without consent nothing is remembered, not even what was spent.

        Raises
        ------
        InputError
        """
        super().fits(worth, fallback)
        for x, (share, own) in enumerate(zip(fallback.shares, self.charges, strict=True)):
            for c in range(len(own)):
                if share[c] > 0 and own[c] > 0:
                    found = Phrase(f"{self.words.actions[x][c]} in mode {self.words.modes[x]}, charged {own[c]:g}")
                    wanted = "free actions: without consent nobody keeps count of what is spent"
                    raise located(f"fallback {fallback.name} beside a budget", found, wanted)

    def to_dict(self) -> dict[str, Any]:
        """Plain content."""
        pairs = zip(self.words.actions, self.charges, strict=True)
        charges = {a: c for offered, own in pairs for a, c in zip(offered, own, strict=True) if c > 0}
        return {"kind": "budget", "limit": self.limit, "charges": charges}
