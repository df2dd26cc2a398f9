"""How much an estimate depends on the number of quadrature nodes.

K nodes are held against 2 K + 1. One Newton step from the estimate tells how far the estimate would move; where
that step is not small, the model is fitted again with the finer rule, from where it stands. With
thousands of distinct groups both rules are compared on a part of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from models.glmm_climb import FAR, climb
from models.glmm_data import MANY, Likelihood, Patterns, Rule
from models.glmm_input import kept, unwrapped
from models.glmm_optimise import PART, Maximum, maximise

if TYPE_CHECKING:
    from models.glmm_results import LogisticMixedResults

SMALL_STEP = 0.1
"""Standard errors below which one Newton step stands for a new fit."""

PRECISION = 1e-3
"""Standard errors left where a new fit under the finer rule takes its last step."""

TOLERATED = 0.01
"""Change of the standard deviation, in its standard errors, above which a fit is called dependent on the rule."""


@dataclass(frozen=True)
class NodeCheck:
    """The standard deviation under a rule and under one with 2 K + 1 nodes.

    Attributes
    ----------
    nodes, finer_nodes : int
    sd, finer_sd : float
        Of the random intercept.
    standard_error : float
        Of `sd`; NaN on the boundary.
    refitted : bool
        Whether `finer_sd` comes from a new fit, not from one Newton step.
    """

    nodes: int
    finer_nodes: int
    sd: float
    finer_sd: float
    standard_error: float
    refitted: bool

    @property
    def change(self) -> float:
        """Change of the standard deviation."""
        return self.finer_sd - self.sd

    @property
    def dependent(self) -> bool:
        """Whether the change exceeds a hundredth of the standard error."""
        return bool(abs(self.change) > TOLERATED * self.standard_error)

    @property
    def text(self) -> str:
        """The check in a sentence."""
        rule = "Laplace" if self.nodes == 1 else f"{self.nodes} nodes"
        return f"sd {self.sd:.5g} with {rule}, {self.finer_sd:.5g} with {self.finer_nodes} ({self.change:+.1e})"


def check_nodes(patterns: Patterns, rule: Rule, best: Maximum) -> NodeCheck:
    """Compare the standard deviation with that under 2 K + 1 nodes."""
    sd, finer = float(best.theta[-1]), Rule.hermite(2 * rule.n_nodes + 1)
    if best.boundary:  # without a variance every rule is exact
        return NodeCheck(rule.n_nodes, finer.n_nodes, sd, sd, np.nan, False)
    patterns, top = best.coordinates.patterns(patterns), best.top
    try:
        inverse = np.linalg.inv(-best.curvature)
    except np.linalg.LinAlgError:
        return NodeCheck(rule.n_nodes, finer.n_nodes, sd, np.nan, np.nan, False)
    error = float(np.sqrt(max(inverse[-1, -1], 0.0)))
    if patterns.n_patterns > MANY:
        # What the rule does to the estimate is seen as well on a part of the groups, both rules on the same part.
        part = patterns.part(PART)
        ours, other = (
            climb(Likelihood(part, r), top, inverse=inverse, stop=PRECISION).theta[-1] for r in (rule, finer)
        )
        return NodeCheck(rule.n_nodes, finer.n_nodes, sd, sd + float(other - ours), error, True)
    likelihood = Likelihood(patterns, finer)
    _, gradient = likelihood(top)
    step = inverse @ gradient
    if gradient @ step <= SMALL_STEP**2:
        return NodeCheck(rule.n_nodes, finer.n_nodes, sd, sd + float(step[-1]), error, False)
    far = gradient @ step > FAR**2  # too far for what the other rule's curvature says
    again = climb(likelihood, top, inverse=None if far else inverse, stop=PRECISION)
    return NodeCheck(rule.n_nodes, finer.n_nodes, sd, float(again.theta[-1]), error, True)


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
