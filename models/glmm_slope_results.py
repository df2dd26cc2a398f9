"""What a fit with random slopes knows: the statsmodels surface, without what exists for one intercept only."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.special import expit
from scipy.stats import chi2, norm
from statsmodels.base import model as base
from statsmodels.stats.contrast import ContrastResults
from statsmodels.tools._decorators import cache_readonly

from models.errors import Phrase, located
from models.glmm_arguments import check_alpha, positions_of
from models.glmm_comparison import about_fixed_effects, check_comparable, untestable
from models.glmm_coordinates import Coordinates
from models.glmm_data import Array
from models.glmm_input import per_row, unwrapped
from models.glmm_prediction import design_of, offset_of
from models.glmm_slope_effects import averaged_probabilities, natural_parameters
from models.glmm_slope_likelihood import SlopeLikelihood
from models.glmm_slope_summary import slope_notes, slope_summary
from models.glmm_table import table_of
from models.glmm_view import fit_view
from models.notebook_view import NotebookView, View

if TYPE_CHECKING:
    from models.glmm_escape import Escape
    from models.glmm_slope import LogisticSlopeModel
    from models.glmm_slope_search import SlopeMaximum

SINGULAR = 1e-3
"""Standard deviation of a combination of effects, in units of the logit, below which it is called zero."""

ABSENT = "random slopes have Wald intervals only; drop the slope for profile intervals, quadrature and simulation"


class LogisticSlopeResults(base.LikelihoodModelResults, base.ResultMixin, NotebookView):
    """Results of a model with random slopes, by Laplace's approximation.

    Attributes
    ----------
    params : array
        Fixed effects, standard deviations of the random effects, correlations of those of one term.
    maximum : SlopeMaximum
    covariance : array [q, q]
        Of the random effects.
    singular : bool
        Some combination of the random effects has no variance: a standard deviation of 0, or a correlation of 1.
    escape : Escape
        Which parameters have no finite estimate (separated data): NaN stands for their errors and intervals.
    notes : tuple of Note
    """

    cov_type = "model"

    def __init__(self, model: LogisticSlopeModel, maximum: SlopeMaximum) -> None:
        self._cache: dict[str, Any] = {}
        self.maximum, p = maximum, model.exog.shape[1]
        self.nobs, self.df_model, self.df_resid = model.nobs, model.df_model, model.df_resid
        lower = np.zeros((len(model.effects),) * 2)
        lower[tuple(np.array(model.entries).T)] = maximum.theta[p:]
        self.covariance = lower @ lower.T
        size = np.sqrt(np.mean(model.random**2, axis=0))
        smallest = np.linalg.svd(lower * size[:, None], compute_uv=False)[-1]
        self.singular = bool(smallest < SINGULAR)
        params, jacobian = natural_parameters(model, maximum.theta)
        found = jacobian @ np.nan_to_num(maximum.covariance) @ jacobian.T
        without = np.isnan(np.diag(maximum.covariance))
        without[p:] = without[p:].any()  # a standard deviation has errors of several entries
        found[without], found[:, without] = np.nan, np.nan
        if self.singular:
            found[p:], found[:, p:] = np.nan, np.nan
        self.has_offset = bool(model.offset.any())
        super().__init__(model, params, normalized_cov_params=found)
        self.escape: Escape = maximum.escape
        self.notes = slope_notes(self)

    # -- estimates ---------------------------------------------------------------------------------
    @property
    def converged(self) -> bool:
        """Whether a maximum was found; not where a parameter runs off."""
        return self.maximum.converged and not self.escape.any

    @property
    def comparable(self) -> bool:
        """Whether `llf` is the highest that the likelihood takes or tends to, so that it can be compared."""
        return self.maximum.converged

    @property
    def llf(self) -> float:
        """Laplace's log-likelihood, binomial coefficients included; what it rises to where parameters run off."""
        return self.maximum.value

    @property
    def fe_params(self) -> Array:
        """Fixed effects."""
        return np.asarray(self.params[: self.model.exog.shape[1]])

    @property
    def estimates(self) -> Array:
        """`params`, but where a parameter runs to (infinity, or NaN) and not where the search for it stopped."""
        out, unbounded = np.array(self.params, float), self.escape.unbounded
        out[unbounded] = np.array([-np.inf, np.nan, np.inf])[self.escape.signs[unbounded] + 1]
        return out

    def cov_params(
        self,
        r_matrix: Any = None,
        column: Any = None,
        scale: Any = None,
        cov_p: Any = None,
        other: Any = None,
        kind: str = "model",
    ) -> Array:
        """Covariance of the estimates, or of linear combinations of them (statsmodels' arguments).

        Raises
        ------
        InputError
            For another `kind` than "model".
        """
        if kind != "model":
            raise located("kind", kind, "'model': random slopes have no other covariance")
        if r_matrix is None or not self.escape.any:
            return np.asarray(super().cov_params(r_matrix, column, scale, cov_p, other))
        return self.escape.combinations(np.asarray(super().cov_params(scale=scale, cov_p=cov_p)), r_matrix, other)

    @cache_readonly
    def bse(self) -> Array:
        """Standard errors; NaN for the variance parameters of a singular fit, and without a maximum."""
        with np.errstate(invalid="ignore"):
            return np.sqrt(np.diag(self.cov_params()))

    @cache_readonly
    def tvalues(self) -> Array:
        """Wald statistics z of the fixed effects; NaN for the others."""
        out = np.full(len(self.params), np.nan)
        p = len(self.fe_params)
        out[:p] = self.fe_params / self.bse[:p]
        return out

    @cache_readonly
    def pvalues(self) -> Array:
        """Two-sided p of the fixed effects; NaN for the others."""
        return np.asarray(2 * norm.sf(np.abs(self.tvalues)))

    def conf_int(self, alpha: float = 0.05, method: str = "wald", which: Any = None, cols: Any = None) -> Array:
        """Wald intervals, cut off at 0 for standard deviations and at -1 and 1 for correlations.

        Raises
        ------
        InputError
            For other kinds: there are none.
        """
        check_alpha(alpha)
        if method != "wald" or which is not None:
            raise located("method", method, f"'wald': {ABSENT}")
        half = norm.ppf(1 - alpha / 2) * self.bse
        ends = np.column_stack([self.params - half, self.params + half])
        p, q = len(self.fe_params), len(self.model.effects)
        ends[p : p + q] = np.maximum(ends[p : p + q], 0.0)
        ends[p + q :] = np.clip(ends[p + q :], -1.0, 1.0)
        return ends if cols is None else ends[positions_of(cols, self.model.names)]

    def odds_ratios(self, alpha: float = 0.05) -> pd.DataFrame:
        """Odds ratios for one and the same group, with Wald intervals."""
        p = len(self.fe_params)
        with np.errstate(over="ignore"):  # separated data: infinity is what is meant
            ends, ratios = np.exp(self.conf_int(alpha)[:p]), np.exp(self.estimates[:p])
        columns = {
            "odds ratio": ratios, "lower": ends[:, 0], "upper": ends[:, 1], "z": self.tvalues[:p],
            "p": self.pvalues[:p],
        }  # fmt: skip
        return pd.DataFrame(columns, index=self.model.names[:p])

    # -- tests -------------------------------------------------------------------------------------
    def t_test(self, r_matrix: Any, cov_p: Any = None, use_t: Any = None) -> Any:
        """Test linear hypotheses about the fixed effects by z (statsmodels' arguments)."""
        return super().t_test(self._about_fixed(r_matrix), cov_p=cov_p, use_t=use_t)

    def wald_test(self, r_matrix: Any, *args: Any, **kwargs: Any) -> Any:
        """Joint chi-square test of linear hypotheses about the fixed effects (statsmodels' arguments).

        NaN where one of them is about a coefficient without a standard error.
        """
        kwargs.setdefault("scalar", True)
        r_matrix = self._about_fixed(r_matrix)
        without = ~np.isfinite(np.diag(self.cov_params()))
        if df := untestable(r_matrix, self.model.names, without):
            nothing = {"chi2": np.nan, "statistic": np.nan}
            return ContrastResults(df_denom=df, distribution="chi2", distargs=(df,), **nothing)
        return super().wald_test(r_matrix, *args, **kwargs)

    def _about_fixed(self, r_matrix: Any) -> Any:
        """Contrasts of the fixed effects with zeros for all variance parameters."""
        p = len(self.fe_params)
        given = np.asarray(r_matrix[0] if isinstance(r_matrix, tuple) else r_matrix)
        if given.dtype.kind in "iufb" and given.shape[-1:] == (len(self.params),):
            # One number for every parameter, as statsmodels makes its tests of terms.
            if given[..., p:].any():
                raise located("hypothesis", Phrase("one about a variance parameter"), "fixed effects only")
            r_matrix = (given[..., :p], r_matrix[1]) if isinstance(r_matrix, tuple) else given[..., :p]
        found = about_fixed_effects(r_matrix, [*self.model.names[:p], self.model.names[p]])
        matrix, value = found if isinstance(found, tuple) else (found, None)
        if isinstance(matrix, (str, list)):
            from statsmodels.formula._manager import FormulaManager

            constraint = FormulaManager().get_linear_constraints(matrix, list(self.model.names))
            matrix, value = constraint.constraint_matrix, constraint.constraint_values
        matrix = np.atleast_2d(np.asarray(matrix, float))
        matrix = np.hstack([matrix[:, :p], np.zeros((len(matrix), len(self.params) - p))])
        return matrix if value is None else (matrix, np.ravel(value))

    def compare_lr_test(self, restricted: Any) -> tuple[float, float, int]:
        """Likelihood-ratio test of fixed effects, against a fit with the same random effects: ``(lr, p, df)``.

        Raises
        ------
        InputError
            For other random effects (zero variances are on a boundary), other data, and what is not nested.
        """
        other = unwrapped(restricted)
        wanted = "the same random effects: only fixed effects are tested"
        if not isinstance(other, LogisticSlopeResults) or self.model.entries != other.model.entries:
            raise located("restricted model", Phrase("other random effects"), wanted)
        check_comparable(self, other)
        if not np.allclose(self.model.random, other.model.random, rtol=1e-9, atol=0.0):
            found = "random effects of the same names and other values"
            if self.model.effects != other.model.effects:
                found = "other random effects"
            raise located("restricted model", Phrase(found), wanted)
        if not (self.comparable and other.comparable):
            raise located("models", Phrase("a fit without a maximum"), "fits that converged")
        big, small = self.model.exog, other.model.exog
        df = big.shape[1] - small.shape[1]
        weights, *_ = np.linalg.lstsq(big, small, rcond=None)
        if df <= 0 or np.abs(big @ weights - small).max() > 1e-7 * np.abs(small).max():
            raise located(
                "restricted model", Phrase("a model that is not nested"), "a model nested in the full one"
            )
        lr = max(0.0, 2.0 * (self.llf - other.llf))
        return float(lr), float(chi2.sf(lr, df)), int(df)

    # -- predictions -------------------------------------------------------------------------------
    def predict(
        self, exog: Any = None, which: str = "marginal", offset: Any = None, transform: bool = True
    ) -> pd.Series:
        """Predictions for rows; see `LogisticMixedResults.predict`.

        Conditional and linear ones are for a group whose random effects are zero; marginal ones average over them.

        Raises
        ------
        InputError
        """
        design, index = design_of(self, exog, transform)
        shift = per_row(offset_of(self, exog, offset), len(design), "offset")
        eta = design @ self.fe_params + (0.0 if shift is None else shift)
        if which == "linear":
            return pd.Series(eta, index=index)
        if which == "conditional":
            return pd.Series(expit(eta), index=index)
        if which != "marginal":
            raise located("which", which, "'marginal', 'conditional' or 'linear'")
        if not transform:
            raise located("transform", transform, "True for marginal predictions, which need the random effects")
        rows = None if exog is None else table_of(exog, "exog")
        z = self.model.random_columns(rows)
        return pd.Series(
            averaged_probabilities(eta, np.sqrt(np.einsum("jq,qr,jr->j", z, self.covariance, z))), index=index
        )

    @cache_readonly
    def fittedvalues(self) -> Array:
        """Probabilities of the fit's rows averaged over groups."""
        return np.asarray(self.predict())

    @cache_readonly
    def resid(self) -> Array:
        """Observed proportions less `fittedvalues`."""
        fixed = self.model.fixed
        return fixed.successes / fixed.trials - self.fittedvalues

    @property
    def random_effects(self) -> pd.DataFrame:
        """Modes of the random effects of every group, on the logit scale: what lme4's ``ranef`` gives."""
        model = self.model
        likelihood = self._at_maximum()
        factor = likelihood.factor(self.maximum.theta)
        labels = pd.Index(model.fixed.group_labels, name=model.group_name)
        return pd.DataFrame(likelihood.modes @ factor.T, index=labels, columns=list(model.effects))

    def _at_maximum(self) -> SlopeLikelihood:
        ones = np.ones(len(self.model.effects))
        likelihood = self.model.likelihood(Coordinates.same(self.model.exog.shape[1]), ones)
        likelihood(self.maximum.theta)
        return likelihood

    # -- what there is not -------------------------------------------------------------------------
    def get_prediction(self, *args: Any, **kwargs: Any) -> Any:
        """Not offered with random slopes.

        Raises
        ------
        InputError
        """
        raise located("get_prediction", Phrase("a fit with random slopes"), f"a random intercept: {ABSENT}")

    @property
    def node_check(self) -> Any:
        """Not offered: there is one rule.

        Raises
        ------
        InputError
        """
        raise located("node_check", Phrase("a fit with random slopes"), f"a random intercept: {ABSENT}")

    def random_effects_interval(self, *args: Any, **kwargs: Any) -> Any:
        """Not offered, and raises `InputError`: `random_effects` has the modes."""
        raise located("random_effects_interval", Phrase("a fit with slopes"), f"a random intercept: {ABSENT}")

    def bootstrap(self, *args: Any, **kwargs: Any) -> Any:
        """Not offered: rows of a group are not independent.

        Raises
        ------
        InputError
        """
        raise located("bootstrap", Phrase("rows to resample"), "groups resampled")

    def remove_data(self) -> None:
        """Not offered: predictions of new rows need the table's coding of the random effects.

        Raises
        ------
        InputError
        """
        raise located("remove_data", Phrase("a fit with random slopes"), "a random intercept, or params kept alone")

    # -- words -------------------------------------------------------------------------------------
    def _view(self) -> View:
        return fit_view(self, "Logistic mixed model, random slopes")

    def summary(self, alpha: float = 0.05, method: str = "wald", title: str | None = None) -> Any:
        """The fit on a screen, with its notes."""
        return slope_summary(self, alpha, method, title)

    summary2 = summary
