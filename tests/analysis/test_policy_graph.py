"""The policy graph: what it says of the policy, held against exact values and the policy itself."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.figures.planning_graph import policy_graph
from analysis.figures.style import to_svg
from analysis.policy_graph import policy_graph_of
from analysis.simulate import calibrated_truth
from models.planning.controller import FiniteStateController, controller_of
from models.planning.finite_memory import infinite_value
from models.planning.latent import latent_problem
from models.planning.mode_process import alternating, bernoulli
from models.planning.policies import Vocabulary
from models.planning.problems import problem as standard
from models.planning.solver import solve
from models.protocol import PUBLISHED
from tests.analysis.test_figures import words
from tests.models.planning.policy_cases import person


def contested(process=None):
    truth = calibrated_truth()
    dear = replace(truth, reward=replace(truth.reward, costs={"help": 40.0, "signal": 3.0}))
    return solve(latent_problem(dear, process), 1e-4)


SOLUTIONS = {
    "contested": contested(),
    "by chance": contested(bernoulli(PUBLISHED, 0.3)),
    "learning": solve(latent_problem(person(), alternating(PUBLISHED, "H"), 0.9)),
    "tiger": solve(standard("tiger"), 1e-3),
}


@pytest.mark.parametrize("name", list(SOLUTIONS))
def test_shares_are_those_of_the_exact_values(name):
    solution = SOLUTIONS[name]
    graph = policy_graph_of(solution)
    full = controller_of(solution.policy)
    value = infinite_value(full, solution.problem)
    again = infinite_value(graph.controller, solution.problem)
    assert graph.controller.n_nodes <= full.n_nodes
    assert again.value == pytest.approx(value.value, rel=1e-9)
    assert graph.share.sum() == pytest.approx(1)
    actions = graph.controller.vocabulary.actions
    for x, names in enumerate(actions):
        for c, action in enumerate(names):
            own = (graph.controller.mode == x) & (graph.controller.choice == c)
            assert graph.share[own].sum() == pytest.approx(value.frequencies.get(action, 0.0), abs=1e-9)
    for arrows in graph.follows:
        assert sum(a.chance for a in arrows) == pytest.approx(1)
    assert np.all(graph.share > 0), "a box that is never reached"


def test_expected_state_is_the_mean_belief_in_the_node():
    graph = policy_graph_of(SOLUTIONS["contested"])
    assert np.all((graph.expected_state >= 0) & (graph.expected_state <= 3))
    assert graph.share @ graph.expected_state == pytest.approx(graph.visits.sum(axis=0) @ np.arange(4))


def test_the_busiest_boxes_and_those_it_starts_in():
    graph = policy_graph_of(SOLUTIONS["learning"])
    for most in (1, 2, 50):
        drawn = graph.busiest(most)
        assert set(graph.starts) <= set(drawn.tolist())
        for x in range(2):
            own = drawn[graph.controller.mode[drawn] == x]
            assert len(own) <= max(most, len(graph.starts))
            left = np.setdiff1d(np.flatnonzero(graph.controller.mode == x), own)
            free = np.setdiff1d(own, graph.starts)
            if len(left) and len(free):
                assert graph.share[left].max() <= graph.share[free].min()
    assert len(graph.busiest(50)) == graph.controller.n_nodes


def test_the_sentence_counts_what_is_done():
    text = policy_graph_of(SOLUTIONS["contested"]).sentence
    assert "signal always" in text
    assert "no help" in text
    assert "of the time" in text


@pytest.mark.parametrize("name", list(SOLUTIONS))
def test_picture(name):
    graph = policy_graph_of(SOLUTIONS[name])
    ax = policy_graph(graph)
    said = words(ax)
    assert "start" in said
    for x in set(graph.controller.mode[graph.busiest(6)].tolist()):
        assert graph.controller.vocabulary.modes[x].split("_")[0] in said
    assert "_" not in said
    drawn = graph.busiest(6)
    for n in drawn:
        action = graph.controller.vocabulary.actions[graph.controller.mode[n]][graph.controller.choice[n]]
        assert action.replace("_", " ") in said
    assert to_svg(policy_graph(graph)) == to_svg(policy_graph(graph))


def test_boxes_that_are_not_drawn_are_shown_to_be_missing():
    graph = policy_graph_of(SOLUTIONS["learning"])
    assert graph.controller.n_nodes > 2
    few, all_of_them = policy_graph(graph, most=1), policy_graph(graph, most=99)
    dots = [sum(line.get_marker() == "o" for line in ax.lines) for ax in (few, all_of_them)]
    assert dots[0] > 0
    assert dots[1] == 0


# -- merging nodes ---------------------------------------------------------------------------------
def random_controller(rng, n, twins):
    """A controller some of whose nodes are copies of others, followers included."""
    mode = np.append([0, 1], rng.integers(2, size=n - 2))
    choice = rng.integers(2, size=n)
    follow = np.full((n, 2, 3), -1)
    for x in range(2):
        follow[:, x] = rng.choice(np.flatnonzero(mode == x), size=(n, 3))
    start = [int(np.flatnonzero(mode == x)[0]) for x in range(2)]
    for _ in range(twins):
        copied = int(rng.integers(len(mode)))
        mode, choice = np.append(mode, mode[copied]), np.append(choice, choice[copied])
        follow = np.concatenate([follow, follow[[copied]]])
        # Some arrows lead to the copy instead.
        swap = (follow == copied) & (rng.random(follow.shape) < 0.5)
        follow = np.where(swap, len(mode) - 1, follow)
    return FiniteStateController(Vocabulary.of(PUBLISHED), mode, choice, follow, start)


@given(st.integers(0, 2**32 - 1), st.integers(2, 6), st.integers(0, 4))
def test_merged_nodes_act_alike_and_no_others_are_merged(seed, n, twins):
    rng = np.random.default_rng(seed)
    controller = random_controller(rng, n, twins)
    merged = controller.merged()
    assert merged.n_nodes <= n
    assert np.array_equal(merged.merged().follow, merged.follow), "merging twice changes something"
    for first in range(2):
        long, short = controller.begin(first), merged.begin(first)
        for _ in range(30):
            assert controller.act(long) == merged.act(short)
            step = (controller.act(long), int(rng.integers(3)), int(rng.integers(2)))
            long, short = controller.observe(long, *step), merged.observe(short, *step)
    # Any two nodes left differ in what they do after some sequence of observations: brute force over all of them.
    m = merged.n_nodes
    alike = (merged.mode[:, None] == merged.mode) & (merged.choice[:, None] == merged.choice)
    for _ in range(m):
        after = merged.follow.reshape(m, -1)
        alike = alike & alike[after[:, None, :], after[None, :, :]].all(axis=-1)
    assert np.array_equal(alike, np.eye(m, dtype=bool))


def test_a_missing_follower_is_not_a_follower():
    words = Vocabulary.of(PUBLISHED)
    follow = np.full((3, 2, 3), -1)
    follow[:, 0, 0] = 0
    follow[2, 1, 2] = 1
    same = FiniteStateController(words, [0, 1, 1], [0, 1, 1], follow, [0, 1])
    assert same.merged().n_nodes == 3
    follow[2, 1, 2] = -1
    assert FiniteStateController(words, [0, 1, 1], [0, 1, 1], follow, [0, 1]).merged().n_nodes == 2
