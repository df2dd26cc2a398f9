"""Where chains of an edited model start: near what the data say if the model's terms allow it, else elsewhere.

Starts informed by EM, and PyMC's own, know nothing of a constraint that an analyst added. The sampler gives up on a
chain whose every start is impossible, so each start is tried out here first.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from threading import Lock
from typing import Any

import numpy as np
import pymc as pm
from pytensor.compile.maker import function

from models.edited_prior import free_points, transformed
from models.errors import InputError
from models.parameters import Array
from models.pymc_engine import INTERPRETED

Start = Callable[[int], Array]
"""Unconstrained coordinates by seed."""

PRIOR_SEED = 7_112
"""Of the draws from the prior that are tried last."""


def possible_starts(
    model: pm.Model, shape_info: tuple[list[str], list[slice], list[tuple[int, ...]]], tries: Sequence[Start]
) -> Start:
    """The first of several starts, by seed, at which the density is finite; a draw from the prior if none is.

    Parameters
    ----------
    model : pymc.Model
    shape_info
        nutpie's names, places and shapes of the unconstrained coordinates.
    tries : sequence of callable

    Returns
    -------
    callable
        By seed; it raises `InputError` where nothing is possible. May be called from several threads.
    """
    values = [model.rvs_to_values[v] for v in model.free_RVs]
    places = {name: (place, shape) for name, place, shape in zip(*shape_info, strict=True)}
    own = [places[v.name] for v in values]
    size = sum(place.stop - place.start for place, _ in own)
    inner = function(values, model.logp(), mode=INTERPRETED, on_unused_input="ignore", allow_input_downcast=True)
    lock, drawn = Lock(), list[Array]()  # compiled functions have one storage each

    def possible(x: Array) -> bool:
        with np.errstate(all="ignore"):
            return bool(np.isfinite(inner(*[x[place].reshape(shape) for place, shape in own])))

    def from_prior() -> list[Array]:
        forward = transformed(model)
        found = []
        for point in free_points(model, PRIOR_SEED):
            x = np.empty(size)
            with np.errstate(all="ignore"):
                for (place, _), value in zip(own, forward(point), strict=True):
                    x[place] = np.asarray(value, dtype=np.float64).ravel()
            if np.isfinite(x).all() and possible(x):
                found.append(x)
        return found

    def start(seed: int) -> Array:
        with lock:
            for attempt in tries:
                x = attempt(seed)
                if possible(x):
                    return x
            if not drawn:
                drawn.extend(from_prior())
            if not drawn:
                raise InputError(
                    "edited model: no chain can start: its density is not finite where EM and PyMC would start, "
                    f"nor at draws from its prior; its terms: {', '.join(names_of_terms(model)) or 'none'}"
                )
            return drawn[seed % len(drawn)].copy()

    return start


def names_of_terms(model: pm.Model) -> list[str]:
    """Names of the terms added to the density, the likelihood among them."""
    return [str(term.name) for term in model.potentials]


def tried_out(model: pm.Model, compiled: Any, *more: Start) -> Start:
    """`possible_starts` of a model compiled by nutpie: other starts first, then PyMC's own."""
    return possible_starts(model, compiled.shape_info, [*more, compiled.initial_point_func])
