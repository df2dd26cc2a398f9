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

ENOUGH = 20
"""Possible points at which densities are compared."""

CANDIDATES = 400
"""Random points among which these are looked for; each is cheap, and terms may rule out most of them."""

TOLERANCE = 1e-9
"""Difference of log-densities, relative to their size, that is put down to rounding."""

Point = dict[str, np.ndarray]
"""A value of every free variable, as the model's prior draws it (not transformed)."""


def check_tables(model: pm.Model, study: StudyDensity) -> None:
    """Refuse what is no model, or lacks a table, or has one of other sizes than `build_model` gives it.

    Raises
    ------
    InputError
    """
    if not isinstance(model, pm.Model):
        raise located("edited model", Phrase(f"a {type(model).__name__}"), "a pymc.Model, as build_model gives it")
    own = model_of(study)
    for name in [*learned_names(study), LIKELIHOOD]:
        if name not in model.named_vars:
            raise located("edited model, variables", sorted(model.named_vars), f"{name!r} among them")
        wanted = own[name].ndim
        if model[name].ndim != wanted:
            raise located(f"edited model, {name}, dimensions", model[name].ndim, f"{wanted}, as build_model has it")
        shape, sizes = _shape(model, name), _shape(own, name)
        if shape != sizes:
            raise located(
                f"edited model, {name}, shape", shape,
                f"{sizes}: {study.spec.states} states, and the actions and groups of this log",
            )  # fmt: skip
    if LIKELIHOOD not in [p.name for p in model.potentials]:
        raise located(f"edited model, {LIKELIHOOD}", Phrase("another kind of variable"), "a potential")
    for variable in model.free_RVs:
        if variable.dtype not in ("float64", "float32"):
            raise located(
                f"edited model, {variable.name}", Phrase(f"a discrete variable ({variable.dtype})"),
                "continuous ones: the sampler moves along gradients",
            )  # fmt: skip


def _shape(model: pm.Model, name: str) -> tuple[int, ...]:
    static = model[name].type.shape
    return tuple(map(int, model[name].shape.eval(mode=INTERPRETED) if None in static else static))


def free_points(model: pm.Model, seed: int, n: int = CANDIDATES) -> list[Point]:
    """Some draws of the free variables from their distributions; added terms do not matter here.

    Raises
    ------
    InputError
        If a variable's distribution is none to draw from, as an improper one.
    """
    names = [v.name for v in model.free_RVs]
    if not names:
        return [{} for _ in range(n)]
    try:
        drawn = pm.draw(list(model.free_RVs), draws=n, random_seed=seed, mode=INTERPRETED)
    except NotImplementedError as error:
        raise located(
            "edited model, free variables", Phrase(f"a distribution nobody can draw from ({error})"),
            "proper ones, not pm.Flat or pm.HalfFlat: contraction is measured against draws from the prior",
        ) from None  # fmt: skip
    return [{name: np.asarray(values[i]) for name, values in zip(names, drawn, strict=True)} for i in range(n)]


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
    density at random points must not change. A point that is possible with the states in one order only is a
    difference; one that is impossible in both says nothing. That finds every prior that tells states apart, but
    for one whose densities happen to agree at all of these points.

    Parameters
    ----------
    model : pymc.Model
    study : StudyDensity
    points : list of Point
        In order, until `ENOUGH` were possible.

    Raises
    ------
    InputError
        Also if hardly a point is possible, so that nobody can tell.
    """
    swaps = range(study.spec.states - 1)
    if not swaps:
        return
    density = density_of(model)
    possible = 0
    for point in points:
        before = density(point)
        for s in swaps:
            _same_density(before, density(swapped(model, point, s)), s)
        possible += bool(np.isfinite(before))
        if possible == ENOUGH:
            return
    if possible == 0:
        raise InputError(
            f"edited model: impossible at each of {len(points)} draws from the distributions of its variables, so "
            "whether the terms added tell states apart cannot be seen. Write the prior so that its variables are "
            "drawn where its terms allow them"
        )


def _same_density(before: float, after: float, s: int) -> None:
    """Refuse log densities of a point and of the same with states s and s + 1 swapped that differ."""
    can, could = bool(np.isfinite(before)), bool(np.isfinite(after))
    if not can and not could:
        return
    if can != could:
        change = "turns from possible to impossible" if can else "turns from impossible to possible"
    elif abs(after - before) > TOLERANCE * max(1.0, abs(before)):
        change = f"changes by {after - before:.3g}"
    else:
        return
    raise InputError(
        "the edited prior tells the states apart, so draws must not be relabelled: with "
        f"s{s} and s{s + 1} swapped the log density {change} at one point. Read the model's own trace and keep its "
        "labels; or, if states are alike, give every variable with one value a state the dimension 'state'"
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


def density_of(model: pm.Model) -> Any:
    """Log density of all terms at a point of the free variables, without Jacobians."""
    values = [model.rvs_to_values[v] for v in model.free_RVs]
    inner = function(
        values, model.logp(jacobian=False), mode=INTERPRETED, on_unused_input="ignore", allow_input_downcast=True
    )
    forward = transformed(model)

    def density(point: Point) -> float:
        with np.errstate(all="ignore"):  # impossible points are met on purpose
            return float(inner(*forward(point)))

    return density


def transformed(model: pm.Model) -> Any:
    """Function from a point of the free variables to their transformed values, in the model's order."""
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
