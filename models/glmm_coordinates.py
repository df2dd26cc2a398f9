r"""Coordinates in which a design is fitted: columns near zero, near unit size, and not nearly dependent.

A covariate in unix seconds is, to an optimiser, the intercept over again; one in millionths makes steps of a
million. The likelihood does not care: :math:`X\beta = Z\gamma` with :math:`Z = (X - 1 m') M` and
:math:`\beta = (I - a m') M \gamma`, where :math:`X a = 1` is the combination of columns that is constant. So
searches run on :math:`Z`, and estimates, curvature and profiles are carried back exactly.

Columns that are fit for use stay as they are. Mixing them for the sake of tidiness would spread the flat direction
of separated data over all columns, where rounding hides it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from models.glmm_data import Array, Patterns

OFF_CENTRE = 10.0
"""Means of a column, in its standard deviations, beyond which it is centred."""

ODD_SIZE = 16.0
"""Root mean square of a column beyond which, or below whose inverse, it is scaled."""

DEPENDENT = 1e-5
"""Smallest eigenvalue of the columns' normalised cross-product below which they are made orthogonal."""

CONSTANT = 1e-12
"""Standard deviation over mean below which a column is constant but for rounding."""


@dataclass(frozen=True)
class Coordinates:
    """Working coordinates of the fixed effects.

    Attributes
    ----------
    shift : array [p]
        Subtracted from the columns (m); zero for columns that take part in `carrier`.
    carrier : array [p]
        Coefficients whose linear predictor is one in every row (a); zero where the design has no constant.
    mix : array [p, p]
        Applied to the centred columns (M).
    """

    shift: Array
    carrier: Array
    mix: Array

    @classmethod
    def of(cls, design: Array) -> Coordinates:
        """Coordinates for a design ``[n, p]`` of full rank."""
        size = design.shape[1]
        mean = design.mean(axis=0)
        apart = design - mean
        spread = np.sqrt(np.einsum("ij,ij->j", apart, apart) / len(design))
        shift, carrier = np.zeros(size), np.zeros(size)
        constant = spread <= CONSTANT * np.abs(mean)
        far = (np.abs(mean) > OFF_CENTRE * spread) & ~constant
        if far.any():
            carrier = _carrier(design, mean, constant, far)
            if carrier.any():
                shift = np.where(far, mean, 0.0)
        sizes = np.where(shift != 0.0, spread, np.sqrt(mean**2 + spread**2))
        odd = (sizes > ODD_SIZE) | (sizes < 1 / ODD_SIZE)
        # Powers of two: scaling by them rounds nothing.
        scale = np.exp2(np.where(odd & (sizes > 0), np.round(np.log2(np.where(sizes > 0, sizes, 1.0))), 0.0))
        found = cls(shift, carrier, np.diag(1.0 / scale))
        working = found.apply(design)
        cross = np.einsum("ij,ik->jk", working, working)
        norms = np.sqrt(np.diag(cross))
        norms[norms == 0] = 1.0
        cross /= np.outer(norms, norms)
        if size > 1 and np.linalg.eigvalsh(cross)[0] < DEPENDENT:
            upper = np.linalg.qr(working / norms, mode="r")
            if np.abs(np.diag(upper)).min() > 0:
                orthogonal = np.linalg.inv(upper) * np.sqrt(len(design))
                found = replace(found, mix=found.mix @ (orthogonal / norms[:, None]))
        return found

    @classmethod
    def same(cls, size: int) -> Coordinates:
        """The columns as they are."""
        return cls(np.zeros(size), np.zeros(size), np.eye(size))

    @cached_property
    def trivial(self) -> bool:
        """Whether nothing changes."""
        return bool(not self.shift.any() and np.array_equal(self.mix, np.eye(len(self.mix))))

    @cached_property
    def matrix(self) -> Array:
        """From working coefficients and the sd to the parameters ``[p + 1, p + 1]``."""
        size = len(self.shift)
        out = np.eye(size + 1)
        out[:size, :size] = self.mix - np.outer(self.carrier, self.shift @ self.mix)
        return out

    @cached_property
    def inverse(self) -> Array:
        """From the parameters to working coefficients and the sd ``[p + 1, p + 1]``."""
        size = len(self.shift)
        out = np.eye(size + 1)
        # (I - a m')^{-1} = I + a m', because m is zero wherever a is not.
        out[:size, :size] = np.linalg.solve(self.mix, np.eye(size) + np.outer(self.carrier, self.shift))
        return out

    def apply(self, design: Array) -> Array:
        """Working columns of rows; differences are taken before anything is multiplied."""
        if self.trivial:
            return design
        return np.asarray((design - self.shift) @ self.mix)

    def patterns(self, patterns: Patterns) -> Patterns:
        """The same data with working columns."""
        if self.trivial:
            return patterns
        return replace(patterns, design=np.ascontiguousarray(self.apply(patterns.design)))

    def forward(self, theta: Array) -> Array:
        """Working parameters."""
        return np.array(theta, float) if self.trivial else self.inverse @ theta

    def back(self, theta: Array) -> Array:
        """Parameters from working ones."""
        return np.array(theta, float) if self.trivial else self.matrix @ theta

    def covariance(self, working: Array) -> Array:
        """Covariance of the parameters from that of working ones."""
        if self.trivial:
            return working
        out = self.matrix @ working @ self.matrix.T
        return np.asarray(0.5 * (out + out.T))

    def hessian(self, working: Array) -> Array:
        """Second derivatives by the parameters from those by working ones."""
        if self.trivial:
            return working
        out = self.inverse.T @ working @ self.inverse
        return np.asarray(0.5 * (out + out.T))

    def holding(self, index: int) -> tuple[Coordinates, Array, float]:
        """Coordinates as good as these, one of which is a parameter of its own.

        Parameters
        ----------
        index : int
            Position of the parameter.

        Returns
        -------
        coordinates : Coordinates
        turn : array [p + 1, p + 1]
            Orthogonal, from the new working parameters to these.
        factor : float
            What the new working parameter at `index` is multiplied by to give the parameter.
        """
        size = len(self.shift)
        turn = np.eye(size + 1)
        row = self.matrix[index]
        length = float(np.linalg.norm(row))
        if index == size or length == abs(row[index]):
            return self, turn, float(row[index])
        # Householder's reflection takes the row to a multiple of the unit vector.
        sign = 1.0 if row[index] >= 0 else -1.0
        normal = row.copy()
        normal[index] += sign * length
        normal /= np.linalg.norm(normal)
        turn -= 2.0 * np.outer(normal, normal)
        return replace(self, mix=self.mix @ turn[:size, :size]), turn, -sign * length


def _carrier(design: Array, mean: Array, constant: np.ndarray, far: np.ndarray) -> Array:
    """Coefficients of columns that are not to be centred which add up to one in every row; zero if none do."""
    carrier = np.zeros(design.shape[1])
    if constant.any() and mean[constant].any():
        first = np.flatnonzero(constant & (mean != 0.0))[0]
        carrier[first] = 1.0 / mean[first]
        return carrier
    others = np.flatnonzero(~far)
    if len(others):
        size = np.abs(design[:, others]).max(axis=0)
        size[size == 0] = 1.0
        found, *_ = np.linalg.lstsq(design[:, others] / size, np.ones(len(design)), rcond=None)
        if np.abs(design[:, others] / size @ found - 1.0).max() < 1e-10:
            carrier[others] = found / size
    return carrier
