"""What a fit with random slopes knows: the statsmodels surface, without what exists for one intercept only."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.special import expit
from scipy.stats import chi2, norm
from statsmodels.base import model as base
from statsmodels.iolib import summary2
from statsmodels.tools._decorators import cache_readonly

from models.errors import Phrase, located
from models.glmm_arguments import check_alpha, positions_of
from models.glmm_comparison import about_fixed_effects, check_comparable
from models.glmm_coordinates import Coordinates
from models.glmm_data import Array
from models.glmm_input import per_row, unwrapped
from models.glmm_notes import Note
from models.glmm_prediction import design_of, offset_of
from models.glmm_slope_effects import averaged_probabilities, natural_parameters
from models.glmm_slope_likelihood import SlopeLikelihood
from models.glmm_summary import WIDTH, shown
from models.glmm_warnings import BoundaryWarning, ConvergenceWarning, SeveralMaximaWarning

if TYPE_CHECKING:
    from models.glmm_slope import LogisticSlopeModel, SlopeMaximum

SINGULAR = 1e-3
"""Standard deviation of a combination of effects, in units of the logit, below which it is called zero."""

ABSENT = "random slopes have Wald intervals only; drop the slope for profile intervals, quadrature and simulation"


class LogisticSlopeResults(base.LikelihoodModelResults, base.ResultMixin):
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
        found = jacobian @ maximum.covariance @ jacobian.T
        if self.singular:
            found[p:], found[:, p:] = np.nan, np.nan
        self.has_offset = bool(model.offset.any())
        super().__init__(model, params, normalized_cov_params=found)
        self.escape = _Nothing(len(params))
        self.notes = self._notes()

    # -- estimates ---------------------------------------------------------------------------------
    @property
    def converged(self) -> bool:
        """Whether a maximum was found."""
        return self.maximum.converged

    @property
    def comparable(self) -> bool:
        """Whether `llf` may be compared."""
        return self.converged

    @property
    def llf(self) -> float:
        """Laplace's log-likelihood, binomial coefficients included."""
        return self.maximum.value

    @property
    def fe_params(self) -> Array:
        """Fixed effects."""
        return np.asarray(self.params[: self.model.exog.shape[1]])

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
        ends = np.exp(self.conf_int(alpha)[:p])
        columns = {
            "odds ratio": np.exp(self.fe_params), "lower": ends[:, 0], "upper": ends[:, 1], "z": self.tvalues[:p],
            "p": self.pvalues[:p],
        }  # fmt: skip
        return pd.DataFrame(columns, index=self.model.names[:p])

    # -- tests -------------------------------------------------------------------------------------
    def t_test(self, r_matrix: Any, cov_p: Any = None, use_t: Any = None) -> Any:
        """Test linear hypotheses about the fixed effects by z (statsmodels' arguments)."""
        return super().t_test(self._about_fixed(r_matrix), cov_p=cov_p, use_t=use_t)

    def wald_test(self, r_matrix: Any, *args: Any, **kwargs: Any) -> Any:
        """Joint chi-square test of linear hypotheses about the fixed effects (statsmodels' arguments)."""
        kwargs.setdefault("scalar", True)
        return super().wald_test(self._about_fixed(r_matrix), *args, **kwargs)

    def _about_fixed(self, r_matrix: Any) -> Any:
        """Contrasts of the fixed effects with zeros for all variance parameters."""
        p = len(self.fe_params)
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
        if not isinstance(other, LogisticSlopeResults) or (
            (self.model.effects, self.model.entries) != (other.model.effects, other.model.entries)
        ):
            wanted = "the same random effects: only fixed effects are tested"
            raise located("restricted model", Phrase("other random effects"), wanted)
        first, second = (_AsIntercept(fit) for fit in (self, other))
        check_comparable(first, second)  # type: ignore[arg-type]
        if not (self.converged and other.converged):
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
        rows = exog if exog is None or isinstance(exog, pd.DataFrame) else pd.DataFrame(exog)
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
    def _notes(self) -> tuple[Note, ...]:
        notes: list[Note] = []
        if not self.converged:
            text = "no maximum found: the curvature where the searches ended is that of no maximum"
            return (*notes, Note(ConvergenceWarning, text))
        if self.singular:
            effects = ", ".join(self.model.names[len(self.fe_params) :])
            text = (
                f"singular fit: some combination of the random effects of {self.model.group_name} has no variance "
                f"({effects}): {', '.join(shown(v) for v in self.params[len(self.fe_params) :])}"
            )
            notes.append(Note(BoundaryWarning, text))
        if max(self.maximum.ends) - min(self.maximum.ends) > 1e-4:
            ends = ", ".join(f"{value:.4f}" for value in sorted(self.maximum.ends, reverse=True))
            text = f"searches ended at log-likelihoods {ends}; the first is reported"
            notes.append(Note(SeveralMaximaWarning, text))
        return tuple(notes)

    def summary(self, alpha: float = 0.05, method: str = "wald", title: str | None = None) -> Any:
        """The fit on a screen, with its notes."""
        model, ends = self.model, self.conf_int(alpha, method)
        effects = "; ".join(", ".join(model.effects[i] for i in block) for block in model.blocks)
        header = {
            "Model:": "Logistic mixed model", "Outcome:": model.outcome_name,
            "Rows:": f"{self.nobs}" + (f" ({model.n_dropped} dropped)" if model.n_dropped else ""),
            "Groups:": f"{model.fixed.n_groups} ({model.group_name})", "Random effects:": effects,
            "Log-likelihood:": f"{self.llf:.4f}", "AIC:": f"{self.aic:.4f}",
            "BIC (log of rows):": f"{self.bic:.4f}",
            "Quadrature:": "Laplace", "Converged:": str(self.converged) + (", singular" if self.singular else ""),
        }  # fmt: skip
        p = len(self.fe_params)
        columns = {
            "Coef.": self.params, "Std.Err.": self.bse, "z": self.tvalues, "P>|z|": self.pvalues,
            f"[{alpha / 2:g}": ends[:, 0], f"{1 - alpha / 2:g}]": ends[:, 1],
            "exp(Coef.)": np.append(np.exp(self.fe_params), np.full(len(self.params) - p, np.nan)),
        }  # fmt: skip
        table = pd.DataFrame(columns, index=model.names).map(shown)
        table["P>|z|"] = ["" if np.isnan(p) else f"{p:.4f}" for p in self.pvalues]
        summary = summary2.Summary()
        summary.add_dict(header)
        summary.add_df(table)
        summary.add_title(title or "Logistic mixed model, random slopes")
        summary.add_text("Intervals: Wald. exp(Coef.): odds ratios for one and the same group.")
        summary.add_text("Laplace's approximation: with few binary outcomes a group it can be badly wrong.")
        for note in self.notes:
            for line in textwrap.wrap(f"{note.category.__name__}: {note.text}", WIDTH):
                summary.add_text(line)
        return summary

    summary2 = summary


class _Nothing:
    """No parameter runs off: what helpers for one intercept ask of a fit."""

    any = False

    def __init__(self, size: int) -> None:
        self.unbounded = np.zeros(size, bool)


class _AsIntercept:
    """A fit as the comparison of data sees it."""

    def __init__(self, results: LogisticSlopeResults) -> None:
        self.model, self.maximum = results.model.fixed, results.maximum
