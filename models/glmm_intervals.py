"""Confidence intervals of a fit: which kind, of which parameters, also of those without a finite estimate."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import norm

from models.errors import Phrase, located
from models.glmm_arguments import check_alpha, positions_of
from models.glmm_data import Array
from models.glmm_input import kept
from models.glmm_one_sided import one_sided_intervals

if TYPE_CHECKING:
    from models.glmm_results import LogisticMixedResults


def intervals(results: LogisticMixedResults, alpha: float, method: str, which: Any, cols: Any = None) -> Array:
    """See `LogisticMixedResults.conf_int`."""
    check_alpha(alpha)
    if cols is not None:
        if which is not None:
            raise located("which", Phrase("cols as well"), "one of them")
        chosen = positions_of(cols, results.model.data.param_names)
        names = [str(results.model.data.param_names[i]) for i in chosen]
        return intervals(results, alpha, method, None if method == "wald" else names)[chosen]
    if method == "wald":
        if which is not None:
            raise located("which", Phrase("given"), "method='profile' with it")
        half = norm.ppf(1 - alpha / 2) * results.bse
        ends = np.column_stack([results.params - half, results.params + half])
        ends[-1] = np.maximum(ends[-1], 0.0)
        return ends
    if method != "profile":
        raise located("method", method, "'wald' or 'profile'")
    names = list(results.model.data.param_names)
    if which is not None:
        which = [which] if isinstance(which, str) else which
        if not np.iterable(which):
            raise located("which", which, "a list of names of parameters")
        unknown = [name for name in which if not isinstance(name, str) or name not in names]
        if unknown:
            raise located("which", unknown[0], f"one of {', '.join(names)}")
    kept(results.model, "patterns", "conf_int(method='profile')")
    positions = [i for i, name in enumerate(names) if which is None or name in which]
    # Profiles take seconds where estimates run off, and a table, its odds ratios and its summary all want them.
    known: dict[tuple[float, int], Array] = results.__dict__.setdefault("_profiled", {})
    missing = [i for i in positions if (alpha, i) not in known]
    if missing:
        known.update(
            {(alpha, i): ends for i, ends in zip(missing, _profiled(results, alpha, missing), strict=True)}
        )
    ends = np.full((len(names), 2), np.nan)
    for i in positions:
        ends[i] = known[alpha, i]
    return ends


def _profiled(results: LogisticMixedResults, alpha: float, positions: list[int]) -> Array:
    """Profile intervals of the parameters at these positions, `[len(positions), 2]`."""
    patterns = kept(results.model, "patterns", "conf_int(method='profile')")
    rule, escape = results.model.rule, results.escape
    ends = np.array(escape.profile(results.maximum, rule, patterns, positions, alpha), dtype=float)
    endless = [i for i in positions if escape.unbounded[i]]
    if endless and results.comparable:
        rows = [positions.index(i) for i in endless]
        ends[rows] = one_sided_intervals(patterns, rule, results.maximum, escape, endless, alpha)
    return ends
