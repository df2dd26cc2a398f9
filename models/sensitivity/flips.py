"""At which value of a number decisions flip: a scan that brackets, bisection that closes in.

Every end of a bracket carries a decision that was made there. Without a horizon that is a decision with its proof
(`models.sensitivity.endless_steps`), so a bracket whose ends differ holds a flip for certain. What a scan cannot
see: two flips between neighbouring points of it that undo each other.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.notebook_view import NotebookView
from models.robust.risk import weighted_quantiles
from models.sensitivity.cases import Array, Cases, Decider, Index, Nodes
from models.sensitivity.endless_kernel import OPEN
from models.sensitivity.reward_grid import ENOUGH, evenly, of_draws

HALVINGS = 60
"""Of one bracket, at most."""

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)

LISTED = 6
"""Flips of so many draws are named one by one."""

Setting = Callable[[Array, Index], Cases]
"""Cases of values of a number ``[m]`` and draws ``[m]``."""


@dataclass(frozen=True)
class Flips(NotebookView):
    """Where the decision of one step changes as one number moves through a range.

    Attributes
    ----------
    parameter : str
        What moves.
    reading : str
    nodes : Nodes
    step : int
    scan : float64[n]
        Where decisions were looked at first.
    at_scan : int64[n, d]
        What is decided there (`models.sensitivity.cases.Answers.label`).
    draw : int64[f]
    low, high : float64[f]
        Bracket of each flip.
    before, after : int64[f]
        What is decided at the ends.
    closed : bool[f]
        Whether the bracket is as narrow as was asked; else decisions inside are open.
    weight : float64[d]
    cautions : tuple of str
        Those of the draws (`models.cautions`).
    """

    parameter: str
    reading: str
    nodes: Nodes
    step: int
    scan: Array
    at_scan: Index
    draw: Index
    low: Array
    high: Array
    before: Index
    after: Index
    closed: NDArray[np.bool_]
    weight: Array
    cautions: tuple[str, ...] = ()

    @property
    def middle(self) -> Array:
        """Middles of the brackets, shape ``[f]``."""
        return (self.low + self.high) / 2

    @property
    def per_draw(self) -> Index:
        """Number of flips of each draw, shape ``[d]``."""
        return np.bincount(self.draw, minlength=len(self.weight))

    @property
    def first(self) -> Array:
        """First flip of each draw, nan where it has none, shape ``[d]``."""
        out = np.full(len(self.weight), np.inf)
        np.minimum.at(out, self.draw, self.middle)
        return np.where(np.isfinite(out), out, np.nan)

    @property
    def share_without(self) -> float:
        """Share of the draws, by weight, without a flip in the range."""
        return float(self.weight[self.per_draw == 0].sum())

    @property
    def share_several(self) -> float:
        """Share of the draws, by weight, with more than one."""
        return float(self.weight[self.per_draw > 1].sum())

    @property
    def always(self) -> dict[str, float]:
        """What draws without a flip decide throughout, with their share of all draws by weight."""
        out: dict[str, float] = {}
        for d in np.flatnonzero(self.per_draw == 0):
            seen = self.at_scan[:, d][self.at_scan[:, d] != OPEN]
            name = self.nodes.words(self.step, int(seen[0]) if len(seen) else OPEN)
            out[name] = out.get(name, 0.0) + float(self.weight[d])
        return out

    @property
    def undecided(self) -> float:
        """Share of the draws, by weight, with a point of the scan at which the bounds say nothing."""
        return float(self.weight[(self.at_scan == OPEN).any(axis=0)].sum())

    def quantiles(self, levels: Sequence[float] = QUANTILES) -> list[float]:
        """Quantiles of the first flip among the draws that have one; nan if none has."""
        has = np.isfinite(self.first)
        if not self.weight[has].sum() > 0:
            return [float("nan")] * len(levels)
        return weighted_quantiles(self.first[has], self.weight[has] / self.weight[has].sum(), levels)

    @property
    def spacing(self) -> float:
        """Largest distance of neighbouring points of the scan: flips that undo each other within it are missed."""
        return float(np.diff(self.scan).max())

    @property
    def sentence(self) -> str:
        """Where the decision flips, in words."""
        mode = self.nodes.protocol.modes[self.nodes.modes[self.step]].name
        where = f"{mode}, {self.parameter} from {self.scan[0]:g} to {self.scan[-1]:g}"
        if len(self.weight) == 1:
            if not len(self.draw):
                return f"{where}: {next(iter(self.always))} throughout"
            order = np.argsort(self.low)
            ends = [_apart(float(self.low[i]), float(self.high[i])) for i in order]
            turns = [
                f"{self.nodes.words(self.step, int(self.before[i]))} up to {low}, "
                f"{self.nodes.words(self.step, int(self.after[i]))} from {high} on"
                for i, (low, high) in zip(order, ends, strict=True)
            ]
            return f"{where}: {'; '.join(turns)}"
        n, even = len(self.weight), evenly(self.weight)
        if not len(self.draw):
            return f"{where}: none of {n:,} draws changes its mind"
        text = f"{where}: {of_draws(1 - self.share_without, n, even)} flip, {self._where_first()}"
        if self.share_without > 0:
            kept = ", ".join(f"{name} {of_draws(share, n, even, '')}" for name, share in self.always.items())
            text += f"; the others never ({kept} throughout)"
        if self.share_several > 0:
            text += f"; {of_draws(self.share_several, n, even, '')} have several"
        return text

    def _where_first(self) -> str:
        """Where draws that flip do so first: one by one, as a range, or with quantiles, by how many they are."""
        has = np.isfinite(self.first)
        values, weight = self.first[has], self.weight[has]
        order, even = np.argsort(values, kind="stable"), evenly(self.weight)
        if len(values) <= LISTED:
            own = [f"{values[i]:.4g}" + ("" if even else f" (weight {weight[i]:.2g})") for i in order]
            return f"at {', '.join(own)}" if len(own) == 1 else f"first at {', '.join(own)}"
        low, middle, high = self.quantiles((0.05, 0.5, 0.95))
        if len(values) < ENOUGH:
            return f"first from {values.min():.4g} to {values.max():.4g}, in the median of these at {middle:.4g}"
        return f"among these first at {middle:.4g} in the median ({low:.4g} to {high:.4g} in the middle 90%)"


def _apart(low: float, high: float) -> tuple[str, str]:
    """Two numbers with as many digits as tell them apart, six at least."""
    for digits in range(6, 18):
        ends = f"{low:.{digits}g}", f"{high:.{digits}g}"
        if ends[0] != ends[1]:
            break
    return ends


def find_flips(
    decider: Decider, parameter: str, setting: Setting, scan: Sequence[float] | Array, tolerance: float = 1e-6
) -> tuple[Flips, ...]:
    """Flips of every step as one number moves.

    Parameters
    ----------
    decider : Decider
    parameter : str
        What moves, in words.
    setting : callable
        Cases of values and draws.
    scan : sequence of float
        Rising; at least two.
    tolerance : float
        Width of the brackets at the end, as a share of the range.

    Raises
    ------
    InputError
        On a scan that does not rise, or a tolerance that is not above 0.
    """
    points = np.asarray(scan, dtype=np.float64)
    if len(points) < 2 or not np.all(np.diff(points) > 0):
        raise located(f"scan of {parameter}", points.tolist(), "at least two values that rise")
    if not tolerance > 0:
        raise located("tolerance of critical values", tolerance, "above 0")
    n, nodes = decider.draws.n_draws, decider.nodes
    answers = decider.decide(setting(np.repeat(points, n), np.tile(np.arange(n), len(points))))
    labels = np.stack([answers.label(k).reshape(len(points), n) for k in range(nodes.n_steps)])
    brackets = _Brackets.of_scan(points, labels)
    width = tolerance * float(points[-1] - points[0])
    for _ in range(HALVINGS):
        busy = np.flatnonzero(~brackets.stuck & (brackets.high - brackets.low > width))
        if not len(busy):
            break
        middle = (brackets.low[busy] + brackets.high[busy]) / 2
        found = decider.decide(setting(middle, brackets.draw[busy]))
        label = np.stack([found.label(k) for k in range(nodes.n_steps)])[brackets.step[busy], np.arange(len(busy))]
        brackets = brackets.halved(busy, middle, label)
    out = []
    for k in range(nodes.n_steps):
        own = np.flatnonzero(brackets.step == k)
        own = own[np.lexsort((brackets.low[own], brackets.draw[own]))]
        out.append(
            Flips(
                parameter, decider.reading, nodes, k, points, labels[k], brackets.draw[own], brackets.low[own],
                brackets.high[own], brackets.before[own], brackets.after[own],
                brackets.high[own] - brackets.low[own] <= width, decider.draws.weight,
                decider.draws.cautions,
            )
        )  # fmt: skip
    return tuple(out)


@dataclass(frozen=True)
class _Brackets:
    """Pairs of values with different decisions, of all draws and steps together."""

    step: Index
    draw: Index
    low: Array
    high: Array
    before: Index
    after: Index
    stuck: NDArray[np.bool_]

    @classmethod
    def of_scan(cls, points: Array, labels: Index) -> _Brackets:
        """Neighbouring points that are decided, and decided differently."""
        rows = []
        for k, d in np.ndindex(labels.shape[0], labels.shape[2]):
            own = labels[k, :, d]
            known = np.flatnonzero(own != OPEN)
            turns = np.flatnonzero(own[known[1:]] != own[known[:-1]])
            rows += [(k, d, known[i], known[i + 1]) for i in turns]
        k, d, i, j = np.array(rows, dtype=np.int64).reshape(-1, 4).T
        return cls(
            k, d, points[i], points[j], labels[k, i, d], labels[k, j, d], np.zeros(len(k), dtype=np.bool_)
        )  # fmt: skip

    def halved(self, busy: Index, middle: Array, label: Index) -> _Brackets:
        """One halving; a third decision in the middle makes two brackets of one, an open one ends the search."""
        low, high = self.low.copy(), self.high.copy()
        before, after, stuck = self.before.copy(), self.after.copy(), self.stuck.copy()
        left, right, unknown = label == before[busy], label == after[busy], label == OPEN
        third = ~left & ~right & ~unknown
        stuck[busy[unknown]] = True
        low[busy[left]] = middle[left]
        new = busy[third]
        more = _Brackets(
            self.step[new], self.draw[new], middle[third], high[new], label[third], after[new], stuck[new]
        )
        high[busy[right]] = middle[right]
        high[new], after[new] = middle[third], label[third]
        own = replace(self, low=low, high=high, before=before, after=after, stuck=stuck)
        if not len(new):
            return own
        names = ("step", "draw", "low", "high", "before", "after", "stuck")
        return _Brackets(*(np.concatenate([getattr(own, name), getattr(more, name)]) for name in names))
