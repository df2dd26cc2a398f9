r"""Logistic mixed model with a random intercept, in the manner of statsmodels.

.. math::

   \operatorname{logit} P(y_{ij} = 1 \mid u_i) = o_{ij} + x_{ij}'\beta + \sigma u_i, \qquad u_i \sim N(0, 1)

Maximum likelihood by adaptive Gauss--Hermite quadrature (`models.glmm_kernel`), 25 nodes unless another number is
asked for; "laplace" is one node. With two or three binary outcomes a participant Laplace's approximation can be
badly wrong, so it is never chosen silently.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from scipy.special import expit
from statsmodels.base import model as base
from statsmodels.formula._manager import FormulaManager
from statsmodels.formula.formulatools import advance_eval_env

from models.errors import Phrase, located
from models.glmm_data import Array, Integers, Likelihood, Patterns, Rule
from models.glmm_formula import (
    column_error,
    named_column,
    numeric_outcome,
    outcome_columns,
    select_rows,
    split_groups,
)
from models.glmm_input import (
    check_counts,
    check_design,
    check_groups,
    check_numbers,
    counts_of,
    group_codes,
    optional_array,
    quadrature_nodes,
)
from models.glmm_marginal import mean_probability
from models.glmm_notes import notes_of
from models.glmm_optimise import maximise
from models.glmm_pickle import restore, state_of
from models.glmm_plain import PlainDesign
from models.glmm_results import LogisticMixedResults, LogisticMixedResultsWrapper

DEFAULT_NODES = 25
"""Quadrature nodes where none are asked for."""


class LogisticMixedModel(base.LikelihoodModel):
    """Logistic regression with a normal random intercept for every group.

    Parameters
    ----------
    endog : array_like [n] or [n, 2]
        0 or 1; counts of successes where `trials` is given; or successes and failures in two columns.
    exog : array_like [n, p]
        Covariates, with a column of ones for the intercept (formulas add it).
    groups : array_like [n]
        Labels; rows with the same label share an intercept.
    trials : array_like [n], optional
        Trials of each row.
    freq_weights : array_like [n], optional
        How often each row was observed, within its group; whole numbers.
    offset : array_like [n], optional
        Added to the linear predictor with coefficient 1.
    quadrature : int or "laplace"
        Nodes of the adaptive Gauss--Hermite rule.
    missing : {"none", "drop", "raise"}
        What happens to rows with missing values, here refused by "none" and "raise" alike.

    Attributes
    ----------
    successes, trials, freq_weights, offset : array [n]
    group_labels : Index [G]
    group_code : array [n]
        Position of each row's group in `group_labels`.
    group_name : str
    patterns : Patterns
        The data as the likelihood sees them.
    rule : Rule
    nobs : int
        Rows, counted by their weights.
    n_dropped : int
        Rows left out for missing values.

    Raises
    ------
    InputError
        For data that cannot be used, naming the place.

    Examples
    --------
    >>> import numpy as np, pandas as pd
    >>> rng = np.random.default_rng(1)
    >>> person = np.repeat(np.arange(200), 4)
    >>> signal = np.tile([0, 1], 400)
    >>> eta = 0.5 + signal + rng.normal(size=200)[person]
    >>> data = pd.DataFrame(
    ...     {"help": (rng.random(800) < 1 / (1 + np.exp(-eta))).astype(int), "signal": signal, "person": person}
    ... )
    >>> result = LogisticMixedModel.from_formula("help ~ signal + (1|person)", data).fit()
    >>> [str(name) for name in result.params.index]
    ['Intercept', 'signal', 'sd(person)']
    >>> bool(result.converged)
    True
    """

    _formula_max_endog = 2

    endog: Array
    exog: Array
    successes: Array
    trials: Array
    freq_weights: Array
    offset: Array
    group_code: Integers
    outcome_name: str
    patterns: Patterns
    rule: Rule
    df_model: int
    df_resid: int
    nobs: int

    def __init__(
        self,
        endog: Any,
        exog: Any,
        groups: Any = None,
        trials: Any = None,
        freq_weights: Any = None,
        offset: Any = None,
        quadrature: int | str = DEFAULT_NODES,
        missing: str = "none",
        **kwargs: Any,
    ) -> None:
        self.rule = Rule.hermite(quadrature_nodes(quadrature))
        self.group_name = str(kwargs.pop("group_name", None) or getattr(groups, "name", None) or "group")
        allowed = {"missing_idx", "formula", "model_spec", "hasconst"}
        if unknown := sorted(set(kwargs) - allowed):
            raise located("LogisticMixedModel", unknown[0], "one of its documented arguments")
        n_given = len(endog) if kwargs.get("missing_idx") is None else len(kwargs["missing_idx"])
        codes, labels = group_codes(groups, n_given)
        given = {"trials": trials, "freq_weights": freq_weights, "offset": offset}
        extras = {name: optional_array(value, n_given, name) for name, value in given.items()}
        check_numbers(endog, exog, {f"groups {self.group_name!r}": codes, **extras}, missing == "drop")
        super().__init__(endog, exog, missing=missing, group_code=codes, **extras, **kwargs)
        # What the base class recreates a model from.
        self._init_keys = ["groups", "trials", "freq_weights", "offset", "quadrature"]
        self._data_attr.extend(["group_code", "successes", "trials", "freq_weights", "offset", "patterns"])
        if self.exog.ndim == 1:
            self.exog = self.exog[:, None]
        counts = counts_of(self.endog, self.endog_names, self.trials)
        self.outcome_name, self.successes, self.trials, counted = counts
        self.freq_weights = np.ones(len(self.endog)) if self.freq_weights is None else self.freq_weights
        self.offset = np.zeros(len(self.endog)) if self.offset is None else self.offset
        # Groups that lost all their rows are groups no longer.
        present, code = np.unique(np.asarray(self.group_code, np.int64), return_inverse=True)
        self.group_code = code.astype(np.int64)
        self.group_labels = labels[present]
        self.n_dropped = n_given - len(self.endog)
        check_counts(self.successes, self.trials, self.freq_weights, self.outcome_name, counted)
        check_groups(self.group_code, self.trials, self.freq_weights, self.group_name)
        check_design(self.exog[self.freq_weights > 0], [str(name) for name in self.exog_names])
        self.patterns = Patterns.from_rows(
            self.exog, self.offset, self.successes, self.trials, self.freq_weights, self.group_code
        )
        self.nobs, self.k_extra = int(self.freq_weights.sum()), 1  # one parameter beside the coefficients
        self.df_model, self.df_resid = self.exog.shape[1] - self.k_constant, self.nobs - self.exog.shape[1] - 1
        self.data.param_names = [*map(str, self.exog_names), f"sd({self.group_name})"]

    @property
    def groups(self) -> Any:
        """Label of each row's group."""
        return np.asarray(self.group_labels)[self.group_code]

    @property
    def quadrature(self) -> int | str:
        """Nodes, or "laplace"."""
        return "laplace" if self.rule.n_nodes == 1 else self.rule.n_nodes

    @property
    def n_groups(self) -> int:
        """Number of groups."""
        return len(self.group_labels)

    @classmethod
    def from_formula(
        cls,
        formula: str,
        data: pd.DataFrame,
        groups: Any = None,
        subset: Any = None,
        drop_cols: Any = None,
        trials: Any = None,
        freq_weights: Any = None,
        offset: Any = None,
        quadrature: int | str = DEFAULT_NODES,
        missing: str = "drop",
        **kwargs: Any,
    ) -> LogisticMixedModel:
        """Make a model from a formula and a table.

        Parameters
        ----------
        formula : str
            ``outcome ~ covariates``, with ``(1|group)`` unless `groups` is given. The outcome is a column of 0 and
            1, a count beside `trials`, or ``successes + failures`` (also ``cbind(successes, failures)``). Read by
            the formula engine that ``statsmodels.formula.options.formula_engine`` names.
        data : DataFrame
        groups, trials, freq_weights, offset : str or array_like, optional
            Names of columns, or one value a row of `data`.
        subset : array_like, optional
            Rows to use, as for ``data.loc``.
        missing : {"drop", "raise"}
            Rows with a missing value in any variable used are left out and counted in `n_dropped`, or refused.

        Raises
        ------
        InputError
            For unknown columns, random terms other than ``(1|group)``, and data that cannot be used.
        """
        formula, groups = split_groups(formula, groups)
        formula = outcome_columns(formula)
        extras = {"groups": groups, "trials": trials, "freq_weights": freq_weights, "offset": offset}
        arrays = {key: named_column(data, value, key) for key, value in extras.items()}
        name = groups if isinstance(groups, str) else getattr(groups, "name", None) or "group"
        data, arrays, n_given = select_rows(numeric_outcome(formula, data), arrays, subset, missing == "drop")
        if drop_cols is None and (plain := PlainDesign.read(formula, data)) is not None:
            return plain.model(cls, formula, data, n_given, {**arrays, **kwargs, "group_name": name}, quadrature)
        advance_eval_env(kwargs)
        manager = FormulaManager()
        try:
            model = super().from_formula(
                formula, data, drop_cols=drop_cols, quadrature=quadrature, missing=missing, group_name=name,
                **arrays, **kwargs,
            )  # fmt: skip
        except (NameError, manager.factor_evaluation_error) as error:
            raise column_error(formula, data, error) from error
        model.n_dropped = n_given - len(model.endog)
        return model

    def __getstate__(self) -> dict[str, Any]:
        return state_of(self)

    def __setstate__(self, state: dict[str, Any]) -> None:
        restore(self, state)

    def loglike(self, params: Any) -> float:
        """Log-likelihood at (fixed effects, sd), binomial coefficients included."""
        return Likelihood(self.patterns, self.rule)(np.asarray(params, float))[0]

    def score(self, params: Any) -> Array:
        """Gradient of `loglike`, exact for the quadrature rule."""
        return Likelihood(self.patterns, self.rule)(np.asarray(params, float))[1]

    def score_obs(self, params: Any) -> Array:
        """Scores of the groups (the independent units), ``[G, p + 1]``, in the order of `group_labels`."""
        likelihood = Likelihood(self.patterns, self.rule)
        likelihood(np.asarray(params, float))
        return likelihood.scores[self.patterns.of_group]

    def loglikeobs(self, params: Any) -> Array:
        """Log-likelihoods of the groups ``[G]``, without binomial coefficients."""
        likelihood = Likelihood(self.patterns, self.rule)
        likelihood(np.asarray(params, float))
        return likelihood.values[self.patterns.of_group]

    def hessian(self, params: Any) -> Array:
        """Second derivatives of `loglike`: central differences of the exact gradient."""
        return Likelihood(self.patterns, self.rule).hessian(np.asarray(params, float))

    def information(self, params: Any) -> Array:
        """Observed information, minus the Hessian."""
        return -self.hessian(params)

    def fit(
        self,
        starts: Sequence[float] | None = None,
        max_iterations: int = 200,
        cov_type: str = "model",
        warn: bool = True,
    ) -> Any:
        """Maximise the likelihood.

        Parameters
        ----------
        starts : sequence of float, optional
            Standard deviations at which searches start, two unless told; the best maximum is kept.
        max_iterations : int
            Of each search.
        cov_type : {"model", "robust"}
            Covariance behind standard errors, tests and intervals: inverse information, or the sandwich over
            groups (`models.glmm_robust`).
        warn : bool
            Whether `LogisticMixedResults.notes` are raised as warnings too.

        Returns
        -------
        LogisticMixedResults (wrapped, so that vectors carry names)
        """
        if starts is not None and (not len(starts) or min(starts) <= 0):
            raise located("starts", tuple(starts), "positive standard deviations")
        best = maximise(self.patterns, self.rule, starts, max_iterations)
        results = LogisticMixedResults(self, best, cov_type)
        results.notes = notes_of(results)
        if warn:
            for note in results.notes:
                warnings.warn(note.text, note.category, stacklevel=2)
        return LogisticMixedResultsWrapper(results)

    def predict(
        self,
        params: Any,
        exog: Any = None,
        which: str = "marginal",
        offset: Any = None,
        intercepts: Any = None,
    ) -> Array:
        """Predictions at given parameters; see `LogisticMixedResults.predict`.

        Parameters
        ----------
        intercepts : array [rows], optional
            Random intercepts on the logit scale (sigma u), for "conditional" and "linear".
        """
        params = np.asarray(params, float)
        if exog is None:
            exog, offset = self.exog, self.offset if offset is None else offset
        exog = np.atleast_2d(np.asarray(exog, float))
        eta = exog @ params[:-1]
        if offset is not None:
            eta = eta + optional_array(np.broadcast_to(offset, eta.shape), len(eta), "offset")
        if which == "marginal":
            if intercepts is not None:
                raise located("predict", Phrase("'marginal' with groups"), "'conditional' or 'linear' for groups")
            return mean_probability(eta, abs(params[-1]))
        if intercepts is not None:
            eta = eta + intercepts
        if which == "linear":
            return eta
        if which == "conditional":
            return np.asarray(expit(eta))
        raise located("which", which, "'marginal', 'conditional' or 'linear'")
