"""The one file that knows nutpie's insides: a compiled density as a nutpie model that samples without the GIL.

nutpie calls a C function for the density. Ours is one cached `cfunc` for every study: the arrays of the study
reach it through a table of addresses, so a new study costs no compilation.
"""

# numba's stubs know neither carray nor intrinsics.
# mypy: disable-error-code="attr-defined,call-arg"

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from functools import cache
from threading import Event
from typing import Any

import numba
import numpy as np
import pandas as pd
from numba.core import cgutils, types
from numba.extending import intrinsic
from numpy.typing import NDArray

from models.compiled import kernel_callback
from models.errors import located
from models.histories import TreeArrays
from models.hmm_density import HmmDensity, RowPlan, StudyArrays, log_density
from models.people_kernel import PeopleArrays

HEADER = 14
"""Dimension; states, actions, emission tables, responses; then lengths: nodes, rows, full vector, learned entries,
theta, distinct people + 1, their runs, people, quadrature nodes."""
ARRAYS = 21
"""Entries of the address table: sizes first, then one address an array."""

MOST_STATES = 6
"""Numbers of states up to which a callback is compiled for that number alone."""

Progress = Callable[[str, int, int], None]


STREAM = 7_101
"""First element of the spawn keys of chains."""

STATS = {"diverging": "diverging", "n_steps": "n_steps", "depth": "depth", "energy": "energy", "lp": "logp"}
"""Our names of the sampler's statistics and nutpie's."""


@dataclass(frozen=True)
class NutsSettings:
    """How to sample. `target_accept` above nutpie's .8 keeps the corners of the simplex free of divergences."""

    draws: int = 1000
    tune: int = 1000
    chains: int = 4
    seed: int = 1
    target_accept: float = 0.95

    def __post_init__(self) -> None:
        for name, low in (("draws", 4), ("tune", 50), ("chains", 1), ("seed", 0)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < low:
                raise located(f"sampling, {name}", value, f"an integer of at least {low}")
            object.__setattr__(self, name, int(value))  # numpy's integers do not go into settings files
        if not 0.5 <= self.target_accept < 1:
            raise located("sampling, target_accept", self.target_accept, "a number from 0.5 to below 1")


@dataclass(frozen=True)
class Chain:
    """One chain on unconstrained coordinates.

    Attributes
    ----------
    x : float64[draw, coordinate]
    stats : dict of str to arrays [draw]
        `diverging`, `n_steps`, `depth`, `energy`, `lp`.
    """

    x: NDArray[np.float64]
    stats: dict[str, NDArray]


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


def sample_chain(
    density: HmmDensity,
    chain: int,
    settings: NutsSettings,
    progress: Callable[[int], None] | None = None,
    stop: Event | None = None,
) -> Chain:
    """Run one chain; its stream depends on seed and chain number only, so chains can be run anywhere, any time.

    Setting `stop` from another thread ends it with `CancelledError`.
    """
    import nutpie

    stream = np.random.SeedSequence(settings.seed, spawn_key=(STREAM, chain))
    sampler = nutpie.sample(
        _model(density), draws=settings.draws, tune=settings.tune, chains=1, cores=1,
        seed=int(stream.generate_state(1)[0]), target_accept=settings.target_accept, progress_bar=False,
        save_warmup=False, blocking=False, progress_rate=200,
        progress_callback=None if progress is None else lambda chains: progress(chains[0].finished_draws),
    )  # fmt: skip
    try:
        while True:
            try:
                tree = sampler.wait(timeout=0.2)
                break
            except TimeoutError:  # still sampling: a moment to notice that it was called off
                if stop is not None and stop.is_set():
                    raise CancelledError from None
    except BaseException:
        sampler.cancel()
        raise
    stats = tree["sample_stats"]
    return Chain(
        np.ascontiguousarray(tree["posterior"]["x"].to_numpy()[0]),
        {name: stats[key].to_numpy()[0] for name, key in STATS.items()},
    )


def sample(
    density: HmmDensity,
    settings: NutsSettings,
    *,
    done: Mapping[int, Chain] | None = None,
    finished: Callable[[int, Chain], None] | None = None,
    progress: Progress | None = None,
) -> dict[int, Chain]:
    """Run the chains that are not `done`, two or more at a time in threads.

    Parameters
    ----------
    density : HmmDensity
    settings : NutsSettings
    done : mapping of int to Chain, optional
        Chains of an interrupted earlier run.
    finished : callable, optional
        Called with each chain as it completes, so that it can be kept.
    progress : callable, optional
        Called with (label, done, total) draws over all chains, tuning included.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C; chains that were complete have been passed to `finished`.
    """
    chains = dict(done or {})
    missing = [c for c in range(settings.chains) if c not in chains]
    total = settings.chains * (settings.draws + settings.tune)
    stop = Event()
    counts = dict.fromkeys(chains, settings.draws + settings.tune)

    def run(chain: int) -> Chain:
        def update(n: int) -> None:
            counts[chain] = n
            if progress is not None:
                progress("sampling", sum(counts.values()), total)

        return sample_chain(density, chain, settings, update if progress is not None else None, stop)

    callback_of(density), _expand()  # compiled once, before threads ask for them
    pool = ThreadPoolExecutor(max_workers=max(1, min(len(missing), os.cpu_count() or 1)))
    try:
        futures = {pool.submit(run, c): c for c in missing}
        for future in as_completed(futures):
            chains[futures[future]] = future.result()
            if finished is not None:
                finished(futures[future], chains[futures[future]])
    except BaseException:
        stop.set()
        pool.shutdown(cancel_futures=True)
        raise
    pool.shutdown()
    return {c: chains[c] for c in sorted(chains)}
