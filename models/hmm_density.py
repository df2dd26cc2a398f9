r"""Log-posterior of the latent-state model on unconstrained coordinates, with its exact gradient, compiled.

Every probability row that is sampled is mapped from unconstrained coordinates the way PyMC maps it, so that this
density equals the PyMC model's to rounding:

- *simplex* rows (Dirichlet): :math:`p = \mathrm{softmax}(x_1, ..., x_{n-1}, -\sum x)`, whose log-Jacobian is
  :math:`\log n + \sum_i \log p_i`;
- *logit* rows (Beta on the response with the higher score, where there are two responses):
  :math:`p = 1 / (1 + e^{-x})`, log-Jacobian :math:`\log p + \log(1 - p)`.

With Dirichlet parameters :math:`\alpha` prior and Jacobian together are :math:`\sum_i \alpha_i \log p_i` plus a
constant.

Two extensions enter through the same vector: tables that differ between groups of people (`models.groups`) and an
offset of each person (`models.person_offset`), whose standard deviation sigma has a half-normal prior and the
coordinate :math:`\log\sigma`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray
from scipy.special import gammaln

from models.compiled import kernel
from models.em_kernel import em
from models.errors import located
from models.forward_backward import sweep
from models.histories import HistoryTree, TreeArrays
from models.parameters import Array, Layout, checked_pins
from models.people_kernel import NOBODY, PeopleArrays, people_sweep

SIMPLEX, LOGIT = 0, 1

START_TRIES, START_MAPS = 10, 50
"""Prior draws tried for the start of a chain, and EM maps spent on each."""


class RowPlan(NamedTuple):
    """Where each sampled row sits in theta and in the unconstrained vector.

    Attributes
    ----------
    start, width : int64[rows]
        Slice of the row in theta.
    kind : int64[rows]
        `SIMPLEX` or `LOGIT`.
    top : int64[rows]
        For `LOGIT` rows the entry of theta that the coordinate drives up.
    offset : int64[rows]
        First coordinate of the row.
    """

    start: NDArray[np.int64]
    width: NDArray[np.int64]
    kind: NDArray[np.int64]
    top: NDArray[np.int64]
    offset: NDArray[np.int64]


class StudyArrays(NamedTuple):
    """All that the compiled density reads.

    Attributes
    ----------
    tree : TreeArrays
    sizes : tuple of int
        States, actions, emission tables, responses; actions and tables over all groups.
    emission_index : int64[actions]
    entry : int64[full]
        Place in theta of every entry of the full tables.
    plan : RowPlan
    alpha, template : float64[theta]
        Dirichlet parameters; theta with the pinned tables filled in. The last entry is sigma where people differ.
    people : PeopleArrays or ()
        Empty where people do not differ: the compiler then leaves their likelihood out.
    unit : tuple of int
        Empty, or a zero a state: `models.forward_backward.forward`.
    """

    tree: TreeArrays
    sizes: tuple[int, int, int, int]
    emission_index: NDArray[np.int64]
    entry: NDArray[np.int64]
    plan: RowPlan
    alpha: Array
    template: Array
    people: PeopleArrays | tuple[()]
    unit: tuple[int, ...] = ()


@dataclass(frozen=True)
class HmmDensity:
    """The posterior of one study as a function of an unconstrained vector.

    Attributes
    ----------
    tree : HistoryTree
    layout : Layout
        A `GroupedLayout` (with the tree of the same groups) lets tables differ between groups.
    alpha : float64[theta]
        Dirichlet (Beta) parameters of every entry, of one group; those of pinned tables are not used.
    pins : mapping
        Transition tables held fixed.
    people : PeopleArrays
        Distinct people and the quadrature over their offsets; `NOBODY` where people do not differ.
    """

    tree: HistoryTree
    layout: Layout
    alpha: Array
    pins: Mapping[str, Array | None]
    people: PeopleArrays = NOBODY

    def __post_init__(self) -> None:
        size = self.layout.base.size
        if self.alpha.shape != (size,):
            raise located("prior, parameters", self.alpha.shape, f"({size},)")
        usable = np.isfinite(self.alpha) & (self.alpha > 0)
        if not np.all(usable):
            raise located("prior, parameters", float(self.alpha[~usable][0]), "finite positive numbers")

    @property
    def people_differ(self) -> bool:
        """Whether people have offsets; sigma is then the last entry of theta, its logarithm the last coordinate."""
        return len(self.people.z) > 0

    @cached_property
    def template(self) -> Array:
        """Theta with the pinned tables filled in."""
        theta = self.layout.base.uniform.copy()
        _, transition, _ = self.layout.base.unpack(theta)
        for action, table in checked_pins(self.layout, self.pins).items():
            transition[self.layout.protocol.action(action)] = table
        tied = self.layout.tied(theta)
        # The place of sigma holds the scale of its prior until a sigma is written there.
        return np.append(tied, self.people.prior_scale) if self.people_differ else tied

    @cached_property
    def arrays(self) -> StudyArrays:
        """What the kernels read."""
        layout = self.layout
        return StudyArrays(
            self.tree.arrays, layout.sizes, layout.emission_index, layout.index, self.plan,
            np.ascontiguousarray(layout.tied(self.alpha)), self.template, self.people if self.people_differ else (),
        )  # fmt: skip

    @cached_property
    def plan(self) -> RowPlan:
        """Sampled rows in the order initial, transition, emission."""
        free = self.layout.free_entries(checked_pins(self.layout, self.pins))
        scores = self.layout.protocol.scores
        columns: list[tuple[int, int, int, int, int]] = []
        offset = 0
        for kind, row in zip(self.layout.row_kinds, self.layout.rows, strict=True):
            width = row.stop - row.start
            if not free[row.start] or width == 1:
                continue
            logit = kind == "emission" and width == 2
            top = row.start + int(np.argmax(scores)) if logit else -1
            columns.append((row.start, width, LOGIT if logit else SIMPLEX, top, offset))
            offset += width - 1
        return RowPlan(*np.array(columns, dtype=np.int64).reshape(-1, 5).T.copy())

    @cached_property
    def dimension(self) -> int:
        """Number of unconstrained coordinates."""
        return int(np.sum(self.plan.width - 1)) + self.people_differ

    @cached_property
    def constant(self) -> float:
        """Normalising constants of priors and Jacobians, so the density is comparable between models."""
        total = 0.0
        alpha = self.arrays.alpha
        for start, width, kind, _, _ in zip(*self.plan, strict=True):
            a = alpha[start : start + width]
            total += float(gammaln(a.sum()) - gammaln(a).sum())
            if kind == SIMPLEX:
                total += float(np.log(width))
        if self.people_differ:
            total += float(0.5 * np.log(2.0 / np.pi) - np.log(self.people.prior_scale[0]))
        return total

    def theta(self, x: Array) -> Array:
        """Constrained parameters of an unconstrained point, in the layout's order."""
        theta = self.template.copy()
        constrain(np.ascontiguousarray(x, dtype=np.float64), self.arrays, theta)
        return theta

    def prior_point(self, seed: int | np.random.Generator | None) -> Array:
        """A draw from the prior, unconstrained."""
        rng = np.random.default_rng(seed)
        theta = self.template.copy()
        for start, width, *_ in zip(*self.plan, strict=True):
            p = rng.gamma(self.arrays.alpha[start : start + width]) + 1e-6
            theta[start : start + width] = p / p.sum()
        if self.people_differ:
            theta[-1] = self.people.prior_scale[0] * abs(rng.standard_normal()) + 1e-3
        return self.unconstrained(theta)

    def starting_point(self, seed: int | np.random.Generator | None) -> Array:
        """Where a chain starts: the best of `START_TRIES` prior draws after a few EM maps each, moved inside.

        Chains that start from the prior itself can stay for good around a lesser maximum, such as one in which
        the states have other labels under one action than under another.
        """
        rng = np.random.default_rng(seed)
        base = self.layout.base
        free = base.free_entries(checked_pins(base, self.pins))
        pseudo = np.maximum(self.alpha - 1.0, 0.0)
        template = base.uniform.copy()
        _, transition, _ = base.unpack(template)
        for action, table in checked_pins(base, self.pins).items():
            transition[base.protocol.action(action)] = table
        coded = self.tree.arrays.action
        pooled = self.tree.arrays._replace(action=np.where(coded < 0, -1, coded % base.protocol.n_actions))
        found = []
        for _ in range(START_TRIES):
            point = template.copy()
            for row in base.rows:
                if free[row.start]:
                    p = rng.gamma(self.alpha[row]) + 1e-6
                    point[row] = p / p.sum()
            theta, trace, *_ = em(
                point, pooled, base.sizes, base.emission_index, pseudo, free, START_MAPS, 0.0, START_MAPS + 1, True,
                np.zeros(1, dtype=np.uint8),
            )  # fmt: skip
            found.append((float(trace[-1]), theta))
        best = max(found, key=lambda pair: pair[0])[1]
        theta = self.layout.tied(np.where(free, 0.9 * best + 0.1 * base.uniform, best))
        if self.people_differ:
            theta = np.append(theta, self.people.prior_scale[0] * (0.2 + abs(rng.standard_normal())))
        return self.unconstrained(theta)

    def unconstrained(self, theta: Array) -> Array:
        """Inverse of `theta`, for starting points; every sampled entry must be positive."""
        x = np.empty(self.dimension)
        for start, width, kind, top, offset in zip(*self.plan, strict=True):
            p = theta[start : start + width]
            if not np.all(p > 0):
                raise located("starting point, probability", float(p.min()), "positive entries")
            if kind == LOGIT:
                # Both entries: one minus the other would be zero in the tails.
                x[offset] = np.log(theta[top]) - np.log(theta[2 * start + 1 - top])
            else:
                logs = np.log(p)
                x[offset : offset + width - 1] = (logs - logs.mean())[:-1]
        if self.people_differ:
            if not theta[-1] > 0:
                raise located("starting point, sigma", float(theta[-1]), "a positive number")
            x[-1] = np.log(theta[-1])
        return x

    def __call__(self, x: Array) -> tuple[float, Array]:
        """Log-density (priors, Jacobians and normalising constants included) and its gradient."""
        gradient = np.empty(self.dimension)
        value = log_density(np.ascontiguousarray(x, dtype=np.float64), gradient, self.arrays, 1.0)
        return value + self.constant, gradient


@kernel
def constrain(x, study, theta):  # type: ignore[no-untyped-def]
    """Write the sampled rows of theta, and sigma where people differ."""
    plan = study.plan
    if len(theta) > len(study.alpha):
        theta[-1] = np.exp(x[-1])
    for row in range(len(plan.start)):
        start, width, offset = plan.start[row], plan.width[row], plan.offset[row]
        if plan.kind[row] == LOGIT:
            value = x[offset]
            # Both tails without cancellation.
            high = 1.0 / (1.0 + np.exp(-value))
            low = 1.0 / (1.0 + np.exp(value))
            theta[plan.top[row]] = high
            theta[start if plan.top[row] == start + 1 else start + 1] = low
        else:
            last = 0.0
            largest = -np.inf
            for i in range(width - 1):
                last -= x[offset + i]
                largest = max(largest, x[offset + i])
            largest = max(largest, last)
            total = 0.0
            for i in range(width - 1):
                theta[start + i] = np.exp(x[offset + i] - largest)
                total += theta[start + i]
            theta[start + width - 1] = np.exp(last - largest)
            total += theta[start + width - 1]
            for i in range(start, start + width):
                theta[i] /= total


@kernel
def tables(full, sizes):  # type: ignore[no-untyped-def]
    """Views of the full vector: ``initial[g, s]``, ``transition[a, s, s']``, ``emission[e, s, o]``."""
    states, actions, emissions, responses = sizes
    first = len(full) - actions * states * states - emissions * states * responses
    second = len(full) - emissions * states * responses
    return (
        full[:first].reshape(first // states, states),
        full[first:second].reshape(actions, states, states),
        full[second:].reshape(emissions, states, responses),
    )


def _swept(  # type: ignore[no-untyped-def]
    people, study, initial, transition, emission, spread, g_initial, g_transition, g_emission
):
    """Log-likelihood and its derivative with respect to sigma, by the kernel that the model needs.

    Which one is decided by types, when callers are compiled: a plain model never waits for the other kernel.
    """
    sweeps = _people_swept if len(people) else _plainly_swept
    return sweeps(people, study, initial, transition, emission, spread, g_initial, g_transition, g_emission)


def _plainly_swept(  # type: ignore[no-untyped-def]
    people, study, initial, transition, emission, spread, g_initial, g_transition, g_emission
):
    nodes, states = len(study.tree.action), initial.shape[1]
    value = sweep(
        study.tree, initial, transition, emission, study.emission_index, g_initial, g_transition, g_emission,
        np.empty((2, nodes, states)), np.empty((2, nodes)), study.unit,
    )  # fmt: skip
    return value, 0.0


def _people_swept(  # type: ignore[no-untyped-def]
    people, study, initial, transition, emission, spread, g_initial, g_transition, g_emission
):
    return people_sweep(
        study.tree, people, initial, transition, emission, study.emission_index, spread, g_initial, g_transition,
        g_emission,
    )  # fmt: skip


@overload(_swept, jit_options={"nogil": True, "error_model": "numpy"})
def _choose_sweep(  # type: ignore[no-untyped-def]
    people, study, initial, transition, emission, spread, g_initial, g_transition, g_emission
):
    return _people_swept if len(people) else _plainly_swept


@kernel
def log_likelihood(study, theta, slope):  # type: ignore[no-untyped-def]
    """Log-likelihood at theta; its gradient is added into `slope`."""
    full = theta[study.entry]
    gradient = np.zeros(len(full))
    initial, transition, emission = tables(full, study.sizes)
    g_initial, g_transition, g_emission = tables(gradient, study.sizes)
    value, g_spread = _swept(
        study.people, study, initial, transition, emission, theta[-1], g_initial, g_transition, g_emission
    )
    slope[-1] += g_spread
    for i in range(len(full)):
        slope[study.entry[i]] += gradient[i]
    return value


@kernel
def log_density(x, gradient, study, temperature):  # type: ignore[no-untyped-def]
    """Log-density up to `HmmDensity.constant`; fills the gradient. The likelihood is raised to `temperature`."""
    plan, alpha = study.plan, study.alpha
    theta = study.template.copy()
    constrain(x, study, theta)
    slope = np.zeros(len(theta))
    value = 0.0
    if temperature > 0.0:
        value = temperature * log_likelihood(study, theta, slope)
    if len(theta) > len(alpha):
        # Half-normal prior of sigma; the coordinate is its logarithm.
        ratio = theta[-1] / study.template[-1]
        value += x[-1] - 0.5 * ratio * ratio
        gradient[-1] = theta[-1] * slope[-1] * temperature + 1.0 - ratio * ratio
    for row in range(len(plan.start)):
        start, width, offset = plan.start[row], plan.width[row], plan.offset[row]
        mean, total = 0.0, 0.0
        for i in range(start, start + width):
            mean += theta[i] * slope[i] * temperature
            total += alpha[i]
        if plan.kind[row] == LOGIT:
            top = plan.top[row]
            coordinate = x[offset]
            # log p and log(1 - p), exact in both tails.
            log_high = (
                -np.log1p(np.exp(-coordinate)) if coordinate > 0 else coordinate - np.log1p(np.exp(coordinate))
            )
            log_low = log_high - coordinate
            rest = 2 * start + 1 - top
            value += alpha[top] * log_high + alpha[rest] * log_low
            gradient[offset] = theta[top] * (slope[top] * temperature - mean) + alpha[top] - total * theta[top]
        else:
            last = 0.0
            largest = -np.inf
            for i in range(width - 1):
                last -= x[offset + i]
                largest = max(largest, x[offset + i])
            largest = max(largest, last)
            norm = np.exp(last - largest)
            for i in range(width - 1):
                norm += np.exp(x[offset + i] - largest)
            log_norm = largest + np.log(norm)
            end = start + width - 1
            value += alpha[end] * (last - log_norm)
            tail = theta[end] * (slope[end] * temperature - mean) + alpha[end] - total * theta[end]
            for i in range(width - 1):
                j = start + i
                value += alpha[j] * (x[offset + i] - log_norm)
                gradient[offset + i] = (
                    theta[j] * (slope[j] * temperature - mean) + alpha[j] - total * theta[j] - tail
                )
    return value
