"""Small problems, and trees and vectors made by hand, for tests of one kernel of the planner at a time."""

import numpy as np
import pytest

from models.planning.arrays import arrays_of
from models.planning.belief_tree import empty_tree, node_of, open_choice
from models.planning.blind_policies import blind_vectors
from models.planning.grid_run import blind_slots
from models.planning.node_backups import new_room
from models.planning.textbook import textbook_problem
from models.planning.vectors import add_vector, empty_vectors
from tests.planning_cases import dense_problem, latent_case, modal_problem, padded
from tests.reference import planning_numpy as reference

PROBLEMS = {
    "modal": modal_problem(3, (4, 1, 3, 2)),
    "small": modal_problem(1, (2, 3, 1)),
    "dense": dense_problem(2, 3, 3, 2),
    "latent": latent_case(2, "bernoulli"),
}


class Scene:
    """A problem with planes, corners and vectors that are made up, and a tree without nodes."""

    def __init__(self, name, seed=0, capacity=300):
        self.problem = PROBLEMS[name]
        self.arrays = arrays_of(self.problem)
        self.rng = np.random.default_rng(seed)
        self.width = self.problem.n_states
        self.planes = 5 + self.rng.normal(size=self.arrays.reward.shape)
        # As high as the planes say, so that neither bound of a belief always wins.
        self.corner = np.full((self.problem.n_modes, self.width), -np.inf)
        for x in range(self.problem.n_modes):
            self.corner[x] = self.planes[self.choices(x)].max(axis=0)
        self.tree = empty_tree(self.arrays, capacity, self.corner, self.planes)
        self.vectors = empty_vectors(self.arrays, blind_slots(self.arrays) + 40)
        blind_vectors(self.arrays, self.vectors, 64)
        self.table = reference.steps(self.problem)
        self.room = new_room(self.arrays)

    def choices(self, x):
        return slice(int(self.arrays.mode_choice[x]), int(self.arrays.mode_choice[x + 1]))

    def size(self, x):
        return len(self.problem.states[x])

    def belief(self, x):
        return self.rng.dirichlet(np.ones(self.size(x)))

    def node(self, x, belief):
        return node_of(self.tree, self.arrays, x, padded(belief, self.width))

    def plane(self, x, belief):
        return (self.planes[self.choices(x), : len(belief)] @ belief).max()

    def held(self, x):
        n = int(self.vectors.counts[0])
        return np.flatnonzero(self.vectors.mode[:n] == x)

    def lower(self, x, belief):
        return (self.vectors.alpha[self.held(x), : len(belief)] @ belief).max()

    def steps_after(self, x, j, belief):
        """Reward, and (place, mode, probability, belief) of every possible outcome of a choice."""
        step = self.table[x][j]
        after = reference.successors(step, belief)
        ways = [
            (z, step.outcomes[z][0], p, tau[: self.size(step.outcomes[z][0])])
            for z, (p, tau) in enumerate(after) if p > 0
        ]  # fmt: skip
        return belief @ step.reward, ways

    def opened(self, i, j):
        open_choice(self.tree, self.arrays, i, j, self.room.after, self.room.probability, self.room.reached)


every = pytest.mark.parametrize("name", sorted(PROBLEMS))


def graph(problem, entries, capacity=None):
    """Vectors from (mode, place of the choice, alpha, followers)."""
    arrays = arrays_of(problem)
    vectors = empty_vectors(arrays, capacity or len(entries))
    for mode, choice, alpha, follow in entries:
        places = np.zeros(vectors.follow.shape[1], dtype=np.int32)
        places[: len(follow)] = follow
        add_vector(vectors, mode, int(arrays.mode_choice[mode]) + choice, np.array(alpha, float), places)
    return arrays, vectors


def lone(alphas):
    """Vectors of one mode that lead to themselves, with a choice each, so that they can be told apart."""
    n, width = len(alphas), len(alphas[0])
    problem = textbook_problem(
        [np.eye(width)] * n, [np.ones((width, 1))] * n, np.zeros((n, width)), 0.9, np.full(width, 1 / width)
    )
    return graph(problem, [(0, c, alpha, [c]) for c, alpha in enumerate(alphas)])
