"""Pickling a model made from a formula, whichever engine read it.

statsmodels leaves the design's description out of a pickle and evaluates the formula again in frames of the caller,
which fails where there are none (at the top of a script). Here formulaic's description is kept, and patsy's, which
cannot be, is made anew from the formula and the data.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np
from statsmodels.formula._manager import FormulaManager


def state_of(model: Any) -> dict[str, Any]:
    """The model's attributes, those of its data object taken apart."""
    state = dict(vars(model))
    data = state.pop("data")
    parts = dict(vars(data))
    if type(parts.get("model_spec")).__module__.startswith("patsy"):
        parts["model_spec"] = None
    if "made" in parts:
        parts["made"] = None  # a plain formula's description is made anew wherever it is asked for
    return {"attributes": state, "data_class": type(data), "data": parts}


def restore(model: Any, state: dict[str, Any]) -> None:
    """Set the attributes of an empty model."""
    vars(model).update(state["attributes"])
    data = state["data_class"].__new__(state["data_class"])
    vars(data).update(state["data"])
    if "model_spec" in state["data"] and data.model_spec is None:
        # Functions used in the formula are looked up where the pickle is read, as on the command line.
        names = {"np": np, "numpy": np, **vars(sys.modules["__main__"])}
        manager = FormulaManager(engine="patsy")
        manager.get_matrices(data.formula, data.frame, eval_env=names)
        data.model_spec = manager.spec
    model.data = data
