"""Values without horizon by every way to solve the linear system, against SuperLU and against each other."""

import time

import numpy as np
import pytest
from scipy import sparse
from scipy.sparse.linalg import spsolve

from models.errors import InputError
from models.planning import finite_memory
from models.planning.controller import controller_of
from models.planning.finite_memory import infinite_value
from models.planning.solver import solve
from models.planning.textbook import textbook_problem
from tests.models.planning.policy_cases import policy, problem


@pytest.mark.parametrize(
    "limits", [{"MOST_WORK": 0}, {"MOST_WORK": 0, "MOST_FILL": 0}, {}, {"MOST_WORK": 0, "MOST_SWEEPS": 1}]
)
def test_every_way_to_solve_gives_the_same(limits, monkeypatch):
    """As a band, as a sum of few or of all terms, and factorised after a sum that took too long."""
    direct = infinite_value(policy("controller"), problem())
    for name, value in {"MOST_SMALL": 0, **limits}.items():
        monkeypatch.setattr(finite_memory, name, value)
    found = infinite_value(policy("controller"), problem())
    assert found.value == pytest.approx(direct.value, rel=1e-10)
    assert abs(found.value - direct.value) <= found.error + direct.error + 1e-12
    assert found.frequencies == pytest.approx(direct.frequencies, rel=1e-9)


def chain(kind, rng, size=1500):
    """A Markov chain that stays near, stays near but for its numbering, goes anywhere, or hardly ever moves."""
    near = np.clip(np.arange(size)[:, None] + rng.integers(-3, 4, (size, 4)), 0, size - 1)
    ends = near if kind in ("near", "renumbered") else rng.integers(0, size, (size, 4))
    share = rng.dirichlet(np.ones(4), size) * (1e-4 if kind == "sticky" else 1)
    table = sparse.csr_array((share.ravel(), (np.repeat(np.arange(size), 4), ends.ravel())), shape=(size, size))
    if kind == "sticky":
        table = (table + (1 - 1e-4) * sparse.eye_array(size)).tocsr()
    order = rng.permutation(size)
    return table[order][:, order] if kind == "renumbered" else table


@pytest.mark.parametrize("kind", ["near", "renumbered", "anywhere", "sticky"])
@pytest.mark.parametrize("discount", [0.0, 0.9, 0.9999])
def test_large_systems(kind, discount):
    """Against SuperLU's own choice of everything; no way takes long, no error is larger than said."""
    rng = np.random.default_rng(4)
    step, known = chain(kind, rng), rng.normal(size=1500)
    begin = time.process_time()
    v, error = finite_memory._solve(step, known, discount)
    visits, _ = finite_memory._solve(step.T.tocsr(), np.full(1500, 1 / 1500), discount)
    assert time.process_time() - begin < 10
    wanted = known if discount == 0 else spsolve((sparse.eye_array(1500) - discount * step).tocsc(), known)
    assert np.abs(v - wanted).max() <= error + 1e-9 * np.abs(wanted).max()
    assert error <= 1e-8 * np.abs(wanted).max()
    assert visits.sum() * (1 - discount) == pytest.approx(1, rel=1e-9)


def test_beliefs_are_said_to_be_no_finite_memory():
    """One that rules out a state the problem could be in, if it had not begun where it did; compiled it can be."""
    turn = np.array([[0.0, 1.0], [1.0, 0.0]])
    clock = textbook_problem([turn], [np.eye(2)], [[0.0, 1.0]], 0.5, [1.0, 0.0])
    solution = solve(clock)
    with pytest.raises(InputError, match=r"memory: found beliefs, .* compile it to a controller"):
        infinite_value(solution.policy, clock)
    assert infinite_value(controller_of(solution.policy), clock).value == pytest.approx(2 / 3)


def test_a_full_table_is_not_factorised(monkeypatch):
    """Its factors would have as many entries as the square of the unknowns."""
    size = 1500
    step = sparse.csr_array(np.random.default_rng(2).dirichlet(np.ones(size), size))
    monkeypatch.setattr(finite_memory, "MOST_FILL", size**2 // 2)
    monkeypatch.setattr(finite_memory, "splu", None)
    _, error = finite_memory._solve(step, np.arange(size) / size, 0.99)
    assert error < 1e-9


def test_discount_zero_with_many_unknowns_is_the_first_reward(monkeypatch):
    monkeypatch.setattr(finite_memory, "MOST_SMALL", 0)
    world = problem().with_discount(0.0)
    found = infinite_value(policy("reactive"), world)
    assert found.error == 0
    assert found.value == pytest.approx(horizon_one(policy("reactive"), world))


def horizon_one(p, world):
    return sum(
        weight * share * float(belief @ world.choices[x][c].reward)
        for x, weight, belief in world.starts()
        for c, share in enumerate(p.probabilities(p.begin(x)))
    )
