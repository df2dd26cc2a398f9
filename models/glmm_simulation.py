"""Data drawn from a mixed model: for bootstraps, checks of residuals, and studies of coverage."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.special import expit

from models.glmm_data import Array, Patterns

if TYPE_CHECKING:
    from models.glmm import LogisticMixedModel


def simulate_successes(model: LogisticMixedModel, theta: Array, rng: np.random.Generator) -> Array:
    """New successes for every row, with new intercepts for every group.

    Parameters
    ----------
    theta : array [p + 1]
        Fixed effects and standard deviation.

    Returns
    -------
    array [n]
        Of `model.trials` trials each; a row with a frequency weight above one is drawn once, like a count of
        ``weight * trials``, and returned as that count.
    """
    u = rng.standard_normal(model.n_groups)
    eta = model.offset + model.exog @ theta[:-1] + theta[-1] * u[model.group_code]
    return rng.binomial((model.trials * model.freq_weights).astype(np.int64), expit(eta)).astype(float)


def patterns_of(model: LogisticMixedModel, successes: Array) -> Patterns:
    """The model's data with other successes, as drawn by `simulate_successes`."""
    trials = model.trials * model.freq_weights
    ones = np.ones(len(trials))
    return Patterns.from_rows(model.exog, model.offset, successes, trials, ones, model.group_code)
