"""What an analyst's model draws beside the tables: kept, put into canonical order with them, seen by the gate.

A concentration, a mean of each state, a deterministic with a name: whatever is not too large is drawn with the
learned vector, in columns behind it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import prod
from typing import Any

import numpy as np
import pymc as pm
import xarray as xr

from models.bayesian_hmm import model_of
from models.edited_prior import STATE_DIMS
from models.edited_starts import Start, tried_out
from models.entries import SPREAD, TABLES
from models.errors import Phrase, located
from models.labels import canonical_order
from models.parameters import Array
from models.pymc_engine import INTERPRETED, ModelTarget, learned_columns
from models.study_density import StudyDensity

LARGEST = 200
"""Entries of an added variable above which it is not kept; free ones count in the gate all the same."""


@dataclass(frozen=True, eq=False)
class EditedTarget(ModelTarget):
    """An edited model: draws are vectors of learned entries, then those of the variables that were added."""

    @cached_property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Shapes of the added variables that are drawn too: all free ones, and deterministics that are not large.

        A variable by the name of a table is that table, which is kept anyway.
        """
        own = {*model_of(self.study).named_vars, *TABLES, SPREAD}
        free = {v.name for v in self.model.free_RVs}
        found = {}
        for variable in [*self.model.free_RVs, *self.model.deterministics]:
            if variable.name in own:
                continue
            static = variable.type.shape
            shape = tuple(map(int, variable.shape.eval(mode=INTERPRETED) if None in static else static))
            if variable.name in free or prod(shape) <= LARGEST:
                found[variable.name] = shape
        return found

    @property
    def width(self) -> int:
        """Columns of a draw."""
        return self.study.layout.size + self.study.density.people_differ + sum(map(prod, self.shapes.values()))

    @cached_property
    def gated(self) -> tuple[str, ...]:
        """The free ones among them."""
        free = {v.name for v in self.model.free_RVs}
        return tuple(name for name in self.shapes if name in free)

    @cached_property
    def sampled_names(self) -> list[str]:
        """The tables that vary, and what was added."""
        return [*learned_columns(self), *self.shapes]

    def starts(self, compiled: Any) -> Start:
        """Near what the data say, if the model's terms allow it."""
        return tried_out(self.frozen, compiled, super().starts(compiled))

    def columns(self, posterior: xr.Dataset) -> Array:
        """Learned entries, then added ones."""
        return self.joined(posterior)[0]

    def joined(self, draws: xr.Dataset) -> Array:
        """Draws as vectors ``[chain, draw, column]``."""
        theta = self.vectors(draws)
        lead = theta.shape[:2]
        return np.concatenate([theta, *(draws[n].to_numpy().reshape(*lead, -1) for n in self.shapes)], axis=-1)

    def split(self, x: Array) -> tuple[Array, xr.Dataset]:
        """Learned vectors, and the added variables with their states in the canonical order of each draw.

        Parameters
        ----------
        x : float64[chain, draw, column]
        """
        at = self.width - sum(map(prod, self.shapes.values()))
        theta = x[..., :at]
        order = canonical_states(self.study, theta)
        variables = {}
        for name, shape in self.shapes.items():
            values = x[..., at : at + prod(shape)].reshape(*x.shape[:2], *shape)
            at += prod(shape)
            dims = dims_of(self.model, name, len(shape))
            for axis, dim in enumerate(dims, start=2):
                if dim in STATE_DIMS:
                    index = order.reshape(
                        *order.shape[:2], *(-1 if i == axis else 1 for i in range(2, values.ndim))
                    )
                    values = np.take_along_axis(values, index, axis=axis)
            variables[name] = (("chain", "draw", *dims), values)
        made = xr.Dataset(variables)
        labels = {d: list(self.model.coords[d]) for d in made.dims if self.model.coords.get(d) is not None}
        return theta, made.assign_coords({d: v for d, v in labels.items() if len(v) == made.sizes[d]})


def canonical_states(study: StudyDensity, theta: Array) -> np.ndarray:
    """Order of the states of each draw, ``[..., s]``, as `models.fit_tree.canonical_tables` has it."""
    emission = study.layout.unpack(theta[..., : study.layout.size])[2]
    return canonical_order(emission, study.log.protocol.scores, study.emission_weights)


def dims_of(model: pm.Model, name: str, ndim: int) -> tuple[str, ...]:
    """Dimensions of a variable as the model names them; PyMC's own names where it does not."""
    own = model.named_vars_to_dims.get(name) or (None,) * ndim
    return tuple(str(dim) if dim is not None else f"{name}_dim_{i}" for i, dim in enumerate(own))


def in_order(target: ModelTarget, draws: xr.Dataset) -> xr.Dataset:
    """Variables of somebody's trace with their axes, and the labels along them, as the model has them.

    Axes are told by name, so a trace may have been transposed, or put in another order of its labels.

    Raises
    ------
    InputError
        On a variable that is missing, has other dimensions, sizes or labels, or values no such table can have.
    """
    out = {}
    for name in target.sampled_names:
        if name not in draws:
            raise located("trace, variables", sorted(map(str, draws.data_vars)), f"{name!r} among them")
        found = draws[name]
        wanted = ("chain", "draw", *dims_of(target.model, name, target.model[name].ndim))
        if set(found.dims) != set(wanted):
            raise located(f"trace, {name}, dimensions", tuple(found.dims), f"{', '.join(wanted)} in any order")
        for dim in wanted[2:]:
            labels = target.model.coords.get(dim)
            if labels is None or dim not in found.coords or list(found[dim].to_numpy()) == list(labels):
                continue
            if sorted(map(str, found[dim].to_numpy())) != sorted(map(str, labels)):
                raise located(f"trace, {name}, {dim}", list(found[dim].to_numpy()), f"{list(labels)}")
            found = found.sel({dim: list(labels)})
        out[name] = found.transpose(*wanted).variable
    return xr.Dataset(out)


def check_probabilities(study: StudyDensity, theta: Array) -> None:
    """Refuse learned vectors with a row that is no probability distribution, or a sigma that is not positive.

    Raises
    ------
    InputError
    """
    if not np.isfinite(theta).all():
        raise located("trace", Phrase("values that are not finite"), "finite draws")
    for kind, row in zip(study.layout.row_kinds, study.layout.rows, strict=True):
        p = theta[..., row]
        off = float(np.abs(p.sum(axis=-1) - 1).max())
        if p.min() < 0 or off > 1e-6:
            found = f"a smallest entry {p.min():.3g} and rows up to {off:.3g} from a sum of 1"
            raise located(f"trace, {kind}", Phrase(found), "rows of probabilities")
    if study.density.people_differ and theta[..., -1].min() <= 0:
        raise located(f"trace, {SPREAD}", float(theta[..., -1].min()), "positive numbers")
