"""The logistic mixed model that stands beside a mixed ANOVA of an outcome of 0 and 1.

The variance of a binary outcome depends on its mean and effects act on a bounded scale, both of which an analysis
of variance ignores. Here the same three effects are tested by likelihood ratios in logistic models with a normal
intercept for every person (`models.glmm`), and as there in two types:

- **Type III**: the model with all effects against the one without the effect's columns, coded to sum to zero over
  groups and times; asks for the effect on the mean log-odds of the cells, every cell counting the same;
- **Type II**: the model of both main effects, without interaction, against the one without the effect.

The test of the interaction is the same in both. Unlike in an analysis of variance, the main effects of a balanced
design are not: log-odds do not average like means.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from analysis.repeated_measures import RepeatedMeasures
from models.errors import Phrase, located
from models.glmm_warnings import CeilingWarning, SeparationWarning
from models.notebook_view import NotebookView

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LogisticTwin(NotebookView):
    """Likelihood-ratio tests of the effects of a mixed design on a binary outcome.

    Attributes
    ----------
    table : DataFrame
        One row an effect: ``effect, chi_squared, df, p``, and ``full, restricted``: the terms of the two models;
        NaN where the search for the maximum of one of them did not end, and where cells with one outcome leave
        nothing to test.
    sd : float
        Standard deviation of the intercepts in the model with all effects, on the logit scale.
    notes : tuple of str
        What the fits warn of.
    ss_type : int
        2 or 3.
    """

    table: pd.DataFrame
    sd: float
    notes: tuple[str, ...]
    ss_type: int

    @property
    def title(self) -> str:
        """What the tests are."""
        return f"Logistic mixed model, likelihood-ratio tests (Type {'II' if self.ss_type == 2 else 'III'})"


def logistic_twin(data: RepeatedMeasures, ss_type: int = 3) -> LogisticTwin:
    """Test group, time and their interaction.

    Parameters
    ----------
    data : RepeatedMeasures
    ss_type : {3, 2}
        As for `analysis.anova.mixed_anova`.

    Raises
    ------
    InputError
        For an outcome that is not 0 or 1, or another type.
    """
    if ss_type not in (2, 3):
        raise located("type of the tests", ss_type, "2 or 3")
    if not data.binary:
        wrong = data.score[~np.isin(data.score, (0.0, 1.0))][0]
        raise located(f"column {data.dv}", wrong, "0 or 1")
    n, m = data.score.shape
    k = len(data.groups)
    group = np.repeat(_sum_to_zero(k)[data.group], m, axis=0)
    time = np.tile(_sum_to_zero(m), (n, 1))
    terms = {
        data.between: group,
        data.within: time,
        f"{data.between}:{data.within}": np.einsum("ij,ik->ijk", group, time).reshape(n * m, -1),
    }
    between, within, both = terms
    every = (between, within, both)
    main = every if ss_type == 3 else (between, within)
    pairs = {effect: (main, tuple(t for t in main if t != effect)) for effect in (between, within)}
    pairs[both] = (every, (between, within))
    wanted = dict.fromkeys((every, *(model for pair in pairs.values() for model in pair)))
    fits = {model: _fit(data, [np.ones((n * m, 1)), *(terms[t] for t in model)]) for model in wanted}
    rows, free = [], []
    for effect, (large, small) in pairs.items():
        full, restricted = fits[large], fits[small]
        df = full.model.exog.shape[1] - restricted.model.exog.shape[1]
        lr = p = np.nan
        if _is_free(full, restricted):
            free.append(effect)
        elif full.comparable and restricted.comparable:
            lr, p, df = full.compare_lr_test(restricted)
        told = {"full": " + ".join(large), "restricted": " + ".join(small)}
        rows.append({"effect": effect, "chi_squared": lr, "df": df, "p": p, **told})
    notes = _notes(data, fits)
    if ss_type == 3 and not fits[every].comparable:
        notes += ("Tests of the main effects of Type II do without the model of all effects.",)
    if free:
        notes += (
            f"No test of {' or '.join(free)}: both models predict the same cells perfectly and come to the same on "
            "the others, whatever happened there. That is no evidence of no effect.",
        )
    return LogisticTwin(pd.DataFrame(rows), float(fits[every].sd), notes, ss_type)


def _is_free(full: Any, restricted: Any) -> bool:
    """Whether coefficients that run to infinity meet what the restricted model asks, whatever the outcomes.

    So it is where both models predict the same rows perfectly, and on the others span the same space: infinities of
    opposite sign add up to anything.
    """
    left = _not_predicted(full)
    if left.all() or not np.array_equal(left, _not_predicted(restricted)):
        return False
    ranks = [np.linalg.matrix_rank(fit.model.exog[left]) if left.any() else 0 for fit in (full, restricted)]
    return bool(ranks[0] == ranks[1])


def _not_predicted(fit: Any) -> NDArray[np.bool_]:
    """Rows of a fit that its covariates do not predict perfectly."""
    separation, model = fit.escape.separation, fit.model
    if separation is None:
        return np.ones(len(model.exog), bool)
    known = model.patterns.design[~separation.left]
    return np.array([not (known == row).all(axis=1).any() for row in model.exog], bool)


def _notes(data: RepeatedMeasures, fits: Mapping[tuple[str, ...], Any]) -> tuple[str, ...]:
    """What the fits warn of, said once and of which models; cells by their names, not by columns of a design."""
    flat = _cells_with_one_outcome(data)
    notes = []
    if flat:
        notes.append(
            f"Only one value of {data.dv} in {'; '.join(flat)}: an effect that needs such a cell has no finite "
            "estimate, though it may have a test."
        )
    told: dict[str, list[str]] = {}
    for model, fit in fits.items():
        for note in fit.notes:
            if note.category not in (SeparationWarning, CeilingWarning):
                told.setdefault(note.text, []).append(" + ".join(model))
    for text, models in told.items():
        notes.append(text if len(models) == len(fits) else f"Model with {', '.join(models)}: {text}")
    risen = [" + ".join(model) for model, fit in fits.items() if fit.comparable and not fit.converged]
    if risen:
        notes.append(
            f"The model with {', '.join(risen)} has no finite estimate of some effect: its tests are of the value "
            "that the likelihood rises to."
        )
    lost = [" + ".join(model) for model, fit in fits.items() if not fit.comparable]
    if lost:
        notes.append(f"No maximum was found for the model with {', '.join(lost)}: tests with it are left out.")
    return tuple(notes)


def _cells_with_one_outcome(data: RepeatedMeasures) -> list[str]:
    out = []
    for g, group in enumerate(data.groups):
        for t, time in enumerate(data.times):
            values = data.score[data.group == g, t]
            if np.ptp(values) == 0:
                out.append(f"{data.between} {group} at {data.within} {time} (all {len(values)} are {values[0]:g})")
    return out


def _sum_to_zero(levels: int) -> Array:
    """Columns of a factor that sum to zero over its levels, ``[level, levels - 1]``."""
    return np.vstack([np.eye(levels - 1), -np.ones(levels - 1)])


def _fit(data: RepeatedMeasures, parts: list[Array]) -> Any:
    from models.glmm import LogisticMixedModel

    if np.ptp(data.score) == 0:
        raise located(f"column {data.dv}", Phrase(f"{data.score[0, 0]:g} in every row"), "values that differ")
    person = pd.Series(np.repeat(np.arange(len(data.people)), data.score.shape[1]), name=data.subject)
    return LogisticMixedModel(data.score.ravel(), np.column_stack(parts), person).fit(warn=False)
