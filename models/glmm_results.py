"""What a fitted mixed model knows: the statsmodels results surface, and the doors to everything beyond it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.stats import norm
from statsmodels.base import model as base
from statsmodels.stats.contrast import ContrastResults
from statsmodels.tools._decorators import cache_readonly

from models.errors import Phrase, located
from models.glmm_arguments import check_alpha
from models.glmm_comparison import about_fixed_effects, likelihood_ratio, untestable
from models.glmm_data import Array, Likelihood
from models.glmm_escape import Escape, find_escape
from models.glmm_input import kept
from models.glmm_intervals import intervals
from models.glmm_nodes import NodeCheck, check_nodes
from models.glmm_optimise import Maximum
from models.glmm_posterior import intercepts
from models.glmm_predicted import Predictions, predictions
from models.glmm_prediction import design_of, offset_of, shifts_of
from models.glmm_summary import GroupSizes, summary_of
from models.glmm_view import fit_view
from models.notebook_view import NotebookView, View

if TYPE_CHECKING:
    from models.glmm import LogisticMixedModel
    from models.glmm_notes import Note

KINDS = ("model", "robust")
"""Kinds of covariance."""


class LogisticMixedResults(base.LikelihoodModelResults, base.ResultMixin, NotebookView):
    """Results of `LogisticMixedModel.fit`.

    Attributes
    ----------
    params : array [p + 1]
        Fixed effects (log odds ratios for one and the same group), then the standard deviation of the intercept.
    maximum : Maximum
        How it was found: searches, evaluations, the pooled fit.
    escape : Escape
        Which parameters have no finite estimate (separated data): NaN stands for their errors and intervals.
    node_check : NodeCheck
        The standard deviation against that under 2 K + 1 nodes, and the log-likelihood against the exact one.
    sizes : GroupSizes
        Trials of the groups.
    has_offset : bool
        Whether any row has an offset.
    notes : tuple of Note
        What must be known before the fit is read; also raised as warnings.
    converged, boundary : bool
        Whether a maximum was found, and whether its standard deviation is zero.
    nobs : int
        Rows, counted by their weights: the number behind `bic`.
    cov_type : str
        Kind of covariance behind `bse`, tests and Wald intervals.
    """

    def __init__(self, model: LogisticMixedModel, maximum: Maximum, cov_type: str = "model") -> None:
        if cov_type not in KINDS:
            raise located("cov_type", cov_type, "'model' or 'robust'")
        self._cache: dict[str, Any] = {}  # remove_data() wants it before anything is cached
        escape = find_escape(model.patterns, model.rule, maximum, [str(n) for n in model.exog_names])
        self.node_check: NodeCheck = check_nodes(
            model.patterns, model.rule, maximum, exact=not escape.within_groups
        )
        if self.node_check.elsewhere:
            # A maximum of the quadrature's own making is none.
            maximum = replace(maximum, converged=False)
            escape = replace(escape, rest=escape.rest and replace(escape.rest, converged=False))
        self.maximum = maximum
        self.escape: Escape = escape
        self.notes: tuple[Note, ...] = ()
        self.nobs = model.nobs
        self.df_model, self.df_resid = model.df_model, model.df_resid
        super().__init__(model, maximum.theta, normalized_cov_params=self._covariance(model, "model"))
        self.cov_type = cov_type
        if cov_type == "robust":
            self.cov_params_default = self._covariance(model, "robust")
        self.sizes, self.has_offset = GroupSizes.of(model), bool(model.offset.any())

    def _covariance(self, model: LogisticMixedModel, kind: str) -> Array:
        return self.escape.covariance(self.maximum, model.rule, model.patterns, kind)

    def _likelihood(self, what: str) -> Likelihood:
        return Likelihood(kept(self.model, "patterns", what), self.model.rule)

    # -- estimates ---------------------------------------------------------------------------------
    @property
    def converged(self) -> bool:
        """Whether a maximum was found.

        Not where a parameter runs off, however flat the likelihood is where the search for it stopped, nor where
        the likelihood has its maximum elsewhere and quadrature's error made this one.
        """
        return self.maximum.converged and not self.escape.any

    @property
    def comparable(self) -> bool:
        """Whether `llf` is the highest that the likelihood takes or tends to, so that it can be compared.

        Also where a parameter runs off (separated data); not where a search did not end, and not where quadrature's
        error made the maximum.
        """
        return bool(np.isfinite(self.escape.supremum(self.maximum)) and not self.node_check.elsewhere)

    @property
    def boundary(self) -> bool:
        """Whether the standard deviation is estimated at zero."""
        return self.maximum.boundary

    @property
    def sd(self) -> float:
        """Standard deviation of the random intercept, on the logit scale."""
        return float(self.params[-1])

    @property
    def fe_params(self) -> Array:
        """Fixed effects."""
        return np.asarray(self.params[:-1])

    @property
    def estimates(self) -> Array:
        """`params`, but where a parameter runs to (infinity, or NaN) and not where the search for it stopped."""
        out = np.array(self.params, float)
        unbounded = self.escape.unbounded
        out[unbounded] = np.array([-np.inf, np.nan, np.inf])[self.escape.signs[unbounded] + 1]
        return out

    @property
    def llf(self) -> float:
        """Log-likelihood, binomial coefficients included; comparable only under the same quadrature rule.

        Where parameters run off, what it rises to: where they stopped it is lower, or the quadrature's error.
        """
        value = self.escape.supremum(self.maximum)
        return value if np.isfinite(value) else self.maximum.value

    @cache_readonly
    def bse(self) -> Array:
        """Standard errors; NaN for a standard deviation on the boundary, and without a finite estimate."""
        with np.errstate(invalid="ignore"):
            errors = np.sqrt(np.diag(self.cov_params()))
        if self.boundary:
            errors[-1] = np.nan
        return errors

    @cache_readonly
    def tvalues(self) -> Array:
        """Wald statistics z of the fixed effects; NaN for the sd, see `models.glmm_variance.variance_test`."""
        return np.append(self.params[:-1] / self.bse[:-1], np.nan)

    @cache_readonly
    def pvalues(self) -> Array:
        """Two-sided p of the fixed effects; NaN for the sd."""
        return np.asarray(2 * norm.sf(np.abs(self.tvalues)))

    def cov_params(
        self,
        r_matrix: Any = None,
        column: Any = None,
        scale: Any = None,
        cov_p: Any = None,
        other: Any = None,
        kind: str | None = None,
    ) -> Array:
        """Covariance of the estimates, or of linear combinations of them.

        Parameters
        ----------
        kind : {"model", "robust"}, optional
            Inverse information or sandwich over groups; that of `cov_type` where it is not given. The other
            arguments are those of statsmodels.
        """
        if kind is not None:
            if kind not in KINDS:
                raise located("kind", kind, "'model' or 'robust'")
            if kind == "robust" and self.cov_type != "robust":
                kept(self.model, "patterns", "cov_params(kind='robust')")
                cov_p = self._covariance(self.model, "robust")
            else:
                cov_p = self.cov_params_default if kind == "robust" else self.normalized_cov_params
        if r_matrix is None or not self.escape.any:
            return np.asarray(super().cov_params(r_matrix, column, scale, cov_p, other))
        return self.escape.combinations(np.asarray(super().cov_params(scale=scale, cov_p=cov_p)), r_matrix, other)

    # -- intervals ---------------------------------------------------------------------------------
    def conf_int(self, alpha: float = 0.05, method: str = "wald", which: Any = None, cols: Any = None) -> Array:
        """Confidence intervals ``[p + 1, 2]``.

        Parameters
        ----------
        alpha : float
            One minus the level.
        method : {"wald", "profile"}
            Estimate plus and minus multiples of the standard error (cut off at zero for the sd), or the values
            that a likelihood-ratio test does not reject: prefer these for the sd and near the ceiling. Without a
            finite estimate there is no Wald interval; that by profile is open on one side at least.
        which : str or sequence of str, optional
            Names of parameters to profile; rows of the others are NaN.
        cols : sequence of int or str, optional
            Positions or names of the parameters wanted, in this order; no other has a row, nor is profiled.

        Raises
        ------
        InputError
            For a level outside 0 to 1, an unknown method or parameter, and a profile after `remove_data`.
        """
        return intervals(self, alpha, method, which, cols)

    @np.errstate(over="ignore")  # separated data: infinite ends are what is meant
    def odds_ratios(self, alpha: float = 0.05, method: str = "wald") -> pd.DataFrame:
        """Odds ratios for one and the same group: exponentials of the fixed effects, with intervals.

        An odds ratio over people is closer to one: `models.glmm_marginal.marginal_contrast`.

        Returns
        -------
        DataFrame
            Columns ``odds ratio``, ``lower``, ``upper``, ``z``, ``p``; the intercept's row is odds, not a ratio.
            Infinite or 0 without a finite estimate, and then only profile intervals have ends.
        """
        ends = np.exp(self.conf_int(alpha, method)[:-1])
        columns = {
            "odds ratio": np.exp(self.estimates[:-1]), "lower": ends[:, 0], "upper": ends[:, 1],
            "z": self.tvalues[:-1], "p": self.pvalues[:-1],
        }  # fmt: skip
        return pd.DataFrame(columns, index=self.model.data.param_names[:-1])

    # -- tests -------------------------------------------------------------------------------------
    def t_test(self, r_matrix: Any, cov_p: Any = None, use_t: Any = None) -> Any:
        """Test linear hypotheses about the fixed effects by z (statsmodels' arguments; ``use_t`` is off)."""
        return super().t_test(about_fixed_effects(r_matrix, self.model.data.param_names), cov_p=cov_p, use_t=use_t)

    def wald_test(self, r_matrix: Any, *args: Any, **kwargs: Any) -> Any:
        """Joint chi-square test of linear hypotheses about the fixed effects (statsmodels' arguments).

        NaN where one of them is about a coefficient without a finite estimate.
        """
        kwargs.setdefault("scalar", True)
        r_matrix = about_fixed_effects(r_matrix, self.model.data.param_names)
        if self.escape.any and (df := untestable(r_matrix, self.model.data.param_names, self.escape.unbounded)):
            nothing = {"chi2": np.nan, "statistic": np.nan}
            return ContrastResults(df_denom=df, distribution="chi2", distargs=(df,), **nothing)
        return super().wald_test(r_matrix, *args, **kwargs)

    def compare_lr_test(self, restricted: Any) -> tuple[float, float, int]:
        """Likelihood-ratio test against a model nested in this one: ``(lr, p, df)``.

        Defined also where a coefficient has no finite estimate, and Wald's test none: by what the likelihood rises
        to.

        Raises
        ------
        InputError
            For other data, another quadrature rule, models that are not nested, or fits without a maximum.
        """
        return likelihood_ratio(self, restricted)

    # -- predictions -------------------------------------------------------------------------------
    def design_of(self, exog: Any, transform: bool = True) -> tuple[Array, Any]:
        """Design matrix of new rows, or of the fit's own, with their index."""
        return design_of(self, exog, transform)

    def predict(
        self,
        exog: Any = None,
        which: str = "marginal",
        groups: Any = None,
        offset: Any = None,
        transform: bool = True,
    ) -> pd.Series:
        """Predictions for rows.

        Parameters
        ----------
        exog : DataFrame or array_like, optional
            Variables of the formula, or columns of the design; the rows of the fit where it is not given.
        which : {"marginal", "conditional", "linear"}
            Probability averaged over groups; probability for a group with intercept zero, or for the groups
            given; linear predictor of the same.
        groups : str or array_like, optional
            Label of each row's group (or the name of the column): predictions then include the mode of its
            intercept, as lme4's do. Groups that the fit has not seen are refused.
        offset : str, number or array_like, optional
            Of new rows; the fit's own rows keep theirs. An ``offset(...)`` of the formula is computed for new rows;
            any other must be given (0 for none).
        transform : bool
            False: `exog` holds columns of the design, not variables of the formula.

        Returns
        -------
        Series

        Raises
        ------
        InputError
            For rows without the variables, offsets or groups of another length, and groups that are unknown.
        """
        design, index = self.design_of(exog, transform)
        offset, shifts = offset_of(self, exog, offset), shifts_of(self, exog, groups, len(design))
        offset = 0.0 if offset is None else offset
        values = self.model.predict(self.params, design, which=which, offset=offset, intercepts=shifts)
        return pd.Series(values, index=index)

    def get_prediction(
        self, exog: Any = None, which: str = "marginal", offset: Any = None, transform: bool = True
    ) -> Predictions:
        """Predictions with standard errors and intervals; arguments as for `predict`.

        Intercepts of known groups have no place here: their uncertainty is that of `random_effects`.

        Returns
        -------
        Predictions
            With ``predicted``, ``se``, ``conf_int()`` and ``summary_frame()``, as in statsmodels.
        """
        return predictions(self, exog, which, offset, transform)

    @cache_readonly
    def fittedvalues(self) -> Array:
        """Probabilities of the fit's rows averaged over groups."""
        kept(self.model, "exog", "fittedvalues")
        return np.asarray(self.model.predict(self.params))

    @cache_readonly
    def resid(self) -> Array:
        """Observed proportions less `fittedvalues`."""
        kept(self.model, "successes", "resid")
        return self.model.successes / self.model.trials - self.fittedvalues

    @property
    def random_effects(self) -> pd.DataFrame:
        """Intercepts of the groups on the logit scale, given their outcomes and the estimates.

        Returns
        -------
        DataFrame
            One row a group: ``mode`` (what lme4 calls conditional mode), ``mean``, ``sd``, and ``lower`` and
            ``upper``, a 95% equal-tailed interval. See `random_effects_interval` for other levels.
        """
        return self.random_effects_interval()

    def random_effects_interval(self, alpha: float = 0.05) -> pd.DataFrame:
        """`random_effects` at another level; all intervals take the estimates as known."""
        check_alpha(alpha)
        posterior = intercepts(self._likelihood("random_effects"), self.params, alpha)
        labels = pd.Index(self.model.group_labels, name=self.model.group_name)
        return posterior.table(self.model.patterns.of_group, labels)

    def remove_data(self) -> None:
        """Drop everything of the size of the data, as in statsmodels; what needs it raises `InputError` then.

        Estimates, Wald intervals, tests, summary, and predictions for new rows remain.
        """
        super().remove_data()
        self.escape = self.escape.without_data()
        for name in ("fittedvalues", "resid"):
            self._cache.pop(name, None)  # else None would stand for them

    def bootstrap(self, *args: Any, **kwargs: Any) -> Any:
        """Not offered: statsmodels' own resamples rows, and rows of a group are not independent.

        Raises
        ------
        InputError
        """
        raise located(
            "bootstrap", Phrase("rows to resample"), "variance_test(method='bootstrap'), or groups resampled"
        )

    def _view(self) -> View:
        return fit_view(self, "Logistic mixed model, random intercept")

    def summary(self, alpha: float = 0.05, method: str = "wald", title: str | None = None) -> Any:
        """The fit on a screen, with its notes.

        Parameters
        ----------
        method : {"wald", "profile"}
            Kind of intervals; that of the standard deviation is by profile in both where the data are at hand.
        """
        check_alpha(alpha)
        return summary_of(self, alpha, method, title)

    def summary2(self, alpha: float = 0.05, method: str = "wald", title: str | None = None) -> Any:
        """`summary`, which is of statsmodels' newer kind, by the name that some of its models have for that."""
        return self.summary(alpha, method, title)
