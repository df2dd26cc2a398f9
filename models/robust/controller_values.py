r"""The value matrix without horizon, :math:`V_i(\pi_p)`: every controller of a pool in every draw."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass

import numpy as np

from models.errors import located
from models.planning.arrays import Array
from models.planning.latent import LatentBatch
from models.robust.controllers import Controller
from models.robust.elimination import Elimination, controller_values, elimination
from models.spread_out import chunks, spread_out

CHUNK = 64
"""Draws side by side: a controller's blocks of so many draws stay in the processor's cache."""


@dataclass(frozen=True)
class ValueMatrix:
    """Values of controllers in draws.

    Attributes
    ----------
    values : float64[p, d]
        In the unit of the reward, before the first mode is seen.
    error : float
        They are off by no more than that, from rounding.
    """

    values: Array
    error: float


def value_matrix(
    batch: LatentBatch, controllers: Sequence[Controller], executor: Executor | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> ValueMatrix:  # fmt: skip
    """Evaluate controllers in every draw of a batch.

    Parameters
    ----------
    batch : LatentBatch
    controllers : sequence of Controller
    executor : concurrent.futures.Executor, optional
        What draws are spread over; threads of this process by default.
    progress : callable, optional
        Called with pieces done and pieces in all.

    Raises
    ------
    InputError
        On a discount of 1, or a controller that cannot start where the batch starts.
    """
    if not 0 <= batch.discount < 1:
        raise located("discount of the batch", batch.discount, "from 0 to below 1: there is no horizon")
    t, n = batch.template, batch.draws.n_states
    for controller in controllers:
        missing = np.flatnonzero((batch.process.start > 0) & (controller.start < 0))
        if missing.size:
            mode = batch.draws.protocol.modes[int(missing[0])].name
            raise located(
                f"controller {controller.name}, start node in mode {mode}", -1, "a node: runs begin there"
            )
    if not controllers:
        return ValueMatrix(np.zeros((0, len(batch))), 0.0)
    plans = [elimination(t, controller) for controller in controllers]
    joint = batch.values.reshape(len(batch), -1, n, n)
    pieces = [
        (plans, np.ascontiguousarray(np.moveaxis(joint[span], 0, -1)), t.reward, batch.discount,
         np.ascontiguousarray(batch.draws.initial[span].T), batch.process.start)
        for span in chunks(len(batch), CHUNK)
    ]  # fmt: skip
    parts = spread_out(executor, _evaluate, pieces, progress)
    residual = max(part[1] for part in parts)
    return ValueMatrix(np.concatenate([part[0] for part in parts], axis=1), residual / (1 - batch.discount))


def _evaluate(piece: tuple[list[Elimination], Array, Array, float, Array, Array]) -> tuple[Array, float]:
    """Values of all controllers in some draws, and the largest residual."""
    plans, joint, reward, discount, initial, starts = piece
    values = np.empty((len(plans), initial.shape[1]))
    worst = 0.0
    for p, plan in enumerate(plans):
        worst = max(worst, controller_values(joint, reward, discount, initial, starts, plan, values[p]))
    return values, worst
