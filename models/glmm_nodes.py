"""How much an estimate depends on the number of quadrature nodes.

K nodes are held against 2 K + 1. One Newton step from the estimate tells how far the estimate would move; where
that step is not small, the model is fitted again with the finer rule. With thousands of distinct groups both rules
are compared on a part of them. Where the two rules give different likelihoods, both are held against the exact one
(`models.glmm_exact`): quadrature makes maxima of its own at large standard deviations, from which a finer rule
finds back no better than the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from models.glmm_climb import FAR, climb
from models.glmm_data import MANY, Likelihood, Patterns, Rule
from models.glmm_exact import exact_log_likelihood
from models.glmm_exact_maximum import exact_maximum
from models.glmm_input import kept, unwrapped
from models.glmm_optimise import FEW_NODES, PART, Maximum, maximise
from models.notebook_view import NotebookView

if TYPE_CHECKING:
    from models.glmm_results import LogisticMixedResults

SMALL_STEP = 0.1
"""Standard errors below which one Newton step stands for a new fit."""

PRECISION = 1e-3
"""Standard errors left where a new fit under the finer rule takes its last step."""

TOLERATED = 0.01
"""Change of the standard deviation, in its standard errors, above which a fit is called dependent on the rule."""


DISAGREE = 0.01
"""Difference of the log-likelihoods by the two rules above which the exact one is asked."""

WRONG = 0.05
"""Error of the log-likelihood above which a fit is told so."""

MANY_NODES = (25, 51)
"""Nodes by which the log-likelihood at the estimate of a coarse rule is told: the exact one takes far longer."""

SETTLED = 0.05
"""Difference between these, against the coarse rule's error, below which that error is told well enough."""

COARSE_PRECISION = 0.01
"""`PRECISION` for coarse rules, which move by whole standard errors."""

LOWER = 0.125
"""How far the exact log-likelihood at an estimate may be below its maximum: about half a standard error."""


@dataclass(frozen=True)
class NodeCheck(NotebookView):
    """The standard deviation under a rule and under one with 2 K + 1 nodes, and both against the exact likelihood.

    Attributes
    ----------
    nodes, finer_nodes : int
    sd, finer_sd : float
        Of the random intercept.
    standard_error : float
        Of `sd`; NaN on the boundary.
    refitted : bool
        Whether `finer_sd` comes from a new fit, not from one Newton step.
    log_likelihood : float
        Under the rule, at the estimate.
    exact : float
        Without quadrature error, at the estimate; NaN where the two rules agree on it. To one decimal under few
        nodes.
    best_exact, best_sd : float
        Highest exact log-likelihood of any parameters, and the standard deviation there; NaN where `exact` is
        within `WRONG` of `log_likelihood`, and under few nodes, which are an approximation by choice.
    """

    nodes: int
    finer_nodes: int
    sd: float
    finer_sd: float
    standard_error: float
    refitted: bool
    log_likelihood: float = np.nan
    exact: float = np.nan
    best_exact: float = np.nan
    best_sd: float = np.nan

    @property
    def change(self) -> float:
        """Change of the standard deviation."""
        return self.finer_sd - self.sd

    @property
    def dependent(self) -> bool:
        """Whether the change exceeds a hundredth of the standard error."""
        return bool(abs(self.change) > TOLERATED * self.standard_error)

    @property
    def wrong(self) -> bool:
        """Whether the log-likelihood that the rule gives is off by more than `WRONG`."""
        return bool(abs(self.log_likelihood - self.exact) > WRONG)

    @property
    def elsewhere(self) -> bool:
        """Whether the likelihood has its maximum elsewhere, half a standard error away or more."""
        return bool(self.best_exact - self.exact > LOWER)

    @property
    def exact_text(self) -> str:
        """`exact` in words, with the digits that are right."""
        return f"about {self.exact:.1f}" if self.nodes <= FEW_NODES else f"{self.exact:.4f} exactly"

    @property
    def text(self) -> str:
        """The check in a sentence."""
        rule = "Laplace" if self.nodes == 1 else f"{self.nodes} nodes"
        text = f"sd {self.sd:.5g} with {rule}, {self.finer_sd:.5g} with {self.finer_nodes} ({self.change:+.1e})"
        if self.wrong:
            text += f"; the log-likelihood there is {self.exact_text}, not {self.log_likelihood:.4f}"
        if np.isfinite(self.best_exact):
            text += f", and has its maximum, {self.best_exact:.4f}, at sd {self.best_sd:.5g}"
        return text


def check_nodes(patterns: Patterns, rule: Rule, best: Maximum, exact: bool = True) -> NodeCheck:
    """Compare the standard deviation with that under 2 K + 1 nodes, and the likelihood with the exact one.

    The two rules' log-likelihoods at the estimate, which cost nothing more, show whether quadrature can be believed
    there: only where they differ is the exact one computed, and if that differs too, maximised; neither where
    `exact` is False, as for fits that are known to have no maximum.
    """
    sd, finer = float(best.theta[-1]), Rule.hermite(2 * rule.n_nodes + 1)
    check = NodeCheck(rule.n_nodes, finer.n_nodes, sd, np.nan, np.nan, False, best.value)
    if best.boundary:  # without a variance every rule is exact
        return replace(check, finer_sd=sd)
    patterns, top = best.coordinates.patterns(patterns), best.top
    many = patterns.n_patterns > MANY
    # What the rule does to the estimate is seen as well on a part of the groups, both rules on the same part.
    part = patterns.part(PART) if many else patterns
    likelihood = Likelihood(part, finer)
    value, gradient = likelihood(top)
    ours, pull = Likelihood(part, rule)(top) if many else (best.value, np.zeros(len(top)))
    try:
        inverse = np.linalg.inv(-best.curvature)
    except np.linalg.LinAlgError:
        inverse = None
    # Of very many groups the errors add up to something even where they move no estimate.
    moves = not many or inverse is None or (gradient - pull) @ inverse @ (gradient - pull) > SMALL_STEP**2
    if exact and moves and abs(value - ours) > DISAGREE:
        check = _against_exact(patterns, best, check)
    if inverse is None:
        return check
    check = replace(check, standard_error=float(np.sqrt(max(inverse[-1, -1], 0.0))))
    if many:
        before, after = (
            climb(Likelihood(part, r), top, inverse=inverse, stop=PRECISION).theta[-1] for r in (rule, finer)
        )
        return replace(check, finer_sd=sd + float(after - before), refitted=True)
    step = inverse @ gradient
    if gradient @ step <= SMALL_STEP**2 and not check.elsewhere:
        return replace(check, finer_sd=sd + float(step[-1]))
    far = gradient @ step > FAR**2  # too far for what the other rule's curvature says
    stop = COARSE_PRECISION if rule.n_nodes <= FEW_NODES else PRECISION
    again = climb(likelihood, top, inverse=None if far else inverse, stop=stop)
    found = float(again.theta[-1])
    if check.wrong and rule.n_nodes > FEW_NODES:
        # From here a search stays on the rule's own hill; the finer rule's fit may be on another.
        own = maximise(patterns, finer)
        if exact_log_likelihood(patterns, own.theta) > exact_log_likelihood(patterns, again.theta):
            found = float(own.theta[-1])
    return replace(check, finer_sd=found, refitted=True)


def _against_exact(patterns: Patterns, best: Maximum, check: NodeCheck) -> NodeCheck:
    """The same with the exact log-likelihood at the estimate, and where that is another, its maximum."""
    check = replace(check, exact=_log_likelihood(patterns, best, check.nodes))
    if not check.wrong or check.nodes <= FEW_NODES:
        return check
    peak = exact_maximum(patterns, best)
    return replace(check, best_exact=peak.value, best_sd=float(peak.theta[-1]))


def _log_likelihood(patterns: Patterns, best: Maximum, nodes: int) -> float:
    """Without quadrature error at the estimate: for coarse rules, far off, by many nodes if these agree."""
    if nodes <= FEW_NODES:
        some, more = (Likelihood(patterns, Rule.hermite(k))(best.top)[0] for k in MANY_NODES)
        if abs(some - more) <= SETTLED * abs(more - best.value):
            return more
    return exact_log_likelihood(patterns, best.top)


def node_table(results: LogisticMixedResults, nodes: Sequence[int] = (1, 3, 7, 15, 25, 51, 101)) -> pd.DataFrame:
    """The fit under other numbers of nodes, each from several starts; one node is Laplace's approximation.

    Returns
    -------
    DataFrame
        One row a rule, indexed by the number of nodes: the parameters, and the log-likelihood, which may not be
        compared across rows except to see it settle.
    """
    names = list(results.model.data.param_names)
    patterns = kept(unwrapped(results).model, "patterns", "node_table")
    rows = []
    for k in nodes:
        best = maximise(patterns, Rule.hermite(k))
        rows.append(dict(zip([*names, "log-likelihood"], [*best.theta, best.value], strict=True)))
    return pd.DataFrame(rows, index=pd.Index(nodes, name="nodes"))
