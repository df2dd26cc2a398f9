r"""Which groups a fit hangs on.

Leaving a group out moves the estimates by about :math:`-A^{-1} s_i` (observed information ``A``, group score
``s_i``); Cook's distance measures that move in standard errors. Groups that matter can be left out in
earnest.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd

from models.errors import Phrase, located
from models.glmm_climb import climb
from models.glmm_data import Array, Likelihood, Patterns
from models.glmm_input import kept, unwrapped


def influence(results: Any) -> pd.DataFrame:
    r"""Approximate effect of leaving each group out.

    Returns
    -------
    DataFrame
        One row a group, most influential first: ``rows``, ``trials``, ``successes``; the change of each parameter
        when the group is left out, in its standard errors (NaN for one that runs off); ``cook``, Cook's distance
        :math:`\Delta' A \Delta / k` with k parameters.

    Raises
    ------
    InputError
        For a fit without a maximum, and after `remove_data`.
    """
    results = unwrapped(results)
    model, theta = results.model, np.asarray(results.params)
    likelihood = Likelihood(kept(model, "patterns", "influence"), model.rule)
    likelihood(theta)
    # Parameters that run off stay where they are.
    inverse = np.nan_to_num(results.normalized_cov_params)
    change = -(likelihood.scores @ inverse)
    errors = np.sqrt(np.diag(inverse))
    free = errors > 0
    if not free.any():
        raise located("influence", Phrase("a fit without a maximum"), "a fit with standard errors")
    # Delta' A Delta with Delta = -A^{-1} s is s' A^{-1} s.
    cook = np.einsum("ij,jk,ik->i", likelihood.scores, inverse, likelihood.scores) / free.sum()
    relative = np.divide(change, errors, out=np.zeros_like(change), where=free)
    relative[:, results.escape.unbounded] = np.nan
    of_group, weights = model.patterns.of_group, model.freq_weights
    columns: dict[str, Any] = {
        "rows": np.bincount(model.group_code, minlength=model.n_groups),
        "trials": np.bincount(model.group_code, weights * model.trials),
        "successes": np.bincount(model.group_code, weights * model.successes),
    }
    columns |= {f"d {n}": relative[of_group, i] for i, n in enumerate(model.data.param_names)}
    columns["cook"] = cook[of_group]
    index = pd.Index(model.group_labels, name=model.group_name)
    return pd.DataFrame(columns, index=index).sort_values("cook", ascending=False, kind="stable")


def without_group(results: Any, label: Any) -> Array:
    """Estimates with one group left out, fitted anew from the full estimates.

    Raises
    ------
    InputError
        For a label the model does not know, and after `remove_data`.
    """
    results = unwrapped(results)
    model, best = results.model, results.maximum
    patterns = best.coordinates.patterns(kept(model, "patterns", "without_group"))
    position = model.group_labels.get_indexer(pd.Index([label]))[0]
    if position < 0:
        raise located("group", label, "one of the fit's groups")
    fewer = patterns.multiplicity.copy()
    fewer[patterns.of_group[position]] -= 1
    reduced = Patterns(
        patterns.design, patterns.offset, patterns.successes, patterns.trials, patterns.start, fewer,
        patterns.of_group, patterns.constant,
    )  # fmt: skip
    start = np.array(best.top)
    start[-1] = max(start[-1], 0.1)  # not at zero, where the slope in the sd vanishes
    return best.coordinates.back(climb(Likelihood(reduced, model.rule), start).theta)
