"""What several random effects come to: their standard deviations and correlations, and probabilities over them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import expit

from models.glmm_data import Array

if TYPE_CHECKING:
    from models.glmm_slope import LogisticSlopeModel


def natural_parameters(model: LogisticSlopeModel, theta: Array) -> tuple[Array, Array]:
    """Fixed effects, standard deviations and correlations, and their derivatives by (beta, entries of Lambda)."""
    p, q = model.exog.shape[1], len(model.effects)
    lower = np.zeros((q, q))
    lower[tuple(np.array(model.entries).T)] = theta[p:]
    sds = np.linalg.norm(lower, axis=1)
    unit = lower / np.where(sds > 0, sds, 1.0)[:, None]
    values = np.concatenate([theta[:p], sds, [unit[i] @ unit[j] for i, j in model.pairs]])
    jacobian = np.zeros((len(values), len(theta)))
    jacobian[:p, :p] = np.eye(p)
    for k, (row, column) in enumerate(model.entries):
        jacobian[p + row, p + k] = unit[row, column]
        for c, (i, j) in enumerate(model.pairs):
            for here, other in ((i, j), (j, i)):
                if row == here and sds[row] > 0:
                    along = unit[other, column] - values[p + q + c] * unit[row, column]
                    jacobian[p + q + c, p + k] += along / sds[row]
    return values, jacobian


def averaged_probabilities(eta: Array, sd: Array) -> Array:
    """Mean of expit over normal predictors with a standard deviation for each row."""
    step = min(0.25, 0.5 / max(float(sd.max(initial=0.0)), 1e-12))
    points = np.arange(-9.0, 9.0 + step, step)
    weights = np.exp(-0.5 * points**2)
    weights /= weights.sum()
    out = np.empty(len(eta))
    for first in range(0, len(eta), 4096):  # bounds the memory
        part = slice(first, first + 4096)
        out[part] = expit(eta[part, None] + sd[part, None] * points) @ weights
    return out
