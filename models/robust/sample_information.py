r"""The value of a next study: how much better plans would be after data of `n` more participants.

.. math:: \mathrm{EVSI}_n = E_D\Big[\max_\pi \sum_i w_i(D) V_i(\pi) - \sum_i w_i(D) V_i(\pi_0)\Big]

with today's plan :math:`\pi_0` and data `D` of a truth that is drawn from what is believed. Every simulated data
set gives a difference that is never negative, exact on the draws (`models.robust.many_weights`), and no more than
what perfect knowledge would add to today's plan with the same weights; their mean has no bias. Reweighting needs
draws that still cover what is believed after the data: their effective number is reported.

Where few draws carry the weight, a plan fits them better than what would be believed with all the draws there
could be, and the number is too high. So a second one is reported: plans chosen without the part of the draws that
the truth is in, scored with that part only. It has no bias for plans made from so many draws, and as more draws
would make better plans, it tends to be too low.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from math import comb

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.special import gammaln

from models.errors import Phrase, located
from models.planning.schedule import Array, Schedule
from models.robust.draw_error import effective_draws
from models.robust.draw_groups import DrawGroups
from models.robust.information import PerfectInformation, beyond_rounding, perfect_information
from models.robust.many_weights import ManyWeights
from models.robust.plan_table import PlanTable
from models.robust.study_data import counted_log_likelihood, history_probabilities, simulated_weights
from models.robust.study_design import NextStudy
from models.robust.study_room import PIECE, check_room
from models.robust.study_worth import SampleInformation, Simulated, StudyWorth
from models.spread_out import chunks, spread_out

FOLDS = 4
"""Parts of the draws: plans are chosen without the part of the truth, and scored by it."""

FEWEST_CUT = 100
"""Draws below which nothing is held out: they count as all the models there are."""

NOTHING = 1e-300
"""Weight below which the other parts of the draws cannot explain the data at all, and today's plan is kept."""

MOST_DATA_SETS = 20_000
"""Data sets that are enumerated at most."""


@dataclass(frozen=True)
class _Work:
    """What every piece of work needs; sent to other processes as it is."""

    schedule: Schedule
    groups: DrawGroups
    studies: tuple[NextStudy, ...]
    sizes: tuple[int, ...]
    seed: int
    optima: Array
    today: Array
    pool: Array | None
    fold: NDArray[np.int64] | None


def sample_information(
    schedule: Schedule,
    studies: NextStudy | Sequence[NextStudy],
    sizes: Sequence[int],
    *,
    replicates: int = 200,
    seed: int = 1,
    kinds: int = 1,
    pool: PlanTable | None = None,
    served: float | None = None,
    cost: float = 0.0,
    perfect: PerfectInformation | None = None,
    executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> SampleInformation:
    """What data of further participants would be worth, for several studies and sizes.

    Parameters
    ----------
    schedule : Schedule
        What the robot will do afterwards with each person served, and what is believed today.
    studies : NextStudy or sequence of NextStudy
    sizes : sequence of int
        Numbers of participants.
    replicates : int
        Simulated data sets of each.
    seed : int
        Truths and luck of replicate `r` depend on this and `r` only.
    kinds : int
        Where people differ: kinds of people in each draw (`models.robust.people_draws`); participants are then
        drawn from them anew.
    pool : PlanTable, optional
        Choose among these plans and today's only: faster, and a lower bound.
    served : float, optional
        How many people will be served by the plan, for the net benefit.
    cost : float
        Of one participant, in the unit of the reward, for the net benefit.
    perfect : PerfectInformation, optional
        Of the same schedule, if it is known already.
    executor : concurrent.futures.Executor, optional
        What data sets are spread over; threads by default. No result depends on it.
    progress : callable, optional
        Called with pieces of work done and in all.

    Returns
    -------
    SampleInformation

    Raises
    ------
    InputError
        On studies of the same name or another protocol, sizes below 1, fewer than two replicates, a pool of another
        schedule, numbers for the net benefit that are none, or more histories and draws than there is time and
        memory for (`models.robust.study_room`).
    """
    several = (studies,) if isinstance(studies, NextStudy) else tuple(studies)
    wanted = _checked(schedule, several, sizes, replicates, served, cost)
    check_room(several, schedule.draws.n_draws, wanted, replicates)
    known = perfect_information(schedule, kinds=kinds, executor=executor) if perfect is None else perfect
    groups = known.groups
    if groups.kinds != kinds or len(groups) * kinds != schedule.draws.n_draws:
        raise located(
            "perfect information, draws", Phrase(f"{len(groups)} of {groups.kinds} kinds"), "those of the schedule"
        )
    values = None
    if pool is not None:
        if pool.values.shape[1] != schedule.draws.n_draws:
            raise located("pool, draws", pool.values.shape[1], f"{schedule.draws.n_draws}, those of the schedule")
        values = np.vstack([groups.mean(pool.values), known.values])
    cut = known.sampled and len(groups) >= FEWEST_CUT
    fold = groups.folds(FOLDS, known.chains) if cut else None
    work = _Work(schedule, groups, several, wanted, seed, known.optima, known.values, values, fold)
    pieces = [(work, span.start, span.stop) for span in chunks(replicates, PIECE)]
    found = spread_out(executor, _gains, pieces, progress)
    every = Simulated(*(np.concatenate(part) for part in zip(*found, strict=True)))
    rows = [
        StudyWorth.of(
            study.name, n, Simulated(*(part[:, j, i] for part in every)), known.value, study.tells_nothing,
            cut, served, cost, known.sampled, schedule.unit, schedule.cautions,
        )
        for j, study in enumerate(several)
        for i, n in enumerate(wanted)
    ]  # fmt: skip
    return SampleInformation(
        tuple(rows), every.gain, every.ceiling, tuple(s.name for s in several), wanted, known.value,
        schedule.letters, seed, pool is None, schedule.unit, schedule.cautions,
    )  # fmt: skip


def _gains(piece: tuple[_Work, int, int]) -> Simulated:
    """What plans gain after some simulated data sets of every study."""
    work, begin, end = piece
    groups, replicates = work.groups, range(begin, end)
    scale = max(1.0, float(np.abs(work.optima).max()))
    out = Simulated(*(np.zeros((len(replicates), len(work.studies), len(work.sizes))) for _ in Simulated._fields))
    telling = [j for j, study in enumerate(work.studies) if not study.tells_nothing]
    weights, truths = [], []
    for j, study in enumerate(work.studies):
        weight, truth = simulated_weights(study, work.schedule.draws, groups, work.sizes, replicates, work.seed)
        flat, shape = weight.reshape(-1, len(groups)), weight.shape[:-1]
        out.ceiling[:, j] = beyond_rounding(flat @ (work.optima - work.today), scale).reshape(shape)
        out.effective[:, j] = effective_draws(weight)
        if j in telling:
            weights.append(flat)
            truths.append(np.repeat(truth, len(work.sizes)))
    if not telling:
        return out
    # All studies at once: what every choice is worth in every draw is then worked out once for them.
    every, shape = np.concatenate(weights), (len(telling), *out.gain[:, 0].shape)
    own = None if work.fold is None else work.fold[np.concatenate(truths)]
    best, scored = _chosen(work, every, own)
    gain = beyond_rounding(best - every @ work.today, scale)
    out.gain[:, telling] = gain.reshape(shape).transpose(1, 0, 2)
    if own is None:
        return out
    # Chosen without the truth's part of the draws, scored by that part.
    mine = own[:, None] == work.fold
    score = np.where(mine, every, 0.0)
    mass = score.sum(axis=1)
    told = np.where(mine, 0.0, every).sum(axis=1) > NOTHING
    gained = (scored - score @ work.today) / mass
    out.held_out[:, telling] = np.where(told, gained, 0.0).reshape(shape).transpose(1, 0, 2)
    out.held_out_ceiling[:, telling] = (score @ (work.optima - work.today) / mass).reshape(shape).transpose(1, 0, 2)
    return out


def _chosen(work: _Work, weight: Array, own: NDArray[np.int64] | None) -> tuple[Array, Array]:
    """Worth of best plans under weights ``[m, u]``, and, by the weights of part `own`, of those best without it."""
    if work.pool is None:
        many, rows = ManyWeights(work.schedule), work.groups.expand(weight)
        if own is None or work.fold is None:
            return many.optima(rows).values, np.zeros(0)
        found = many.crossed(rows, np.repeat(work.fold, work.groups.kinds), own)
        return found.values, found.scored
    best = (weight @ work.pool.T).max(axis=1)
    if own is None:
        return best, np.zeros(0)
    mine = own[:, None] == work.fold
    choice = np.argmax(np.where(mine, 0.0, weight) @ work.pool.T, axis=1)
    return best, np.asarray(np.einsum("mu,mu->m", np.where(mine, weight, 0.0), work.pool[choice]))


def enumerated_information(schedule: Schedule, study: NextStudy, people: int, *, kinds: int = 1) -> float:
    """The same value without simulation: the sum over every data set that so many participants can give.

    Parameters
    ----------
    schedule : Schedule
    study : NextStudy
    people : int
        Few: the data sets are enumerated.
    kinds : int
        As in `sample_information`.

    Raises
    ------
    InputError
        If there are too many data sets.
    """
    _checked(schedule, (study,), (people,), 2, None, 0.0)
    groups = DrawGroups.of(schedule.draws, kinds)
    if study.tells_nothing:
        return 0.0
    seen = np.flatnonzero(history_probabilities(study, schedule.draws, groups).max(axis=0) > 0)
    number = comb(people + len(seen) - 1, people)
    if number > MOST_DATA_SETS:
        raise located(f"study {study.name!r}, data sets", number, f"at most {MOST_DATA_SETS} to be enumerated")
    tables = np.zeros((number, study.n_histories))
    tables[:, seen] = _compositions(people, len(seen))
    log_ways = gammaln(people + 1) - gammaln(tables + 1).sum(axis=1)
    log_chance = counted_log_likelihood(study, schedule.draws, groups, csr_array(tables)) + log_ways[:, None]
    joint = groups.weight * np.exp(log_chance)
    many = ManyWeights(schedule)
    today = float(many.optima(schedule.draws.weight[None]).values[0])
    gain = many.optima(groups.expand(joint)).values.sum() - today
    return float(beyond_rounding(np.array([gain]), max(1.0, abs(today)))[0])


def _compositions(total: int, parts: int) -> Array:
    """All ways to write `total` as a sum of `parts` numbers, shape ``[m, parts]``."""
    rows = np.zeros((1, 0))
    left = np.array([float(total)])
    for _ in range(parts - 1):
        take = [np.arange(n + 1.0) for n in left]
        times = [len(t) for t in take]
        rows = np.column_stack([np.repeat(rows, times, axis=0), np.concatenate(take)])
        left = np.repeat(left, times) - rows[:, -1]
    return np.column_stack([rows, left])


def _checked(
    schedule: Schedule, studies: tuple[NextStudy, ...], sizes: Sequence[int], replicates: int, served: float | None,
    cost: float,
) -> tuple[int, ...]:  # fmt: skip
    """The sizes in rising order, once everything is as it should be."""
    names = [s.name for s in studies]
    if not names or len(set(names)) < len(names):
        raise located("studies, names", Phrase(", ".join(names) or "none"), "at least one, each with its own name")
    for study in studies:
        if study.protocol != schedule.protocol:
            raise located(f"study {study.name!r}, protocol", study.protocol.name, repr(schedule.protocol.name))
    whole = all(isinstance(n, int | np.integer) and not isinstance(n, bool) and n >= 1 for n in sizes)
    if not whole or not len(sizes):
        raise located("participants of a study", list(sizes), "whole numbers of at least 1")
    if isinstance(replicates, bool) or not isinstance(replicates, int | np.integer) or replicates < 2:
        raise located("simulated data sets", replicates, "at least 2")
    if served is not None and not (np.isfinite(served) and served > 0):
        raise located("people served", served, "a positive number")
    if not (np.isfinite(cost) and cost >= 0):
        raise located("cost of a participant", cost, "a number of at least 0")
    return tuple(sorted({int(n) for n in sizes}))
