"""A policy and the proof of how good it is."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from models.notebook_view import NotebookView, View
from models.planning.arrays import Array, Index
from models.planning.precision import relative_gap
from models.planning.problem import Problem

if TYPE_CHECKING:
    from models.planning.alpha_policy import AlphaPolicy

Status = Literal["converged", "time limit", "memory limit", "stalled", "interrupted"]


@dataclass(frozen=True)
class TracePoint:
    """Bounds at one moment: seconds of work, bounds, method, and how much it holds."""

    seconds: float
    lower: float
    upper: float
    method: str
    beliefs: int
    vectors: int


@dataclass(frozen=True)
class Solution(NotebookView):
    r"""A policy and a proof of how good it is: :math:`\underline V \le V^\pi \le V^* \le \bar V` at the start.

    Attributes
    ----------
    problem : Problem
    lower, upper : float
        Bounds of the optimal value; the policy is worth at least `lower`.
    status : str
        ``converged``, ``time limit``, ``memory limit``, ``stalled`` (rounds without progress), or ``interrupted``.
    precision : float
    relative : bool
        Whether `precision` is relative to the larger of the bounds' sizes (`models.planning.precision`).
    seconds, compile_seconds : float
        Wall time of the work, and of compiling or loading kernels.
    alpha : float64[k, w]
        Alpha vectors: values by hidden state.
    mode, choice : int64[k]
        Mode of each vector, and its choice, counted within the mode.
    follow : int32[k, z]
        The vector that follows each outcome of the choice (`models.planning.arrays`): the policy graph.
    beliefs : int
        Beliefs that were backed up.
    trace : tuple of TracePoint
    """

    problem: Problem
    lower: float
    upper: float
    status: Status
    precision: float
    relative: bool
    seconds: float
    compile_seconds: float
    alpha: Array
    mode: Index
    choice: Index
    follow: NDArray[np.int32]
    beliefs: int
    trace: tuple[TracePoint, ...] = field(repr=False)

    @property
    def gap(self) -> float:
        """Upper less lower bound."""
        return self.upper - self.lower

    @property
    def relative_gap(self) -> float:
        """Gap as a share of the larger bound's size (`models.planning.precision`)."""
        return relative_gap(self.lower, self.upper, self.problem.least_size)

    @property
    def alpha_vectors(self) -> int:
        """Number of alpha vectors."""
        return len(self.alpha)

    @cached_property
    def policy(self) -> AlphaPolicy:
        """The policy of the lower bound."""
        from models.planning.alpha_policy import AlphaPolicy

        return AlphaPolicy(self.problem, self.alpha, self.mode, self.choice, self.follow)

    @property
    def sentence(self) -> str:
        """The certificate in words."""
        text = (
            f"{self.problem.name}: the optimal value lies between {self.lower:.6g} and {self.upper:.6g} "
            f"(gap {self.gap:.3g}, {100 * self.relative_gap:.3g}%); the policy is worth at least the former"
        )
        if self.status == "converged":
            return text + "."
        kind = "relative" if self.relative else "absolute"
        return f"{text}. Not solved to the {kind} gap of {self.precision:g}: {self.status}."

    def _view(self) -> View:
        warnings = () if self.status == "converged" else (f"not solved to the precision asked for: {self.status}.",)
        return View("Solution", "", warnings, (), (self.sentence,))
