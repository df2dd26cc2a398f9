r"""Logistic mixed model with random slopes, by Laplace's approximation.

.. math::

   \operatorname{logit} P(y_{ij} = 1 \mid u_i) = o_{ij} + x_{ij}'\beta + z_{ij}'\Lambda u_i, \qquad u_i \sim N(0, I)

lme4's ``(1 + x | g)``, and with effects that are not correlated ``(x || g)`` or ``(1 | g) + (0 + x | g)``.
Quadrature over several effects would cost a power of the nodes, so there is Laplace's approximation only, which
with few binary outcomes a group can be badly wrong (`models.glmm`): it must be asked for by name.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from copy import copy
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from statsmodels.base import model as base

from models.errors import Phrase, located
from models.glmm_arguments import check_iterations, check_known
from models.glmm_coordinates import Coordinates
from models.glmm_data import Array
from models.glmm_formula import quoted_names
from models.glmm_input import check_complete, redundant_columns
from models.glmm_pickle import restore, state_of
from models.glmm_slope_design import RandomDesign, lost_rows, new_columns
from models.glmm_slope_likelihood import SlopeLikelihood
from models.glmm_slope_results import LogisticSlopeResults
from models.glmm_slope_search import maximise_slopes
from models.glmm_table import check_rows_left, is_used, plain_columns
from models.glmm_wrapper import LogisticMixedResultsWrapper

if TYPE_CHECKING:
    from models.glmm import LogisticMixedModel
    from models.glmm_slope_terms import RandomTerms


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
        data = plain_columns(data, " + ".join(formulas))
        terms_of = [
            RandomDesign.of(formula, data, options["missing"], separate)
            for formula, separate in zip(formulas, terms.separate, strict=True)
        ]
        random = pd.concat([term.columns for term in terms_of], axis=1)
        if random.columns.duplicated().any():
            twice = random.columns[random.columns.duplicated()][0]
            raise located("random effects", Phrase(f"{twice} twice"), "each effect in one term")
        whole = random.notna().all(axis=1)
        if not whole.any():
            check_rows_left([random], len(data), data[[c for c in data.columns if is_used(c, " ".join(formulas))]])
        if not whole.all() and options["missing"] == "raise":
            raise located("random effects, row", int(np.argmin(whole)) + 1, "no missing value (missing='raise')")
        arrays = {k: v for k, v in options.items() if k in ("trials", "freq_weights", "offset") and np.ndim(v)}
        for name, values in arrays.items():
            options[name] = np.asarray(values)[whole.to_numpy()]
        lost = lost_rows(terms_of, data, " ".join([terms.fixed, *formulas]))
        fixed = kind.from_formula(terms.fixed, data[whole], **options)
        fixed.n_dropped += int((~whole).sum())
        fixed.dropped_by_terms = {**fixed.dropped_by_terms, **lost}
        random = random.loc[fixed.data.row_labels]
        check_complete({f"random effects, {name}": random[name].to_numpy(float) for name in random})
        redundant = redundant_columns(random.to_numpy(float))
        if redundant:
            name = Phrase(str(random.columns[redundant[0]]))
            raise located("random effects", name, "columns that vary on their own")
        sizes = [size for term in terms_of for size in term.blocks]
        number = np.cumsum([0, *sizes])
        blocks = tuple(tuple(range(a, b)) for a, b in pairwise(map(int, number)))
        return cls(fixed, random, blocks, formulas)

    @property
    def dropped_by_terms(self) -> Mapping[str, int]:
        """Rows left out though all their values were there, by the column that is no number in them."""
        return self.fixed.dropped_by_terms

    def __getstate__(self) -> dict[str, Any]:
        return state_of(self)

    def __setstate__(self, state: dict[str, Any]) -> None:
        restore(self, state)

    def random_columns(self, rows: pd.DataFrame | None) -> Array:
        """Columns of the random effects, of new rows or the fit's own."""
        if rows is None:
            return self.random
        return np.hstack([new_columns(f, self.fixed.data.frame, rows) for f in self.formulas])

    def likelihood(
        self,
        coordinates: Coordinates,
        scale: Array,
        rows: NDArray[np.bool_] | None = None,
        columns: Sequence[int] | None = None,
    ) -> SlopeLikelihood:
        """The likelihood in working columns: of the design by coordinates, of the random effects over `scale`.

        Of all rows and columns of the design, or of those given.
        """
        model = self.fixed
        design = self.exog if columns is None else self.exog[:, list(columns)]
        order = np.argsort(model.group_code, kind="stable")
        counted = model.freq_weights > 0
        used = order[(counted if rows is None else counted & rows)[order]]
        code = model.group_code[used]
        weights = model.freq_weights[used]
        return SlopeLikelihood(
            coordinates.apply(design)[used], model.offset[used], weights * model.successes[used],
            weights * model.trials[used], self.random[used] / scale,
            np.flatnonzero(np.append(True, np.diff(code) != 0)), self.entries, model.patterns.constant,
        )  # fmt: skip

    def fit(
        self,
        warn: bool = True,
        max_iterations: int = 500,
        cov_type: str = "model",
        method: str | None = None,
        maxiter: int | None = None,
        disp: Any = 0,
        **others: Any,
    ) -> Any:
        """Maximise Laplace's likelihood from several standard deviations of the slopes.

        Parameters
        ----------
        warn : bool
            Whether the notes of the results are raised as warnings too.
        max_iterations, maxiter : int
            Of each search.
        cov_type : {"model"}
            Inverse information.
        method : {"bfgs"}, optional
        disp : bool
            Accepted for statsmodels' sake: nothing is printed.

        Returns
        -------
        LogisticSlopeResults (wrapped, so that vectors carry names)

        Raises
        ------
        InputError
            For arguments that are out of range, unknown, or for a random intercept only.
        """
        if others:
            wanted = "one of max_iterations (or maxiter), warn, method, disp: searches choose where they start"
            raise located("fit", Phrase(f"the argument {next(iter(others))}"), wanted)
        check_known(method, {})
        if cov_type != "model":
            raise located("cov_type", cov_type, "'model': random slopes have no other covariance")
        iterations = check_iterations(max_iterations if maxiter is None else maxiter)
        results = LogisticSlopeResults(self, maximise_slopes(self, iterations))
        if warn:
            for note in results.notes:
                warnings.warn(note.text, note.category, stacklevel=2)
        return LogisticMixedResultsWrapper(results)
