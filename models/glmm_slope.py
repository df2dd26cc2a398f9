r"""Logistic mixed model with random slopes, by Laplace's approximation.

.. math::

   \operatorname{logit} P(y_{ij} = 1 \mid u_i) = o_{ij} + x_{ij}'\beta + z_{ij}'\Lambda u_i, \qquad u_i \sim N(0, I)

lme4's ``(1 + x | g)``, and with effects that are not correlated ``(x || g)`` or ``(1 | g) + (0 + x | g)``.
Quadrature over several effects would cost a power of the nodes, so there is Laplace's approximation only, which
with few binary outcomes a group can be badly wrong (`models.glmm`): it must be asked for by name.
"""

from __future__ import annotations

import warnings
from copy import copy
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.optimize import minimize
from statsmodels.base import model as base
from statsmodels.formula._manager import FormulaManager

from models.errors import InputError, Phrase, located
from models.glmm_coordinates import Coordinates
from models.glmm_data import Array
from models.glmm_formula import column_error, quoted_names
from models.glmm_input import redundant_columns
from models.glmm_optimise import negative_definite
from models.glmm_pickle import restore, state_of
from models.glmm_slope_likelihood import SlopeLikelihood
from models.glmm_slope_results import LogisticSlopeResults
from models.glmm_wrapper import LogisticMixedResultsWrapper

if TYPE_CHECKING:
    from models.glmm import LogisticMixedModel
    from models.glmm_slope_terms import RandomTerms

SPREADS = (0.3, 1.0)
"""Standard deviations of slopes, in units of their column, at which searches start."""

STEP = 1e-7
"""Standard errors left at which Newton's steps end."""

CLOSED = 1e-3
"""Entry of a standardised Lambda, in units of the logit, below which a direction has no variance."""


@dataclass(frozen=True)
class SlopeMaximum:
    """The best maximum found, in the parameters (beta, entries of Lambda).

    Attributes
    ----------
    theta : array
    value : float
    covariance : array
        Inverse of minus the Hessian; zero for entries at zero in a singular fit.
    converged : bool
    ends : tuple of float
        Log-likelihoods at which searches ended.
    """

    theta: Array
    value: float
    covariance: Array
    converged: bool
    ends: tuple[float, ...]


class LogisticSlopeModel(base.LikelihoodModel):
    """Logistic mixed model with random slopes; made by `models.glmm.LogisticMixedModel.from_formula`.

    Attributes
    ----------
    fixed : LogisticMixedModel
        The same with a random intercept: outcomes, groups, design.
    random : array [n, q]
        Columns of the random effects.
    effects : tuple of str
        Their names.
    blocks : tuple of tuple of int
        Effects that are correlated with each other.
    """

    def __init__(
        self,
        fixed: LogisticMixedModel,
        random: pd.DataFrame,
        blocks: tuple[tuple[int, ...], ...],
        formulas: tuple[str, ...],
    ) -> None:
        super().__init__(fixed.endog, fixed.exog)
        self.fixed, self.random, self.blocks, self.formulas = fixed, random.to_numpy(float), blocks, formulas
        self.effects = tuple(map(str, random.columns))
        self.data, self.formula = copy(fixed.data), fixed.formula
        self.group_name, self.outcome_name, self.nobs = fixed.group_name, fixed.outcome_name, fixed.nobs
        self.offset, self.offset_term, self.n_dropped = fixed.offset, fixed.offset_term, fixed.n_dropped
        self.entries = tuple((i, j) for block in blocks for i in block for j in block if j <= i)
        self.pairs = tuple((j, i) for i, j in self.entries if j < i)
        self.df_model, self.k_extra = fixed.df_model, len(self.entries)
        self.df_resid = self.nobs - self.exog.shape[1] - len(self.entries)
        name = self.group_name
        sds = [f"sd({name})" if e == "Intercept" else f"sd({name}: {e})" for e in self.effects]
        correlations = [f"corr({name}: {self.effects[i]}, {self.effects[j]})" for i, j in self.pairs]
        self.names = [*map(str, fixed.exog_names), *sds, *correlations]
        self.data.param_names = self.names

    @classmethod
    def read(
        cls, kind: type[LogisticMixedModel], terms: RandomTerms, data: pd.DataFrame, options: dict[str, Any]
    ) -> LogisticSlopeModel:
        """Make the model of a formula's random terms; `options` are those of `LogisticMixedModel.from_formula`.

        Raises
        ------
        InputError
        """
        if str(options["quadrature"]).lower() != "laplace":
            raise located(
                "quadrature", options["quadrature"], "'laplace', by name: there is no other rule for random slopes"
            )
        for name in ("groups", "subset", "drop_cols"):
            if options.pop(name, None) is not None:
                wanted = "random slopes without it: groups in the formula, rows chosen before"
                raise located(name, Phrase("given"), wanted)
        data = data.reset_index(drop=True)
        formulas = tuple(quoted_names(block) for block in terms.blocks)
        parts = [_columns(formula, data) for formula in formulas]
        random = pd.concat(parts, axis=1)
        if random.columns.duplicated().any():
            twice = random.columns[random.columns.duplicated()][0]
            raise located("random effects", Phrase(f"{twice} twice"), "each effect in one term")
        whole = random.notna().all(axis=1)
        if not whole.all() and options["missing"] == "raise":
            raise located("random effects, row", int(np.argmin(whole)) + 1, "no missing value (missing='raise')")
        arrays = {k: v for k, v in options.items() if k in ("trials", "freq_weights", "offset") and np.ndim(v)}
        for name, values in arrays.items():
            options[name] = np.asarray(values)[whole.to_numpy()]
        fixed = kind.from_formula(terms.fixed, data[whole], **options)
        fixed.n_dropped += int((~whole).sum())
        random = random.loc[fixed.data.row_labels]
        redundant = redundant_columns(random.to_numpy(float))
        if redundant:
            name = Phrase(str(random.columns[redundant[0]]))
            raise located("random effects", name, "columns that vary on their own")
        number = np.cumsum([0, *(part.shape[1] for part in parts)])
        blocks = tuple(tuple(range(a, b)) for a, b in pairwise(map(int, number)))
        if terms.separate:
            blocks = tuple((i,) for i in range(random.shape[1]))
        return cls(fixed, random, blocks, formulas)

    def __getstate__(self) -> dict[str, Any]:
        return state_of(self)

    def __setstate__(self, state: dict[str, Any]) -> None:
        restore(self, state)

    def random_columns(self, rows: pd.DataFrame | None) -> Array:
        """Columns of the random effects, of new rows or the fit's own."""
        if rows is None:
            return self.random
        return np.hstack([_columns(f, self.fixed.data.frame, rows).to_numpy(float) for f in self.formulas])

    def likelihood(self, coordinates: Coordinates, scale: Array) -> SlopeLikelihood:
        """The likelihood in working columns: of the design by coordinates, of the random effects over `scale`."""
        model = self.fixed
        order = np.argsort(model.group_code, kind="stable")
        used = order[model.freq_weights[order] > 0]
        code = model.group_code[used]
        weights = model.freq_weights[used]
        return SlopeLikelihood(
            coordinates.apply(self.exog)[used], model.offset[used], weights * model.successes[used],
            weights * model.trials[used], self.random[used] / scale,
            np.flatnonzero(np.append(True, np.diff(code) != 0)), self.entries, model.patterns.constant,
        )  # fmt: skip

    def fit(self, warn: bool = True, max_iterations: int = 500) -> Any:
        """Maximise Laplace's likelihood from several standard deviations of the slopes.

        Parameters
        ----------
        warn : bool
            Whether the notes of the results are raised as warnings too.
        max_iterations : int
            Of each search.

        Returns
        -------
        LogisticSlopeResults (wrapped, so that vectors carry names)
        """
        results = LogisticSlopeResults(self, self.maximise(max_iterations))
        if warn:
            for note in results.notes:
                warnings.warn(note.text, note.category, stacklevel=2)
        return LogisticMixedResultsWrapper(results)

    def maximise(self, max_iterations: int = 500) -> SlopeMaximum:
        """The best maximum, from the fit with a random intercept."""
        begin = self.fixed.fit(warn=False)._results
        coordinates = Coordinates.of(self.exog)
        scale = np.sqrt(np.mean(self.random**2, axis=0))
        likelihood = self.likelihood(coordinates, scale)
        p = self.exog.shape[1]
        beta = coordinates.forward(np.append(begin.params[:-1], 0.0))[:-1]
        beta = beta if np.isfinite(beta).all() and np.abs(beta).max() < 50 else np.zeros(p)
        found = []
        for spread in SPREADS:
            start = np.concatenate([beta, [0.0 if i != j else spread for i, j in self.entries]])
            for k, (i, j) in enumerate(self.entries):
                if i == j and self.effects[i] == "Intercept":
                    start[p + k] = min(max(begin.sd, 0.3), 5.0)
            options = {"maxiter": max_iterations, "gtol": 1e-5}
            found.append(minimize(partial(_negative, likelihood), start, jac=True, method="BFGS", options=options))
        best = min(found, key=lambda f: f.fun)
        theta, value, covariance, converged = _newton(likelihood, np.asarray(best.x), p)
        out = np.eye(len(theta))
        out[:p, :p] = coordinates.matrix[:-1, :-1]
        for k, (i, _) in enumerate(self.entries):
            out[p + k, p + k] = 1.0 / scale[i]
        return SlopeMaximum(
            out @ theta, value, out @ covariance @ out.T, converged, tuple(float(-f.fun) for f in found)
        )


def _columns(formula: str, data: pd.DataFrame, rows: pd.DataFrame | None = None) -> pd.DataFrame:
    """Design of a random term, NaN where a value is missing; of other rows as the table was coded."""
    manager = FormulaManager()
    try:
        design = manager.get_matrices(formula, data, pandas=True)
        if rows is not None:
            rows = rows.reset_index(drop=True)
            design = manager.get_matrices(manager.spec, rows, pandas=True, prediction=True)
    except InputError:
        raise
    except Exception as error:  # engines raise what they like
        raise column_error(formula, data, error) from error
    return pd.DataFrame(design).reindex((data if rows is None else rows).index)


def _negative(likelihood: SlopeLikelihood, theta: Array) -> tuple[float, Array]:
    value, gradient = likelihood(theta)
    return -value, -gradient


def _newton(likelihood: SlopeLikelihood, theta: Array, p: int) -> tuple[Array, float, Array, bool]:
    """Newton's steps from near the top; entries of Lambda that are zero there stay so, as they do by symmetry."""
    theta = theta.copy()
    diagonal = np.array([i == j for i, j in likelihood.entries])
    converged = False
    for _ in range(20):
        small = np.abs(theta[p:]) < CLOSED
        trial = theta.copy()
        trial[p:][small & diagonal] = 0.0
        if likelihood(trial)[0] >= likelihood(theta)[0] - 1e-6:
            theta = trial
        fixed = np.append(np.zeros(p, bool), diagonal & (theta[p:] == 0.0))
        # A row of Lambda before a column without variance is not determined: nor is what stands below a zero.
        empty = {j for (i, j), zero in zip(likelihood.entries, fixed[p:], strict=True) if i == j and zero}
        below = [j in empty and abs(theta[p + k]) < CLOSED for k, (_, j) in enumerate(likelihood.entries)]
        fixed[p:] |= np.array(below)
        theta[fixed] = 0.0
        free = np.flatnonzero(~fixed)
        hessian = likelihood.hessian(theta)[np.ix_(free, free)]
        value, gradient = likelihood(theta)
        if not negative_definite(hessian):
            break
        step = np.linalg.solve(-hessian, gradient[free])
        if gradient[free] @ step <= STEP**2:
            converged = True
            break
        length = 1.0
        while length > 1e-6:
            trial = theta.copy()
            trial[free] += length * step
            if likelihood(trial)[0] >= value - 1e-12 * abs(value):
                break
            length *= 0.5
        theta = trial
    covariance = np.full((len(theta), len(theta)), np.nan)
    if converged:
        covariance = np.zeros((len(theta), len(theta)))
        covariance[np.ix_(free, free)] = np.linalg.inv(-hessian)
    return theta, float(likelihood(theta)[0]), covariance, converged
