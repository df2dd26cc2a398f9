"""A protocol of three modes and three responses, all the way: simulate, compress, evaluate, learn."""

import itertools
import math

import numpy as np
import pytest

from models.baum_welch import BaumWelch
from models.em_kernel import em
from models.events import EventLog
from models.forward_backward import history_log_likelihoods, log_likelihood_and_gradient
from models.lspomdp import LatentStatePOMDP
from models.parameters import DirichletPrior, Layout
from models.protocol import Protocol
from models.simulation import simulate_responses
from tests.models.test_protocol import THREE
from tests.models.test_simulation import design_of
from tests.random_cases import random_run
from tests.reference import enumeration

TRUTH = LatentStatePOMDP(
    np.array([0.6, 0.4]),
    np.array([
        [[0.95, 0.05], [0.2, 0.8]],
        [[0.6, 0.4], [0.05, 0.95]],
        [[0.9, 0.1], [0.15, 0.85]],
        [[0.8, 0.2], [0.1, 0.9]],
        [[0.7, 0.3], [0.3, 0.7]],
        [[0.5, 0.5], [0.02, 0.98]],
    ]),
    np.array([
        [[0.8, 0.15, 0.05], [0.1, 0.2, 0.7]],
        [[0.7, 0.2, 0.1], [0.05, 0.15, 0.8]],
        [[0.6, 0.3, 0.1], [0.2, 0.1, 0.7]],
        [[0.5, 0.4, 0.1], [0.1, 0.1, 0.8]],
    ]),
    THREE,
)  # fmt: skip


@pytest.fixture(scope="module")
def study() -> EventLog:
    """1,500 people, 8 rounds of random actions, a tenth of the responses missing; through a file's columns."""
    rng = np.random.default_rng(42)
    design = design_of([random_run(rng, THREE, 8, 0.1) for _ in range(1500)], THREE)
    log, _ = simulate_responses(TRUTH, design, rng)
    return EventLog.from_frame(log.to_frame().sample(frac=1.0, random_state=1), THREE)


def test_the_log_and_its_protocol_survive_files(study, tmp_path):
    path = tmp_path / "three.toml"
    path.write_text(THREE.to_toml(), encoding="utf-8")
    protocol = Protocol.from_toml(path)
    again = EventLog.from_frame(study.to_frame(), protocol)
    assert np.array_equal(again.response, study.response)
    assert set(study.to_frame()["observation"].unique()) == {"refuse", "later", "accept", "none", "missing"}


def test_the_likelihood_is_the_sum_over_all_state_paths(study):
    part = study.select(runs=np.arange(60))
    tree = part.tree()
    tables = (TRUTH.initial, TRUTH.transition, TRUTH.emission)
    values = history_log_likelihoods(tree, *tables, TRUTH.emission_index)
    total = 0.0
    for h, node in enumerate(tree.terminals):
        path = tree.path(int(node))
        run = list(zip(tree.arrays.action[path].tolist(), tree.arrays.response[path].tolist(), strict=True))
        exact = math.log(enumeration.likelihood(enumeration.path_probabilities(run, *tables, TRUTH.emission_index)))
        assert values[h] == pytest.approx(exact, rel=1e-12)
        total += exact * tree.arrays.ends[node]
    found = log_likelihood_and_gradient(tree, *tables, TRUTH.emission_index)
    assert found.log_likelihood == pytest.approx(total, rel=1e-12)


def test_all_responses_of_a_design_have_probability_one():
    """Summed over the 3**4 possible answers to one sequence of actions."""
    actions = [2, 1, 5, 4, 0, 3]
    shows = [a for a in actions if THREE.emission_index[a] >= 0]
    runs = []
    for answers in itertools.product(range(3), repeat=len(shows)):
        answer = iter(answers)
        runs.append([(a, next(answer) if THREE.emission_index[a] >= 0 else -1) for a in actions])
    tree = design_of(runs, THREE).tree()
    assert tree.n_histories == 81
    values = history_log_likelihoods(tree, TRUTH.initial, TRUTH.transition, TRUTH.emission, TRUTH.emission_index)
    assert math.fsum(np.exp(values)) == pytest.approx(1, rel=1e-13)


def assert_near_the_truth(model):
    np.testing.assert_allclose(model.initial, TRUTH.initial, atol=0.06)
    np.testing.assert_allclose(model.emission, TRUTH.emission, atol=0.06)
    np.testing.assert_allclose(model.transition, TRUTH.transition, atol=0.12)


def test_the_em_kernel_recovers_the_truth(study):
    layout = Layout(THREE, 2)
    rng = np.random.default_rng(3)
    start = layout.pack(np.full(2, 0.5), rng.dirichlet(np.ones(2), (6, 2)), rng.dirichlet(np.ones(3), (4, 2)))
    theta, trace, *_, converged = em(
        start, study.tree().arrays, layout.sizes, layout.emission_index, DirichletPrior().pseudo_counts(layout),
        layout.free_entries({}), 5000, 1e-8, 5, True, np.zeros(1, np.uint8),
    )  # fmt: skip
    assert converged
    fitted = LatentStatePOMDP(*layout.unpack(theta), THREE).canonical(study.emission_weights)
    assert_near_the_truth(fitted)
    at_truth = log_likelihood_and_gradient(
        study.tree(), TRUTH.initial, TRUTH.transition, TRUTH.emission, TRUTH.emission_index
    )
    # Twice the gain is about chi-square with 1 + 12 + 16 = 29 degrees of freedom.
    assert 0 < 2 * (trace[-1] - at_truth.log_likelihood) < 60


def test_baum_welch_recovers_the_truth(study):
    fit = BaumWelch(2, restarts=6, finalists=2).fit(study)
    assert fit.converged
    assert fit.n_parameters == 1 + 12 + 16
    assert_near_the_truth(fit.model)
    assert fit.score(study) == pytest.approx(fit.log_likelihood, rel=1e-12)
    assert fit.predict_proba(study).shape == (study.n_events, 2)
