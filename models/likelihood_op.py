"""The likelihood kernel as a PyTensor Op: value and exact gradient in one pass, compiled into PyTensor's graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytensor.tensor as pt
from pytensor.gradient import DisconnectedType, disconnected_type
from pytensor.graph.basic import Apply, Variable
from pytensor.graph.op import Op
from pytensor.link.numba.dispatch.basic import register_funcify_and_cache_key

from models.compiled import kernel, kernel_digest
from models.forward_backward import sweep
from models.histories import HistoryTree, TreeArrays
from models.parameters import Layout


class HistoryLogLikelihood(Op):
    """Weighted log-likelihood of a prefix tree of histories.

    Inputs are the tables ``initial[s]``, ``transition[a, s, s']``, ``emission[e, s, o]``, then the emission index
    and the five arrays of the tree, so that one compiled graph serves every study of the same shape. Outputs
    are the log-likelihood and its gradient with respect to the three tables; only the first output can be
    differentiated.
    """

    __props__ = ()

    def make_node(self, *inputs: Any) -> Apply:
        """Check ranks and name the outputs."""
        variables = [pt.as_tensor_variable(i) for i in inputs]
        ranks = (1, 3, 3, 1, 1, 1, 1, 1, 1)
        if tuple(v.ndim for v in variables) != ranks:
            raise TypeError(
                f"HistoryLogLikelihood wants inputs of ranks {ranks}, got {[v.ndim for v in variables]}"
            )
        variables[:3] = [v.astype("float64") for v in variables[:3]]
        outputs = [pt.dscalar(), *(v.type() for v in variables[:3])]
        return Apply(self, variables, outputs)

    def perform(self, node: Apply, inputs: Sequence[Any], outputs: Sequence[list[Any]]) -> None:
        """Evaluate without PyTensor's compiler (the kernel itself is compiled either way)."""
        results = _evaluate(*(np.ascontiguousarray(i) for i in inputs))
        for storage, result in zip(outputs, results, strict=True):
            storage[0] = np.asarray(result)

    def pullback(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], cotangents: Sequence[Variable]
    ) -> list[Variable]:
        """Gradient of the first output: the other three outputs times its cotangent."""
        if not all(isinstance(c.type, DisconnectedType) for c in cotangents[1:]):
            raise NotImplementedError("second derivatives of the history likelihood")
        tables = [pt.mul(cotangents[0], g) for g in outputs[1:]]
        return [*tables, *(disconnected_type() for _ in inputs[3:])]

    def connection_pattern(self, node: Apply) -> list[list[bool]]:
        """Tables reach every output; the data reach none through a gradient."""
        return [[True] * 4] * 3 + [[False] * 4] * 6


@kernel
def _evaluate(  # type: ignore[no-untyped-def]
    initial, transition, emission, emission_index, first_child, n_children, action, response, ends
):
    nodes, states = len(action), len(initial)
    g_initial = np.zeros_like(initial)
    g_transition = np.zeros_like(transition)
    g_emission = np.zeros_like(emission)
    tree = TreeArrays(first_child, n_children, action, response, ends)
    value = sweep(
        tree, initial, transition, emission, emission_index, g_initial, g_transition, g_emission,
        np.empty((2, nodes, states)), np.empty((2, nodes)),
    )  # fmt: skip
    return np.asarray(value), g_initial, g_transition, g_emission


@register_funcify_and_cache_key(HistoryLogLikelihood)
def _compiled(op: HistoryLogLikelihood, node: Apply, **kwargs: Any) -> tuple[Any, str]:
    return _evaluate, f"prosocial-history-likelihood-{kernel_digest()}"


def log_likelihood(tree: HistoryTree, layout: Layout, initial: Any, transition: Any, emission: Any) -> Variable:
    """Symbolic log-likelihood of a tree under symbolic tables."""
    arrays = [pt.as_tensor_variable(a) for a in (layout.emission_index, *tree.arrays)]
    outputs = HistoryLogLikelihood().make_node(initial, transition, emission, *arrays).outputs
    return outputs[0]
