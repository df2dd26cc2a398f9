"""What the plan depends on: the paper's grid in three readings, critical values, and everything else that can move.

The paper solves the model for five values of `r` and four of each cost and records two actions: helping a person
in need, then signalling in need of help. It prints neither a discount nor what the state after the second step is
worth, so there are three readings, and all are shown: the policy without a horizon, the exact two-step plan, and
the same with the prosocial reward of the state after it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from analysis.sensitivity_findings import Finding, check_findings
from analysis.sensitivity_variants import (
    Beside,
    Variant,
    belief_variants,
    beside_variant,
    discount_variants,
    x_variants,
)
from analysis.sensitivity_variants import table as variant_table
from models.errors import InputError, located
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView
from models.planning.latent import DISCOUNT
from models.sensitivity.cases import Decider, believing
from models.sensitivity.endless_steps import INFINITE, EndlessSteps
from models.sensitivity.few_steps import TWO_STEP, TWO_STEP_TERMINAL, FewSteps
from models.sensitivity.flips import Flips, find_flips
from models.sensitivity.moving import moving, ranges
from models.sensitivity.reward_grid import (
    ENOUGH,
    GridDecisions,
    RewardGrid,
    decide_grid,
    decisions_when_certain,
    reward_at,
)

READINGS = (INFINITE, TWO_STEP, TWO_STEP_TERMINAL)

READING_WORDS = {
    INFINITE: "policy without a horizon",
    TWO_STEP: "two steps, nothing after them",
    TWO_STEP_TERMINAL: "two steps, the state after them rewarded",
}

ENDLESS_MOST = 0.99
"""Discount up to which decisions without a horizon are looked for."""

Told = Callable[[str, int, int], None]


@dataclass(frozen=True)
class SensitivityEffort:
    """How many draws answer what: evenly spaced ones; a single model always answers everything.

    Attributes
    ----------
    endless_draws : int
        For the grid without a horizon.
    endless_variants, endless_critical, endless_certain : int
        For variants, for critical values, and for decisions at certainty of a state, without a horizon.
    few_draws, few_critical : int, optional
        For the grid and variants, and for the critical values in the two-step readings; all by default. Variants
        have as many draws as the grid, so that one question has one answer wherever it is asked.
    scan, endless_scan : int
        Points at which critical values are looked for first: exact readings and single models, and draws without a
        horizon.
    critical, moved : bool
        Whether critical values are looked for at all, and those of the discount and of the states' scores too.
    variants : bool
        Whether variants are asked about.
    """

    endless_draws: int = 100
    endless_variants: int = 40
    endless_critical: int = 25
    endless_certain: int = 20
    few_draws: int | None = None
    few_critical: int | None = 1000
    scan: int = 33
    endless_scan: int = 17
    critical: bool = True
    moved: bool = True
    variants: bool = True

    def __post_init__(self) -> None:
        for name in ("endless_draws", "endless_variants", "endless_critical", "endless_certain"):
            if getattr(self, name) < 1:
                raise located(name.replace("_", " "), getattr(self, name), "at least 1")
        for name in ("scan", "endless_scan"):
            if getattr(self, name) < 2:
                raise located(f"points of the {name.replace('_', ' ')}", getattr(self, name), "at least 2")


@dataclass(frozen=True)
class SensitivityStudy(NotebookView):
    """Everything that was asked of one model, or of the draws of one fit.

    Attributes
    ----------
    draws : ModelDraws
    grid : RewardGrid
    discounts : mapping of reading to float
    maps : mapping of reading to GridDecisions
    critical : tuple of Flips
    findings : tuple of Finding
        The paper's, one for each reading; empty for other protocols and for robots without both costly actions.
    variants : mapping of kind to tuple of rows
        ``discount``, ``x``, ``belief``, ``beside``: one row a variant, reading and step.
    """

    draws: ModelDraws
    grid: RewardGrid
    discounts: Mapping[str, float]
    maps: Mapping[str, GridDecisions]
    critical: tuple[Flips, ...]
    findings: tuple[Finding, ...]
    variants: Mapping[str, tuple[dict[str, Any], ...]] = field(repr=False)

    def rows(self) -> list[dict[str, Any]]:
        """One row a reading, cell and step; for one model with the bounds of what each action is worth."""
        out = []
        for found in self.maps.values():
            own = found.rows()
            if found.n_draws == 1:
                bounds = [found.bounds(k) for k in range(found.n_steps)]
                for i, row in enumerate(own):
                    row["values"] = bounds[i % found.n_steps][i // found.n_steps]
            out += [{**row, "draws": found.n_draws} for row in own]
        return out

    def flips(self, reading: str, parameter: str) -> tuple[Flips, ...]:
        """Critical values of one number in one reading, step by step; empty if they were not looked for."""
        return tuple(f for f in self.critical if f.reading == reading and f.parameter == parameter)

    @property
    def sentence(self) -> str:
        """At how many cells most draws act, by reading, and where that is a toss."""
        parts = []
        for reading, found in self.maps.items():
            rows = found.rows()
            steps = []
            for k in range(found.n_steps):
                own = [row for row in rows if row["k"] == k]
                null = found.answers.nodes.protocol.modes[found.answers.nodes.modes[k]].null_action
                acts = sum(row["action"] not in (null, "undecided") for row in own)
                toss = sum(row["verdict"] in ("coin toss", "undecided") for row in own)
                text = f"step {k} acts in {acts} of {len(own)} cells"
                steps.append(text + (f" ({toss} a toss)" if found.n_draws >= ENOUGH else ""))
            asked = f" ({found.n_draws:,} draws)" if found.n_draws > 1 else ""
            parts.append(f"{READING_WORDS[reading]}{asked}: {', '.join(steps)}")
        return "; ".join(parts) + "."


def decider_of(
    reading: str, draws: ModelDraws, modes: tuple[int, ...] | None = None, *, sharp: bool = False,
    executor: Executor | None = None, progress: Callable[[int, int], None] | None = None,
) -> Decider:  # fmt: skip
    """The decider of a reading.

    Parameters
    ----------
    reading : str
    draws : ModelDraws
    modes : tuple of int, optional
        Mode of each step.
    sharp : bool
        Work longer where actions are worth nearly the same, without a horizon.
    executor, progress
        As `EndlessSteps` takes them.

    Raises
    ------
    InputError
        On an unknown reading.
    """
    if reading == INFINITE:
        how = {"tolerance": 1e-7, "rounds": 60} if sharp else {}
        return EndlessSteps(draws, modes, executor=executor, progress=progress, **how)  # type: ignore[arg-type]
    if reading in (TWO_STEP, TWO_STEP_TERMINAL):
        return FewSteps(draws, reading == TWO_STEP_TERMINAL, modes)
    raise located("reading", reading, f"one of {', '.join(READINGS)}")


def discounts_of(readings: Sequence[str], discount: float | None) -> dict[str, float]:
    """Discount of each reading: .95 without a horizon and 1 for known steps, unless given.

    Raises
    ------
    InputError
        On an unknown reading, a discount outside 0..1, or one of 1 without a horizon.
    """
    for reading in readings:
        if reading not in READINGS:
            raise located("reading", reading, f"one of {', '.join(READINGS)}")
    if discount is None:
        return {r: DISCOUNT if r == INFINITE else 1.0 for r in readings}
    if not 0 <= discount <= 1:
        raise located("discount", discount, "a number from 0 to 1")
    if discount >= 1 and INFINITE in readings:
        raise located("discount", discount, f"below 1 for the reading {INFINITE}: values would be infinite")
    return dict.fromkeys(readings, float(discount))


def sensitivity_study(
    draws: ModelDraws, *, r: Sequence[float] | None = None, costs: Sequence[float] | None = None,
    readings: Sequence[str] = READINGS, discount: float | None = None, beside: Sequence[Beside] = (),
    scores: Mapping[str, Sequence[float]] | None = None, effort: SensitivityEffort | None = None,
    executor: Executor | None = None, progress: Told | None = None,
) -> SensitivityStudy:  # fmt: skip
    """Ask a model, or the draws of a fit, what its decisions depend on.

    Parameters
    ----------
    draws : ModelDraws
        With the reward that stays where it is not varied.
    r, costs : sequence of float, optional
        The grid; the paper's by default, the same costs for every costly action.
    readings : sequence of str
        Of `READINGS`.
    discount : float, optional
        Of all readings; .95 without a horizon and 1 for two steps by default.
    beside : sequence of Beside
        Other models, such as fits of other numbers of states or with other priors.
    scores : mapping of name to sequence of float, optional
        Further scores of the states to be tried, such as those that the token game gives.
    effort : SensitivityEffort, optional
    executor : concurrent.futures.Executor, optional
        What cases are spread over; threads by default.
    progress : callable, optional
        Called with the step, pieces done and pieces in all.

    Raises
    ------
    InputError
        On readings, discounts, grids or scores that are none; on one state, where nothing moves anybody.
    """
    if draws.n_states < 2:
        raise InputError("sensitivity: with one state nothing the robot does changes anybody")
    if not readings:
        raise located("readings", 0, f"at least one of {', '.join(READINGS)}")
    effort = effort or SensitivityEffort()
    used = discounts_of(readings, discount)
    grid = RewardGrid.of(draws, r, costs)
    work = _Work(draws, grid, used, effort, executor, progress)
    maps = {reading: work.grid_map(reading) for reading in used}
    findings = check_findings(maps, {reading: work.when_certain(reading) for reading in used})
    critical = tuple(flip for reading in used for flip in work.critical(reading)) if effort.critical else ()
    base = grid.base
    kinds: dict[str, list[Variant]] = {
        "discount": discount_variants(draws, base),
        "x": x_variants(draws, base, scores or {}),
        "belief": belief_variants(draws, base),
        "beside": [Variant(f"as asked ({draws.n_states} states)", draws, base)] if beside else [],
    }
    kinds["beside"] += [beside_variant(other, base) for other in beside]
    variants = {kind: tuple(work.variants(kind, own)) if effort.variants else () for kind, own in kinds.items()}
    return SensitivityStudy(draws, grid, used, maps, critical, findings, variants)


@dataclass(frozen=True)
class _Work:
    """One study at work."""

    draws: ModelDraws
    grid: RewardGrid
    discounts: Mapping[str, float]
    effort: SensitivityEffort
    executor: Executor | None
    progress: Told | None

    def told(self, step: str) -> Callable[[int, int], None] | None:
        tell = self.progress
        return None if tell is None else lambda done, total: tell(step, done, total)

    def thinned(self, reading: str, endless: int, few: int | None) -> ModelDraws:
        count = endless if reading == INFINITE else few
        return self.draws if count is None else self.draws.thin(count)

    def grid_map(self, reading: str) -> GridDecisions:
        own = self.thinned(reading, self.effort.endless_draws, self.effort.few_draws)
        told = self.told(f"grid, {READING_WORDS[reading]}")
        decider = decider_of(reading, own, executor=self.executor, progress=told)
        return decide_grid(decider, self.grid, self.discounts[reading], self.draws.n_draws)

    def when_certain(self, reading: str) -> list[np.ndarray]:
        """By step: how often draws act when they are certain of each state, over `r` and the step's own cost."""
        own = self.thinned(reading, self.effort.endless_draws, self.effort.few_draws)
        own = own.thin(min(own.n_draws, self.effort.endless_certain if reading == INFINITE else 200))
        out = []
        modes = tuple(range(len(own.protocol.modes)))
        for axis, values in zip(self.grid.axes, self.grid.costs, strict=True):
            rewards = [reward_at(self.grid.base, r, {axis: c}) for r in self.grid.r for c in values]
            steps = modes[axis.mode : axis.mode + 1] if reading == INFINITE else modes[axis.mode :]
            told = self.told(f"certain of a state, {axis.name}")
            deciders = [
                decider_of(
                    reading, believing(own, np.eye(own.n_states)[s]), steps, executor=self.executor, progress=told
                )
                for s in range(own.n_states)
            ]
            out.append(decisions_when_certain(deciders, rewards, self.discounts[reading]))
        return out

    def critical(self, reading: str) -> list[Flips]:
        """Critical values of everything that is a number."""
        endless, single = reading == INFINITE, self.draws.n_draws == 1
        own = self.thinned(reading, self.effort.endless_critical, self.effort.few_critical)
        points = self.effort.endless_scan if endless and not single else self.effort.scan
        tolerance = 1e-6 if single else 1e-3
        decider = decider_of(reading, own, sharp=single, executor=self.executor)
        base, g = self.grid.base, self.discounts[reading]
        spans = ranges(base, self.grid.r, dict(zip(self.grid.axes, self.grid.costs, strict=True)))
        spans["discount"] = (0.0, ENDLESS_MOST if endless else 1.0)
        told = self.told(f"critical values, {READING_WORDS[reading]}")
        axes = {f"cost_{axis.name}": axis for axis in self.grid.axes}
        if not self.effort.moved:
            spans = {name: span for name, span in spans.items() if name == "r" or name in axes}
        out: list[Flips] = []
        for i, (name, (low, high)) in enumerate(spans.items()):
            how: dict[str, Any] = (
                {"r": True} if name == "r" else {"gamma": True} if name == "discount"
                else {"cost": axes[name]} if name in axes else {"state": int(name.removeprefix("x_"))}
            )  # fmt: skip
            setting = moving(own.protocol, base, g, **how)
            out += find_flips(decider, name, setting, np.linspace(low, high, points), tolerance)
            if told is not None:
                told(i + 1, len(spans))
        return out

    def variants(self, kind: str, variants: Sequence[Variant]) -> list[dict[str, Any]]:
        """One row a variant, reading and step."""
        rows: list[dict[str, Any]] = []
        told = self.told(f"variants: {kind}")
        for i, variant in enumerate(variants):
            for reading, g in self.discounts.items():
                asked = g if variant.discount is None else variant.discount
                if reading == INFINITE and asked >= 1:
                    continue
                count = self.effort.endless_variants if reading == INFINITE else self.effort.few_draws
                own = variant.draws if count is None else variant.draws.thin(count)
                cell = RewardGrid.point(own.protocol, variant.reward)
                found = decide_grid(decider_of(reading, own, executor=self.executor), cell, asked)
                rows += variant_table(variant, found)
            if told is not None:
                told(i + 1, len(variants))
        return rows
