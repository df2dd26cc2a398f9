"""`solve`: certificates that hold, whatever the form in which a problem is put."""

from dataclasses import replace

import numpy as np
import pytest

from models.planning.formats.end_state import flat, observed_end
from models.planning.latent import latent_problem
from models.planning.problem import Branch, Choice, Problem, csr
from models.planning.problems import problem as standard_problem
from models.planning.solver import solve
from models.planning.textbook import textbook_problem
from tests.planning_cases import (
    CASES,
    dense_problem,
    latent_case,
    modal_problem,
    mode_processes,
    sparse_problem,
    sticky_model,
)
from tests.reference import planning_numpy as reference

SECONDS = 3.0


def solved(problem, precision=1e-4, **options):
    return solve(problem, precision, time_limit=SECONDS, **options)


def agree(one, other, factor=1.0, shift=0.0):
    """Intervals overlap once the second is scaled and shifted."""
    slack = 1e-9 * max(1, abs(one.lower), abs(one.upper))
    assert one.lower <= factor * other.upper + shift + slack
    assert factor * other.lower + shift <= one.upper + slack


def graph_value(solution):
    """Value at the start of the solution's policy graph, started at the best vector: a linear solve of our own."""
    problem = solution.problem
    values = reference.controller_values(problem, solution.mode, solution.choice, solution.follow)
    total = 0.0
    for x, joint in enumerate(problem.initial):
        if joint.sum() > 0:
            total += max(joint @ v for v, m in zip(values, solution.mode, strict=True) if m == x)
    return total


def check(solution):
    """Everything a certificate promises."""
    lower = np.array([p.lower for p in solution.trace])
    upper = np.array([p.upper for p in solution.trace])
    size = max(abs(solution.lower), abs(solution.upper), 1.0)
    assert (np.diff(lower) >= 0).all()
    assert (np.diff(upper) <= 0).all()
    assert (lower <= upper + 1e-9 * size).all()
    assert (solution.lower, solution.upper) == (lower[-1], upper[-1])
    assert set(solution.mode) == set(range(solution.problem.n_modes))
    value = graph_value(solution)
    assert solution.lower - 1e-8 * size <= value <= solution.upper + 1e-8 * size
    if solution.status == "converged" and solution.relative:
        assert solution.relative_gap <= solution.precision
    return solution


@pytest.mark.parametrize("name", sorted(CASES))
def test_certificates_hold(name):
    solution = check(solved(CASES[name]))
    assert solution.status == "converged"
    assert "optimal value lies between" in solution.sentence
    if CASES[name].n_states > 2:
        low, high = reference.tree_interval(CASES[name], 4)
        assert solution.lower <= high + 1e-8
        assert solution.upper >= low - 1e-8


@pytest.mark.parametrize("seed", range(6))
def test_two_states_a_mode_against_plain_grids(seed):
    problem = modal_problem(100 + seed, ((2, 2), (2, 1, 2))[seed % 2])
    solution = check(solved(problem, 1e-5, relative=False))
    low, high = reference.line_interval(problem)
    assert solution.lower <= high + 1e-8
    assert solution.upper >= low - 1e-8
    assert high - low < 1e-3


@pytest.mark.parametrize("seed", range(2))
def test_sparse_problems(seed):
    solution = check(solve(sparse_problem(seed, 20 + 30 * seed), 0.02, time_limit=1.0))
    low, high = reference.tree_interval(solution.problem, 3)
    assert solution.lower <= high
    assert solution.upper >= low


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30))
def test_many_problems_against_plain_grids(seed):
    for sizes in ((2, 2), (2, 1, 2), (1, 2, 2, 2)):
        problem = modal_problem(1000 + seed, sizes, (0.7, 0.9, 0.95)[seed % 3])
        solution = check(solve(problem, 1e-5, time_limit=SECONDS))
        low, high = reference.line_interval(problem)
        assert solution.lower <= high + 1e-8
        assert solution.upper >= low - 1e-8


@pytest.mark.parametrize("name", sorted(CASES))
def test_no_policy_is_worth_more_than_the_upper_bound(name):
    problem = CASES[name]
    solution = solved(problem, 1e-3)
    rng = np.random.default_rng(7)
    table = reference.steps(problem)
    for _ in range(10):
        mode = np.concatenate([np.arange(problem.n_modes), rng.integers(problem.n_modes, size=8)])
        choice = [int(rng.integers(len(table[x]))) for x in mode]
        follow = np.zeros((len(mode), 20), dtype=int)
        for i, (x, c) in enumerate(zip(mode, choice, strict=True)):
            for z, (after, _, _) in enumerate(table[x][c].outcomes):
                follow[i, z] = rng.choice(np.flatnonzero(mode == after))
        values = reference.controller_values(problem, mode, choice, follow)
        worth = sum(float(joint @ values[x]) for x, joint in enumerate(problem.initial))
        assert worth <= solution.upper + 1e-9


@pytest.mark.parametrize("seed", range(4))
def test_following_the_policy_pays_what_it_promises(seed):
    """Simulated with the problem's own update of the belief, not with the graph: at least the lower bound."""
    problem = (latent_case(seed, n=3, discount=0.8), modal_problem(seed, (2, 3, 1), 0.8))[seed % 2]
    solution = solved(problem, 1e-3)
    rng = np.random.default_rng(seed)
    policy = solution.policy

    def ahead(x, belief, depth):
        """Expected reward of the policy, exactly, over the likely outcomes; then what its vectors promise."""
        i = policy.vector(belief, problem.modes[x])
        if depth == 0:
            return policy.value(belief, problem.modes[x])
        c = int(solution.choice[i])
        return belief @ problem.choices[x][c].reward + problem.discount * sum(
            p * ahead(after, b, depth - 1) for after, _, p, b in problem.outcomes(x, c, belief)
        )

    for x, _, belief in problem.starts():
        for b in (belief, rng.dirichlet(np.ones(len(belief)))):
            promised = policy.value(b, problem.modes[x])
            for depth in (1, 3):
                assert ahead(x, b, depth) >= promised - 1e-7 * max(1, abs(promised))


@pytest.mark.parametrize("name", ["dense 2", "modal 3", "latent 3 table"])
def test_the_optimum_is_convex_in_the_belief(name):
    problem = CASES[name]
    rng = np.random.default_rng(0)
    x = int(np.argmax([len(s) for s in problem.states]))
    ends = rng.dirichlet(np.ones(problem.n_states), size=2)

    def at(belief):
        start = [np.zeros(len(s)) for s in problem.states]
        start[x] = belief
        return solved(problem.started(start), 1e-3)

    first, last = map(at, ends)
    for share in (0.25, 0.6):
        between = at(share * ends[0] + (1 - share) * ends[1])
        assert between.lower <= share * first.upper + (1 - share) * last.upper + 1e-9


# -- other forms of the same problem -------------------------------------------------------------------
def permuted(problem, rng):
    """States, actions, modes and observations in another order."""
    modes = rng.permutation(problem.n_modes)
    states = [rng.permutation(len(s)) for s in problem.states]
    seen = rng.permutation(len(problem.observations))
    where = {int(x): i for i, x in enumerate(modes)}
    place = {int(o): i for i, o in enumerate(seen)}

    def branch(b, x):
        t = csr(b.transition.toarray()[np.ix_(states[x], states[b.mode])])
        e = None if b.emission is None else csr(b.emission.toarray()[states[b.mode]])
        return Branch(where[b.mode], t, tuple(place[o] for o in b.observations), e)

    choices = []
    for x in modes:
        offered = []
        for c in rng.permutation(len(problem.choices[x])):
            choice = problem.choices[x][c]
            branches = [branch(b, x) for b in choice.branches]
            rng.shuffle(branches)
            offered.append(Choice(choice.action, choice.reward[states[x]], tuple(branches)))
        choices.append(tuple(offered))
    return Problem(
        tuple(problem.modes[x] for x in modes),
        tuple(tuple(problem.states[x][y] for y in states[x]) for x in modes), tuple(choices),
        tuple(problem.observations[o] for o in seen), tuple(problem.initial[x][states[x]] for x in modes),
        problem.discount,
    )  # fmt: skip


@pytest.mark.parametrize("name", sorted(CASES))
def test_order_does_not_matter(name):
    agree(solved(CASES[name]), solved(permuted(CASES[name], np.random.default_rng(3))))


@pytest.mark.parametrize("name", ["dense 2", "modal 1", "latent 2 bernoulli"])
@pytest.mark.parametrize(("factor", "shift"), [(1.0, 7.0), (1.0, -50.0), (1e-4, 0.0), (1e5, 0.0)])
def test_reward_scale_and_shift(name, factor, shift):
    problem = CASES[name]
    choices = tuple(
        tuple(replace(c, reward=factor * c.reward + shift) for c in offered) for offered in problem.choices
    )
    changed = check(solved(replace(problem, choices=choices)))
    assert changed.status == "converged"
    agree(changed, solved(problem), factor, shift / (1 - problem.discount))


def test_an_observation_in_two_copies_tells_nothing_more():
    problem = dense_problem(2, 4, 3, 3)
    branches = [c.branches[0] for c in problem.choices[0]]
    tables = [b.emission.toarray() for b in branches]
    doubled = textbook_problem(
        [b.transition for b in branches],
        [np.column_stack([0.3 * t[:, 0], t[:, 1:], 0.7 * t[:, 0]]) for t in tables],
        np.stack([c.reward for c in problem.choices[0]]), problem.discount, problem.initial[0],
    )  # fmt: skip
    agree(solved(problem), solved(doubled))


@pytest.mark.parametrize("seed", range(3))
def test_without_information_the_best_plan_is_open_loop(seed):
    problem = dense_problem(seed, 3, 2, 2, 0.6)
    tables = [c.branches[0].transition.toarray() for c in problem.choices[0]]
    reward = np.stack([c.reward for c in problem.choices[0]])
    blind = textbook_problem(tables, np.full((2, 3, 2), 0.5), reward, 0.6, problem.initial[0])
    joint, horizon = problem.initial[0][None], 13
    worth = np.zeros(1)
    for k in range(horizon):  # all sequences of actions
        worth = np.concatenate([worth + 0.6**k * joint @ r for r in reward])
        joint = np.concatenate([joint @ t for t in tables])
    left = 0.6**horizon * np.abs(reward).max() / 0.4
    solution = solved(blind)
    assert solution.lower - left <= worth.max() <= solution.upper + left


@pytest.mark.parametrize("name", ["modal 1", "modal 2", "latent 1", "latent 3 table"])
def test_modes_folded_into_the_state(name):
    problem = next(p for key, p in CASES.items() if key.startswith(name))
    start = [np.zeros(len(s)) for s in problem.states]
    x, _, belief = next(problem.starts())
    start[x] = belief
    problem = problem.started(start)
    folded = flat(problem)
    assert folded.n_modes == 1
    agree(solved(problem, 1e-3), solved(folded, 1e-2))


@pytest.mark.parametrize("kind", ["alternating", "bernoulli", "table"])
def test_start_states_shown_or_folded_into_the_end(kind):
    problem = latent_problem(sticky_model(np.random.default_rng(5), 2), mode_processes(1)[kind], 0.8)
    folded = observed_end(problem)
    assert folded.n_modes >= problem.n_modes
    agree(solved(problem, 1e-5), solved(folded, 1e-5))

    # Exactly the same for a few steps, leaf values apart.
    def leaf(_, w):
        return w.sum(axis=1) * 3.0

    assert reference.tree_value(problem, 5, leaf) == pytest.approx(reference.tree_value(folded, 5, leaf), rel=1e-12)


# -- warm starts ---------------------------------------------------------------------------------------
@pytest.mark.parametrize("make", [
    lambda s: latent_case(s, n=3), lambda s: dense_problem(s, 4, 3, 3, shift=-5.0),
    lambda s: sparse_shifted(s), lambda s: dense_problem(s, 5, 2, 2, shift=5.0),
], ids=["latent", "dense-negative", "sparse-negative", "dense-positive"])  # fmt: skip
def test_warm_starts_are_valued_anew(make):
    """Another model's numbers would be wrong here; its policy graph is not."""
    for old, new in ((1, 2), (3, 1)):
        before = solve(make(old), 0.02, time_limit=SECONDS)
        warm = check(solve(make(new), 0.02, time_limit=SECONDS, warm=before))
        agree(warm, solve(make(new), 0.02, time_limit=SECONDS))
        again = check(solve(make(old), 0.02, time_limit=SECONDS, warm=before))
        assert again.trace[0].lower >= graph_value(before) - 1e-6 * abs(before.lower)


def sparse_shifted(seed):
    """More states than the grid takes, all rewards negative: zeros would be above the optimum."""
    problem = sparse_problem(seed, 16, 2, 3, 0.6)
    choices = tuple(replace(c, reward=c.reward - 5) for c in problem.choices[0])
    return replace(problem, choices=(choices,))


# -- problems of the literature ------------------------------------------------------------------------
def test_tiger():
    """19.3714 with five vectors: sarsop.md, table 1, solved by an independent implementation to 8e-10."""
    solution = check(solved(standard_problem("tiger"), 1e-5))
    assert solution.status == "converged"
    assert solution.lower == pytest.approx(19.3714, rel=1e-4)
    assert solution.upper == pytest.approx(19.3714, rel=1e-4)


PUBLISHED = {
    "tiger.95": (19.3714, 19.3714), "tiger.aaai": (1.933, 1.934), "1d": (1.2604, 1.2614),
    "cheese.95": (3.4853, 3.4863),
    "shuttle.95": (32.889, 32.890), "4x3.95": (1.8899, 1.8909), "paint.95": (3.2936, 3.2946),
    "network": (293.19, 297.72), "hallway": (0.987, 1.210), "tag-avoid": (-6.31, -1.62),
}  # fmt: skip
"""Bounds by the reference implementation of SARSOP, absolute gap .001 unless a range: design note sarsop.md."""


@pytest.mark.parametrize("name", [
    *(n for n in PUBLISHED if n not in ("hallway", "tag-avoid", "network")),
    *(pytest.param(n, marks=pytest.mark.slow) for n in ("network", "hallway", "tag-avoid")),
])  # fmt: skip
def test_files_in_circulation(shared, name):
    from models.planning.formats import read_problem

    path = shared / "data" / "pomdp" / f"{name}.pomdp"
    if not path.exists():
        pytest.skip(f"{path.name} is absent: the files may not be passed on")
    low, high = PUBLISHED[name]
    solution = solve(read_problem(path), 1e-5 if name == "tiger.95" else 1e-3, time_limit=4.0)
    # Printed values are rounded, and their gap lies to either side.
    slack = 2e-3 if high - low < 0.01 else 0.0
    assert solution.lower <= high + slack
    assert solution.upper >= low - slack
    assert solution.lower <= solution.upper
    if name == "tiger.95":
        assert 0.5 * (solution.lower + solution.upper) == pytest.approx(19.3714, rel=1e-4)
