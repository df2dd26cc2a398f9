"""The likelihood kernels as PyTensor Ops: value and exact gradient in one pass, compiled into PyTensor's graph."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, ClassVar

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
from models.people_kernel import NOBODY, PeopleArrays, people_sweep


class _KernelOp(Op):
    """A kernel that returns the log-likelihood and its gradient with respect to its first inputs.

    Data are inputs too, so that one compiled graph serves every study of the same shape. Only the first output
    can be differentiated.
    """

    __props__ = ()
    ranks: ClassVar[tuple[int, ...]]
    """Rank of every input: parameters first, then data."""
    parameters: ClassVar[int]
    evaluate: ClassVar[Any]

    def make_node(self, *inputs: Any) -> Apply:
        """Check ranks and name the outputs."""
        variables = [pt.as_tensor_variable(i) for i in inputs]
        if tuple(v.ndim for v in variables) != self.ranks:
            raise TypeError(
                f"{type(self).__name__} wants inputs of ranks {self.ranks}, got {[v.ndim for v in variables]}"
            )
        n = self.parameters
        variables[:n] = [v.astype("float64") for v in variables[:n]]
        outputs = [pt.dscalar(), *(v.type() for v in variables[:n])]
        return Apply(self, variables, outputs)

    def perform(self, node: Apply, inputs: Sequence[Any], outputs: Sequence[list[Any]]) -> None:
        """Evaluate without PyTensor's compiler (the kernel itself is compiled either way)."""
        results = type(self).evaluate(*(np.ascontiguousarray(i).reshape(np.shape(i)) for i in inputs))
        for storage, result in zip(outputs, results, strict=True):
            storage[0] = np.asarray(result)

    def pullback(
        self, inputs: Sequence[Variable], outputs: Sequence[Variable], cotangents: Sequence[Variable]
    ) -> list[Variable]:
        """Gradient of the first output: the other outputs times its cotangent."""
        if not all(isinstance(c.type, DisconnectedType) for c in cotangents[1:]):
            raise NotImplementedError("second derivatives of the history likelihood")
        slopes = [pt.mul(cotangents[0], g) for g in outputs[1:]]
        return [*slopes, *(disconnected_type() for _ in inputs[self.parameters :])]

    def connection_pattern(self, node: Apply) -> list[list[bool]]:
        """Parameters reach every output; the data reach none through a gradient."""
        n, outputs = self.parameters, self.parameters + 1
        return [[True] * outputs] * n + [[False] * outputs] * (len(self.ranks) - n)


@kernel
def _evaluate(  # type: ignore[no-untyped-def]
    initial, transition, emission, emission_index, first_child, n_children, action, response, ends
):
    nodes, states = len(action), initial.shape[1]
    g_initial = np.zeros_like(initial)
    g_transition = np.zeros_like(transition)
    g_emission = np.zeros_like(emission)
    tree = TreeArrays(first_child, n_children, action, response, ends)
    value = sweep(
        tree, initial, transition, emission, emission_index, g_initial, g_transition, g_emission,
        np.empty((2, nodes, states)), np.empty((2, nodes)),
    )  # fmt: skip
    return np.asarray(value), g_initial, g_transition, g_emission


@kernel
def _evaluate_people(  # type: ignore[no-untyped-def]
    initial, transition, emission, spread, emission_index, first_child, n_children, action, response, ends,
    offset, node, count, z, log_weight, scores,
):  # fmt: skip
    g_initial = np.zeros_like(initial)
    g_transition = np.zeros_like(transition)
    g_emission = np.zeros_like(emission)
    tree = TreeArrays(first_child, n_children, action, response, ends)
    people = PeopleArrays(offset, node, count, z, log_weight, scores, np.ones(1))
    value, g_spread = people_sweep(
        tree,
        people,
        initial,
        transition,
        emission,
        emission_index,
        spread.item(),
        g_initial,
        g_transition,
        g_emission,
    )
    return np.asarray(value), g_initial, g_transition, g_emission, np.asarray(g_spread)


class HistoryLogLikelihood(_KernelOp):
    """Weighted log-likelihood of a prefix tree of histories.

    Inputs: ``initial[g, s]``, ``transition[a, s, s']``, ``emission[e, s, o]``; the emission index and the five
    arrays of the tree.
    """

    ranks = (2, 3, 3, 1, 1, 1, 1, 1, 1)
    parameters = 3
    evaluate = staticmethod(_evaluate)


class PeopleLogLikelihood(_KernelOp):
    """The same where people differ: sigma is a parameter more; distinct people and quadrature are data."""

    ranks = (2, 3, 3, 0, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1)
    parameters = 4
    evaluate = staticmethod(_evaluate_people)


@register_funcify_and_cache_key(HistoryLogLikelihood)
def _compiled(op: HistoryLogLikelihood, node: Apply, **kwargs: Any) -> tuple[Any, str]:
    return _evaluate, f"prosocial-history-likelihood-{kernel_digest('models.likelihood_op')}"


@register_funcify_and_cache_key(PeopleLogLikelihood)
def _compiled_people(op: PeopleLogLikelihood, node: Apply, **kwargs: Any) -> tuple[Any, str]:
    return _evaluate_people, f"prosocial-people-likelihood-{kernel_digest('models.likelihood_op')}"


def log_likelihood(
    tree: HistoryTree, layout: Layout, initial: Any, transition: Any, emission: Any, spread: Any = None,
    people: PeopleArrays = NOBODY,
) -> Variable:  # fmt: skip
    """Symbolic log-likelihood of a tree under symbolic tables.

    Parameters
    ----------
    tree : HistoryTree
    layout : Layout
    initial, transition, emission
        ``[g, s]`` (or ``[s]``), ``[g * a, s, s']``, ``[g * e, s, o]``.
    spread : scalar, optional
        Sigma, where people differ.
    people : PeopleArrays
    """
    initial = pt.as_tensor_variable(initial)
    if initial.ndim == 1:
        initial = initial[None, :]
    arrays = [pt.as_tensor_variable(a) for a in (layout.emission_index, *tree.arrays)]
    if spread is None:
        return HistoryLogLikelihood().make_node(initial, transition, emission, *arrays).outputs[0]
    more = [pt.as_tensor_variable(a) for a in people[:-1]]
    return PeopleLogLikelihood().make_node(initial, transition, emission, spread, *arrays, *more).outputs[0]
