r"""Tests of whether there is any variance between groups.

Zero is on the boundary of what the standard deviation can be, so twice the difference of log-likelihoods is not
chi-square with one degree of freedom but a 50:50 mixture of that and of a point at zero (Self & Liang 1987; Stram &
Lee 1994). The mixture holds for many groups; the parametric bootstrap asks the fitted null model itself.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.stats import chi2

from models.errors import Phrase, located
from models.glmm_data import Array
from models.glmm_input import kept, one_intercept, unwrapped
from models.glmm_optimise import maximise
from models.glmm_simulation import patterns_of, simulate_successes
from models.notebook_view import NotebookView

STREAM = 7_402
"""First element of the spawn keys used here."""


@dataclass(frozen=True)
class VarianceTest(NotebookView):
    """Test of a standard deviation of zero.

    Attributes
    ----------
    lr : float
        Twice the difference of the log-likelihoods with and without the random intercept.
    p : float
    method : str
    share_zero : float
        Share of `lr` at zero under the null: 0.5 by theory, or as found in the bootstrap.
    draws, failed : int
        Bootstrap samples; those without a maximum count as exceeding `lr`.
    seed : int or None
    simulated : array [draws] or None
    """

    lr: float
    p: float
    method: str
    share_zero: float
    draws: int = 0
    failed: int = 0
    seed: int | None = None
    simulated: Array | None = None

    @property
    def text(self) -> str:
        """The test in a sentence."""
        how = "50:50 mixture of 0 and chi-square(1)"
        if self.method == "bootstrap":
            how = f"parametric bootstrap, {self.draws} samples, seed {self.seed}, {self.share_zero:.0%} at zero"
        return f"variance between groups: LR = {self.lr:.4f}, p = {self.p:.4g} ({how})"


def variance_test(results: Any, method: str = "chibar", draws: int = 499, seed: int = 1) -> VarianceTest:
    """Test the random intercept against a logistic regression without groups.

    Parameters
    ----------
    method : {"chibar", "bootstrap"}
    draws, seed : int
        For the bootstrap: data are drawn from the regression without groups and both models fitted to each sample;
        p is (1 + samples that reach `lr`) / (1 + draws).

    Raises
    ------
    InputError
        For another method, fewer than 19 draws, a bootstrap after `remove_data`, and where the standard deviation
        runs to infinity.
    """
    results = unwrapped(results)
    model, best = results.model, results.maximum
    one_intercept(model, "variance_test")
    if results.escape.unbounded[-1]:
        raise located("variance_test", Phrase("a standard deviation that runs off"), "a fit with a maximum")
    exact = results.node_check.best_exact
    # Without a variance every rule is exact, and quadrature's own maxima are none.
    lr = max(0.0, 2.0 * ((exact if np.isfinite(exact) else best.value) - best.pooled_value))
    if best.boundary:
        lr = 0.0
    if method == "chibar":
        p = 1.0 if lr == 0.0 else 0.5 * float(chi2.sf(lr, 1))
        return VarianceTest(lr, p, method, 0.5)
    if method != "bootstrap":
        raise located("method", method, "'chibar' or 'bootstrap'")
    if draws < 19:
        raise located("draws", draws, "at least 19")
    kept(model, "patterns", "variance_test(method='bootstrap')")
    null = np.append(best.pooled_beta, 0.0)
    simulated, failed = np.empty(draws), 0
    for i in range(draws):
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, i)))
        sample = maximise(patterns_of(model, simulate_successes(model, null, rng)), model.rule)
        simulated[i] = 0.0 if sample.boundary else 2.0 * (sample.value - sample.pooled_value)
        failed += not (sample.converged or np.isfinite(simulated[i]))
    simulated = np.where(np.isfinite(simulated), simulated, np.inf)
    p = (1 + np.sum(simulated >= lr)) / (1 + draws)
    return VarianceTest(lr, float(p), method, float(np.mean(simulated <= 1e-8)), draws, failed, seed, simulated)
