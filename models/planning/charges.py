"""What actions are charged against a budget: their cost, one apiece, or as the user says.

Charges are added up as the decimals they are written as: three times 0.1 is 0.3, and a budget of 0.3 pays for it.
So they are counted in whole numbers of a unit that fits all of them, however many digits they have. A budget pays
for a sum that, as the nearest floating-point number, is not above it: then it pays for every sum that was ever
printed as that budget.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from math import gcd, lcm
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from models.errors import located
from models.protocol import Protocol
from models.reward import Reward, default_x

if TYPE_CHECKING:
    from models.lspomdp import LatentStatePOMDP
    from models.model_draws import ModelDraws
    from models.planning.schedule import Schedule

Array = NDArray[np.float64]
Index = NDArray[np.int64]
Charges = Literal["cost", "count"] | Mapping[str, float]

PLAIN_UNITS = 2**43
"""Units up to which charges are 64-bit numbers, Python's own beyond: sums over a million events fit."""

MOST_APART = 10**15
"""The largest charge in terms of the smallest positive one: sums in floating point lose what is smaller."""


def charges_of(source: Schedule | LatentStatePOMDP | ModelDraws, kind: Charges = "cost") -> Array:
    """What each action of the protocol is charged.

    Parameters
    ----------
    source : Schedule, LatentStatePOMDP or ModelDraws
        Whose protocol and costs count.
    kind : {"cost", "count"} or mapping of str to float
        The cost of the action in the unit of the reward; 1 for every action other than its mode's null action; or
        by name, with 0 for actions that are not named.

    Returns
    -------
    float64[a]
        Over all actions of the protocol, non-negative.

    Raises
    ------
    InputError
        On another kind, an unknown action, a charge that is negative or not finite, or one for a null action: what
        can always be done must be free.

    Examples
    --------
    >>> from models.lspomdp import LatentStatePOMDP
    >>> stays = LatentStatePOMDP([.5, .5], [[[1, 0], [0, 1]]] * 4, [[[.9, .1], [.2, .8]]] * 2)
    >>> charges_of(stays), charges_of(stays, {"signal": 2})
    (array([ 0., 15.,  0., 15.]), array([0., 0., 0., 2.]))
    """
    protocol: Protocol = source.protocol
    nulls = {m.null_action for m in protocol.modes}
    if isinstance(kind, Mapping):
        for name in kind:
            protocol.action(name)
        out = np.array([_number(f"charge of {a}", kind.get(a, 0.0)) for a in protocol.action_names])
    elif isinstance(kind, str) and kind == "count":
        out = np.array([float(a not in nulls) for a in protocol.action_names])
    elif isinstance(kind, str) and kind == "cost":
        given: Any = getattr(source, "draws", source)
        own = (given.reward or Reward(default_x(source.n_states))).costs
        out = np.array([float(own.get(a, protocol.costs[a])) for a in protocol.action_names])
    else:
        raise located("charges", kind, "cost, count, or a number by name of the action")
    for name, charge in zip(protocol.action_names, out.tolist(), strict=True):
        if not (np.isfinite(charge) and charge >= 0):
            raise located(f"charge of {name}", charge, "a number from 0 on")
        if name in nulls and charge != 0:
            raise located(f"charge of {name}", charge, "0: the null action of a mode must be free")
    return out


def checked_charges(protocol: Protocol, charges: ArrayLike) -> Array:
    """Charges given as an array, checked as those of `charges_of`.

    Raises
    ------
    InputError
        If there is not one number for each action, or they are none that `charges_of` returns.
    """
    out = np.asarray(charges, dtype=np.float64)
    if out.shape != (protocol.n_actions,):
        raise located("charges, shape", out.shape, f"({protocol.n_actions},), one an action of the protocol")
    nulls = {m.null_action for m in protocol.modes}
    for name, charge in zip(protocol.action_names, out.tolist(), strict=True):
        if not (np.isfinite(charge) and charge >= 0) or (name in nulls and charge != 0):
            raise located(f"charge of {name}", charge, "0" if name in nulls else "a number from 0 on")
    return out


class Units(NamedTuple):
    """Charges and a budget in whole units.

    Attributes
    ----------
    charge : int64[a] or object[a]
        Python's own whole numbers where 64 bits might not hold their sums.
    budget : int or float
        Whole units that it pays for; infinite without a limit.
    size : Fraction
        Of a unit.
    """

    charge: Index
    budget: float
    size: Fraction

    def amount(self, units: int) -> float:
        """So many units as a number."""
        return float(units * self.size)

    def within(self, budget: float) -> float:
        """Whole units that a budget pays for: as many as come to no more, as the nearest floating-point number.

        Raises
        ------
        InputError
            On a budget that is negative or no number.
        """
        check_budget(budget)
        if np.isinf(budget):
            return float("inf")
        # What is nearer to the budget than to the next number is rounded to the budget.
        top = (Fraction(float(budget)) + Fraction(float(np.nextafter(float(budget), np.inf)))) / 2
        units = int(top / self.size)
        return units if self.amount(units) <= budget else units - 1


def in_units(charges: Sequence[float] | Array, budget: float = 0.0) -> Units:
    """Count charges and a budget in the largest unit of which all charges are multiples.

    Raises
    ------
    InputError
        On a budget that is negative or no number, or charges of sizes too different to be added up.
    """
    check_budget(budget)
    exact = [Fraction(repr(float(c))) for c in charges]
    positive = [f for f in exact if f > 0]
    if positive and max(positive) > MOST_APART * min(positive):
        found = np.asarray(charges).tolist()
        raise located("charges", found, f"positive ones within a factor of {MOST_APART:.0e} of each other")
    scale = lcm(*(f.denominator for f in exact))
    whole = [int(f * scale) for f in exact]
    common = gcd(*whole) or 1
    units = [w // common for w in whole]
    counted = np.array(units, dtype=np.int64 if max(units) <= PLAIN_UNITS else object)
    found = Units(counted, 0, Fraction(common, scale))
    return found._replace(budget=found.within(budget))


def check_budget(budget: float) -> None:
    """Refuse what is no budget.

    Raises
    ------
    InputError
        On anything but a number from 0 on.
    """
    if isinstance(budget, bool | str) or not isinstance(budget, int | float | np.number) or not budget >= 0:
        raise located("budget", budget, "a number from 0 on")


def _number(place: str, value: object) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | np.number):
        raise located(place, value, "a number from 0 on")
    return float(value)
