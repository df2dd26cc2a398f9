"""What is asked of an edited PyMC model before it is fitted: its tables, its likelihood, free labels of states."""

from __future__ import annotations

from typing import Any

import numpy as np
import pymc as pm
import xarray as xr
from pytensor.compile.maker import function
from pytensor.graph.replace import clone_replace

from models.bayesian_hmm import learned_names, learned_vector, model_of
from models.errors import InputError, Phrase, located
from models.parameters import Array
from models.pymc_engine import INTERPRETED
from models.study_density import StudyDensity

LIKELIHOOD = "log_likelihood"
"""Name of the potential that brings the data in."""

STATE_DIMS = ("state", "state_next")

TRIED = 3
"""Random points at which densities are compared."""

TOLERANCE = 1e-9
"""Difference of log-densities, relative to their size, that is put down to rounding."""

Point = dict[str, np.ndarray]
"""A value of every free variable, as the model's prior draws it (not transformed)."""


def check_tables(model: pm.Model, study: StudyDensity) -> None:
    """Refuse a model that lacks a table, or has one with other dimensions than `build_model` gives it.

    Raises
    ------
    InputError
    """
    own = model_of(study)
    for name in [*learned_names(study), LIKELIHOOD]:
        if name not in model.named_vars:
            raise located("edited model, variables", sorted(model.named_vars), f"{name!r} among them")
        wanted = own[name].ndim
        if model[name].ndim != wanted:
            raise located(f"edited model, {name}, dimensions", model[name].ndim, f"{wanted}, as build_model has it")
    if LIKELIHOOD not in [p.name for p in model.potentials]:
        raise located(f"edited model, {LIKELIHOOD}", Phrase("another kind of variable"), "a potential")


def free_points(model: pm.Model, seed: int) -> list[Point]:
    """Some draws of the free variables from their distributions; added terms do not matter here."""
    names = [v.name for v in model.free_RVs]
    drawn = pm.draw(list(model.free_RVs), draws=TRIED, random_seed=seed, mode=INTERPRETED) if names else []
    return [{name: np.asarray(values[i]) for name, values in zip(names, drawn, strict=True)} for i in range(TRIED)]


def check_likelihood(model: pm.Model, study: StudyDensity, point: Point) -> None:
    """Refuse a model whose likelihood is not the log's, as one built from another selection of it.

    Raises
    ------
    InputError
    """
    names = [*learned_names(study), LIKELIHOOD]
    values = dict(zip(names, _evaluate(model, [model[n] for n in names], point), strict=True))
    draws = xr.Dataset(
        {n: ((*"cd", *(f"{n}{i}" for i in range(v.ndim))), v[None, None]) for n, v in values.items()}
    )
    wanted = float(study.log_likelihoods(learned_vector(study, draws)[0, 0]).sum())
    found = float(values[LIKELIHOOD])
    if abs(found - wanted) > TOLERANCE * max(1.0, abs(wanted)):
        raise located(
            f"edited model, {LIKELIHOOD} at one point", found,
            f"{wanted:g}, that of the {study.log.n_participants} people of this log: was the model built for "
            "another log, or another selection of it?",
        )  # fmt: skip


def check_labels_are_free(model: pm.Model, study: StudyDensity, points: list[Point]) -> None:
    """Refuse a prior that tells states apart: draws could not be put into canonical order.

    Neighbouring states are swapped in every variable with a dimension ``state`` or ``state_next``; the model's
    density at random points must not change. That finds every prior that tells states apart, but for one whose
    densities happen to agree at all of these points.

    Raises
    ------
    InputError
    """
    density = _density(model)
    base = [density(point) for point in points]
    for s in range(study.spec.states - 1):
        for point, before in zip(points, base, strict=True):
            after = density(swapped(model, point, s))
            if abs(after - before) > TOLERANCE * max(1.0, abs(before)):
                raise InputError(
                    "the edited prior tells the states apart, so draws must not be relabelled: with "
                    f"s{s} and s{s + 1} swapped the log density changes by {after - before:.3g} at one point. Read "
                    "the model's own trace and keep its labels; or, if states are alike, give every variable with "
                    "one value a state the dimension 'state'"
                )


def swapped(model: pm.Model, point: Point, s: int) -> Point:
    """The point with states s and s + 1 exchanged."""
    out = {}
    for name, value in point.items():
        for axis, dim in enumerate(model.named_vars_to_dims.get(name, ())):
            if dim in STATE_DIMS:
                order = np.arange(value.shape[axis])
                order[[s, s + 1]] = order[[s + 1, s]]
                value = np.take(value, order, axis=axis)
        out[name] = value
    return out


def _density(model: pm.Model) -> Any:
    """Log density of all terms at a point of the free variables, without Jacobians."""
    values = [model.rvs_to_values[v] for v in model.free_RVs]
    inner = function(
        values, model.logp(jacobian=False), mode=INTERPRETED, on_unused_input="ignore", allow_input_downcast=True
    )
    forward = _forward(model)

    def density(point: Point) -> float:
        return float(inner(*forward(point)))

    return density


def _forward(model: pm.Model) -> Any:
    """Function from a point of the free variables to their transformed values."""
    plain = [v.type() for v in model.free_RVs]
    outputs: list[Any] = []
    for rv, value in zip(model.free_RVs, plain, strict=True):
        transform = model.rvs_to_transforms[rv]
        outputs.append(value if transform is None else transform.forward(value, *rv.owner.inputs))
    replaced = clone_replace(outputs, dict(zip(model.free_RVs, plain, strict=True)))
    forward = function(plain, replaced, mode=INTERPRETED, on_unused_input="ignore")
    names = [v.name for v in model.free_RVs]
    return lambda point: forward(*[point[n] for n in names])


def _evaluate(model: pm.Model, wanted: list[Any], point: Point) -> list[Array]:
    """Values of variables of the model at a point of its free ones."""
    inputs = list(model.free_RVs)
    evaluate = function(inputs, wanted, mode=INTERPRETED, on_unused_input="ignore")
    return [np.asarray(v) for v in evaluate(*[point[v.name] for v in inputs])]
