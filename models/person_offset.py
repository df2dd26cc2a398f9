"""People who differ: each has an offset on the helping log-odds, integrated out by quadrature.

The rule is the trapezoid rule on :math:`[-5, 5]` under the normal density. For a person with few responses it is
as exact as a Gauss-Hermite rule of as many nodes (both to rounding); for one with many responses, whose likelihood
is a narrow peak, its even spacing resolves the peak with fewer nodes. All people share the nodes, so the recursion
over histories is done once a node and not once a person; `node_check` measures whether they are enough.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.events import EventLog
from models.histories import UNSEEN, HistoryTree
from models.hmm_density import HmmDensity
from models.parameters import Array
from models.people_kernel import PeopleArrays

REACH = 5.0
"""Nodes reach to this many standard deviations; what lies beyond has probability 6e-7."""

FEWEST, MOST = 21, 61
"""Bounds of the number of nodes that is chosen by itself."""

SD_OF_INTEREST, RESOLUTION = 1.5, 1.2
"""Nodes are spaced this share of a person's likelihood's width at this sigma, which makes its error about 1e-6."""


@dataclass(frozen=True)
class PersonOffset:
    """Prior and quadrature of the offsets.

    Attributes
    ----------
    scale : float
        Standard deviation of the half-normal prior of sigma, in log-odds.
    nodes : int, optional
        Quadrature nodes; by the number of responses of the people if not given.
    """

    scale: float = 1.5
    nodes: int | None = None

    def __post_init__(self) -> None:
        if isinstance(self.scale, bool) or not (0 < self.scale <= 1e3):
            raise located("person offset, scale of the prior", self.scale, "a positive number up to 1000")
        if self.nodes is not None and not (isinstance(self.nodes, int | np.integer) and 3 <= self.nodes <= 1001):
            raise located("person offset, nodes", self.nodes, "an integer from 3 to 1001")
        if self.nodes is not None:
            object.__setattr__(self, "nodes", int(self.nodes))

    def points(self, log: EventLog) -> int:
        """Number of nodes for a log."""
        if self.nodes is not None:
            return int(self.nodes)
        responses = np.bincount(
            person_of_run(log)[log.run_of_event], weights=log.response != UNSEEN, minlength=log.n_participants
        )
        # A binary response carries at most 1/4 of information on the log-odds, and people who differ much are
        # mostly near a floor or a ceiling: half of that is typical of the people whose peak is narrowest.
        width = 1.0 / np.sqrt(1.0 + SD_OF_INTEREST**2 * responses.max() / 8.0)
        wanted = int(np.ceil(2 * REACH / (RESOLUTION * width))) + 1
        return int(np.clip(wanted + 1 - wanted % 2, FEWEST, MOST))

    def arrays(self, log: EventLog, tree: HistoryTree, nodes: int | None = None) -> PeopleArrays:
        """What the kernels read.

        Parameters
        ----------
        log : EventLog
        tree : HistoryTree
            Of that log.
        nodes : int, optional
            Another number of nodes than the log asks for.
        """
        z, log_weight = quadrature(nodes or self.points(log))
        offset, node, count = distinct_people(tree, person_of_run(log))
        scores = np.asarray(log.protocol.scores, dtype=np.float64)
        return PeopleArrays(offset, node, count, z, log_weight, scores, np.array([float(self.scale)]))

    def to_dict(self) -> dict[str, Any]:
        """What identifies it, for settings and keys of stored fits."""
        return {"scale": float(self.scale), "nodes": self.nodes}


def person_of_run(log: EventLog) -> NDArray[np.int64]:
    """Position of each run's participant among the sorted participants."""
    return np.unique(log.participant, return_inverse=True)[1].astype(np.int64)


def quadrature(nodes: int) -> tuple[Array, Array]:
    """Nodes of the trapezoid rule under the standard normal density, and logarithms of their weights.

    Examples
    --------
    >>> z, log_weight = quadrature(15)
    >>> [round(float(np.exp(log_weight) @ z**k), 4) for k in (0, 2, 4)]
    [1.0, 1.0, 2.9993]
    """
    z = np.linspace(-REACH, REACH, nodes)
    weight = np.exp(-0.5 * z * z)
    weight[[0, -1]] *= 0.5
    return z, np.log(weight / weight.sum())


def each_person(people: PeopleArrays, tree: HistoryTree, person: NDArray[np.int64]) -> PeopleArrays:
    """The same quadrature with one entry a person, in the order of their numbers."""
    order = np.lexsort((tree.run_node, person))
    runs = np.bincount(person)
    offset = np.append(0, np.cumsum(runs)).astype(np.int64)
    return people._replace(offset=offset, node=tree.run_node[order].astype(np.int64), weight=np.ones(len(runs)))


def reweighted(density: HmmDensity, person: NDArray[np.int64], weight: NDArray[np.float64]) -> HmmDensity:
    """The density in which each person counts as often as `weight` says.

    Parameters
    ----------
    density : HmmDensity
    person : int64[runs]
        Person of each run, numbered from 0.
    weight : float64[person]
    """
    tree = density.tree.with_runs(weight[person])
    if not density.people_differ:
        return replace(density, tree=tree)
    offset, node, count = distinct_people(density.tree, person, weight)
    # The tree's own counts stay as they are: they only mark where runs end.
    return replace(density, people=density.people._replace(offset=offset, node=node, weight=count))


def distinct_people(
    tree: HistoryTree, person: NDArray[np.int64], weight: NDArray[np.float64] | None = None
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """People with the same multiset of histories, once each.

    Parameters
    ----------
    tree : HistoryTree
    person : int64[runs]
        Person of each run, numbered from 0.
    weight : float64[person], optional
        How much each person counts; 1 if not given.

    Returns
    -------
    offset : int64[distinct + 1]
    node : int64[...]
        Nodes at which the runs of distinct person p end: ``node[offset[p] : offset[p + 1]]``.
    count : float64[distinct]
    """
    order = np.lexsort((tree.run_node, person))
    node, runs = tree.run_node[order], np.bincount(person)
    start = np.append(0, np.cumsum(runs))[:-1]
    counts = np.ones(len(runs)) if weight is None else np.asarray(weight, dtype=np.float64)
    ends: list[NDArray] = []
    lengths: list[NDArray] = []
    totals: list[NDArray] = []
    for n in np.unique(runs[runs > 0]):
        members = np.flatnonzero(runs == n)
        rows = node[start[members][:, None] + np.arange(n)]
        kinds, kind = np.unique(rows, axis=0, return_inverse=True)
        ends.append(kinds.ravel())
        lengths.append(np.full(len(kinds), n))
        totals.append(np.bincount(kind.ravel(), weights=counts[members], minlength=len(kinds)))
    offset = np.append(0, np.cumsum(np.concatenate(lengths))).astype(np.int64)
    return offset, np.concatenate(ends).astype(np.int64), np.concatenate(totals).astype(np.float64)
