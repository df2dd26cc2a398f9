r"""Laplace's likelihood of the logistic mixed model with several random effects a group, with its exact gradient.

With :math:`\eta_j = o_j + x_j'\beta + a_j'u`, :math:`a_j = \Lambda' z_j` and :math:`u \sim N(0, I)`,

.. math::

   \ell_i = h(\hat u) - \tfrac12 \log\det H, \quad h(u) = \sum_j [y_j\eta_j - m_j\log(1+e^{\eta_j})] - u'u/2, \quad
   H = I + \sum_j w_j a_j a_j', \quad w_j = m_j p_j(1-p_j)

at the mode :math:`\hat u` of `h` (Bates et al. 2015). With :math:`v_j = a_j'H^{-1}a_j`, :math:`w_j'` the derivative
of :math:`w_j` by :math:`\eta_j` and :math:`k = H^{-1}\sum_j w_j' v_j a_j`, mode and determinant differentiated,

.. math::

   d\ell_i = \sum_j (r_j - \tfrac12 w_j' v_j + \tfrac12 w_j k'a_j)\, d\eta_j
           - \sum_j (w_j H^{-1}a_j + \tfrac12 r_j k)' da_j

where :math:`r_j = y_j - m_j p_j` and :math:`d\eta_j` is taken with `u` held.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import expit

from models.glmm_data import Array, Integers

MOST_STEPS = 100
"""Newton steps of the search for the modes."""

ARRIVED = 1e-11
"""Length of the last step of every group."""


@dataclass
class SlopeLikelihood:
    """The log-likelihood of rows that are sorted by group; modes of the last call are where the next one starts.

    Attributes
    ----------
    design : array [n, p]
    offset, successes, trials : array [n]
    random : array [n, q]
        Columns of the random effects (z).
    start : array [groups]
        First row of each group.
    entries : tuple of (row, column)
        Entries of the lower triangle of Lambda that are parameters; the others are zero.
    constant : float
        Logarithms of the binomial coefficients.
    """

    design: Array
    offset: Array
    successes: Array
    trials: Array
    random: Array
    start: Integers
    entries: tuple[tuple[int, int], ...]
    constant: float

    def __post_init__(self) -> None:
        self.group = np.repeat(np.arange(len(self.start)), np.diff(np.append(self.start, len(self.offset))))
        self.modes = np.zeros((len(self.start), self.random.shape[1]))
        self.scores = np.zeros((len(self.start), self.design.shape[1] + len(self.entries)))
        self.precision = np.zeros((len(self.start), self.random.shape[1], self.random.shape[1]))

    def factor(self, theta: Array) -> Array:
        """Lambda ``[q, q]`` at parameters (beta, entries)."""
        out = np.zeros((self.random.shape[1],) * 2)
        out[tuple(np.array(self.entries).T)] = theta[self.design.shape[1] :]
        return out

    def __call__(self, theta: Array) -> tuple[float, Array]:
        """Log-likelihood, constant included, and gradient; `scores` receives those of the groups."""
        fixed = self.offset + self.design @ theta[: self.design.shape[1]]
        a = self.random @ self.factor(theta)
        u, value = self._modes(fixed, a)
        eta = fixed + np.einsum("jq,jq->j", a, u[self.group])
        p, q = expit(eta), expit(-eta)
        w = self.trials * p * q
        bend = w * (q - p)
        residual = self.successes * q - (self.trials - self.successes) * p
        inverse = np.linalg.inv(self.precision)
        solved = np.einsum("jqr,jr->jq", inverse[self.group], a)
        leverage = np.einsum("jq,jq->j", a, solved)
        pull = self._sum((bend * leverage)[:, None] * a)
        k = np.einsum("gqr,gr->gq", inverse, pull)[self.group]
        by_eta = residual - 0.5 * bend * leverage + 0.5 * w * np.einsum("jq,jq->j", k, a)
        by_a = -w[:, None] * solved - 0.5 * residual[:, None] * k
        rows = [by_eta[:, None] * self.design]
        for row, column in self.entries:
            z = self.random[:, row]
            rows.append((z * (by_eta * u[self.group, column] + by_a[:, column]))[:, None])
        self.scores = self._sum(np.column_stack(rows))
        determinants = np.linalg.slogdet(self.precision)[1]
        return float(value.sum() - 0.5 * determinants.sum()) + self.constant, self.scores.sum(axis=0)

    def _sum(self, rows: Array) -> Array:
        return np.asarray(np.add.reduceat(rows, self.start, axis=0))

    def _modes(self, fixed: Array, a: Array) -> tuple[Array, Array]:
        """Modes of all groups by Newton's method with step halving, which h, being concave, needs only far out."""
        size = a.shape[1]

        def height(u: Array) -> Array:
            eta = fixed + np.einsum("jq,jq->j", a, u[self.group])
            softplus = np.maximum(eta, 0.0) + np.log1p(np.exp(-np.abs(eta)))
            rows = self.successes * (softplus - eta) + (self.trials - self.successes) * softplus
            return np.asarray(-self._sum(rows) - 0.5 * np.einsum("gq,gq->g", u, u))

        u = self.modes
        value = height(u)
        zero = height(np.zeros_like(u))
        u = np.where((value >= zero)[:, None], u, 0.0)
        value = np.maximum(value, zero)
        for _ in range(MOST_STEPS):
            eta = fixed + np.einsum("jq,jq->j", a, u[self.group])
            p, q = expit(eta), expit(-eta)
            residual = self.successes * q - (self.trials - self.successes) * p
            slope = self._sum(residual[:, None] * a) - u
            w = self.trials * p * q
            self.precision = np.eye(size) + self._sum((w[:, None] * a)[:, :, None] * a[:, None, :])
            step = np.linalg.solve(self.precision, slope[:, :, None])[:, :, 0]
            if np.abs(step).max() <= ARRIVED:
                break
            length = np.ones(len(u))
            for _ in range(30):
                new = u + length[:, None] * step
                new_value = height(new)
                worse = new_value < value - 1e-12 * (1.0 + np.abs(value))
                if not worse.any():
                    break
                length = np.where(worse, 0.5 * length, length)
            u, value = new, new_value
        self.modes = u
        return u, value

    def hessian(self, theta: Array) -> Array:
        """Second derivatives by central differences of the exact gradient."""
        out = np.empty((len(theta), len(theta)))
        for i in range(len(theta)):
            step = 1e-5 * max(1.0, abs(theta[i]))
            up, down = theta.copy(), theta.copy()
            up[i] += step
            down[i] -= step
            out[i] = (self(up)[1] - self(down)[1]) / (up[i] - down[i])
        return np.asarray(0.5 * (out + out.T))
