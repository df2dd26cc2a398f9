"""Curves of power from simulation: shares with their Monte Carlo error, and where a wanted value is reached."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, special

Array = NDArray[np.float64]

MONTE_CARLO_LEVEL = 0.95
"""Level of intervals that show the error of simulation."""


def wilson_interval(hits: Array, trials: Array | float, level: float = MONTE_CARLO_LEVEL) -> tuple[Array, Array]:
    """Interval of a share (Wilson 1927), which is never empty at 0 or 1.

    Examples
    --------
    >>> low, high = wilson_interval(np.array([10.0]), 10)
    >>> round(float(low[0]), 3), float(high[0])
    (0.722, 1.0)
    """
    z = float(special.ndtri((1 + level) / 2))
    share = hits / trials
    centre = (share + z**2 / (2 * trials)) / (1 + z**2 / trials)
    half = z * np.sqrt(share * (1 - share) / trials + z**2 / (4 * trials**2)) / (1 + z**2 / trials)
    return np.where(hits == 0, 0.0, centre - half), np.where(hits == trials, 1.0, centre + half)


@dataclass(frozen=True)
class Reached:
    """The number of people at which a curve reaches a wanted value.

    Attributes
    ----------
    n : float
        By interpolation between simulated numbers; NaN where the curve stays below, `first` where it starts above.
    low, high : float
        The same of the upper and the lower ends of the curve's intervals: fewest and most people that simulation
        error allows (NaN: more than simulated).
    first, last : float
        The range of people simulated.
    """

    n: float
    low: float
    high: float
    first: float
    last: float

    @property
    def words(self) -> str:
        """The answer in words."""
        if np.isnan(self.n):
            return f"not reached by {self.last:,.0f} people"
        if self.n <= self.first:
            return f"reached by {self.first:,.0f} people, the fewest simulated"
        low = f"{np.ceil(self.low):,.0f}" if self.low > self.first else f"below {self.first:,.0f}"
        high = f"{np.ceil(self.high):,.0f}" if np.isfinite(self.high) else f"beyond {self.last:,.0f}"
        return f"reached at about {np.ceil(self.n):,.0f} people (simulation error: {low} to {high})"

    def to_dict(self) -> dict[str, Any]:
        """For JSON: whole people, None where not reached within the range."""
        whole = {key: None if np.isnan(value) else int(np.ceil(value)) for key, value in vars(self).items()}
        return {**whole, "words": self.words}


def reached(people: Array, value: Array, low: Array, high: Array, wanted: float) -> Reached:
    """Find where a rising curve, known with error at several numbers of people, reaches `wanted`.

    More people cannot be worse, so each curve is first made to rise (isotonic regression), then interpolated
    linearly over the square root of the number of people, on which power bends least.

    Parameters
    ----------
    people : float64[size]
        Ascending.
    value, low, high : float64[size]
        The curve and its intervals.
    wanted : float
    """
    n, fewest, most = (_crossing(people, curve, wanted) for curve in (value, high, low))
    return Reached(n, fewest, most, float(people[0]), float(people[-1]))


def _crossing(people: Array, curve: Array, wanted: float) -> float:
    rising = optimize.isotonic_regression(curve).x
    above = np.flatnonzero(rising >= wanted)
    if not len(above):
        return np.nan
    i = int(above[0])
    if i == 0:
        return float(people[0])
    a, b = np.sqrt(people[i - 1]), np.sqrt(people[i])
    share = (wanted - rising[i - 1]) / (rising[i] - rising[i - 1])
    return float((a + share * (b - a)) ** 2)
