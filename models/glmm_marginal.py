r"""Population-averaged probabilities and odds ratios, with intervals.

A coefficient of the mixed model compares a person with *the same person* under another covariate; its exponential
is a conditional odds ratio. Averaged over people,

.. math:: P(x) = \int \operatorname{expit}(o + x'\beta + \sigma u)\, \varphi(u)\, du,

odds ratios are closer to one, the more so the larger the standard deviation. The integral is a trapezoidal sum,
exact to rounding; intervals are by the delta method on the logit scale, or by simulation from the estimates'
normal distribution.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.special import expit, logit
from scipy.stats import norm

from models.errors import Phrase, located
from models.glmm_arguments import check_alpha
from models.glmm_data import Array
from models.glmm_input import kept, one_intercept, unwrapped
from models.glmm_table import is_used
from models.notebook_view import NotebookView

if TYPE_CHECKING:
    from models.glmm_results import LogisticMixedResults

STREAM = 7_401
"""First element of the spawn keys used here."""

PERFECT = 1e-6
"""How close to 0 or 1 a probability must have come where a coefficient runs off, to be said to be 0 or 1."""


@dataclass(frozen=True)
class Estimate:
    """A number with an interval."""

    value: float
    lower: float
    upper: float

    def __str__(self) -> str:
        if np.isnan(self.value):
            return "not determined"
        if np.isnan([self.lower, self.upper]).all():
            return f"{self.value:.4g} (no interval)"
        return f"{self.value:.4g} ({self.lower:.4g} to {self.upper:.4g})"


@dataclass(frozen=True)
class MarginalContrast(NotebookView):
    """Two settings of the covariates, averaged over the rows of the data and over people.

    Attributes
    ----------
    setting, reference : str
        What was set.
    probability, reference_probability, difference, odds_ratio : Estimate
        Population-averaged; without interval where a coefficient without a finite estimate takes part.
    conditional_odds_ratio : Estimate or None
        For one and the same person; None where it differs between rows (interactions).
    level : float
        Of the intervals.
    """

    setting: str
    reference: str
    probability: Estimate
    reference_probability: Estimate
    difference: Estimate
    odds_ratio: Estimate
    conditional_odds_ratio: Estimate | None
    level: float

    @property
    def text(self) -> str:
        """The contrast in a sentence."""
        per_person = f"; for one person {self.conditional_odds_ratio}" if self.conditional_odds_ratio else ""
        return (
            f"{self.setting} against {self.reference}: probability {self.probability} against "
            f"{self.reference_probability}, odds ratio over people {self.odds_ratio}{per_person} "
            f"[{100 * self.level:g}% intervals]"
        )


def _grid(sd: float) -> tuple[Array, Array]:
    """Points and weights of the trapezoidal rule against the standard normal density.

    expit(eta + sd u) has poles at distance pi / sd from the real line, which bounds the error by
    exp(-2 pi^2 / (sd step)): below 1e-16 for the step used.
    """
    step = min(0.25, 0.5 / max(sd, 1e-12))
    points = np.arange(-9.0, 9.0 + step, step)
    weights = np.exp(-0.5 * points**2)
    return points, weights / weights.sum()


def mean_probability(eta: Array, sd: float) -> Array:
    """Integral of expit(eta + sd u) over the standard normal u; shape of `eta`."""
    return probability_and_slopes(eta, sd)[0]


def probability_and_slopes(eta: Array, sd: float) -> tuple[Array, Array, Array]:
    """`mean_probability` and its derivatives by eta and by the sd."""
    points, weights = _grid(sd)
    flat, inverse = np.unique(np.ravel(eta), return_inverse=True)
    out = np.empty((3, len(flat)))
    for first in range(0, len(flat), 4096):  # bounds the memory
        part = slice(first, first + 4096)
        p = expit(flat[part, None] + sd * points)
        slope = p * (1 - p) * weights
        out[:, part] = p @ weights, slope.sum(axis=1), slope @ points
    p, by_eta, by_sd = (row[inverse].reshape(np.shape(eta)) for row in out)
    return p, by_eta, by_sd


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def marginal_probabilities(
    results: LogisticMixedResults, exog: Any = None, alpha: float = 0.05, offset: Any = None
) -> pd.DataFrame:
    """Population-averaged probabilities of rows, with intervals.

    Parameters
    ----------
    exog : DataFrame or array_like, optional
        As for `LogisticMixedResults.predict`; the data of the fit where it is not given.
    offset : str, number or array_like, optional
        Of new rows; it must be given if the model has one that is not in its formula (0 for none). The fit's own
        rows keep theirs.

    Returns
    -------
    DataFrame
        Columns ``probability``, ``lower``, ``upper``; intervals by the delta method on the logit scale.

    Raises
    ------
    InputError
        For what cannot be predicted, an unknown level, and the rows of the fit after `remove_data`.
    """
    results = unwrapped(results)
    check_alpha(alpha)
    found = results.get_prediction(exog, offset=offset)
    ends = found.conf_int(alpha)
    columns = {"probability": found.predicted, "lower": ends[:, 0], "upper": ends[:, 1]}
    return pd.DataFrame(columns, index=found.row_labels)


def variances(rows: Array, covariance: Array) -> Array:
    """Variances of linear combinations; NaN only for those with a parameter that has none."""
    without = np.isnan(np.diag(covariance))
    found = np.einsum("ij,jk,ik->i", rows, np.nan_to_num(covariance), rows)
    found[(rows[:, without] != 0).any(axis=1)] = np.nan
    return np.asarray(found)


@np.errstate(divide="ignore", invalid="ignore", over="ignore")
def marginal_contrast(
    results: LogisticMixedResults,
    setting: Mapping[str, Any],
    reference: Mapping[str, Any],
    alpha: float = 0.05,
    method: str = "delta",
    draws: int = 10_000,
    seed: int = 1,
) -> MarginalContrast:
    """Compare two settings of covariates over the people of the study.

    Every row of the data is given the setting, then the reference; all else stays as observed, and probabilities
    are averaged over rows (standardisation).

    Parameters
    ----------
    setting, reference : mapping of str to value
        Values of variables of the formula, as ``{"signal": 1}``; of covariate columns for a model made from arrays.
    method : {"delta", "simulation"}
        Intervals from derivatives, on the logit or log scale, or from draws of the parameters.
    draws, seed : int
        For "simulation".

    Returns
    -------
    MarginalContrast
        With NaN or infinite ends where a probability is 0 or 1 to rounding (separated data).

    Raises
    ------
    InputError
        For a variable the model does not know or values it cannot take, and after `remove_data`.
    """
    results = unwrapped(results)
    if not hasattr(results, "maximum"):
        raise located("results", Phrase(type(results).__name__), "a fitted LogisticMixedModel")
    one_intercept(results.model, "marginal_contrast")
    check_alpha(alpha)
    _check_settings(results, setting, reference)
    model, theta = results.model, np.asarray(results.params)
    first, second = _set(results, setting), _set(results, reference)
    covariance = results.cov_params()
    level = norm.ppf(1 - alpha / 2)

    def averages(at: Array) -> tuple[Array, Array]:
        """Both average probabilities at parameters, and their derivatives."""
        values, slopes = [], []
        for design in (first, second):
            p, by_eta, by_sd = probability_and_slopes(model.offset + design @ at[:-1], abs(at[-1]))
            beyond = (design[:, unbounded[:-1]] != 0).any(axis=1) & (np.abs(p - 0.5) > 0.5 - PERFECT)
            values.append(np.average(np.where(beyond, np.round(p), p), weights=weights))
            row = np.column_stack([by_eta[:, None] * design, by_sd])
            slope = np.average(row, axis=0, weights=weights)
            # Nothing is known of how far a coefficient without an estimate is off, however flat p is there.
            slope[np.append((design != 0).any(axis=0), True) & unbounded] = np.nan
            slopes.append(slope)
        return np.array(values), np.array(slopes)

    weights, unbounded = model.freq_weights * model.trials, results.escape.unbounded
    p, jacobian = averages(theta)
    odds = logit(p)
    if method == "delta":
        on_logit = jacobian / (p * (1 - p))[:, None]

        def interval(centre: float, gradient: Array) -> tuple[float, float]:
            half = level * np.sqrt(np.maximum(variances(gradient[None], covariance)[0], 0.0))
            return centre - half, centre + half

        ends = [expit(interval(odds[i], on_logit[i])) for i in range(2)]
        difference = interval(p[0] - p[1], jacobian[0] - jacobian[1])
        ratio = np.exp(interval(odds[0] - odds[1], on_logit[0] - on_logit[1]))
    elif method == "simulation":
        if not isinstance(draws, (int, np.integer)) or draws < 2:
            raise located("draws", draws, "a whole number from 2")
        if np.isnan(covariance).any():
            raise located("method", method, "'delta': parameters without a finite estimate cannot be drawn")
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM,)))
        sample = rng.multivariate_normal(theta, covariance, size=draws, method="eigh")
        # Distinct pairs of rows only: a draw costs as much as a fit otherwise.
        both, times = np.unique(np.column_stack([first, second, model.offset]), axis=0, return_inverse=True)
        weights = np.bincount(times, weights)
        first, second = both[:, : first.shape[1]], both[:, first.shape[1] : -1]
        simulated = np.array([_average(first, second, both[:, -1], weights, row) for row in sample])
        tails = [alpha / 2, 1 - alpha / 2]
        ends = list(np.quantile(simulated, tails, axis=0).T)
        difference = np.quantile(simulated[:, 0] - simulated[:, 1], tails)
        ratio = np.exp(np.quantile(logit(simulated[:, 0]) - logit(simulated[:, 1]), tails))
    else:
        raise located("method", method, "'delta' or 'simulation'")
    return MarginalContrast(
        _words(setting), _words(reference),
        Estimate(p[0], *map(float, ends[0])), Estimate(p[1], *map(float, ends[1])),
        Estimate(p[0] - p[1], *map(float, difference)),
        Estimate(float(np.exp(odds[0] - odds[1])), *map(float, ratio)),
        _conditional(first - second, results.estimates, covariance, level), 1 - alpha,
    )  # fmt: skip


def _average(first: Array, second: Array, offset: Array, weights: Array, theta: Array) -> list[float]:
    return [
        float(np.average(mean_probability(offset + design @ theta[:-1], abs(theta[-1])), weights=weights))
        for design in (first, second)
    ]


def _conditional(shift: Array, theta: Array, covariance: Array, level: float) -> Estimate | None:
    """The odds ratio for one person, if it is the same in all rows."""
    row = shift[0]
    if not np.allclose(shift, row):
        return None
    centre = float(np.sum(row[row != 0] * theta[:-1][row != 0]))
    half = level * float(np.sqrt(np.maximum(variances(row[None], covariance[:-1, :-1])[0], 0.0)))
    return Estimate(float(np.exp(centre)), float(np.exp(centre - half)), float(np.exp(centre + half)))


def _check_settings(results: LogisticMixedResults, *settings: Any) -> None:
    kept(results.model, "exog", "marginal_contrast")
    for place, values in zip(("setting", "reference"), settings, strict=True):
        if not isinstance(values, Mapping):
            raise located(place, values, "variables and their values, as {'signal': 1}")
        for name, value in values.items():
            if np.ndim(value) != 0:
                raise located(f"{place}, {name}", Phrase(f"{np.size(value)} values"), "one value for all rows")
            if pd.isna(value):
                raise located(f"{place}, {name}", value, "a value")


def _set(results: LogisticMixedResults, values: Mapping[str, Any]) -> Array:
    """The design with some variables set in every row."""
    model = results.model
    frame = getattr(model.data, "frame", None)
    if frame is None or not hasattr(model, "formula"):
        names = [str(name) for name in model.exog_names]
        design = model.exog.copy()
        for name, value in values.items():
            if name not in names:
                raise located("setting", name, f"one of {', '.join(names)}")
            try:
                design[:, names.index(name)] = float(value)
            except (TypeError, ValueError):
                raise located(f"setting, {name}", value, "a number") from None
        return np.asarray(design)
    known = [str(column) for column in frame.columns]
    right = str(model.formula).split("~", 1)[1]
    for name in values:
        if name not in known:
            raise located("setting", name, f"one of the columns {', '.join(known)}")
        if not is_used(name, right):
            raise located("setting", name, f"a variable of the formula ({right.strip()}): this one changes nothing")
    rows = (
        frame if model.data.missing_row_idx is None else frame.drop(index=frame.index[model.data.missing_row_idx])
    )
    if len(rows) != len(model.endog):
        raise located("data", Phrase(f"{len(rows)} rows"), f"the {len(model.endog)} rows of the fit")
    return results.design_of(rows.assign(**values))[0]


def _words(values: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {_word(value)}" for name, value in values.items())


def _word(value: Any) -> str:
    """A value as it is said: four digits are enough of a quartile."""
    return f"{value:.4g}" if isinstance(value, float) and abs(value) < 1e4 else str(value)
