"""A compiled density as a nutpie model that samples without the GIL.

nutpie calls a C function for the density. Ours is one cached `cfunc` for every study: the arrays of the study
reach it through a table of addresses, so a new study costs no compilation.
"""

# numba's stubs know neither carray nor intrinsics.
# mypy: disable-error-code="attr-defined,call-arg"

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from threading import Event
from typing import Any

import numba
import numpy as np
import pandas as pd
import xarray as xr
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from models import chains as runs
from models.chains import STATS, Chain, NutsSettings, Progress
from models.compiled import kernel_callback
from models.histories import TreeArrays
from models.hmm_density import HmmDensity, RowPlan, StudyArrays, log_density
from models.people_kernel import PeopleArrays
from models.work_clock import WorkClock

__all__ = ["STATS", "Chain", "NutsSettings", "Progress", "callback_of", "sample", "sample_chain"]

HEADER = 14
"""Dimension; states, actions, emission tables, responses; then lengths: nodes, rows, full vector, learned entries,
theta, distinct people + 1, their runs, people, quadrature nodes."""
ARRAYS = 21
"""Entries of the address table: sizes first, then one address an array."""

MOST_STATES = 6
"""Numbers of states up to which a callback is compiled for that number alone."""

STREAM = 7_101
"""First element of the spawn keys of chains."""


@intrinsic
def _pointer(typing_context, address):  # type: ignore[no-untyped-def]
    """Integer address to a void pointer."""

    def generate(context, builder, signature, arguments):  # type: ignore[no-untyped-def]
        return builder.inttoptr(arguments[0], cgutils.voidptr_t)

    return types.voidptr(address), generate


@numba.njit(inline="always")
def _ints(address, n):  # type: ignore[no-untyped-def]
    return numba.carray(_pointer(address), (n,), np.int64)


@numba.njit(inline="always")
def _floats(address, n):  # type: ignore[no-untyped-def]
    return numba.carray(_pointer(address), (n,), np.float64)


_LOGP = types.int64(
    types.uint64, types.CPointer(types.double), types.CPointer(types.double), types.CPointer(types.double),
    types.voidptr,
)  # fmt: skip
_EXPAND = types.int64(
    types.uint64, types.uint64, types.CPointer(types.double), types.CPointer(types.double), types.voidptr
)


@numba.njit(inline="always")
def _pieces(table):  # type: ignore[no-untyped-def]
    """What every model has, from the table of addresses."""
    sizes = (table[1], table[2], table[3], table[4])
    nodes, rows, full, learned, theta = table[5], table[6], table[7], table[8], table[9]
    at = table[HEADER:]
    tree = TreeArrays(
        _ints(at[0], nodes), _ints(at[1], nodes), _ints(at[2], nodes), _ints(at[3], nodes), _floats(at[4], nodes)
    )
    plan = RowPlan(
        _ints(at[7], rows), _ints(at[8], rows), _ints(at[9], rows), _ints(at[10], rows), _ints(at[11], rows)
    )
    return (
        tree, sizes, _ints(at[5], sizes[1]), _ints(at[6], full), plan, _floats(at[12], learned),
        _floats(at[13], theta),
    )  # fmt: skip


@numba.njit(inline="always")
def _status(value, gradient):  # type: ignore[no-untyped-def]
    """What nutpie is told: 0, or that value or gradient is not a number."""
    if not np.isfinite(value):
        return 4
    for i in range(len(gradient)):
        if not np.isfinite(gradient[i]):
            return 3
    return 0


@cache
def _plain_logp(states: int) -> Any:
    """Callback of the plain model, compiled for its number of states (any number, from `MOST_STATES` on)."""
    unit = (0,) * states if states <= MOST_STATES else ()

    @kernel_callback(_LOGP)
    def logp(dimension, x_, gradient_, value_, user_data):  # type: ignore[no-untyped-def]
        table = numba.carray(user_data, (HEADER + ARRAYS,), np.int64)
        x, gradient = numba.carray(x_, (table[0],)), numba.carray(gradient_, (table[0],))
        value = numba.carray(value_, (1,))
        tree, sizes, emission_index, entry, plan, alpha, template = _pieces(table)
        study = StudyArrays(tree, sizes, emission_index, entry, plan, alpha, template, (), unit)
        value[0] = log_density(x, gradient, study, 1.0)
        return _status(value[0], gradient)

    return logp


@cache
def _people_logp() -> Any:
    """Callback of the hierarchical model."""

    @kernel_callback(_LOGP)
    def logp(dimension, x_, gradient_, value_, user_data):  # type: ignore[no-untyped-def]
        table = numba.carray(user_data, (HEADER + ARRAYS,), np.int64)
        x, gradient = numba.carray(x_, (table[0],)), numba.carray(gradient_, (table[0],))
        value = numba.carray(value_, (1,))
        tree, sizes, emission_index, entry, plan, alpha, template = _pieces(table)
        edges, runs, persons, points = table[10], table[11], table[12], table[13]
        at = table[HEADER:]
        people = PeopleArrays(
            _ints(at[14], edges), _ints(at[15], runs), _floats(at[16], persons), _floats(at[17], points),
            _floats(at[18], points), _floats(at[19], sizes[3]), _floats(at[20], 1),
        )  # fmt: skip
        study = StudyArrays(tree, sizes, emission_index, entry, plan, alpha, template, people, ())
        value[0] = log_density(x, gradient, study, 1.0)
        return _status(value[0], gradient)

    return logp


def callback_of(density: HmmDensity) -> Any:
    """The compiled callback a density needs."""
    return _people_logp() if density.people_differ else _plain_logp(density.layout.n_states)


@cache
def _expand() -> Any:
    @kernel_callback(_EXPAND)
    def expand(dimension, expanded, x_, out_, user_data):  # type: ignore[no-untyped-def]
        x = numba.carray(x_, (dimension,))
        out = numba.carray(out_, (dimension,))
        for i in range(dimension):
            out[i] = x[i]
        return 0

    return expand


def address_table(density: HmmDensity) -> tuple[NDArray[np.int64], tuple[NDArray, ...]]:
    """Sizes and addresses for the callbacks, and the arrays that must outlive them."""
    study = density.arrays
    people = density.people
    arrays = (
        *study.tree,
        study.emission_index,
        study.entry,
        *study.plan,
        study.alpha,
        study.template,
        *people,
    )
    header = (
        density.dimension, *study.sizes, density.tree.n_nodes, len(study.plan.start), len(study.entry),
        len(study.alpha), len(study.template), len(people.offset), len(people.node), len(people.weight),
        len(people.z),
    )  # fmt: skip
    table = np.array([*header, *(array.ctypes.data for array in arrays)], dtype=np.int64)
    return table, arrays


def _model(density: HmmDensity) -> Any:
    """The density as a nutpie model; it holds the arrays that its callbacks read."""
    from nutpie import _lib
    from nutpie.sample import CompiledModel

    table, arrays = address_table(density)
    dimension = density.dimension

    class Model(CompiledModel):
        keep = (table, arrays)

        @property
        def n_dim(self) -> int:
            return dimension

        @property
        def shapes(self) -> dict[str, tuple[int, ...]]:
            return {"x": (dimension,)}

        @property
        def coords(self) -> dict[str, Any]:
            return {"coordinate": np.arange(dimension)}

        def _make_sampler(self, settings: Any, init_mean: Any, cores: Any, *rest: Any) -> Any:
            sizes = {"coordinate": dimension}
            variables = _lib.PyVariable.new_variables(
                ["x"], ["float64"], [(dimension,)], sizes, {"x": ["coordinate"]}
            )
            logp = _lib.LogpFunc(callback_of(density).address, table.ctypes.data, self)
            expand = _lib.ExpandFunc(dimension, dimension, _expand().address, table.ctypes.data, self)
            model = _lib.PyMcModel(
                logp, expand, variables, dimension, sizes, {"coordinate": pd.RangeIndex(dimension)},
                density.starting_point, lambda *a, **k: None,
            )  # fmt: skip
            return _lib.PySampler.from_pymc(settings, cores, model, *rest)

    return Model({"x": ("coordinate",)})


class DensityTarget:
    """The compiled density as something to sample; draws are its unconstrained coordinates."""

    stream = STREAM

    def __init__(self, density: HmmDensity) -> None:
        self.density = density

    def prepare(self) -> None:
        """Compile the callbacks."""
        import nutpie  # noqa: F401

        callback_of(self.density), _expand()

    def nutpie_model(self) -> Any:
        """One for each chain: it holds the arrays its callbacks read."""
        return _model(self.density)

    def columns(self, posterior: xr.Dataset) -> NDArray[np.float64]:
        """Coordinates as they come."""
        return posterior["x"].to_numpy()[0]


def sample_chain(
    density: HmmDensity,
    chain: int,
    settings: NutsSettings,
    progress: Callable[[int], None] | None = None,
    stop: Event | None = None,
) -> Chain:
    """`models.chains.sample_chain` of a density."""
    return runs.sample_chain(DensityTarget(density), chain, settings, progress, stop)


def sample(
    density: HmmDensity,
    settings: NutsSettings,
    *,
    done: Mapping[int, Chain] | None = None,
    finished: Callable[[int, Chain], None] | None = None,
    progress: Progress | None = None,
    clock: WorkClock | None = None,
) -> dict[int, Chain]:
    """`models.chains.sample` of a density."""
    return runs.sample(
        DensityTarget(density), settings, done=done, finished=finished, progress=progress, clock=clock
    )
