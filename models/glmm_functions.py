"""The likelihood of a mixed model as functions of its parameters, in statsmodels' names."""

from __future__ import annotations

from typing import Any

from statsmodels.base import model as base

from models.glmm_arguments import parameters
from models.glmm_data import Array, Likelihood, Patterns, Rule
from models.glmm_input import kept


class LikelihoodFunctions(base.LikelihoodModel):
    """A model that has `patterns` and a `rule`; parameters are the fixed effects and the standard deviation."""

    patterns: Patterns
    rule: Rule

    def _likelihood(self, what: str) -> Likelihood:
        return Likelihood(kept(self, "patterns", what), self.rule)

    def _parameters(self, params: Any) -> Array:
        """As numbers, fixed effects and sd.

        Raises
        ------
        InputError
            Of another number.
        """
        return parameters(params, [str(name) for name in self.data.param_names])

    def loglike(self, params: Any) -> float:
        """Log-likelihood at (fixed effects, sd), binomial coefficients included."""
        return self._likelihood("loglike")(self._parameters(params))[0]

    def score(self, params: Any) -> Array:
        """Gradient of `loglike`, exact for the quadrature rule."""
        return self._likelihood("score")(self._parameters(params))[1]

    def score_obs(self, params: Any) -> Array:
        """Scores of the groups (the independent units), ``[G, p + 1]``, in the order of `group_labels`."""
        likelihood = self._likelihood("score_obs")
        likelihood(self._parameters(params))
        return likelihood.scores[self.patterns.of_group]

    def loglikeobs(self, params: Any) -> Array:
        """Log-likelihoods of the groups ``[G]``, without binomial coefficients."""
        likelihood = self._likelihood("loglikeobs")
        likelihood(self._parameters(params))
        return likelihood.values[self.patterns.of_group]

    def hessian(self, params: Any) -> Array:
        """Second derivatives of `loglike`: central differences of the exact gradient."""
        return self._likelihood("hessian").hessian(self._parameters(params))

    def information(self, params: Any) -> Array:
        """Observed information, minus the Hessian."""
        return -self.hessian(params)
