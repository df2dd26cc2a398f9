"""Predictions for rows: their design, offset and groups, checked."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from scipy.special import expit

from models.errors import Phrase, located
from models.glmm_data import Array
from models.glmm_formula import named_column, new_design
from models.glmm_input import kept, per_row
from models.glmm_marginal import mean_probability
from models.glmm_offset import offset_of_rows
from models.glmm_table import table_of

if TYPE_CHECKING:
    from models.glmm import LogisticMixedModel
    from models.glmm_results import LogisticMixedResults


def design_of(results: LogisticMixedResults, exog: Any, transform: bool = True) -> tuple[Array, Any]:
    """Design matrix of new rows, or of the fit's own, with their index.

    Where `transform` is False `exog` holds columns of the design, whether there is a formula or not.

    Raises
    ------
    InputError
        For anything that gives no columns like those of the fit.
    """
    model = results.model
    if exog is None:
        return kept(model, "exog", "predictions for the rows of the fit"), model.data.row_labels
    if isinstance(exog, dict):
        exog = table_of(exog, "exog")
    if hasattr(model, "formula") and transform:
        design, index = new_design(model, exog)
    else:
        try:
            design = np.atleast_2d(np.asarray(exog, float))
        except (TypeError, ValueError):
            raise located("exog", Phrase("values that are no numbers"), "numbers") from None
        index = getattr(exog, "index", pd.RangeIndex(len(design)))
    if design.shape[1] != len(model.exog_names):
        raise located("exog", Phrase(f"{design.shape[1]} columns"), f"{len(model.exog_names)}")
    return design, index


def offset_of(results: LogisticMixedResults, exog: Any, offset: Any) -> Any:
    """The offset given, by name or as it is; without one that of the fit's own rows, or of the formula.

    Raises
    ------
    InputError
        For new rows without an offset where the model has one that is not in its formula.
    """
    if exog is None and offset is None:
        return results.model.offset
    table = table_of(exog, "exog") if isinstance(exog, (pd.DataFrame, dict)) else None
    if offset is None:
        return offset_of_rows(results.model, table, results.has_offset)
    return offset if table is None else named_column(table, offset, "offset")


def shifts_of(results: LogisticMixedResults, exog: Any, groups: Any, n_rows: int) -> Array | None:
    """Modes of the intercepts of rows' groups on the logit scale; None without groups.

    Raises
    ------
    InputError
        For groups of another length, and groups that the fit has not seen.
    """
    model = results.model
    if groups is None:
        return None
    if isinstance(exog, (pd.DataFrame, dict)):
        groups = named_column(table_of(exog, "exog"), groups, "groups")
    elif exog is None and isinstance(groups, str) and groups == model.group_name:
        groups = model.groups
    if np.shape(groups) != (n_rows,):
        raise located("groups", Phrase(f"shape {np.shape(groups)}"), f"one label for each of {n_rows} rows")
    position = model.group_labels.get_indexer(pd.Index(np.asarray(groups)))
    if (position < 0).any():
        unknown = np.asarray(groups)[position < 0][0]
        raise located("groups", Phrase(str(unknown)), "groups of the fit; which='marginal' for others")
    return np.asarray(results.random_effects["mode"].to_numpy()[position])


def predict_rows(
    model: LogisticMixedModel, params: Array, exog: Any, which: str, offset: Any, intercepts: Any
) -> Array:
    """Predictions at given parameters, for rows of a design; see `LogisticMixedResults.predict`.

    Raises
    ------
    InputError
        For a design, offset or intercepts of another size, an unknown kind, and marginal ones with intercepts.
    """
    if exog is None:
        exog = kept(model, "exog", "predictions for the rows of the fit")
        offset = model.offset if offset is None else offset
    elif offset is None and model.offset is not None and model.offset.any():
        offset_of_rows(model, None, has_offset=True)
    exog = np.atleast_2d(np.asarray(exog, float))
    if exog.shape[1] != len(params) - 1:
        raise located("exog", Phrase(f"{exog.shape[1]} columns"), f"{len(params) - 1}, as in the fit")
    eta = exog @ params[:-1]
    for place, shift in (("offset", offset), ("intercepts", intercepts)):
        values = per_row(shift, len(eta), place)
        eta = eta if values is None else eta + values
    if which == "marginal":
        if intercepts is not None:
            raise located("predict", Phrase("'marginal' with groups"), "'conditional' or 'linear' for groups")
        return mean_probability(eta, abs(params[-1]))
    if which == "linear":
        return np.asarray(eta)
    if which == "conditional":
        return np.asarray(expit(eta))
    raise located("which", which, "'marginal', 'conditional' or 'linear'")
