"""Baum-Welch for the latent-state POMDP: restarts in two stages, honest convergence, one canonical result.

Plain Baum-Welch does not converge in the usual number of iterations on this kind of data, and its best optimum
is found by few restarts. So many short accelerated runs screen the starting points and the best of them are run
until the gain has stayed below the tolerance. `BaumWelch.paper` is the published procedure instead.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from models.baum_welch_fit import BaumWelchFit, Optimum
from models.design_facts import Study
from models.em_kernel import em
from models.errors import located
from models.histories import HistoryTree
from models.labels import canonical_order, permute
from models.lspomdp import LatentStatePOMDP
from models.parameters import Array, DirichletPrior, Layout, checked_pins, recorded
from models.spread_out import spread_out

Progress = Callable[[int, int], None]
"""Called with (done, total) from one thread as restarts finish."""

SAME_OPTIMUM = 0.01
"""Log-likelihoods closer than this count as one optimum in the histogram."""

AGREEMENT = 3
"""Runs that must end at the best optimum before a search with several rounds stops."""

TOGETHER = 4
"""Restarts that are sent to another process together: the study travels along."""


@dataclass(frozen=True)
class BaumWelch:
    """Settings of a fit; `fit` runs it.

    Attributes
    ----------
    n_states : int
    restarts : int
        Random starting points: T and O rows from Dirichlet(1), uniform initial belief.
    finalists : int or None
        How many of them go on to convergence; None runs every one (a single stage).
    rounds : int
        Rounds of restarts at the most: another is added while fewer than `AGREEMENT` runs agree on the best
        optimum.
    screening_maps : int
        EM maps spent on each starting point before the finalists are chosen.
    max_maps : int
        Cap on EM maps in the final stage; reaching it is reported as not converged.
    tolerance : float
        Gain in log-likelihood (nats, plus log-prior) counted as none.
    patience : int
        Accepted iterates in a row without gain that end a run.
    accelerate : bool
        SQUAREM extrapolation with a monotone guard.
    pins : mapping of action to table or None
        Transition tables held fixed; None stands for the identity.
    prior : DirichletPrior
        Pseudo-counts; the default is maximum likelihood.
    seed : int
    """

    n_states: int
    restarts: int = 200
    finalists: int | None = 30
    rounds: int = 3
    screening_maps: int = 100
    max_maps: int = 20_000
    tolerance: float = 1e-8
    patience: int = 10
    accelerate: bool = True
    pins: Mapping[str, Array | None] = field(default_factory=dict)
    prior: DirichletPrior = field(default_factory=DirichletPrior)
    seed: int = 1

    def __post_init__(self) -> None:
        for name, low in (
            ("n_states", 1), ("restarts", 1), ("rounds", 1), ("screening_maps", 0), ("max_maps", 1),
            ("patience", 1), ("seed", 0),
        ):  # fmt: skip
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < low:
                raise located(f"Baum-Welch, {name}", value, f"an integer of at least {low}")
        if self.finalists is not None and self.finalists < 1:
            raise located("Baum-Welch, finalists", self.finalists, "at least 1, or None for a single stage")
        if not (np.isfinite(self.tolerance) and self.tolerance >= 0):
            raise located("Baum-Welch, tolerance", self.tolerance, "a number of at least 0")

    @classmethod
    def paper(cls, n_states: int, *, pins: Mapping[str, Array | None] | None = None, seed: int = 1) -> BaumWelch:
        """The published procedure: plain EM, one stage of 30 restarts.

        T and O are drawn from Dirichlet(1), the initial belief starts uniform and is learned. The paper prints
        neither tolerance nor cap: the conventional 1e-5 and 1,000 iterations are used here.
        """
        return cls(
            n_states, restarts=30, finalists=None, rounds=1, screening_maps=0, max_maps=1000, tolerance=1e-5,
            patience=1, accelerate=False, pins=pins or {}, seed=seed,
        )  # fmt: skip

    @property
    def sentence(self) -> str:
        """The procedure in words."""
        if self.finalists is None:
            stages = f"one stage of {self.restarts} restarts"
        else:
            final = min(self.finalists, self.restarts)
            stages = f"{self.restarts} restarts of {self.screening_maps} EM maps, the best {final} of them run on"
        if self.rounds > 1:
            stages += f" (up to {self.rounds} such rounds, until {AGREEMENT} runs agree on the best optimum)"
        accelerated = "accelerated (SQUAREM)" if self.accelerate else "plain EM"
        paper = "; the published procedure, whose cap and tolerance are unprinted" if self.is_paper else ""
        return (
            f"Search: {stages} until the gain stays below {self.tolerance:g} for {self.patience} iterate"
            f"{'s' if self.patience > 1 else ''} or {self.max_maps:,} EM maps are reached, {accelerated}{paper}."
        )

    @property
    def is_paper(self) -> bool:
        """Whether these are the settings of `paper`, pins aside."""
        return replace(self, pins={}) == BaumWelch.paper(self.n_states, seed=self.seed)

    def fit(
        self, log: Study, *, progress: Progress | None = None, executor: Executor | None = None
    ) -> BaumWelchFit:
        """Learn from an event log, or from the compressed form of one.

        Parameters
        ----------
        log : EventLog or CompressedLog
        progress : callable, optional
            Called with (finished, total) restarts.
        executor : concurrent.futures.Executor, optional
            Runs the restarts; threads on all cores by default. The result does not depend on it.

        Raises
        ------
        InputError
            If the log has no recorded response, or a pinned table does not fit.
        """
        recorded(log)
        layout = Layout(log.protocol, self.n_states)
        pins = checked_pins(layout, self.pins)
        problem = _Problem(log.tree(), layout, self.prior.pseudo_counts(layout), layout.free_entries(pins))
        informed = layout.informed_entries(log)
        stop = np.zeros(1, dtype=np.uint8)
        per_round = self.restarts if self.finalists is None else min(self.finalists, self.restarts)
        screened: list[_Run] = []
        runs: list[_Run] = []
        total = done = 0

        def collect(thetas: list[Array], cap: int, tolerance: float, patience: int) -> list[_Run]:
            nonlocal done
            before = done
            found: list[_Run] = spread_out(
                executor, partial(_run, problem, (cap, tolerance, patience, self.accelerate, stop)), thetas,
                None if progress is None else lambda now, _: progress(before + now, total),
                together=TOGETHER, names=lambda i: f"restart {i} of {len(thetas)} (seed {self.seed})",
                stop=lambda: stop.fill(1),
            )  # fmt: skip
            done += len(found)
            return found

        for number in range(self.rounds):
            total += (self.restarts if self.finalists is not None else 0) + per_round
            indices = range(number * self.restarts, (number + 1) * self.restarts)
            starts = [self._start(layout, pins, informed, i) for i in indices]
            if self.finalists is not None:
                short = collect(starts, self.screening_maps, 0.0, self.screening_maps + 1)
                ranking = np.argsort([-run.objective for run in short], kind="stable")[:per_round]
                starts = [short[i].theta for i in ranking]
                screened += short
            runs += collect(starts, self.max_maps, self.tolerance, self.patience)
            best = max(run.objective for run in runs)
            if sum(best - run.objective <= SAME_OPTIMUM for run in runs) >= min(AGREEMENT, per_round):
                break
        winner = max(range(len(runs)), key=lambda i: runs[i].objective)
        return _result(self, log, layout, pins, runs, winner, [run.log_likelihood for run in screened])

    def _start(self, layout: Layout, pins: Mapping[str, Array], informed: NDArray[np.bool_], restart: int) -> Array:
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(self.n_states, restart)))
        s, a, e, o = layout.sizes
        transition = rng.dirichlet(np.ones(s), (a, s))
        emission = rng.dirichlet(np.ones(o), (e, s))
        for action, table in pins.items():
            transition[layout.protocol.action(action)] = table
        theta = layout.pack(np.full(s, 1.0 / s), transition, emission)
        # A table the data cannot inform stays uniform: a random one would pass for an estimate.
        return np.where(informed | ~layout.free_entries(pins), theta, layout.uniform)


@dataclass(frozen=True)
class _Problem:
    tree: HistoryTree
    layout: Layout
    pseudo: Array
    free: NDArray[np.bool_]


@dataclass(frozen=True)
class _Run:
    theta: Array
    trace: Array
    log_likelihood: float
    gradient: Array
    maps: int
    converged: bool

    @property
    def objective(self) -> float:
        return float(self.trace[-1])


def _run(problem: _Problem, settings: tuple[int, float, int, bool, NDArray[np.uint8]], theta: Array) -> _Run:
    return _Run(
        *em(
            theta, problem.tree.arrays, problem.layout.sizes, problem.layout.emission_index, problem.pseudo,
            problem.free, *settings,
        )
    )  # fmt: skip


def refine(
    tree: HistoryTree,
    theta: Array,
    layout: Layout,
    free: NDArray[np.bool_],
    settings: BaumWelch,
    stop: NDArray[np.uint8],
) -> tuple[Array, float, float]:
    """Run one starting point to convergence: theta, its log-likelihood and its objective (for the bootstrap)."""
    problem = _Problem(tree, layout, settings.prior.pseudo_counts(layout), free)
    limits = (settings.max_maps, settings.tolerance, settings.patience, settings.accelerate, stop)
    run = _run(problem, limits, theta)
    return run.theta, run.log_likelihood, run.objective


def _result(
    settings: BaumWelch, log: Study, layout: Layout, pins: Mapping[str, Array], runs: list[_Run], best: int,
    screened: list[float],
) -> BaumWelchFit:  # fmt: skip
    run = runs[best]
    tables = layout.unpack(run.theta)
    counts = layout.unpack(run.theta * run.gradient)
    order = canonical_order(tables[2], log.protocol.scores, log.emission_weights)
    initial, transition, emission = (_on_simplex(table) for table in permute(order, *tables))
    model = LatentStatePOMDP(initial, transition, emission, log.protocol)
    ordered_pins = {a: table[np.ix_(order, order)] for a, table in pins.items()}
    expected = permute(order, *counts)
    rows = layout.informed_rows(log)
    free_rows = np.array([layout.free_entries(pins)[row.start] for row in layout.rows])
    widths = np.array([row.stop - row.start for row in layout.rows])
    slack = [
        run.gradient[row].max() - float(run.theta[row] @ run.gradient[row])
        for row, used in zip(layout.rows, rows & free_rows, strict=True)
        if used
    ]
    values = sorted((r.log_likelihood, r.converged) for r in runs)[::-1]
    optima: list[list[tuple[float, bool]]] = []
    for value in values:
        if optima and optima[-1][0][0] - value[0] <= SAME_OPTIMUM:
            optima[-1].append(value)
        else:
            optima.append([value])
    return BaumWelchFit(
        model=model,
        log_likelihood=run.log_likelihood,
        trace=run.trace,
        converged=run.converged,
        maps=run.maps,
        optima=tuple(Optimum(group[0][0], len(group), sum(c for _, c in group)) for group in optima),
        screened=np.array(screened),
        n_parameters=int(np.sum((widths - 1) * (rows & free_rows))),
        n_responses=log.n_responses_recorded,
        n_runs=log.n_runs,
        restarts=len(screened) if screened else len(runs),
        initial_count=expected[0],
        transition_count=expected[1],
        emission_count=expected[2],
        stationarity=max(slack, default=0.0),
        emission_weights=log.emission_weights,
        pins=ordered_pins,
        settings=settings,
    )


def _on_simplex(table: Array) -> Array:
    """Remove the rounding of thousands of maps, so rows sum to one to the last bit or two."""
    return table / table.sum(axis=-1, keepdims=True)
