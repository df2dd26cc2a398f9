r"""The value of partial information: what it would be worth to know one block of the tables, by itself.

.. math:: \mathrm{EVPPI} = E_\phi\Big[\max_\pi E[V(\pi) \mid \phi]\Big] - \max_\pi E[V(\pi)]

for a block :math:`\phi` of the tables, over a stated finite pool of plans. Draws are put into cells by which plan
looks best given the block (`models.robust.block_smoother`); each cell has a plan of its own, the best one in the
pool for the draws in it. The pool holds today's plan, those that are best for many single draws, and Bayes trees of
slices of the draws along the block and of the cells that matter. Two numbers come of it:

- *in the sample*: the plans of the cells, scored on the draws they were chosen with. Cells average, so this is
  never more than the pool's EVPI; but who chooses and scores with the same draws is optimistic.
- *cross-fitted*: the rule from block to plan is made without a part of the draws and scored on that part. This is
  an honest value of one rule that could be used, so it tends to be too low, and it has a standard error.

The truth should lie between them, up to that error. Who knows a block knows its parts, so a block is offered the
rules of its parts: in each part of the draws the rule that does best in the others. The plain regression estimate
is reported beside them. Of a sample of fewer than a hundred draws the cross-fitted number would be luck, so there
is none.

A list of weighted models is no sample: it is all that is believed. Being told the block leaves the models that have
this block, so the draws are put into cells by equal blocks, each with its own best plan, and the worth is exact. A
block that differs in every model is worth as much as perfect knowledge.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.errors import Phrase, located
from models.planning.exact import Decisions
from models.planning.schedule import Array, Schedule
from models.robust.block_smoother import Smoother, Terms, block_features, block_names, equal_blocks, parts_of
from models.robust.block_worth import FEWEST_DRAWS, BlockWorth, PartialInformation
from models.robust.draw_error import check_chains, draw_mean
from models.robust.draw_groups import DrawGroups
from models.robust.information import PerfectInformation, beyond_rounding, perfect_information
from models.robust.own_plans import OwnPlans, own_plans
from models.robust.plan_table import BestPlans, PlanTable, plan_key
from models.spread_out import spread_out

__all__ = ["BlockWorth", "PartialInformation", "partial_information"]

FREQUENT = 30
"""Plans that are best for single draws, the most frequent ones, that the pool begins with."""

SLICES = 6
"""Cells of equal weight that the first Bayes trees are made for."""

SMALLEST_CELL = 0.01
"""Share of the draws, by weight, below which a cell has no Bayes tree of its own and takes a plan of the pool."""

FOLDS = 4
"""Parts that draws are cut into for cross-fitting."""


@dataclass(frozen=True)
class _Work:
    """What the work on any block needs; sent to other processes as it is."""

    table: PlanTable
    groups: DrawGroups
    own: tuple[int, ...]
    which: NDArray[np.int64]
    today: int
    fold: NDArray[np.int64] | None


def partial_information(
    schedule: Schedule,
    blocks: Sequence[str] | None = None,
    *,
    kinds: int = 1,
    chains: int | None = None,
    folds: int = FOLDS,
    pool: Sequence[Decisions] = (),
    perfect: PerfectInformation | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> PartialInformation:
    """What it would be worth to know single blocks of the tables.

    Parameters
    ----------
    schedule : Schedule
    blocks : sequence of str, optional
        As in `models.robust.block_smoother.block_names`; all of those by default.
    kinds : int
        Where people differ: kinds of people in each draw (`models.robust.people_draws`).
    chains : int, optional
        How many chains the draws come from, one after the other and equally long. Standard errors then allow for
        the draws' correlation, and parts of the draws are cut within chains; without it draws count as independent.
    folds : int
        Parts for cross-fitting: neighbours in a chain stay together.
    pool : sequence of Decisions
        Further plans to choose among.
    perfect : PerfectInformation, optional
        Of the same schedule, if it is known already.
    executor : concurrent.futures.Executor, optional
        What blocks are spread over; threads by default.
    progress : callable, optional
        Called with blocks done and in all.

    Raises
    ------
    InputError
        On an unknown block, folds or chains that draws cannot be cut into, or too many histories.
    """
    known = perfect_information(schedule, kinds=kinds, executor=executor) if perfect is None else perfect
    groups = known.groups
    if groups.kinds != kinds or len(groups) * kinds != schedule.draws.n_draws:
        raise located(
            "perfect information, draws", Phrase(f"{len(groups)} of {groups.kinds} kinds"), "those of the schedule"
        )
    chains = known.chains if chains is None else chains
    check_chains(len(groups), chains)
    if isinstance(folds, bool) or not isinstance(folds, int | np.integer) or folds < 2:
        raise located("folds", folds, "an integer of at least 2")
    names = block_names(schedule.protocol) if blocks is None else tuple(blocks)
    # Parts of the blocks are worked on too, asked for or not, for what is said of a block must not depend on that.
    every_name = dict.fromkeys([*names, *(p for name in names for p in parts_of(schedule.protocol, name))])
    if not known.sampled:
        every_name = dict.fromkeys(names)
    features = [block_features(schedule.draws, groups, name) for name in every_name]
    own = own_plans(schedule, executor)
    if not known.sampled:
        return _exact(schedule, known, own, names, [x.shape[1] for x in features], int(folds), progress)
    table = PlanTable.of(schedule, [known.plan, *own.plans[:FREQUENT], *pool])
    frequent = tuple(table.row(p) for p in own.plans[:FREQUENT])
    which = own.which[:: groups.kinds]
    # A rule can be held against other draws only where the draws are a sample, and a large one.
    cut = len(groups) >= FEWEST_DRAWS
    fold = groups.folds(folds, chains) if cut else None
    work = _Work(table, groups, frequent, which, table.row(known.plan.decisions), fold)
    found = spread_out(executor, _block, [(work, x) for x in features], progress)
    by_name = dict(zip(every_name, zip(features, found, strict=True), strict=True))
    every = table.with_plans([plan for cells in found for plan in cells.plans])
    values = groups.mean(every.values)
    scale = max(1.0, float(np.abs(values).max()))
    best = float((values @ groups.weight).max())
    rows = []
    for name in names:
        x, cells = by_name[name]
        # A block without free probabilities of its own has no part that has some.
        offered = [cells, *(by_name[p][1] for p in parts_of(schedule.protocol, name) if p in by_name)]
        scored = [_scored(values, groups.weight, own.cell, best) for own in offered]
        chosen, plans = max(scored, key=lambda pair: pair[0])
        chosen = float(beyond_rounding(np.array([chosen]), scale)[0])
        worth, se = 0.0 if x.shape[1] == 0 else float("nan"), float("nan")
        if fold is not None:
            error = draw_mean(_best_elsewhere(offered, groups.weight, fold), groups.weight, chains)
            worth, se = error.mean, error.se
        rows.append(
            BlockWorth(
                name, worth, se, chosen, cells.regression, plans, x.shape[1], unit=schedule.unit,
                cautions=schedule.cautions,
            )
        )  # fmt: skip
    pooled = beyond_rounding(np.array([groups.weight @ values.max(axis=0) - best]), scale)[0]
    return PartialInformation(tuple(rows), known.value, float(pooled), len(every.plans), int(folds), chains,
                              len(groups), unit=schedule.unit, cautions=schedule.cautions)  # fmt: skip


def _scored(values: Array, weight: Array, cell: NDArray[np.int64], best: float) -> tuple[float, int]:
    """What a plan for every cell gains over the best one for all, on the draws it is chosen with; plans in use."""
    sums = np.stack([values[:, cell == c] @ weight[cell == c] for c in np.unique(cell)])
    return float(sums.max(axis=1).sum() - best), len(set(sums.argmax(axis=1)))


def _best_elsewhere(offered: Sequence[_Cells], weight: Array, fold: NDArray[np.int64]) -> Array:
    """Gain in every draw of the rule that gains most in the other parts of the draws; the first of equals."""
    gain = np.stack([cells.gain for cells in offered])
    out = np.empty(gain.shape[1])
    for part in np.unique(fold):
        here = fold == part
        out[here] = gain[np.argmax(gain[:, ~here] @ weight[~here])][here]
    return out


def _exact(
    schedule: Schedule, known: PerfectInformation, own: OwnPlans, names: Sequence[str], free: Sequence[int],
    folds: int, progress: Callable[[int, int], None] | None,
) -> PartialInformation:  # fmt: skip
    """Worth of each block where the draws are all that is believed: the best plan for every set of equal blocks."""
    groups, best = known.groups, BestPlans(schedule)
    today = groups.weight * known.values
    scale = max(1.0, float(np.abs(known.optima).max()))
    plans = {plan_key(known.plan.decisions)}
    rows = []
    for number, (name, probabilities) in enumerate(zip(names, free, strict=True), 1):
        same = equal_blocks(schedule.draws, groups, name)
        worth, cells = 0.0, set()
        for cell in np.unique(same):
            members = np.flatnonzero((same == cell) & (groups.weight > 0))
            if not len(members):
                continue
            weight = np.zeros(len(groups))
            weight[members] = groups.weight[members]
            if len(members) == 1 and groups.kinds == 1:
                # The best plan for one draw is its own.
                plan, value = own.plans[own.which[members[0]]], float(weight @ known.optima)
            else:
                found = best.solved(groups.expand(weight))
                plan, value = found.decisions, found.value
            worth += float(beyond_rounding(np.array(value - today[members].sum()), scale))
            cells.add(plan_key(plan))
        plans |= cells
        rows.append(
            BlockWorth(
                name, worth, float("nan"), worth, float("nan"), len(cells), probabilities, exact=True,
                unit=schedule.unit, cautions=schedule.cautions,
            )
        )  # fmt: skip
        if progress is not None:
            progress(number, len(names))
    return PartialInformation(
        tuple(rows), known.value, known.value, len(plans), folds, known.chains, len(groups), exact=True,
        unit=schedule.unit, cautions=schedule.cautions,
    )  # fmt: skip


@dataclass(frozen=True)
class _Cells:
    """What came of one block: cell of each draw, plans found, gain of the cross-fitted rule in each draw."""

    cell: NDArray[np.int64]
    plans: tuple[Decisions, ...]
    gain: Array
    regression: float


@dataclass(frozen=True)
class _Rule:
    """From a block to a plan: the smoother, and for each plan that looks best the row of the plan to follow."""

    smoother: Smoother
    follow: NDArray[np.int64]

    def cell(self, features: Array) -> NDArray[np.int64]:
        """Which plan looks best, shape ``[u]``."""
        return np.asarray(np.argmax(self.smoother.predict(features), axis=1))


def _block(piece: tuple[_Work, Array]) -> _Cells:
    """Cells of all draws, and the gain of rules that were made without the draws they are scored on."""
    work, features = piece
    groups, table = work.groups, work.table
    n = len(groups)
    if features.shape[1] == 0:
        return _Cells(np.zeros(n, dtype=np.int64), (), np.zeros(n), 0.0)
    table, rule = _make_rule(work, table, features, groups.weight)
    cell = rule.cell(features)
    smoothed = rule.smoother.predict(features)
    regression = float(groups.weight @ smoothed.max(axis=1) - (groups.weight @ smoothed).max())
    gain = np.zeros(n)
    for part in () if work.fold is None else np.unique(work.fold):
        out = work.fold == part
        rest = np.where(out, 0.0, groups.weight)
        if rest.sum() <= 0 or out.all():
            continue
        table, partial = _make_rule(work, table, features, rest / rest.sum())
        values = groups.mean(table.values)
        at = np.flatnonzero(out)
        gain[at] = values[partial.follow[partial.cell(features[at])], at] - values[work.today, at]
    return _Cells(cell, table.plans[len(work.table.plans) :], gain, regression)


def _make_rule(work: _Work, table: PlanTable, features: Array, weight: Array) -> tuple[PlanTable, _Rule]:
    """A rule made with the draws that have weight, and the table with the plans that it needed.

    Plans that the table holds already are candidates only if these draws lead to them.
    """
    groups = work.groups
    bayes = table.best.plan(groups.expand(weight))
    table = table.with_plans([bayes])
    share = np.bincount(work.which, weights=weight, minlength=len(work.own))[: len(work.own)]
    rows = dict.fromkeys([table.row(bayes), *(r for r, s in zip(work.own, share, strict=True) if s > 0)])
    terms = Terms.of(features, weight)
    for divide in (_along, _by_plan):
        smoother, _ = _smooth(groups, table, list(rows), terms)
        cell = divide(smoother.predict(features), weight)
        for c in np.flatnonzero(np.bincount(cell, weights=weight) > SMALLEST_CELL):
            plan = table.best.plan(groups.expand(np.where(cell == c, weight, 0.0)))
            table = table.with_plans([plan])
            rows[table.row(plan)] = None
    smoother, candidates = _smooth(groups, table, list(rows), terms)
    cell = _by_plan(smoother.predict(features), weight)
    values = groups.mean(table.values[candidates])
    # A plan that looks best for none of these draws may do so for another one: it is then followed as it is.
    follow = candidates.copy()
    for c in np.unique(cell[weight > 0]):
        own = np.where(cell == c, weight, 0.0)
        follow[c] = candidates[np.argmax(values @ own)]
    return table, _Rule(smoother, follow)


def _by_plan(smoothed: Array, _weight: Array) -> NDArray[np.int64]:
    """Cells by which plan looks best."""
    return np.asarray(np.argmax(smoothed, axis=1))


def _along(smoothed: Array, weight: Array) -> NDArray[np.int64]:
    """Cells of about equal weight along the direction in which plans' worth differs most.

    A plan that is best for a whole region of the block, and for no single draw in it, is found only so.
    """
    apart = smoothed - weight @ smoothed
    _, directions = np.linalg.eigh((weight[:, None] * apart).T @ apart)
    score = apart @ directions[:, -1]
    # Equal blocks have equal scores up to rounding, and stay together.
    score = np.round(score / max(float(np.ptp(score)), 1e-300), 9)
    order = np.argsort(score, kind="stable")
    reached = np.cumsum(weight[order])
    edges = score[order][np.searchsorted(reached, np.arange(1, SLICES) / SLICES)]
    return np.asarray(np.searchsorted(np.unique(edges), score, side="right"))


def _smooth(
    groups: DrawGroups, table: PlanTable, rows: list[int], terms: Terms
) -> tuple[Smoother, NDArray[np.int64]]:
    """Smoothed worth of candidate plans over that of the first one."""
    candidates = np.array(rows)
    values = groups.mean(table.values[candidates])
    return terms.fit((values - values[0]).T), candidates
