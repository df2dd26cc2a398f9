"""Predictions with standard errors and intervals, in statsmodels' shape."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.special import expit, logit
from scipy.stats import norm

from models.errors import located
from models.glmm_arguments import check_alpha
from models.glmm_data import Array
from models.glmm_input import per_row
from models.glmm_marginal import probability_and_slopes, variances
from models.glmm_prediction import design_of, offset_of

if TYPE_CHECKING:
    from models.glmm_results import LogisticMixedResults


@dataclass(frozen=True)
class Predictions:
    """Predictions of rows; intervals take the parameters' covariance into account, not a new row's own chance.

    Attributes
    ----------
    predicted, se : array [rows]
        The prediction and its standard error, on its own scale, by the delta method. NaN errors for rows with a
        coefficient without a finite estimate.
    which : {"marginal", "conditional", "linear"}
        As in `LogisticMixedResults.predict`.
    row_labels : Index
    """

    predicted: Array
    se: Array
    which: str
    row_labels: Any

    @property
    def var_pred(self) -> Array:
        """Squared standard errors."""
        return np.asarray(self.se**2)

    @np.errstate(divide="ignore", invalid="ignore")
    def conf_int(self, alpha: float = 0.05) -> Array:
        """Intervals ``[rows, 2]``; those of probabilities are made on the logit scale, to stay within 0 and 1."""
        check_alpha(alpha)
        level, p = norm.ppf(1 - alpha / 2), self.predicted
        if self.which == "linear":
            return np.column_stack([p - level * self.se, p + level * self.se])
        half = level * self.se / (p * (1 - p))
        return np.column_stack([expit(logit(p) - half), expit(logit(p) + half)])

    def summary_frame(self, alpha: float = 0.05) -> pd.DataFrame:
        """Columns ``predicted``, ``se``, ``ci_lower``, ``ci_upper``."""
        ends = self.conf_int(alpha)
        columns = {"predicted": self.predicted, "se": self.se, "ci_lower": ends[:, 0], "ci_upper": ends[:, 1]}
        return pd.DataFrame(columns, index=self.row_labels)


def predictions(
    results: LogisticMixedResults, exog: Any, which: str, offset: Any, transform: bool = True
) -> Predictions:
    """See `LogisticMixedResults.get_prediction`."""
    design, index = design_of(results, exog, transform)
    shift = per_row(offset_of(results, exog, offset), len(design), "offset")
    theta = np.asarray(results.params)
    eta = design @ theta[:-1] + (0.0 if shift is None else shift)
    jacobian = np.column_stack([design, np.zeros(len(design))])
    predicted = eta
    if which == "marginal":
        predicted, by_eta, by_sd = probability_and_slopes(eta, theta[-1])
        jacobian = np.column_stack([by_eta[:, None] * design, by_sd])
    elif which == "conditional":
        predicted = expit(eta)
        jacobian = (predicted * (1 - predicted))[:, None] * jacobian
    elif which != "linear":
        raise located("which", which, "'marginal', 'conditional' or 'linear'")
    se = np.sqrt(np.maximum(variances(jacobian, results.cov_params()), 0.0))
    # Also where a probability is so close to 0 or 1 that its slope is zero.
    se[(design[:, results.escape.unbounded[:-1]] != 0).any(axis=1)] = np.nan
    return Predictions(np.asarray(predicted), se, which, index)
