"""Rewards of states that cannot be come to: kept out of the work on a problem, and put back into its vectors.

An upper bound that begins at the highest reward for ever, and a tolerance that goes by the largest value, would
carry a number of any size into values that it has nothing to do with.
"""

from __future__ import annotations

import numpy as np

from models.planning.arrays import ProblemArrays
from models.planning.problem import Problem
from models.planning.reachable import reachable_states
from models.planning.vectors import Vectors, evaluate_closed

WORK = 1e8
"""Multiplications that values beyond reach are worth, once the search is over."""


def within_reach(arrays: ProblemArrays, problem: Problem) -> tuple[ProblemArrays, bool]:
    """Arrays whose rewards are all between those that the problem can pay, and whether any had to be changed.

    Values of beliefs that the problem can come to are the same: what leads out of its reach cannot be met.
    """
    lowest, highest, _ = problem.stakes
    own = np.arange(arrays.reward.shape[1]) < np.repeat(arrays.mode_size, np.diff(arrays.mode_choice))[:, None]
    tamed = np.where(own, np.clip(arrays.reward, lowest, highest), 0.0)
    if (tamed == arrays.reward).all():
        return arrays, False
    return arrays._replace(reward=tamed), True


def beyond_reach(problem: Problem, arrays: ProblemArrays, vectors: Vectors, work: float = WORK) -> None:
    """Value a policy graph anew in the states that the problem cannot come to, with the rewards they have.

    Parameters
    ----------
    problem : Problem
    arrays : ProblemArrays
        With all rewards as they are.
    vectors : Vectors
        Changed in place: worth what they say within reach, anything elsewhere.
    work : float
        Multiplications at most; where they are too few for a sweep, vectors say the least there can be.
    """
    n = int(vectors.counts[0])
    lowest = float(arrays.reward.min()) / (1 - arrays.discount)
    anew = vectors._replace(alpha=np.full_like(vectors.alpha[:n], lowest))
    # A vector takes one of the choices.
    entries = (len(arrays.value) + len(arrays.seen_value)) / len(arrays.reward)
    sweeps = int(min(1000.0, work / (n * (1.0 + entries))))
    if sweeps > 0:
        evaluate_closed(arrays, anew, 0, 1e-9 * abs(lowest), sweeps)
    for x, met in enumerate(reachable_states(problem)):
        not_met = np.ix_(np.flatnonzero(vectors.mode[:n] == x), np.flatnonzero(~met))
        vectors.alpha[not_met] = anew.alpha[not_met]
