"""Where an outcome begins to be possible."""

import numpy as np
import pytest

from models.planning.arrays import arrays_of
from models.planning.problem import Branch, Choice, Problem, csr
from models.planning.step_kernel import POSSIBLE, successors


@pytest.mark.parametrize(("p", "possible"), [(2 * POSSIBLE, True), (POSSIBLE, False), (0.5 * POSSIBLE, False)])
def test_where_an_outcome_begins_to_be_possible(p, possible):
    shows = csr([[1.0, p], [1.0, p]])
    problem = Problem(
        ("m",), (("a", "b"),), ((Choice("look", np.zeros(2), (Branch(0, csr(np.eye(2)), (0, 1), shows),)),),),
        ("usual", "hardly ever"), (np.array([1.0, 0.0]),), 0.9,
    )  # fmt: skip
    after, probability = np.full((2, 2), 7.0), np.full(2, 7.0)
    successors(arrays_of(problem), 0, np.array([1.0, 0.0]), 2, after, probability, np.zeros(2))
    assert probability.tolist() == [1.0, p if possible else 0.0]
    assert after.tolist() == [[1.0, 0.0], [float(possible), 0.0]]
