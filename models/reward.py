r"""What a round is worth: :math:`R(s, a) = -C_a + \exp(r x_s) - \exp(r x_0)` in reward units.

The published unit is such that one act of helping costs 15.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from models.errors import located
from models.notebook_view import NotebookView, View, frame_rows
from models.protocol import Protocol

PUBLISHED_X = (45.0, 48.0, 56.0, 67.0)
PUBLISHED_R = 0.06
UNIT = "reward units"
"""What values are in, where nobody says."""


def default_x(n_states: int) -> tuple[float, ...]:
    """Team tokens a round by state: the published values for four states, evenly spread 45..67 otherwise.

    Values of plans made with different numbers of states are in different currencies.
    """
    if n_states == len(PUBLISHED_X):
        return PUBLISHED_X
    return tuple(float(v) for v in np.linspace(PUBLISHED_X[0], PUBLISHED_X[-1], n_states))


@dataclass(frozen=True)
class Reward(NotebookView, plain=True):
    """The paper's reward.

    Attributes
    ----------
    x : tuple of float
        Prosocial score of each state, tokens a round.
    r : float
        Steepness, per token (published: 0.06).
    costs : mapping of str to float
        Cost of actions by name, in `unit`; actions not named cost what the protocol says.
    unit : str
        What values and costs are in, in the plural: ``points``, ``tokens``. Words only; no number depends on it.
    """

    x: tuple[float, ...]
    r: float = PUBLISHED_R
    costs: Mapping[str, float] = field(default_factory=dict)
    unit: str = UNIT

    def __post_init__(self) -> None:
        if not isinstance(self.unit, str) or not self.unit.strip():
            raise located("reward, unit", self.unit, "a word in the plural, such as points")
        if not np.all(np.isfinite(self.x)) or len(self.x) == 0:
            raise located("reward, x", self.x, "finite numbers, one a state")
        if not _finite(self.r):
            raise located("reward, r", self.r, "a finite number")
        for name, cost in self.costs.items():
            if not _finite(cost):
                raise located(f"reward, cost of {name}", cost, "a finite number")
        with np.errstate(over="ignore", invalid="ignore"):
            if not np.isfinite(self.prosocial()).all():
                raise located("reward, r", self.r, "a steepness at which exp(r x) is a finite number")

    @classmethod
    def of_values(cls, values: ArrayLike, costs: Mapping[str, float] | None = None, unit: str = UNIT) -> Reward:
        r"""The reward in which a round in state s is worth :math:`v_s - v_0`, whatever the values are.

        For a study with a measure of its own. The paper's form holds any values, with r = 1 and
        :math:`x_s = \log(1 + v_s - \min_t v_t)`; these scores mean nothing by themselves.

        Parameters
        ----------
        values : float[s]
            What a round with a person in each state is worth, in the unit of the costs.
        costs : mapping of str to float, optional
        unit : str
            As the attributes.

        Raises
        ------
        InputError
            If they are no finite numbers, one a state.

        Examples
        --------
        >>> Reward.of_values([12.0, 15.5, 30.0]).prosocial().round(9)
        array([ 0. ,  3.5, 18. ])
        """
        try:
            value = np.asarray(values, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            raise located("reward, values", values, "finite numbers, one a state") from None
        if value.ndim != 1 or value.size == 0 or not np.all(np.isfinite(value)):
            raise located("reward, values", value.tolist(), "finite numbers, one a state")
        return cls(tuple(np.log1p(value - value.min()).tolist()), 1.0, dict(costs or {}), unit)

    @property
    def stated(self) -> bool:
        """Whether values were stated (`of_values`), so that scores and steepness mean nothing by themselves."""
        return self.r == 1.0 and min(self.x) == 0.0

    def prosocial(self) -> NDArray[np.float64]:
        r"""Part that depends on the state: :math:`\exp(r x_s) - \exp(r x_0)`, shape ``[s]``."""
        x = np.asarray(self.x)
        return np.exp(self.r * x) - np.exp(self.r * x[0])

    def table(self, protocol: Protocol) -> NDArray[np.float64]:
        """Reward of every action in every state, shape ``[a, s]``.

        Examples
        --------
        >>> from models.protocol import PUBLISHED
        >>> Reward(default_x(4)).table(PUBLISHED).round(1)[1]
        array([-15. , -12.1,  -1.1,  25.8])
        """
        for name in self.costs:
            protocol.action(name)
        cost = np.array([self.costs.get(a, protocol.costs[a]) for a in protocol.action_names])
        return self.prosocial()[None, :] - cost[:, None]

    def _view(self) -> View:
        rows = [
            {"state": f"s{i}", "x": x, "exp(r x) - exp(r x0)": float(v)}
            for i, (x, v) in enumerate(zip(self.x, self.prosocial(), strict=True))
        ]
        costs = ", ".join(f"{name} {cost:g}" for name, cost in self.costs.items()) or "those of the protocol"
        told = f"exp(r x_s) - exp(r x_0) less the cost of the action; r = {self.r:g} per token. Costs: {costs}."
        units = {"x": "tokens a round", "exp(r x) - exp(r x0)": self.unit}
        return View("Reward", "definition", (), (), (told,), (frame_rows(rows, ".prosocial()"),), units)


def _finite(value: float) -> bool:
    try:
        return math.isfinite(value)
    except OverflowError:  # a whole number above 1e308
        return False
