r"""Profile-likelihood intervals.

A value ``c`` of one parameter belongs to the interval when :math:`2(\ell_{max} - \ell_p(c))` stays below the
quantile of chi-square with one degree of freedom, :math:`\ell_p(c)` being the maximum over all other parameters.
The signed root of that fall is nearly linear in ``c``, and its slope is known from the gradient (envelope theorem),
so two or three Newton steps find an end; every inner search starts on the line that the curvature predicts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from models.glmm_climb import climb
from models.glmm_data import Array, Likelihood
from models.glmm_optimise import Maximum

FARTHEST = 60.0
"""Standard errors beyond which an end that has not been met is called infinite."""

CLOSE = 1e-6
"""Relative precision of the signed root at an end."""


NEAR_ZERO = 1e-3
"""Standard deviation below which an inner search may have stayed at zero only because it started there."""

AWAY = 1.0
"""Standard deviation from which another starts then."""


@dataclass(frozen=True)
class _Peak:
    """The maximum in coordinates of which one is the parameter to profile."""

    likelihood: Likelihood
    theta: Array
    value: float
    inverse: Array
    boundary: bool


def profile_intervals(likelihood: Likelihood, best: Maximum, which: Sequence[int], alpha: float = 0.05) -> Array:
    """Ends of the profile intervals of some parameters.

    Parameters
    ----------
    likelihood : Likelihood
        Of the fitted model.
    best : Maximum
        Its maximum.
    which : sequence of int
        Positions in ``(beta, sd)``.
    alpha : float
        One minus the level.

    Returns
    -------
    array [len(which), 2]
        NaN where there is no proper maximum to start from; -inf or inf where the likelihood never falls far enough;
        0 where the sd may be zero.
    """
    wanted = float(np.sqrt(chi2.ppf(1 - alpha, 1)))
    ends = np.full((len(which), 2), np.nan)
    if not best.converged:
        return ends
    size = len(best.theta)
    usual = likelihood
    if not best.coordinates.trivial:
        usual = Likelihood(best.coordinates.patterns(likelihood.patterns), likelihood.rule)
    for row, index in enumerate(which):
        coordinates, turn, factor = best.coordinates.holding(index)
        same = coordinates is best.coordinates
        information = -(turn.T @ best.curvature @ turn)
        if best.boundary:
            # No curvature to trust in the sd: a unit of it keeps the inner searches' matrix definite.
            information[-1], information[:, -1] = 0.0, 0.0
            information[-1, -1] = 1.0
        peak = _Peak(
            usual if same else Likelihood(coordinates.patterns(likelihood.patterns), likelihood.rule),
            turn.T @ best.top, best.value, np.linalg.inv(information), best.boundary,
        )  # fmt: skip
        for side in (-1, 1):
            if index == size - 1 and best.boundary and side < 0:
                ends[row, 0] = 0.0
            else:
                end = _end(peak, index, side if factor > 0 else -side, wanted)
                ends[row, (side + 1) // 2] = factor * end
    return ends


def _end(peak: _Peak, index: int, side: int, wanted: float) -> float:
    is_sd = index == len(peak.theta) - 1
    centre, error = float(peak.theta[index]), float(np.sqrt(peak.inverse[index, index]))
    if is_sd and peak.boundary:
        error = 0.5
    direction = peak.inverse[:, index] / peak.inverse[index, index]
    if is_sd and side < 0:
        root = _root(peak, index, 0.0, peak.theta - centre * direction)[0]
        if root <= wanted:
            return 0.0
    # The end is always between `inside`, where the root is too small, and `outside`, where it is too large.
    inside, outside = 0.0, np.inf
    distance = wanted * error
    theta = peak.theta + side * distance * direction
    for _ in range(60):
        if is_sd and side < 0:
            distance = min(distance, 0.5 * (inside + centre) if distance >= centre else distance)
            theta[index] = centre - distance
        root, slope, found = _root(peak, index, centre + side * distance, theta)
        if abs(root - wanted) <= CLOSE * wanted:
            return centre + side * distance
        if root < wanted:
            inside = distance
        else:
            outside = distance
        if inside > FARTHEST * error:
            return side * np.inf
        new = distance + (wanted - root) / slope if slope > 0 else np.inf
        if not inside < new < outside:
            new = 0.5 * (inside + outside) if np.isfinite(outside) else 2.0 * distance
        new = min(new, 4.0 * distance)
        # Along the line from the maximum to the point just found, which bends with the profile.
        theta = peak.theta + (found - peak.theta) * (new / distance)
        distance = new
        if outside - inside <= 1e-9 * error:
            break
    return centre + side * distance


def _root(peak: _Peak, index: int, value: float, start: Array) -> tuple[float, float, Array]:
    """Root of twice the fall of the profile at a value, its slope away from the maximum, and the point."""
    theta = np.array(start, float)
    theta[index] = value
    search = climb(peak.likelihood, theta, fixed=index, inverse=peak.inverse)
    if peak.boundary and index != len(theta) - 1 and search.theta[-1] < NEAR_ZERO:
        # At zero the slope in the sd vanishes, and a search stays there even where a positive one is higher.
        theta[-1] = AWAY
        other = climb(peak.likelihood, theta, fixed=index)
        search = max(search, other, key=lambda s: s.value)
    point = search.theta.copy()
    fall = 2.0 * (peak.value - search.value)
    root = float(np.sqrt(max(fall, 0.0)))
    _, gradient = peak.likelihood(point)
    slope = abs(float(gradient[index])) / root if root > 0 else 0.0
    return root, slope, point
