"""Baum-Welch over several numbers of states: the point-estimate half of every analysis.

For each number of states there is the workbench's own search and, beside it, the published procedure, so that a
report can say how much of the paper's "highest log-likelihood at 4 states" is a statement about restarts.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import cast

from analysis.wording import counted
from models.baum_welch import SAME_OPTIMUM, BaumWelch
from models.baum_welch_fit import BaumWelchFit
from models.bootstrap import Bootstrap, bootstrap_fit
from models.design_facts import Study
from models.errors import Phrase, located
from models.events import EventLog
from models.identification import Identification, identification
from models.notebook_view import NotebookView, View, frame_rows
from models.parameters import Array
from models.protocol import PUBLISHED

MOST_STATES = 12

Progress = Callable[[str, int, int], None]
"""Called with (what is running, done, total)."""


@dataclass(frozen=True, repr=False)
class EmStudy(NotebookView):
    """Fits of one event log.

    Attributes
    ----------
    log : EventLog
        The `CompressedLog` where `run_em` was given one: what needs every run cannot be asked of it.
    fits : dict of int to BaumWelchFit
        Own search, by number of states.
    paper_fits : dict of int to BaumWelchFit
        Published procedure on the same data; empty if not asked for.
    identifications : dict of int to Identification
        Of `fits`.
    bootstraps : dict of int to Bootstrap
        Parametric bootstrap of `fits`; empty if not asked for.
    seconds : dict of int to float
        Wall time of each own fit, without compilation.
    compile_seconds : float
    """

    log: EventLog
    fits: dict[int, BaumWelchFit]
    paper_fits: dict[int, BaumWelchFit] = field(default_factory=dict)
    identifications: dict[int, Identification] = field(default_factory=dict)
    bootstraps: dict[int, Bootstrap] = field(default_factory=dict)
    seconds: dict[int, float] = field(default_factory=dict)
    compile_seconds: float = 0.0

    @property
    def states(self) -> tuple[int, ...]:
        """Numbers of states that were fitted."""
        return tuple(self.fits)

    @property
    def best_by_bic(self) -> int:
        """Number of states with the smallest BIC; the smallest number among ties (`fewest`)."""
        return fewest({k: -fit.bic for k, fit in self.fits.items()})

    @property
    def best_by_log_likelihood(self) -> int:
        """Number of states with the largest log-likelihood, the paper's criterion; the smallest among ties."""
        return fewest({k: fit.log_likelihood for k, fit in self.fits.items()})

    def _view(self) -> View:
        rows = [
            {
                "states": k, "log_likelihood": fit.log_likelihood, "AIC": fit.aic, "BIC": fit.bic,
                "converged": fit.converged, "restarts at best": fit.optima[0].restarts,
            }
            for k, fit in self.fits.items()
        ]  # fmt: skip
        told: dict[str, list[int]] = {}
        for k, fit in self.fits.items():
            found = self.identifications.get(k)
            for text in (*fit._view().warnings, *(found.sentences() if found else ())):
                told.setdefault(text, []).append(k)
        warnings = [f"at {', '.join(map(str, numbers))} states: {text}" for text, numbers in told.items()]
        said = (f"BIC is lowest at {counted(self.best_by_bic, 'state')}.", self.restarts_sentence)
        return View("Baum-Welch by number of states", "", tuple(warnings), (), said, (frame_rows(rows, ".fits"),))

    @property
    def restarts_sentence(self) -> str:
        """How the paper's procedure and the longer search differ, and what that says about the criterion."""
        if not self.paper_fits:
            return "The published procedure was not run."
        parts = []
        for k, paper in self.paper_fits.items():
            own = self.fits[k].log_likelihood
            n = sum(not o for o in _converged_flags(paper))
            parts.append(
                f"{counted(k, 'state')}: {paper.log_likelihood:.2f} against {own:.2f} "
                f"({n} of {counted(paper.runs_in_final_stage, 'run')} hit the cap)"
            )
        text = (
            "Log-likelihood of the published procedure (one stage, 30 restarts, at most 1,000 iterations, "
            f"tolerance 1e-5) against the longer search: {'; '.join(parts)}."
        )
        if len(self.paper_fits) < 2:
            return text
        paper_best = fewest({k: fit.log_likelihood for k, fit in self.paper_fits.items()})
        text += f" The published procedure is highest at {counted(paper_best, 'state')}. {self._own_highest}"
        text += (
            " A model with one more state contains the smaller one, so the maximum cannot fall as states are added."
        )
        if 5 in self.paper_fits and self.log.protocol == PUBLISHED:
            text += (
                ' So the paper\'s "highest log-likelihood at 4 states" means a tie, or that its restarts with 5 '
                "states did not reach their maximum, not that 4 states describe people best."
            )
        return text

    @property
    def _own_highest(self) -> str:
        """Where the longer search is highest: at the largest number of states, unless it missed a maximum."""
        largest = max(self.fits)
        short = self.fits[self.best_by_log_likelihood].log_likelihood - self.fits[largest].log_likelihood
        if short <= SAME_OPTIMUM:
            return (
                f"The longer search is highest at the largest number fitted, {largest}, as it must be, up to ties."
            )
        return (
            f"The longer search is highest at {self.best_by_log_likelihood} and lower by {short:.2f} at {largest}, "
            "where it therefore missed the maximum."
        )


def fewest(height: Mapping[int, float]) -> int:
    """Smallest number of states whose value lies within 0.01 of the highest.

    Examples
    --------
    >>> fewest({2: -700.0, 3: -650.004, 4: -650.0})
    3
    """
    best = max(height.values())
    return min(k for k, value in height.items() if best - value <= SAME_OPTIMUM)


def _converged_flags(fit: BaumWelchFit) -> list[bool]:
    return [flag for o in fit.optima for flag in [True] * o.converged + [False] * (o.restarts - o.converged)]


def run_em(
    log: Study,
    states: Sequence[int] = (2, 3, 4, 5),
    *,
    settings: Callable[[int], BaumWelch] | None = None,
    pins: Mapping[str, Array | None] | None = None,
    seed: int = 1,
    with_paper: bool = False,
    bootstrap: Mapping[int, int] | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> EmStudy:
    """Fit every number of states.

    Parameters
    ----------
    log : EventLog or CompressedLog
        The bootstrap needs an event log.
    states : sequence of int
    settings : callable, optional
        Number of states to `BaumWelch` settings; the defaults with `pins` and `seed` unless given.
    pins : mapping, optional
        Transition tables held fixed (None: the identity), by action.
    seed : int
    with_paper : bool
        Also run the published procedure.
    bootstrap : mapping of int to int, optional
        Replicates of the bootstrap, by number of states.
    executor : concurrent.futures.Executor, optional
        Does restarts and replicates; threads of this process by default. The result does not depend on it.
    progress : callable, optional
    """
    if len(states) == 0:
        raise located("states", list(states), "at least one number of states")
    if bootstrap and any(bootstrap.values()) and not isinstance(log, EventLog):
        raise located("bootstrap of", Phrase("a compressed log"), "an event log, since it needs every run")
    pins = pins or {}
    make = settings or (lambda k: BaumWelch(k, pins=pins, seed=seed))
    started = time.perf_counter()
    BaumWelch(2, restarts=1, finalists=1, screening_maps=1, max_maps=1, seed=seed).fit(log)
    compile_seconds = time.perf_counter() - started

    def report(label: str) -> Callable[[int, int], None] | None:
        return None if progress is None else lambda done, total: progress(label, done, total)

    fits, paper, found, boots, seconds = {}, {}, {}, {}, {}
    for k in states:
        started = time.perf_counter()
        fits[k] = make(k).fit(log, progress=report(f"Baum-Welch, {counted(k, 'state')}"), executor=executor)
        seconds[k] = time.perf_counter() - started
        found[k] = identification(fits[k], log, seed=seed)
        if with_paper:
            own = BaumWelch.paper(k, pins=pins, seed=seed)
            told = report(f"published procedure, {counted(k, 'state')}")
            paper[k] = own.fit(log, progress=told, executor=executor)
        if bootstrap and bootstrap.get(k) and isinstance(log, EventLog):
            boots[k] = bootstrap_fit(
                fits[k], log, bootstrap[k], seed=seed, progress=report(f"bootstrap, {counted(k, 'state')}"),
                executor=executor,
            )  # fmt: skip
    return EmStudy(cast(EventLog, log), fits, paper, found, boots, seconds, compile_seconds)


def parse_states(text: str) -> tuple[int, ...]:
    """Read ``4``, ``2-5`` or ``2,4`` as numbers of states.

    Examples
    --------
    >>> parse_states("2-5"), parse_states("2,4")
    ((2, 3, 4, 5), (2, 4))
    """
    wanted = f"a number such as 4, a range such as 2-5 or a list such as 2,4 (1 to {MOST_STATES} states)"
    values: set[int] = set()
    for part in text.split(","):
        low, dash, high = part.strip().partition("-")
        ends = [low, high] if dash else [low, low]
        # Length first: a number of thousands of digits is not worth converting.
        if not all(end.isdecimal() and len(end) <= 4 and 1 <= int(end) <= MOST_STATES for end in ends):
            raise located("--states", text, wanted)
        if int(ends[0]) > int(ends[1]):
            raise located("--states", text, f"{wanted}, the smaller number first")
        values.update(range(int(ends[0]), int(ends[1]) + 1))
    return tuple(sorted(values))
