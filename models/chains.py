"""Chains of nutpie: one at a time, each with its own stream, or several in threads, kept as they complete.

Whatever can be sampled is a `Target`: the compiled density (`models.nuts`) or a PyMC model (`models.pymc_engine`).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import CancelledError, ThreadPoolExecutor, as_completed
from dataclasses import dataclass, replace
from threading import Event, Lock
from typing import Any, Protocol

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from models.errors import InputError, located
from models.spread_out import threads_here
from models.work_clock import WorkClock

Progress = Callable[[str, int, int], None]

STATS = {
    "diverging": "diverging", "n_steps": "n_steps", "depth": "depth", "energy": "energy", "lp": "logp",
    "reached_max_treedepth": "maxdepth_reached", "step_size": "step_size", "acceptance_rate": "mean_tree_accept",
}  # fmt: skip
"""Our names of the sampler's statistics, which are ArviZ's where it has one, and nutpie's."""


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
        object.__setattr__(self, "target_accept", float(self.target_accept))


@dataclass(frozen=True)
class Chain:
    """One chain.

    Attributes
    ----------
    x : float64[draw, column]
        What its target makes of the draws: unconstrained coordinates (engine `direct`), or vectors of learned
        entries (engine `pymc`).
    stats : dict of str to arrays [draw]
        The keys of `STATS`.
    cpu_seconds : float
        CPU time it took, without compilation: chains that run at the same time share the process's equally.
    """

    x: NDArray[np.float64]
    stats: dict[str, NDArray]
    cpu_seconds: float = 0.0


def unusable(chain: Chain, draws: int, columns: int | None = None) -> str | None:
    """What is wrong with a chain that was read back; None if a run of these settings may have made it.

    Parameters
    ----------
    chain : Chain
    draws, columns : int
        Of the run; columns need not be known.
    """
    x, seconds = np.asarray(chain.x), np.asarray(chain.cpu_seconds)
    if x.ndim != 2 or len(x) != draws or (columns is not None and x.shape[1] != columns):
        return f"draws of shape {x.shape}, wanted {draws} x {'any' if columns is None else columns}"
    if x.dtype != np.float64 or not np.isfinite(x).all():
        return "draws that are not finite numbers"
    if set(chain.stats) != set(STATS):
        return f"statistics {', '.join(sorted(chain.stats)) or 'none'}, wanted {', '.join(sorted(STATS))}"
    for name, values in chain.stats.items():
        if values.shape != (draws,) or values.dtype.kind not in "biuf":
            return f"statistic {name} of shape {values.shape}, wanted {draws} numbers"
    if seconds.shape != () or not np.isfinite(seconds) or seconds < 0:
        return "no CPU time"
    return None


class Target(Protocol):
    """What can be sampled."""

    @property
    def stream(self) -> int:
        """First element of the spawn keys of its chains."""
        ...

    def prepare(self) -> None:
        """Import and compile what all chains share."""
        ...

    def nutpie_model(self) -> Any:
        """As nutpie wants it."""
        ...

    def columns(self, posterior: xr.Dataset) -> NDArray[np.float64]:
        """Variables of nutpie's model, dims chain (one) and draw first, to ``[draw, column]``."""
        ...


def sample_chain(
    target: Target,
    chain: int,
    settings: NutsSettings,
    progress: Callable[[int], None] | None = None,
    stop: Event | None = None,
) -> Chain:
    """Run one chain; its stream depends on seed and chain number only, so chains can be run anywhere, any time.

    Setting `stop` from another thread ends it with `CancelledError`.

    Raises
    ------
    InputError
        If the density is finite nowhere the chain may start.
    """
    import nutpie

    stream = np.random.SeedSequence(settings.seed, spawn_key=(target.stream, chain))
    sampler = nutpie.sample(
        target.nutpie_model(), draws=settings.draws, tune=settings.tune, chains=1, cores=1,
        seed=int(stream.generate_state(1)[0]), target_accept=settings.target_accept, progress_bar=False,
        save_warmup=False, blocking=False, progress_rate=200,
        progress_callback=None if progress is None else lambda chains: progress(chains[0].finished_draws),
    )  # fmt: skip
    try:
        while True:
            try:
                tree = sampler.wait(timeout=0.2)
                break
            except RuntimeError as error:
                if "initialization points failed" not in str(error):
                    raise
                raise InputError(
                    f"chain {chain} cannot start: the log density or its gradient is not finite at any starting "
                    "point; a term of the model, such as a constraint, rules all of them out"
                ) from None
            except TimeoutError:  # still sampling: a moment to notice that it was called off
                if stop is not None and stop.is_set():
                    raise CancelledError from None
    except BaseException:
        sampler.cancel()
        raise
    stats = tree["sample_stats"]
    return Chain(
        np.ascontiguousarray(target.columns(tree["posterior"].to_dataset())),
        {name: stats[key].to_numpy()[0] for name, key in STATS.items()},
    )


def sample(
    target: Target,
    settings: NutsSettings,
    *,
    done: Mapping[int, Chain] | None = None,
    finished: Callable[[int, Chain], None] | None = None,
    progress: Progress | None = None,
    clock: WorkClock | None = None,
) -> dict[int, Chain]:
    """Run the chains that are not `done`, two or more at a time in threads.

    Parameters
    ----------
    target : Target
    settings : NutsSettings
    done : mapping of int to Chain, optional
        Chains of an interrupted earlier run.
    finished : callable, optional
        Called with each chain as it completes, so that it can be kept.
    progress : callable, optional
        Called with (label, done, total) draws over all chains, tuning included.
    clock : WorkClock, optional
        That tells CPU time from compilation.

    Raises
    ------
    KeyboardInterrupt
        On Ctrl-C; chains that were complete have been passed to `finished`.
    """
    chains = {c: chain for c, chain in (done or {}).items() if c < settings.chains}
    missing = [c for c in range(settings.chains) if c not in chains]
    if not missing:
        return {c: chains[c] for c in sorted(chains)}
    clock = clock or WorkClock()
    total = settings.chains * (settings.draws + settings.tune)
    stop = Event()
    counts = dict.fromkeys(chains, settings.draws + settings.tune)
    with clock.preparing():
        target.prepare()  # once, before threads ask for it
    shares = _Shares(clock)

    def run(chain: int) -> Chain:
        def update(n: int) -> None:
            counts[chain] = n
            if progress is not None:
                progress("sampling", sum(counts.values()), total)

        shares.begin(chain)
        try:
            made = sample_chain(target, chain, settings, update if progress is not None else None, stop)
        finally:
            seconds = shares.end(chain)
        return replace(made, cpu_seconds=seconds)

    pool = ThreadPoolExecutor(max_workers=max(1, min(len(missing), threads_here())))
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


class _Shares:
    """CPU time of the process, shared equally among the chains that run at the moment.

    The sampler's threads are not Python's, so nobody can ask them for their own.
    """

    def __init__(self, clock: WorkClock) -> None:
        self._clock, self._lock = clock, Lock()
        self._seconds: dict[int, float] = {}
        self._last = 0.0

    def begin(self, chain: int) -> None:
        with self._lock:
            self._share()
            self._seconds[chain] = 0.0

    def end(self, chain: int) -> float:
        with self._lock:
            self._share()
            return self._seconds.pop(chain)

    def _share(self) -> None:
        now = self._clock.cpu()
        for chain in self._seconds:
            self._seconds[chain] += (now - self._last) / len(self._seconds)
        self._last = now
