r"""What plans are worth on average given one block of the tables: a regression over the draws.

:math:`E[V_i(\pi) \mid \text{block}]` is smoothed out of the draws by ridge regression on the block's free
probabilities, their squares and products (values are polynomials in them); the penalty of each plan is chosen by
generalised cross-validation (Golub, Heath & Wahba 1979). Strong, Oakley & Brennan (2014) introduced regression for
this purpose.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from models.errors import located
from models.event_rules import one_of
from models.model_draws import ModelDraws
from models.planning.schedule import Array
from models.protocol import Protocol
from models.robust.draw_groups import DrawGroups

PENALTIES = np.concatenate([np.zeros(1), np.logspace(-4, 4, 17)])
"""Penalties tried, for features of unit variance, in numbers of draws over 100."""

DRAWS_A_TERM = 4
"""Products are left out where there would be fewer draws than this for each term, then squares."""

SMALLEST = 1e-12
"""Directions of the terms with less than this share of the largest square are left out."""

VARIES = 1e-12
"""Spread below which a probability is held fixed."""


def block_names(protocol: Protocol) -> tuple[str, ...]:
    """The blocks that are looked at: each action's transitions, all responses and each action's, initial belief.

    Examples
    --------
    >>> from models.protocol import PUBLISHED
    >>> block_names(PUBLISHED)[3:6]
    ('transition[signal]', 'emission', 'emission[no_signal]')
    """
    moves = tuple(f"transition[{a}]" for a in protocol.action_names)
    shown = tuple(f"emission[{a}]" for a in protocol.emission_actions)
    return (*moves, "emission", *(shown if len(shown) > 1 else ()), "initial")


def parts_of(protocol: Protocol, name: str) -> tuple[str, ...]:
    """The blocks that a block is made of; none if it is of one action or the initial belief.

    Examples
    --------
    >>> from models.protocol import PUBLISHED
    >>> parts_of(PUBLISHED, "emission"), parts_of(PUBLISHED, "initial")
    (('emission[no_signal]', 'emission[signal]'), ())
    """
    if name not in ("transition", "emission"):
        return ()
    actions = protocol.action_names if name == "transition" else protocol.emission_actions
    return tuple(f"{name}[{a}]" for a in actions)


def block_words(name: str) -> str:
    """A block as it is spoken of.

    Examples
    --------
    >>> block_words("transition[no_help]"), block_words("emission")
    ('how no help moves people', 'how each state responds')
    """
    table, _, action = name.rstrip("]").partition("[")
    said = action.replace("_", " ")
    if table == "initial":
        return "how people start"
    if table == "emission":
        return f"how each state responds to {said}" if action else "how each state responds"
    return f"how {said} moves people" if action else "how people move"


def block_features(draws: ModelDraws, groups: DrawGroups, name: str) -> Array:
    """Free probabilities of a block in every draw, shape ``[u, f]``; those that are held fixed are left out.

    Parameters
    ----------
    draws : ModelDraws
    groups : DrawGroups
        Kinds of people share what they share; where they differ the first and the last kind tell of all.
    name : str
        As in `block_names`, or ``transition`` for all actions.

    Raises
    ------
    InputError
        If there is no such block.
    """
    free = _free(draws, name)
    first, last = free[:: groups.kinds], free[groups.kinds - 1 :: groups.kinds]
    both = first if np.array_equal(first, last) else np.hstack([first, last])
    return np.ascontiguousarray(both[:, np.ptp(both, axis=0) > VARIES])


def equal_blocks(draws: ModelDraws, groups: DrawGroups, name: str) -> NDArray[np.int64]:
    """Which draws have the same block, for all kinds of people: a number each, shape ``[u]``.

    Parameters
    ----------
    draws, groups, name
        As for `block_features`.

    Raises
    ------
    InputError
        If there is no such block.
    """
    values = _free(draws, name).reshape(len(groups), -1)
    order = np.argsort(values, axis=0, kind="stable")
    # Probabilities are equal if no step between them, in order of size, is more than rounding.
    steps = np.diff(np.take_along_axis(values, order, axis=0), axis=0) > VARIES
    number = np.zeros(values.shape, dtype=np.int64)
    np.put_along_axis(number, order[1:], np.cumsum(steps, axis=0), axis=0)
    return np.asarray(np.unique(number, axis=0, return_inverse=True)[1]).ravel()


def _free(draws: ModelDraws, name: str) -> Array:
    """A block's probabilities but the last of each distribution, shape ``[d, f]``."""
    known = (
        *block_names(draws.protocol),
        "transition",
        *(f"emission[{a}]" for a in draws.protocol.emission_actions),
    )
    if name not in known:
        raise located("block of the tables", name, one_of(known))
    table, _, action = name.rstrip("]").partition("[")
    values = getattr(draws, table)
    if action:
        names: Sequence[str] = (
            draws.protocol.action_names if table == "transition" else draws.protocol.emission_actions
        )
        values = values[:, names.index(action)]
    return np.ascontiguousarray(values[..., :-1].reshape(draws.n_draws, -1))


@dataclass(frozen=True)
class Terms:
    """The terms of a regression on one block, ready for any number of plans.

    Attributes
    ----------
    centre, scale : float64[f]
        Of the features.
    order : int
        0: linear; 1: with squares; 2: with products as well.
    middle : float64[t]
        Means of the terms.
    weight : float64[n]
        Of the draws in use, summing to one.
    used : int64[n]
        Which draws those are.
    rows : float64[n, t]
        Terms less their means, times the root of the weight.
    squares : float64[q]
        Squares of their singular values.
    basis : float64[t, q]
        Directions that go with them.
    """

    centre: Array
    scale: Array
    order: int
    middle: Array
    weight: Array
    used: NDArray[np.int64]
    rows: Array
    squares: Array
    basis: Array

    @classmethod
    def of(cls, features: Array, weight: Array) -> Terms:
        """Terms of the draws that have weight.

        Parameters
        ----------
        features : float64[u, f]
        weight : float64[u]
        """
        used = np.flatnonzero(weight > 0)
        x, w = features[used], weight[used] / weight[used].sum()
        centre = w @ x
        scale = np.sqrt(w @ (x - centre) ** 2)
        scale = np.where(scale > VARIES, scale, 1.0)
        f = x.shape[1]
        sizes = (f, 2 * f, 2 * f + f * (f - 1) // 2)
        order = max((k for k in (1, 2) if sizes[k] * DRAWS_A_TERM <= len(used)), default=0)
        terms = _terms((x - centre) / scale, order)
        middle = w @ terms
        rows = np.sqrt(w * len(used))[:, None] * (terms - middle)
        # The penalised fit needs no more than squares of singular values, and they are cheaper by far.
        squares, basis = np.linalg.eigh(rows.T @ rows)
        keep = squares > SMALLEST * max(float(squares.max(initial=0.0)), 1e-300)
        return cls(centre, scale, order, middle, w, used, rows, squares[keep], basis[:, keep])

    def fit(self, worth: Array) -> Smoother:
        """Regress the worth of plans, shape ``[u, p]``, each with a penalty of its own."""
        n, y = len(self.used), worth[self.used]
        intercept = self.weight @ y
        target = np.sqrt(self.weight * n)[:, None] * (y - intercept)
        singular = np.sqrt(self.squares)
        along = self.basis.T @ (self.rows.T @ target) / singular[:, None]
        rest = np.maximum((target**2).sum(axis=0) - (along**2).sum(axis=0), 0.0)
        shrink = self.squares / (self.squares + PENALTIES[:, None] * n / 100)  # [penalty, direction]
        missed = rest + (1 - shrink) ** 2 @ along**2  # [penalty, plan]
        freedom = np.maximum(n - 1 - shrink.sum(axis=1), 1e-9)
        best = np.argmin(missed / freedom[:, None] ** 2, axis=0)
        slope = self.basis @ (shrink[best].T / singular[:, None] * along)
        return Smoother(self.centre, self.scale, self.order, self.middle, intercept, slope)


@dataclass(frozen=True)
class Smoother:
    """Fitted regression of several plans' worth on the features of one block.

    Attributes
    ----------
    centre, scale, order, middle
        As in `Terms`.
    intercept : float64[p]
    slope : float64[t, p]
    """

    centre: Array
    scale: Array
    order: int
    middle: Array
    intercept: Array
    slope: Array

    def predict(self, features: Array) -> Array:
        """Smoothed worth of every plan in every draw, shape ``[u, p]``."""
        terms = _terms((features - self.centre) / self.scale, self.order)
        return np.asarray(self.intercept + (terms - self.middle) @ self.slope)


def _terms(z: Array, order: int) -> Array:
    """Features, their squares and their products."""
    parts = [z]
    if order >= 1:
        parts.append(z**2)
    if order >= 2:
        i, j = np.triu_indices(z.shape[1], 1)
        parts.append(z[:, i] * z[:, j])
    return np.hstack(parts)
