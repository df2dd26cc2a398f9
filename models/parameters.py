"""The layout of a model's parameters as one vector, and which of them are free.

``theta = [initial[s], transition[a, s, s'], emission[e, s, o]]``, flattened in that order: a list of probability
rows. Learning, standard errors and identification all speak this layout.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from models.design_facts import Study
from models.errors import located
from models.lspomdp import check_rows
from models.protocol import Protocol

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Layout:
    """Shapes and names of the parameter vector for a protocol and a number of states."""

    protocol: Protocol
    n_states: int

    @cached_property
    def sizes(self) -> tuple[int, int, int, int]:
        """States, actions, emission tables, responses: what the compiled loop wants."""
        p = self.protocol
        return self.n_states, p.n_actions, len(p.emission_actions), p.n_responses

    @property
    def base(self) -> Layout:
        """Layout of one group of people: this one (`models.groups` has those of several)."""
        return self

    @property
    def n_groups(self) -> int:
        """Number of groups of people."""
        return 1

    @cached_property
    def row_kinds(self) -> list[str]:
        """Table of every row."""
        s, _, e, _ = self.sizes
        return ["initial"] + ["transition"] * self.n_transition_rows + ["emission"] * (e * s)

    @cached_property
    def index(self) -> NDArray[np.int64]:
        """Place in the vector of every entry of the tables that kernels read."""
        return np.arange(self.size)

    def tied(self, one: NDArray) -> NDArray:
        """A vector in the layout of one group as one of this layout."""
        return one

    @property
    def n_transition_rows(self) -> int:
        """Number of rows of all transition tables."""
        return self.protocol.n_actions * self.n_states

    @cached_property
    def rows(self) -> list[slice]:
        """Slice of every probability row: initial, then transition rows, then emission rows."""
        s, _, e, o = self.sizes
        widths = [s] * (1 + self.n_transition_rows) + [o] * (e * s)
        ends = np.cumsum(widths)
        return [slice(int(b - w), int(b)) for w, b in zip(widths, ends, strict=True)]

    @cached_property
    def emission_index(self) -> NDArray[np.int64]:
        """Emission table of each action, -1 for silent modes."""
        return np.asarray(self.protocol.emission_index, dtype=np.int64)

    @property
    def size(self) -> int:
        """Length of the vector."""
        return self.rows[-1].stop

    def pack(self, initial: Array, transition: Array, emission: Array) -> Array:
        """Tables to vector."""
        return np.concatenate([initial.ravel(), transition.ravel(), emission.ravel()])

    def unpack(self, theta: Array) -> tuple[Array, Array, Array]:
        """Vector to (views of) tables; leading axes, of draws, are kept."""
        s, a, e, o = self.sizes
        lead = theta.shape[:-1]
        first, second = s, s + a * s * s
        return (
            theta[..., :first],
            theta[..., first:second].reshape(*lead, a, s, s),
            theta[..., second:].reshape(*lead, e, s, o),
        )

    def free_entries(self, pins: Mapping[str, Array]) -> NDArray[np.bool_]:
        """Which entries may move when the transition tables of `pins` are held."""
        free = np.ones(self.size, dtype=bool)
        _, transition, _ = self.unpack(free)
        for action in pins:
            transition[self.protocol.action(action)] = False
        return free

    def informed_rows(self, log: Study) -> NDArray[np.bool_]:
        """Rows whose table the log can say anything about, by design alone.

        A transition table needs the action to be followed by another event; an emission table needs a
        recorded response under its action.
        """
        by_action = log.design.followed
        by_emission = log.emission_weights > 0
        return np.concatenate([[True], np.repeat(by_action, self.n_states), np.repeat(by_emission, self.n_states)])

    def informed_entries(self, log: Study) -> NDArray[np.bool_]:
        """`informed_rows`, entry by entry."""
        return np.repeat(self.informed_rows(log), [row.stop - row.start for row in self.rows])

    @cached_property
    def uniform(self) -> Array:
        """The vector in which every row is uniform."""
        widths = np.array([row.stop - row.start for row in self.rows])
        return np.repeat(1.0 / widths, widths)


def on_boundary(row: Array, boundary: float) -> int:
    """Free parameters of a probability row that sit at 0 or 1: its degrees of freedom less those inside.

    Examples
    --------
    >>> on_boundary(np.array([0.0, 1.0]), 1e-4), on_boundary(np.array([0.0, 0.3, 0.7]), 1e-4)
    (1, 1)
    """
    inside = int(np.sum((row > boundary) & (row < 1 - boundary)))
    return len(row) - 1 - max(inside - 1, 0)


def checked_pins(layout: Layout, pins: Mapping[str, Array | None]) -> dict[str, Array]:
    """Transition tables to hold fixed, by action; None means the identity.

    Raises
    ------
    InputError
        On an unknown action, a wrong shape or rows that are not probabilities.
    """
    n = layout.n_states
    out: dict[str, Array] = {}
    for action, table in pins.items():
        layout.protocol.action(action)
        array = np.eye(n) if table is None else np.asarray(table, dtype=np.float64)
        if array.shape != (n, n):
            raise located(f"pinned table of {action}, shape", array.shape, f"({n}, {n})")
        check_rows("pinned", array, [(f"action {action}", f"state {s}") for s in range(n)])
        out[action] = array
    return out


@dataclass(frozen=True)
class DirichletPrior:
    """Dirichlet parameters of the rows as pseudo-counts plus one; 1 everywhere is maximum likelihood.

    Attributes
    ----------
    initial, emission : float
        Symmetric parameter of each row, at least 1 (below, the posterior mode need not exist).
    transition : float
        Parameter of every entry of a transition row.
    stay : float
        Added to the diagonal of transition tables (a sticky prior).
    """

    initial: float = 1.0
    transition: float = 1.0
    emission: float = 1.0
    stay: float = 0.0

    def __post_init__(self) -> None:
        for name, low in (("initial", 1.0), ("transition", 1.0), ("emission", 1.0), ("stay", 0.0)):
            value = getattr(self, name)
            if not (np.isfinite(value) and value >= low):
                raise located(f"prior, {name}", value, f"a number of at least {low:g}")

    def pseudo_counts(self, layout: Layout) -> Array:
        """Dirichlet parameters minus one in the layout's order."""
        s, a, e, o = layout.sizes
        transition = np.full((a, s, s), self.transition - 1.0) + self.stay * np.eye(s)
        return layout.pack(np.full(s, self.initial - 1.0), transition, np.full((e, s, o), self.emission - 1.0))


STICKY = DirichletPrior(stay=2.0)
"""Default prior of the Bayesian model: transition rows Dirichlet(1 + 2 on staying), everything else uniform."""


def recorded(log: Study) -> int:
    """Recorded responses of a log, refusing logs without any."""
    n = log.n_responses_recorded
    if n == 0:
        raise located(f"study {log.study!r}, recorded responses", 0, "at least one: nothing can be learned")
    return n
