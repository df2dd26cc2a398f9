"""What an edited PyMC model is, as a digest: the same for a model built again the same way, in any process.

The graph of its density and of its named variables is walked: every operation with its properties, every constant
and data container with its content. The likelihood stands by its name: its data have a digest of their own. Because
an operation of somebody else's may hide what it does, log densities at some points are part of the digest too.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from typing import Any

import numpy as np
import pymc as pm
from pytensor.compile.sharedvalue import SharedVariable
from pytensor.graph.basic import Constant, Variable
from pytensor.graph.traversal import ancestors as all_ancestors
from pytensor.graph.traversal import io_toposort

from models.edited_prior import density_of, free_points

PROBES = 5
"""Points whose densities are part of the digest."""

PROBE_SEED = 7_113


def model_digest(model: pm.Model) -> str:
    """Digest of a model's variables, names, dimensions, terms, transforms, starts and data.

    Parameters
    ----------
    model : pymc.Model
    """
    named = [*model.free_RVs, *model.deterministics, *model.potentials]
    digest = hashlib.sha256()
    for variable in named:
        transform = model.rvs_to_transforms.get(variable)
        start = model.rvs_to_initial_values.get(variable)
        dims = model.named_vars_to_dims.get(variable.name, ())
        about = [variable.name, dims, _properties(transform), _content(start)]
        digest.update(repr(about).encode())
    digest.update(repr({k: None if v is None else list(map(str, v)) for k, v in model.coords.items()}).encode())
    digest.update("\n".join(_lines([*named, model.logp()])).encode())
    density = density_of(model)
    for point in free_points(model, PROBE_SEED, PROBES):
        digest.update(f"{density(point):.10g}".encode())
    return digest.hexdigest()


def _lines(outputs: list[Any]) -> Iterable[str]:
    """A graph as text: what each variable is made of, in an order that only the graph determines."""
    number: dict[Variable, int] = {}

    def of(variable: Variable) -> int:
        return number.setdefault(variable, len(number))

    inputs = [v for v in all_ancestors(outputs) if v.owner is None]
    for variable in inputs:
        if isinstance(variable, Constant):
            what = _content(variable.data)
        elif isinstance(variable, SharedVariable) and not _random(variable):
            what = _content(variable.get_value(borrow=True))
        else:
            what = variable.name or ""  # a value variable; the state of a generator says nothing of the model
            what = "" if _random(variable) else what
        yield f"{of(variable)} {variable.type} {what}"
    for node in io_toposort(inputs, outputs):
        made = [of(v) for v in node.outputs]
        yield f"{made} {_properties(node.op)} {[of(v) for v in node.inputs]}"
    yield str([of(v) for v in outputs])


def _random(variable: Variable) -> bool:
    return "Random" in type(variable.type).__name__


def _properties(thing: Any) -> str:
    """An operation's or transform's kind and properties, inner graphs included, without addresses in memory."""
    if thing is None or isinstance(thing, bool | int | float | str):
        return repr(thing)
    if isinstance(thing, tuple | list):
        return f"({', '.join(_properties(part) for part in thing)})"
    kind = f"{type(thing).__module__}.{type(thing).__qualname__}"
    inner = getattr(thing, "fgraph", None)
    if inner is not None:
        return f"{kind}[{' | '.join(_lines(list(inner.outputs)))}]"
    names = [n for n in getattr(thing, "__props__", None) or () if isinstance(n, str)]
    parts = [f"{name}={_properties(getattr(thing, name))}" for name in names]
    return f"{kind}({', '.join(parts)}){getattr(thing, 'name', None) or ''}"


def _content(value: Any) -> str:
    """A constant's content; long ones by their digest."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        return _properties(value)
    if array.dtype == object:
        return _properties(value)
    return f"{array.dtype}{array.shape}{hashlib.sha256(np.ascontiguousarray(array).tobytes()).hexdigest()}"
