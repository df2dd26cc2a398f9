r"""What would be believed of the draws after data of a next study, for many simulated data sets.

A data set is simulated from a draw that is taken for the truth, chosen by weight. What it makes of the weights is
Bayes' rule, :math:`w_i(D) \propto w_i \prod_h P_i(h)^{n_h}` with :math:`n_h` participants of history `h`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array

from models.model_draws import ModelDraws
from models.planning.schedule import Array
from models.robust.draw_groups import DrawGroups
from models.robust.study_design import NextStudy
from models.spread_out import chunks

STREAM = 611
"""First number of the spawn key of every stream of simulated participants."""

IMPOSSIBLE = -1e200
"""Stands for the logarithm of zero: no number of participants makes it infinite, and none makes it count."""

ROOM = 4_000_000
"""Probabilities that are held at once."""


class Believed(NamedTuple):
    """What simulated data make of the weights.

    Attributes
    ----------
    weight : float64[replicate, size, u]
        Of the draws after the data; sums to one over draws.
    truth : int64[replicate]
        The draw that the data came from.
    """

    weight: Array
    truth: NDArray[np.int64]


def simulated_weights(
    study: NextStudy, draws: ModelDraws, groups: DrawGroups, sizes: Sequence[int], replicates: range, seed: int
) -> Believed:
    """Weights of the draws after simulated data.

    A replicate's truth and participants come from a stream of its own: every study is run on the same truths and
    the same luck, and a smaller study is the beginning of a larger one.

    Parameters
    ----------
    study : NextStudy
    draws : ModelDraws
    groups : DrawGroups
        Its rows: those of one draw are kinds of participants.
    sizes : sequence of int
        Numbers of participants.
    replicates : range
        Which data sets.
    seed : int
    """
    truth, counts = _data(study, draws, groups, sizes, replicates, seed)
    if study.tells_nothing:
        return Believed(np.broadcast_to(groups.weight, (len(truth), len(sizes), len(groups))), truth)
    with np.errstate(divide="ignore"):
        log_prior = np.log(groups.weight)
    log_weight = counted_log_likelihood(study, draws, groups, counts) + log_prior
    log_weight -= log_weight.max(axis=1, keepdims=True)
    weight = np.exp(log_weight)
    weight /= weight.sum(axis=1, keepdims=True)
    return Believed(weight.reshape(len(truth), len(sizes), -1), truth)


def counted_log_likelihood(study: NextStudy, draws: ModelDraws, groups: DrawGroups, counts: csr_array) -> Array:
    r""":math:`\sum_h n_h \log P_i(h)` of every table of counts in every draw.

    Parameters
    ----------
    study : NextStudy
    draws : ModelDraws
    groups : DrawGroups
    counts : csr_array of float64[m, h]

    Returns
    -------
    float64[m, u]
    """
    out = np.empty((counts.shape[0], len(groups)))
    for span in chunks(len(groups), max(1, ROOM // (study.n_histories * groups.kinds))):
        chance = history_probabilities(study, draws, groups, np.arange(span.start, span.stop))
        with np.errstate(divide="ignore"):
            log_chance = np.where(chance > 0, np.log(chance), IMPOSSIBLE)
        out[:, span] = counts @ np.ascontiguousarray(log_chance.T)
    return out


def history_probabilities(
    study: NextStudy, draws: ModelDraws, groups: DrawGroups, which: NDArray[np.int64] | None = None
) -> Array:
    """Probability of every history of a new participant under some draws, kinds of people averaged.

    Parameters
    ----------
    study : NextStudy
    draws : ModelDraws
    groups : DrawGroups
    which : int64[n], optional
        Numbers of draws; all of them by default.

    Returns
    -------
    float64[n, h]
    """
    chosen = np.arange(len(groups)) if which is None else which
    rows = (chosen[:, None] * groups.kinds + np.arange(groups.kinds)).ravel()
    some = replace(
        draws, initial=draws.initial[rows], transition=draws.transition[rows], emission=draws.emission[rows],
        weight=np.full(len(rows), 1.0 / len(rows)),
    )  # fmt: skip
    chance = study.history_probabilities(some)
    if groups.kinds == 1:
        return chance
    return np.asarray(np.einsum("ukh,uk->uh", chance.reshape(len(chosen), groups.kinds, -1), groups.share[chosen]))


def _data(
    study: NextStudy, draws: ModelDraws, groups: DrawGroups, sizes: Sequence[int], replicates: range, seed: int
) -> tuple[NDArray[np.int64], csr_array]:
    """Truths ``[r]`` and counts of histories ``[r * sizes, h]``."""
    luck = [_stream(seed, r).random(1 + max(sizes)) for r in replicates]
    believed = np.cumsum(groups.weight)
    truth = np.searchsorted(believed, np.array([u[0] for u in luck]) * believed[-1], side="right")
    known, number = np.unique(truth, return_inverse=True)
    shape = (len(luck) * len(sizes), study.n_histories)
    if study.tells_nothing:
        return truth, csr_array(shape)
    # By one number between 0 and 1 against cumulated probabilities: like responses go together across studies.
    edges = np.cumsum(history_probabilities(study, draws, groups, known), axis=1)
    columns, values, ends = [], [], [0]
    for u, row in zip(luck, number, strict=True):
        history = np.searchsorted(edges[row], u[1:] * edges[row, -1], side="right")
        for n in sizes:
            seen, times = np.unique(history[:n], return_counts=True)
            columns.append(seen)
            values.append(times.astype(np.float64))
            ends.append(ends[-1] + len(seen))
    return truth, csr_array((np.concatenate(values), np.concatenate(columns), np.array(ends)), shape=shape)


def _stream(seed: int, replicate: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, replicate)))
