"""One contender of the benchmark `bayes` in a process of its own: what it cost, and how good its draws are.

The clock is CPU time of the process, its threads and its children. It starts when the third-party libraries are
imported and the data lie in memory, and stops when the contender hands back its draws: whatever is built, compiled
(at the import of the workbench's modules too) or read from a cache in between is counted.

``python -m analysis.bench.bayes_contender NAME LOG.pickle SETTINGS.json`` prints one JSON object. The pickle is
the caller's own; the caller also chooses the folders of the compilers' caches, through the environment.
"""

from __future__ import annotations

import contextlib
import importlib
import importlib.util
import io
import json
import pickle
import resource
import sys
import time
import warnings
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from models.events import EventLog

Array = NDArray[np.float64]
Sampled = tuple[tuple[Array, Array, Array], Mapping[str, NDArray[Any]]]

PYMC = ("numba", "scipy.stats", "pandas", "xarray", "arviz", "nutpie", "pymc", "pytensor.tensor")

IMPORTS: dict[str, tuple[str, ...]] = {
    "direct": ("numba", "scipy.special", "pandas", "xarray", "arviz", "nutpie"),
    "pymc": PYMC,
    "scan": PYMC,
    "unrolled": PYMC,
    "marginalised": (*PYMC, "pymc_extras"),
    "numpyro": ("pandas", "arviz", "jax", "numpyro", "numpyro.infer"),
}
"""Third-party libraries of every contender, imported before the clock starts."""


@dataclass(frozen=True)
class Settings:
    """What every contender is asked for.

    Attributes
    ----------
    states, draws, tune, chains, seed : int
    """

    states: int = 3
    draws: int = 1000
    tune: int = 1000
    chains: int = 4
    seed: int = 1


@dataclass(frozen=True)
class Outcome:
    """One run of one contender.

    Attributes
    ----------
    cpu_seconds, wall_seconds : float
    min_ess : float
        Smallest bulk effective sample size over all entries of all tables, states in canonical order.
    max_rhat : float
    divergences : int
    gradients : int
        Leapfrog steps after tuning.
    """

    cpu_seconds: float
    wall_seconds: float
    min_ess: float
    max_rhat: float
    divergences: int
    gradients: int

    @property
    def rate(self) -> float:
        """Effective draws a CPU second."""
        return self.min_ess / self.cpu_seconds


def importable(name: str) -> bool:
    """Whether the libraries of a contender are installed (they are looked for, not imported)."""
    tops = {module.partition(".")[0] for module in IMPORTS[name]}
    return all(importlib.util.find_spec(top) is not None for top in tops)


def cpu_seconds() -> float:
    """CPU seconds of this process, its threads and its finished children, user and system."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def examine(log: EventLog, tables: tuple[Array, Array, Array], divergences: int) -> tuple[float, float]:
    """Smallest bulk effective sample size and largest r-hat over all entries, every draw in canonical order.

    Parameters
    ----------
    log : EventLog
    tables : initial[chain, draw, s], transition[chain, draw, a, s, s'], emission[chain, draw, e, s, o]
    divergences : int
    """
    from models.gate import convergence_gate
    from models.relabel import relabel_draws

    ordered = relabel_draws(*tables, log.protocol.scores, log.emission_weights)
    entries = np.concatenate([t.reshape(*t.shape[:2], -1) for t in ordered], axis=-1)
    gate = convergence_gate(entries, [str(i) for i in range(entries.shape[-1])], divergences)
    return gate.min_ess_bulk, gate.max_rhat


def _ours(log: EventLog, settings: Settings, engine: Any) -> Sampled:
    from models.bayesian_fit import fit
    from models.nuts import NutsSettings
    from models.parameters import STICKY
    from models.posterior import TABLES

    sampler = NutsSettings(settings.draws, settings.tune, settings.chains, settings.seed)
    data = fit(log, settings.states, prior=STICKY, engine=engine, sampler=sampler).data
    initial, transition, emission = (data["posterior"][name].to_numpy() for name in TABLES)
    return (initial, transition, emission), {k: v.to_numpy() for k, v in data["sample_stats"].items()}


def _tables(log: EventLog, drawn: Mapping[str, Array]) -> tuple[Array, Array, Array]:
    from analysis.bench.bayes_peers import help_name

    high = drawn[help_name(log)]
    pair = (1.0 - high, high)
    emission = np.stack(pair if int(np.argmax(log.protocol.scores)) == 1 else pair[::-1], axis=-1)
    return drawn["initial"], drawn["transition"], emission


def _pymc_peer(log: EventLog, settings: Settings, name: str) -> Sampled:
    """Sample with PyMC's defaults: its own choice of sampler and acceptance target."""
    import pymc as pm

    from analysis.bench.bayes_peers import PYMC_PEERS
    from models.parameters import STICKY

    with PYMC_PEERS[name](log, settings.states, STICKY):
        trace = pm.sample(
            settings.draws, tune=settings.tune, chains=settings.chains, random_seed=settings.seed, progressbar=False
        )
    posterior, stats = trace["posterior"], trace["sample_stats"]
    drawn = {name: posterior[name].to_numpy() for name in ("initial", "transition", help_name_of(posterior))}
    return _tables(log, drawn), {k: stats[k].to_numpy() for k in ("diverging", "n_steps")}


def help_name_of(posterior: Any) -> str:
    """The variable that is neither of the other two."""
    (name,) = set(posterior.data_vars) - {"initial", "transition"}
    return str(name)


def _numpyro(log: EventLog, settings: Settings) -> Sampled:
    from analysis.bench.bayes_numpyro import sample_numpyro
    from models.parameters import STICKY

    drawn, stats = sample_numpyro(log, prior=STICKY, **asdict(settings))
    return _tables(log, drawn), stats


def run(name: str, log: EventLog, settings: Settings) -> Outcome:
    """Run one contender in this process."""
    for module in IMPORTS[name]:
        importlib.import_module(module)
    cpu, wall = cpu_seconds(), time.perf_counter()
    if name in ("direct", "pymc"):
        tables, stats = _ours(log, settings, name)
    elif name == "numpyro":
        tables, stats = _numpyro(log, settings)
    else:
        tables, stats = _pymc_peer(log, settings, name)
    cpu, wall = cpu_seconds() - cpu, time.perf_counter() - wall
    divergences = int(np.sum(stats["diverging"]))
    ess, rhat = examine(log, tables, divergences)
    return Outcome(cpu, wall, ess, rhat, divergences, int(np.sum(stats["n_steps"])))


def main() -> None:
    """Run what the command line names; only the JSON goes to standard output."""
    name, data, settings = sys.argv[1:]
    with warnings.catch_warnings(), contextlib.redirect_stdout(io.StringIO()):
        warnings.simplefilter("ignore")  # peers' remarks on their own insides
        log = pickle.loads(Path(data).read_bytes())
        outcome = run(name, log, Settings(**json.loads(settings)))
    print(json.dumps(asdict(outcome)))


if __name__ == "__main__":
    main()
