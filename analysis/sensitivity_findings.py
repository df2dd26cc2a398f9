"""The paper's three findings about its sensitivity analysis, each decided by a number that is written down first.

The paper says *dominant*, *more likely*, *especially*, *sensitive* without saying how they were measured. Here each
word has a measure of its own, taken over the same grid. A measure is worked out in every draw. What the draws say
of a finding is the share of them in which it holds: a mean over the draws may pass a threshold that hardly any of
them passes, or the other way round. Undecided cells count half, and where they might turn a verdict there is none.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from models.notebook_view import NotebookView
from models.sensitivity.cases import Array
from models.sensitivity.reward_grid import (
    ENOUGH,
    ENOUGH_TO_BE_SURE,
    FEW_DRAWS,
    ROUNDING,
    SURE,
    GridDecisions,
    evenly,
    of_draws,
)

HELP, SIGNAL = "help", "signal"

DOMINANT_FROM = 0.08
"""The `r` from which on helping is dominant, as printed."""

STEEP_FROM, MODERATE = 0.06, 15.0
"""The `r` from which on signalling is likely, and what a moderate cost of signalling is at most."""

PRINTED = {
    "helping": "step 0: helping is dominant only for r >= 0.08",
    "signalling": "step 1, after helping: signalling is more likely, especially for r >= 0.06 and moderate or low "
    "cost; at steep r even at higher costs",
    "contrast": "signalling is more state- and cost-sensitive than helping",
}


@dataclass(frozen=True)
class Measure:
    """One number that decides a finding, or stands beside it.

    Attributes
    ----------
    name, words : str
        What it is, and what would have to be the case.
    value : float or str
        Mean over the draws, or what it comes to in words.
    holds : bool or None
        None if it cannot be told on this grid.
    share : float or None
        Share of the draws, by weight, in which it holds.
    decides : bool
        Whether the verdict rests on it.
    """

    name: str
    words: str
    value: float | str
    holds: bool | None
    share: float | None
    decides: bool = True


@dataclass(frozen=True)
class Finding(NotebookView):
    """One printed finding in one reading.

    Attributes
    ----------
    key, printed : str
    reading : str
    measures : tuple of Measure
    share : float or None
        Share of the draws, by weight, in which everything that decides holds.
    draws : int
    even : bool
        Whether all draws weigh the same.
    undecided : bool
        Whether any cell is, in any draw.
    cautions : tuple of str
        Those of the draws (`models.cautions`).
    """

    key: str
    printed: str
    reading: str
    measures: tuple[Measure, ...]
    share: float | None
    draws: int
    even: bool = True
    undecided: bool = False
    cautions: tuple[str, ...] = ()

    @property
    def verdict(self) -> str:
        """Of the mean over the draws: ``holds``, ``holds in part``, ``does not hold`` or ``cannot be told``.

        Of one model that is all there is to say; of several draws `over_draws` says what they come to.
        """
        told = [m.holds for m in self.measures if m.decides]
        if any(holds is None for holds in told) or not told:
            return "cannot be told"
        return "holds" if all(told) else "holds in part" if any(told) else "does not hold"

    @property
    def over_draws(self) -> str:
        """Verdict of one model; of several draws whether nearly all agree, by `share`.

        ``holds``, ``does not hold`` (at least 95% of the draws agree), ``open``, ``cannot be told``, or ``too few
        draws``.
        """
        if self.draws == 1 or self.share is None:
            return self.verdict if self.draws == 1 else "cannot be told"
        agree = max(self.share, 1 - self.share) >= SURE - ROUNDING
        if self.draws < (ENOUGH_TO_BE_SURE if agree else ENOUGH):
            return FEW_DRAWS
        return "open" if not agree else "holds" if self.share > 0.5 else "does not hold"

    @property
    def holds_in(self) -> str:
        """In how many draws it holds; of one model its verdict."""
        if self.draws == 1 or self.share is None:
            return self.over_draws
        return of_draws(self.share, self.draws, self.even)

    @property
    def sentence(self) -> str:
        """In how many draws it holds, or the verdict of one model, and the measures behind it."""
        parts = []
        for m in self.measures:
            value = m.value if isinstance(m.value, str) else f"{m.value:.3g}"
            parts.append(f"{m.name}: {value}" + ("" if m.decides else " (beside)"))
        if self.draws == 1 or self.share is None:
            text = f"{self.over_draws}: {'; '.join(parts)}."
        else:
            text = f"holds in {self.holds_in}. Means over the draws: {'; '.join(parts)}."
        return text + (" Undecided cells count half." if self.undecided else "")

    def to_dict(self) -> dict[str, Any]:
        """The finding as commands give it in their JSON."""
        return {
            "finding": self.key, "printed": self.printed, "reading": self.reading, "verdict": self.over_draws,
            "verdict_of_mean": self.verdict,
            "holds": {"holds": True, "holds in part": False, "does not hold": False}.get(self.over_draws),
            "share": self.share, "draws": self.draws, "measures": [vars(m) for m in self.measures],
            "undecided": self.undecided, "sentence": self.sentence,
        }  # fmt: skip


def check_findings(
    maps: Mapping[str, GridDecisions], certain: Mapping[str, Sequence[Array]]
) -> tuple[Finding, ...]:
    """Check the printed findings in every reading.

    Parameters
    ----------
    maps : mapping of reading to GridDecisions
    certain : mapping of reading to list of float64[s, g, d]
        By costly action: how often draws act when they are certain of each state, over `r` and its own cost.

    Returns
    -------
    tuple of Finding
        Empty where the costly actions are not helping and then signalling.
    """
    out: list[Finding] = []
    for reading, found in maps.items():
        if tuple(a.name for a in found.grid.axes) == (HELP, SIGNAL):
            half, never, always = (_checked(found, certain[reading], way) for way in (0.5, 0.0, 1.0))
            undecided = bool((found.answers.choice < 0).any())
            out += [
                replace(_agreed(own, *others), undecided=undecided, cautions=found.cautions)
                for own, *others in zip(half, never, always, strict=True)
            ]
    return tuple(out)


def _checked(found: GridDecisions, certain: Sequence[Array], undecided: float) -> tuple[Finding, ...]:
    """The findings of one reading, undecided cells counted as that much of an action."""
    table = _Table.of(found, undecided)
    reading = found.reading
    return _helping(reading, table), _signalling(reading, table), _contrast(reading, table, certain)


def _agreed(own: Finding, *others: Finding) -> Finding:
    """A finding without the verdicts that undecided cells might turn: those that others do not share."""
    measures = []
    for i, m in enumerate(own.measures):
        same = all(other.measures[i].holds == m.holds for other in others)
        measures.append(m if same else replace(m, holds=None, share=None))
    shared = all(other.over_draws == own.over_draws for other in others)
    return replace(own, measures=tuple(measures), share=own.share if shared else None)


@dataclass(frozen=True)
class _Table:
    """Cells of a grid, and how often each draw helps and signals there, ``[g, d]``."""

    r: Array
    cost_help: Array
    cost_signal: Array
    help: Array
    signal: Array
    weight: Array
    shape: tuple[int, ...]

    @classmethod
    def of(cls, found: GridDecisions, undecided: float = 0.5) -> _Table:
        r = np.array([r for r, _ in found.grid.cells])
        costs = np.array([c for _, c in found.grid.cells])
        first, second = (a.mode for a in found.grid.axes)
        # `acting` counts what is open half.
        helps, signals = (found.acting(k) + (undecided - 0.5) * found.by_draw(k)[..., -1] for k in (first, second))
        return cls(r, costs[:, 0], costs[:, 1], helps, signals, found.weight, found.grid.shape)

    def mean(self, values: Array) -> float:
        """Mean over the draws in which a measure is defined; nan if there are none."""
        own = np.isfinite(values)
        total = self.weight[own].sum()
        return float(self.weight[own] @ values[own] / total) if total > 0 else float("nan")

    def measure(
        self, name: str, words: str, values: Array, holds: Callable[[Array], Array], decides: bool = True
    ) -> tuple[Measure, Array]:
        """A measure from its value in every draw, and in which draws it holds."""
        mean = self.mean(values)
        if not np.isfinite(mean):
            return Measure(name, words, "no such cells", None, None, decides), np.zeros(len(values), dtype=bool)
        own = np.isfinite(values) & holds(np.where(np.isfinite(values), values, 0.0))
        return Measure(name, words, mean, bool(holds(np.array([mean]))[0]), self.share(own), decides), own

    def share(self, own: Array) -> float:
        return float(self.weight[own].sum())


def _above_zero(values: Array) -> Array:
    return np.asarray(values > 1e-12)


def _helping(reading: str, t: _Table) -> Finding:
    """Dominant: the robot helps in more than half of the cells of a value of `r`."""
    steep = np.unique(t.r)
    asked = steep >= DOMINANT_FROM
    dominance = np.stack([t.help[t.r == r].mean(axis=0) for r in steep])
    costly = t.cost_help > 0
    without_free = np.stack([_mean_of(t.help, (t.r == r) & costly) for r in steep])
    measures = []
    for name, table, decides in (
        ("share of the cost cells in which it helps", dominance, True),
        ("the same without cells in which helping is free", without_free, False),
    ):
        mean = np.array([t.mean(row) for row in table])
        told = ", ".join(f"{m:.3g} at r {r:g}" for r, m in zip(steep.tolist(), mean.tolist(), strict=True))
        own = ((table > 0.5) == asked[:, None]).all(axis=0)
        known = bool(asked.any() and not asked.all() and np.isfinite(mean).all())
        measures.append(
            Measure(
                name, f"above one half from r {DOMINANT_FROM:g} on and nowhere below", told,
                bool(((mean > 0.5) == asked).all()) if known else None, t.share(own) if known else None, decides,
            )
        )  # fmt: skip
    first = _first_dominant(steep, np.array([t.mean(row) for row in dominance]))
    measures.append(Measure("dominant from", f"r {DOMINANT_FROM:g}", first, None, None, False))
    return Finding(
        "helping", PRINTED["helping"], reading, tuple(measures), measures[0].share, len(t.weight), evenly(t.weight)
    )  # fmt: skip


def _first_dominant(steep: Array, mean: Array) -> str:
    above = mean > 0.5
    for i in range(len(steep)):
        if above[i:].all():
            return f"r {steep[i]:g} on"
    return "no r of the grid"


def _signalling(reading: str, t: _Table) -> Finding:
    """More likely: than where it did not help; especially: than elsewhere; at higher costs: than at less `r`."""
    helped, rest = t.help, 1.0 - t.help
    after = _weighted(t.signal, helped) - _weighted(t.signal, rest)
    region = (t.r >= STEEP_FROM) & (t.cost_signal <= MODERATE)
    inside = _weighted(t.signal[region], helped[region])
    outside = _weighted(t.signal[~region], helped[~region])
    steep = np.unique(t.r[t.r >= STEEP_FROM])
    nothing = np.full(len(t.weight), np.nan)
    paid = [_highest_paid(t, r) for r in (steep[0], steep[-1])] if len(steep) > 1 else [nothing, nothing]
    rows = [
        t.measure(
            "signals more often in the cells of the grid in which it helped than in those in which it did not, by",
            "above 0; cells in which it helped have higher r and lower costs, too",
            after, _above_zero,
        ),
        t.measure(
            f"after helping, more often at r >= {STEEP_FROM:g} and costs up to {MODERATE:g} than elsewhere, by",
            "above 0", inside - outside, _above_zero,
        ),
        t.measure(
            f"highest cost paid for a signal after helping, at the steepest r more than at r {STEEP_FROM:g}, by",
            "above 0 (no signal at any cost counts as -1)", paid[1] - paid[0], _above_zero,
        ),
    ]  # fmt: skip
    measures = [row[0] for row in rows]
    every = np.logical_and.reduce([row[1] for row in rows])
    known = all(m.holds is not None for m in measures)
    measures.append(
        Measure(
            f"signals after helping, at r >= {STEEP_FROM:g} and costs up to {MODERATE:g}", "a share of those cells",
            t.mean(inside), None, None, False,
        )
    )  # fmt: skip
    alike, _ = t.measure(
        "the first at the same r and cost of a signal, where some costs of helping are paid and others are not, by",
        "above 0", _at_the_same(t), _above_zero, False,
    )  # fmt: skip
    measures.append(alike)
    return Finding(
        "signalling", PRINTED["signalling"], reading, tuple(measures), t.share(every) if known else None,
        len(t.weight), evenly(t.weight),
    )  # fmt: skip


def _at_the_same(t: _Table) -> Array:
    """How much more often each draw signals after helping, over pairs of `r` and cost of a signal with both."""
    rows = []
    for r, cost in sorted({*zip(t.r.tolist(), t.cost_signal.tolist(), strict=True)}):
        here = (t.r == r) & (t.cost_signal == cost)
        rows.append(_weighted(t.signal[here], t.help[here]) - _weighted(t.signal[here], 1.0 - t.help[here]))
    table = np.stack(rows)
    return _weighted(np.nan_to_num(table), np.isfinite(table).astype(float))


def _highest_paid(t: _Table, r: float) -> Array:
    """Highest cost at which a draw signals after helping at an `r`; -1 if at none, nan if it never helps there."""
    here = t.r == r
    helps = t.help[here] > 0.5
    paid = np.where(helps & (t.signal[here] > 0.5), t.cost_signal[here][:, None], -1.0).max(axis=0)
    return np.where(helps.any(axis=0), paid, np.nan)


def _contrast(reading: str, t: _Table, certain: Sequence[Array]) -> Finding:
    """Sensitive: how much the action moves from one end of its own cost to the other, and from state to state."""
    n = len(t.weight)
    steep, helps, signals = t.shape
    help_by = t.help.reshape(steep, helps, signals, n)
    signal_by = t.signal.reshape(steep, helps, signals, n)
    cost_help, cost_signal = _moved(help_by, 1), _moved(signal_by, 2)
    charged = [c.reshape(t.shape) > 0 for c in (t.cost_help, t.cost_signal)]
    paid_help = _moved(help_by[:, charged[0][0, :, 0]], 1)
    paid_signal = _moved(signal_by[:, :, charged[1][0, 0]], 2)
    own = certain[0].shape[2]
    keep = np.floor((np.arange(own) + 0.5) * n / own).astype(int)
    state_help, state_signal = (np.ptp(c, axis=0).mean(axis=0) for c in certain)
    some = _Table(t.r, t.cost_help, t.cost_signal, t.help, t.signal, t.weight[keep] / t.weight[keep].sum(), t.shape)
    costs, by_cost = t.measure(
        f"share of the grid's lines on which its own cost changes whether it signals ({t.mean(cost_signal):.2f}), "
        f"less the same of helping ({t.mean(cost_help):.2f})", "above 0", cost_signal - cost_help, _above_zero,
    )  # fmt: skip
    paid, _ = t.measure(
        f"the same without cells in which the action is free ({t.mean(paid_signal):.2f}, {t.mean(paid_help):.2f})",
        "above 0", paid_signal - paid_help, _above_zero, False,
    )  # fmt: skip
    states, by_state = some.measure(
        "share of the cells (r by own cost) in which certainty of one state or another changes whether it signals "
        f"({some.mean(state_signal):.2f}), less the same of helping ({some.mean(state_help):.2f})",
        "above 0", state_signal - state_help, _above_zero,
    )  # fmt: skip
    return Finding(
        "contrast", PRINTED["contrast"], reading, (costs, paid, states), some.share(by_cost[keep] & by_state), own,
        evenly(t.weight),
    )  # fmt: skip


def _moved(acts: Array, axis: int) -> Array:
    """How much an action moves along its own cost, mean over the lines; nan where fewer than two costs are left."""
    if acts.shape[axis] < 2:
        return np.full(acts.shape[-1], np.nan)
    return np.asarray(np.ptp(acts, axis=axis).mean(axis=(0, 1)))


def _weighted(values: Array, weight: Array) -> Array:
    """Mean over cells by draw, nan where no cell counts."""
    total = weight.sum(axis=0)
    return np.divide((values * weight).sum(axis=0), total, out=np.full(len(total), np.nan), where=total > 1e-12)


def _mean_of(values: Array, cells: Array) -> Array:
    return values[cells].mean(axis=0) if cells.any() else np.full(values.shape[1], np.nan)
