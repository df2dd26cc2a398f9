"""The logistic mixed model that stands beside a mixed ANOVA of an outcome of 0 and 1.

The variance of a binary outcome depends on its mean and effects act on a bounded scale, both of which an analysis
of variance ignores. Here the same three effects are tested by likelihood ratios in logistic models with a normal
intercept for every person (`models.glmm`), each effect against the model with all others of its order (Type II).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.repeated_measures import RepeatedMeasures
from models.errors import Phrase, located

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LogisticTwin:
    """Likelihood-ratio tests of the effects of a mixed design on a binary outcome.

    Attributes
    ----------
    table : DataFrame
        One row an effect: ``effect, chi_squared, df, p``; NaN where one of the two models has no maximum.
    sd : float
        Standard deviation of the intercepts in the model with all effects, on the logit scale.
    notes : tuple of str
        What the fits warn of.
    """

    table: pd.DataFrame
    sd: float
    notes: tuple[str, ...]


def logistic_twin(data: RepeatedMeasures) -> LogisticTwin:
    """Test group, time and their interaction.

    Raises
    ------
    InputError
        For an outcome that is not 0 or 1.
    """
    if not data.binary:
        wrong = data.score[~np.isin(data.score, (0.0, 1.0))][0]
        raise located(f"column {data.dv}", wrong, "0 or 1")
    n, m = data.score.shape
    group = np.repeat(np.eye(len(data.groups))[data.group][:, 1:], m, axis=0)
    time = np.tile(np.eye(m)[:, 1:], (n, 1))
    both = np.einsum("ij,ik->ijk", group, time).reshape(n * m, -1)
    one = np.ones((n * m, 1))
    fits = {
        "time": _fit(data, [one, time]),
        "group": _fit(data, [one, group]),
        "additive": _fit(data, [one, group, time]),
        "all": _fit(data, [one, group, time, both]),
    }
    pairs = (
        (data.between, "additive", "time"),
        (data.within, "additive", "group"),
        (f"{data.between}:{data.within}", "all", "additive"),
    )
    rows = []
    for effect, large, small in pairs:
        full, restricted = fits[large], fits[small]
        df = full.model.exog.shape[1] - restricted.model.exog.shape[1]
        lr = p = np.nan
        if full.converged and restricted.converged:
            lr, p, df = full.compare_lr_test(restricted)
        rows.append({"effect": effect, "chi_squared": lr, "df": df, "p": p})
    notes = tuple(dict.fromkeys(note.text for fit in fits.values() for note in fit.notes))
    lost = [name for name, fit in fits.items() if not fit.converged]
    if lost:
        notes += (f"No maximum was found for the model with {', '.join(lost)}: tests with it are left out.",)
    return LogisticTwin(pd.DataFrame(rows), float(fits["all"].sd), notes)


def _fit(data: RepeatedMeasures, parts: list[Array]) -> Any:
    from models.glmm import LogisticMixedModel

    if np.ptp(data.score) == 0:
        raise located(f"column {data.dv}", Phrase(f"{data.score[0, 0]:g} in every row"), "values that differ")
    person = pd.Series(np.repeat(np.arange(len(data.people)), data.score.shape[1]), name=data.subject)
    return LogisticMixedModel(data.score.ravel(), np.column_stack(parts), person).fit(warn=False)
