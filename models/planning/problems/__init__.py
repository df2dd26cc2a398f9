"""Problems of the literature, written from their published definitions.

They are what a solver is checked and compared on. Index orders are those of the house: ``transition[a, s, s']``,
``observation[a, s', o]``, ``reward[a, s]``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from models.errors import located
from models.planning.problem import Problem
from models.planning.problems.rock_sample import rock_sample
from models.planning.problems.tag import tag
from models.planning.textbook import textbook_problem


def tiger(discount: float = 0.95) -> Problem:
    """The tiger problem.

    Behind one of two doors is a tiger, behind the other a reward of 10. Listening costs 1 and tells the right door
    with probability .85; the wrong door costs 100, and after any door everything starts anew.

    States: tiger-left, tiger-right. Actions: listen, open-left, open-right. Observations: tiger-left, tiger-right.

    References
    ----------
    Kaelbling, L. P., Littman, M. L., & Cassandra, A. R. (1998). Planning and acting in partially observable
    stochastic domains. Artificial Intelligence, 101, 99-134, section 5.1. They use a discount of .75.

    Examples
    --------
    >>> tiger().choices[0][0].reward
    array([-1., -1.])
    """
    even = np.full((2, 2), 0.5)
    doors = ("tiger-left", "tiger-right")
    return textbook_problem(
        [np.eye(2), even, even],
        [np.array([[0.85, 0.15], [0.15, 0.85]]), even, even],
        np.array([[-1.0, -1.0], [-100.0, 10.0], [10.0, -100.0]]),
        discount,
        states=doors, actions=("listen", "open-left", "open-right"), observations=doors, name="tiger",
    )  # fmt: skip


def crying_baby(discount: float = 0.9) -> Problem:
    """The crying baby problem, with three actions.

    A baby is hungry or sated and becomes hungry with probability .1 unless it is fed. It cries with probability .8
    when hungry and .1 when sated; sung to, .9 and 0. A hungry baby costs 10 a step, feeding 5, singing .5. The
    first belief is even.

    States: hungry, sated. Actions: feed, sing, ignore. Observations: crying, quiet.

    References
    ----------
    Kochenderfer, M. J., Wheeler, T. A., & Wray, K. H. (2022). Algorithms for decision making. MIT Press,
    appendix F.7.
    """
    fed = np.array([[0.0, 1.0], [0.0, 1.0]])
    unfed = np.array([[1.0, 0.0], [0.1, 0.9]])
    cries = np.array([[0.8, 0.2], [0.1, 0.9]])
    sung = np.array([[0.9, 0.1], [0.0, 1.0]])
    return textbook_problem(
        [fed, unfed, unfed],
        [cries, sung, cries],
        np.array([[-15.0, -5.0], [-10.5, -0.5], [-10.0, 0.0]]),
        discount,
        states=("hungry", "sated"), actions=("feed", "sing", "ignore"), observations=("crying", "quiet"),
        name="crying_baby",
    )  # fmt: skip


PROBLEMS: dict[str, Callable[[], Problem]] = {
    "tiger": tiger,
    "crying_baby": crying_baby,
    "rock_sample_4_4": partial(rock_sample, 4, 4),
    "rock_sample_5_5": partial(rock_sample, 5, 5),
    "rock_sample_5_7": partial(rock_sample, 5, 7),
    "rock_sample_7_8": partial(rock_sample, 7, 8),
    "tag": tag,
}
"""Every standard problem by name."""


def problem(name: str) -> Problem:
    """A standard problem.

    Parameters
    ----------
    name : str
        One of `PROBLEMS`.

    Raises
    ------
    InputError
        If there is none of that name.

    Examples
    --------
    >>> problem("tiger").n_states
    2
    """
    if name not in PROBLEMS:
        raise located("standard problem", name, f"one of {', '.join(PROBLEMS)}")
    return PROBLEMS[name]()
