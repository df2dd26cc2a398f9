"""Questions to a model with known tables, against the reference recursion run by run."""

import numpy as np
import pytest

from models import inference
from models.baum_welch import BaumWelch
from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.simulation import simulate_responses
from tests.models.test_protocol import THREE
from tests.models.test_recovery import truth, varied_design
from tests.random_cases import random_tables


@pytest.fixture(scope="module")
def log():
    rng = np.random.default_rng(4)
    return simulate_responses(truth(), varied_design(30, 5, rng), rng)[0]


def test_a_model_scores_a_log_without_a_fit(log):
    model = truth()
    by_run = inference.run_log_likelihoods(model, log)
    assert by_run.shape == (log.n_runs,)
    assert inference.log_likelihood(model, log) == by_run.sum()
    for run in range(5):
        alpha = model.initial
        for event in range(log.offsets[run], log.offsets[run + 1]):
            a, o = log.action[event], log.response[event]
            weighted = alpha * (model.emission[model.emission_index[a], :, o] if o >= 0 else 1.0)
            alpha = weighted @ model.transition[a]
        assert by_run[run] == pytest.approx(np.log(weighted.sum()), rel=1e-12)
    assert inference.smoothed(model, log).shape == (log.n_events, 3)


def test_a_fit_asks_the_same_questions(log):
    fit = BaumWelch(2, restarts=3, finalists=1, screening_maps=5, max_maps=50).fit(log)
    assert fit.score(log) == pytest.approx(fit.log_likelihood, rel=1e-12)
    assert fit.decode(log)[0] == inference.most_probable_path(fit.model, log)[0]


def test_another_protocol_is_refused(log):
    other = LatentStatePOMDP(*random_tables(np.random.default_rng(1), THREE, 2), THREE)
    with pytest.raises(InputError, match="event log, protocol: found 'published', wanted that of the model"):
        inference.log_likelihood(other, log)


def test_condition_of_every_event(log):
    assert set(log.condition_of_event) == {"varied"}
    assert len(log.condition_of_event) == log.n_events
