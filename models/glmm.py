r"""Logistic mixed model with a random intercept, in the manner of statsmodels.

.. math::

   \operatorname{logit} P(y_{ij} = 1 \mid u_i) = o_{ij} + x_{ij}'\beta + \sigma u_i, \qquad u_i \sim N(0, 1)

Maximum likelihood by adaptive Gauss--Hermite quadrature (`models.glmm_kernel`), 25 nodes unless another number is
asked for; "laplace" is one node. With two or three binary outcomes a participant Laplace's approximation can be
badly wrong, so it is never chosen silently.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from formulaic.errors import FormulaSyntaxError
from statsmodels.formula._manager import FormulaManager
from statsmodels.formula.formulatools import advance_eval_env

from models.errors import InputError, located
from models.glmm_arguments import check_iterations, check_known, check_start_params, check_starts
from models.glmm_data import Array, Integers, Patterns, Rule
from models.glmm_formula import column_error
from models.glmm_functions import LikelihoodFunctions
from models.glmm_gaps import check_columns, engine_error, terms_without_numbers
from models.glmm_input import (
    check_counts,
    check_design,
    check_groups,
    check_numbers,
    counts_of,
    group_codes,
    kept,
    per_row,
    quadrature_nodes,
)
from models.glmm_notes import notes_of
from models.glmm_optimise import maximise
from models.glmm_pickle import restore, state_of
from models.glmm_plain import PlainDesign
from models.glmm_prediction import predict_rows
from models.glmm_results import LogisticMixedResults
from models.glmm_slope import LogisticSlopeModel
from models.glmm_slope_terms import RandomTerms
from models.glmm_table import check_missing, check_rows_left, is_used, numeric_table, read_table, table_of
from models.glmm_wrapper import LogisticMixedResultsWrapper

DEFAULT_NODES = 25
"""Quadrature nodes where none are asked for."""


class LogisticMixedModel(LikelihoodFunctions):
    """Logistic regression with a normal random intercept for every group.

    Parameters
    ----------
    endog : array_like [n] or [n, 2]
        0 or 1; counts of successes where `trials` is given; or successes and failures in two columns.
    exog : array_like [n, p]
        Covariates, with a column of ones for the intercept (formulas add it).
    groups : array_like [n]
        Labels; rows with the same label share an intercept.
    trials : array_like [n] or number, optional
        Trials of each row, or of all.
    freq_weights : array_like [n] or number, optional
        How often each row was observed, within its group; whole numbers.
    offset : array_like [n] or number, optional
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
    dropped_by_terms : dict of str to int
        How many of these had all values, by the column of the design that is no number in them.
    offset_term : str or None
        The offset of the formula.

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
    offset_term: str | None = None
    dropped_by_terms: Mapping[str, int] = MappingProxyType({})

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
        check_missing(missing, ("none", "drop", "raise"))
        endog, exog = numeric_table(endog, "outcome"), numeric_table(exog, "covariate")
        n_given = len(endog) if kwargs.get("missing_idx") is None else len(kwargs["missing_idx"])
        if not len(endog):
            check_rows_left([], n_given, pd.DataFrame())
        codes, labels = group_codes(groups, n_given)
        given = {"trials": trials, "freq_weights": freq_weights, "offset": offset}
        extras = {name: per_row(value, n_given, name) for name, value in given.items()}
        check_numbers(endog, exog, {f"groups {self.group_name!r}": codes, **extras}, missing == "drop")
        if missing == "drop" and kwargs.get("missing_idx") is None:
            check_rows_left([endog, exog, codes, *extras.values()], n_given)
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
        return np.asarray(self.group_labels)[kept(self, "group_code", "groups")]

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
    ) -> Any:
        """Make a model from a formula and a table.

        Parameters
        ----------
        formula : str
            ``outcome ~ covariates``, with ``(1|group)`` unless `groups` is given, and ``offset(...)`` if there is
            one. The outcome is a column of 0 and
            1, a count beside `trials`, or ``successes + failures`` (also ``cbind(successes, failures)``). Read by
            the formula engine that ``statsmodels.formula.options.formula_engine`` names.
        data : DataFrame or dict of columns
            Columns may be of pandas' nullable types.
        groups, trials, freq_weights, offset : str or array_like, optional
            Names of columns, or one value a row of `data`; but for the groups also one number for all rows.
        subset : array_like, optional
            Rows to use, as for ``data.loc``.
        missing : {"drop", "raise"}
            Rows with a missing value in any variable used are left out and counted in `n_dropped`, or refused.

        Raises
        ------
        InputError
            For unknown columns, several groups, and data that cannot be used.

        Returns
        -------
        LogisticMixedModel, or with ``(1 + x|group)``, ``(x||group)`` and the like LogisticSlopeModel
            The second by ``quadrature="laplace"`` only (`models.glmm_slope`).
        """
        given = {"groups": groups, "trials": trials, "freq_weights": freq_weights, "offset": offset}
        if isinstance(formula, str) and (terms := RandomTerms.read(formula)) is not None:
            options = {**given, "subset": subset, "drop_cols": drop_cols, "quadrature": quadrature, **kwargs}
            return LogisticSlopeModel.read(cls, terms, table_of(data), options | {"missing": missing})
        formula, data, arrays, n_given, name, term, lost = read_table(formula, data, given, subset, missing)
        if drop_cols is None and (plain := PlainDesign.read(formula, data)) is not None:
            named = {**arrays, **kwargs, "group_name": name}
            plain_model: LogisticMixedModel = plain.model(cls, formula, data, n_given, named, quadrature)
            plain_model.offset_term, plain_model.dropped_by_terms = term, lost
            return plain_model
        check_columns(formula, data, missing)
        check_rows_left([data[column] for column in data.columns if is_used(column, formula)], n_given, data)
        advance_eval_env(kwargs)
        manager = FormulaManager()
        try:
            model = super().from_formula(
                formula, data, drop_cols=drop_cols, quadrature=quadrature, missing=missing, group_name=name,
                **arrays, **kwargs,
            )  # fmt: skip
        except InputError:
            raise
        except (NameError, SyntaxError, ValueError, FormulaSyntaxError, manager.factor_evaluation_error) as error:
            raise engine_error(formula, data, error) or column_error(formula, data, error) from error
        model.n_dropped, model.offset_term = n_given - len(model.endog), term
        model.dropped_by_terms = {**lost, **terms_without_numbers(model, formula, data)}
        return model

    def __getstate__(self) -> dict[str, Any]:
        return state_of(self)

    def __setstate__(self, state: dict[str, Any]) -> None:
        restore(self, state)

    def fit(
        self,
        starts: Sequence[float] | None = None,
        max_iterations: int = 200,
        cov_type: str = "model",
        warn: bool = True,
        start_params: Any = None,
        method: str | None = None,
        maxiter: int | None = None,
        disp: Any = 0,
        **others: Any,
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
        start_params : array_like [p + 1], optional
            Fixed effects and a positive standard deviation at which one search more starts.
        method : {"bfgs"}, optional
            As in statsmodels; there is no other.
        maxiter : int, optional
            statsmodels' name of `max_iterations`.
        disp : bool
            Accepted for statsmodels' sake: nothing is printed, see `LogisticMixedResults.notes`.

        Returns
        -------
        LogisticMixedResults (wrapped, so that vectors carry names)

        Raises
        ------
        InputError
            For arguments that are out of range or unknown, and after `remove_data`.
        """
        check_known(method, others)
        iterations = check_iterations(max_iterations if maxiter is None else maxiter)
        starts = check_starts(starts)
        start = None if start_params is None else check_start_params(self._parameters(start_params))
        best = maximise(kept(self, "patterns", "fit"), self.rule, starts, iterations, start)
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
        return predict_rows(self, self._parameters(params), exog, which, offset, intercepts)
