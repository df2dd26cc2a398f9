"""Planning by brute force: every history, every action, nothing remembered."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models.planning.problem import Problem


def horizon_value(problem: Problem, horizon: int) -> float:
    """Best expected discounted reward of `horizon` steps, before the first mode is seen."""
    return sum(p * value(problem, x, belief, horizon) for x, p, belief in problem.starts())


def value(problem: Problem, mode: int, belief: NDArray[np.float64], horizon: int) -> float:
    """Best expected discounted reward of `horizon` steps from a belief."""
    return max(action_values(problem, mode, belief, horizon)) if horizon else 0.0


def action_values(problem: Problem, mode: int, belief: NDArray[np.float64], horizon: int) -> list[float]:
    """The same for each action taken first."""
    return [
        float(belief @ choice.reward)
        + problem.discount
        * sum(p * value(problem, x, after, horizon - 1) for x, _, p, after in problem.outcomes(mode, c, belief))
        for c, choice in enumerate(problem.choices[mode])
    ]
