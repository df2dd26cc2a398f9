r"""PyMC's map from unconstrained coordinates to rows of probabilities, as one Op.

PyMC writes :math:`p = \mathrm{softmax}(x_1, ..., x_{n-1}, -\sum x)` and its log-Jacobian
:math:`\log n + \sum_i \log p_i` as a dozen elementwise operations a row, each of which is compiled by itself. This
is the same map in one compiled function and one for its gradient; a model's compilation takes half the time.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytensor.tensor as pt
from pymc.logprob.transforms import SimplexTransform
from pytensor.gradient import DisconnectedType
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.op import Op
from pytensor.link.numba.dispatch.basic import register_funcify_and_cache_key

from models.compiled import kernel, kernel_digest


class SimplexRows(Op):
    """``x[row, n - 1]`` to ``p[row, n]`` and the log-Jacobian ``[row]``."""

    __props__ = ()

    def make_node(self, x: Any) -> Apply:  # type: ignore[override]
        """Name the outputs."""
        x = pt.as_tensor_variable(x).astype("float64")
        rows, width = x.type.shape
        wide = None if width is None else width + 1
        return Apply(
            self, [x], [pt.tensor(dtype="float64", shape=(rows, wide)), pt.tensor(dtype="float64", shape=(rows,))]
        )

    def perform(self, node: Apply, inputs: Sequence[Any], outputs: Sequence[list[Any]]) -> None:
        """Evaluate without PyTensor's compiler."""
        outputs[0][0], outputs[1][0] = _rows(np.ascontiguousarray(inputs[0]))

    def pullback(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], cotangents: Sequence[Variable]
    ) -> list[Variable]:
        """Gradient by `SimplexRowsPullback`."""
        given = [
            pt.zeros_like(output) if isinstance(cotangent.type, DisconnectedType) else cotangent
            for output, cotangent in zip(outputs, cotangents, strict=True)
        ]
        return SimplexRowsPullback().make_node(outputs[0], *given).outputs


class SimplexRowsPullback(Op):
    """Gradient of `SimplexRows` from its probabilities and the gradients of both outputs."""

    __props__ = ()

    def make_node(self, *inputs: Any) -> Apply:
        """Name the output."""
        given = [pt.as_tensor_variable(v).astype("float64") for v in inputs]
        rows, width = given[0].type.shape
        narrow = None if width is None else width - 1
        return Apply(self, given, [pt.tensor(dtype="float64", shape=(rows, narrow))])

    def perform(self, node: Apply, inputs: Sequence[Any], outputs: Sequence[list[Any]]) -> None:
        """Evaluate without PyTensor's compiler."""
        outputs[0][0] = _pull_back(*(np.ascontiguousarray(i) for i in inputs))


@kernel
def _rows(x):  # type: ignore[no-untyped-def]
    rows, n = x.shape[0], x.shape[1] + 1
    p = np.empty((rows, n))
    log_jacobian = np.empty(rows)
    for r in range(rows):
        last, largest = 0.0, -np.inf
        for i in range(n - 1):
            last -= x[r, i]
            largest = max(largest, x[r, i])
        largest = max(largest, last)
        total = np.exp(last - largest)
        logs = last
        p[r, n - 1] = total
        for i in range(n - 1):
            p[r, i] = np.exp(x[r, i] - largest)
            total += p[r, i]
            logs += x[r, i]
        for i in range(n):
            p[r, i] /= total
        # The coordinates sum to zero, so the sum of log p is n times the normaliser.
        log_jacobian[r] = np.log(n) + logs - n * (largest + np.log(total))
    return p, log_jacobian


@kernel
def _pull_back(p, g_p, g_log_jacobian):  # type: ignore[no-untyped-def]
    rows, n = p.shape
    out = np.empty((rows, n - 1))
    for r in range(rows):
        mean = 0.0
        for i in range(n):
            mean += p[r, i] * g_p[r, i]
        tail = p[r, n - 1] * (g_p[r, n - 1] - mean) + g_log_jacobian[r] * (1.0 - n * p[r, n - 1])
        for i in range(n - 1):
            own = p[r, i] * (g_p[r, i] - mean) + g_log_jacobian[r] * (1.0 - n * p[r, i])
            out[r, i] = own - tail
    return out


@register_funcify_and_cache_key(SimplexRows)
def _compiled(op: SimplexRows, node: Apply, **kwargs: Any) -> tuple[Any, str]:
    return _rows, f"prosocial-simplex-{kernel_digest('models.simplex_op')}"


@register_funcify_and_cache_key(SimplexRowsPullback)
def _compiled_pullback(op: SimplexRowsPullback, node: Apply, **kwargs: Any) -> tuple[Any, str]:
    return _pull_back, f"prosocial-simplex-pullback-{kernel_digest('models.simplex_op')}"


class RowsTransform(SimplexTransform):
    """PyMC's simplex transform by `SimplexRows`; same coordinates, same density."""

    def _both(self, value: Any) -> tuple[Any, Any]:
        value = pt.as_tensor(value)
        width = value.type.shape[-1]
        lead = [value.shape[i] for i in range(value.ndim - 1)]
        outputs: list[Any] = SimplexRows().make_node(value.reshape((-1, width))).outputs
        p, log_jacobian = outputs
        if not lead:
            return p[0], log_jacobian[0]
        return p.reshape((*lead, width + 1)), log_jacobian.reshape(lead)

    def backward(self, value: Any, *inputs: Any) -> Any:
        """Coordinates to probabilities."""
        return self._both(value)[0]

    def log_jac_det(self, value: Any, *inputs: Any) -> Any:
        """Log-Jacobian of each row."""
        return self._both(value)[1]


def rows_transform(states: int) -> RowsTransform | SimplexTransform:
    """Transform of rows of this width; one entry has no coordinate and is left to PyMC."""
    return RowsTransform() if states > 1 else SimplexTransform()
