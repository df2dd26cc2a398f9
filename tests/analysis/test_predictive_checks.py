"""Predictive checks pass where the model made the data and fail where another process did."""

import numpy as np
import pytest

from analysis.predictive_checks import (
    Statistics,
    posterior_checks,
    prior_draws,
    prior_predictive,
    prior_sentence,
)
from analysis.response_rates import value_of_response
from models.histories import UNSEEN
from models.parameters import DirichletPrior, Layout
from models.protocol import PUBLISHED
from tests.analysis.posterior_cases import posterior_of, random_model, sampled, study
from tests.analysis.report_cases import CORRIDOR, log_of, random_log


def test_statistics_by_hand():
    log = log_of(
        [
            (1, 0, "a", [("signal", "help"), ("signal", "help"), ("help", "none"), ("signal", "no_help")]),
            (2, 0, "a", [("signal", "no_help"), ("signal", "missing"), ("signal", "no_help")]),
            (2, 1, "b", [("signal", "help")]),
        ]
    )
    statistics = Statistics(log)
    found = dict(zip((c for _, c in statistics.names), statistics.of(log.response), strict=True))
    assert found == pytest.approx(
        {
            "a, HHH": 0, "a, HHRH": 2, "b, H": 1, "mean run of equal responses": 6 / 4,
            "longest run of equal responses": 5 / 3, "first response": 2 / 3, "last response": 1 / 3,
            "last less first response": -0.5, "variance of help count": 0.5, "always help": 0.0, "never help": 0.0,
        }
    )  # fmt: skip


def test_the_model_passes_on_its_own_data():
    found = posterior_checks(sampled(2), study(), draws=200)
    assert found.failed.empty
    assert found.sentence.startswith("No check fails")
    assert "Conditioned on" in found.sentence
    assert found.table["outside"].sum() <= 6
    again = posterior_checks(sampled(2), study(), draws=200)
    assert found.table.equals(again.table)


def test_people_who_never_change_are_found_out():
    """Everybody keeps to one answer: help rates can be matched, runs of equal responses cannot."""
    log = study()
    rng = np.random.default_rng(1)
    answer = (rng.random(log.n_runs) < 0.82).astype(np.int8)[log.run_of_event]
    stubborn = log.with_responses(np.where(log.response == UNSEEN, UNSEEN, answer).astype(np.int8))
    found = posterior_checks(sampled(2), stubborn, draws=200)
    failed = set(found.failed["check"])
    assert {"mean run of equal responses", "variance of help count"} <= failed
    assert found.sentence.startswith(f"The model FAILS {len(failed)} of")


def test_people_who_tire_are_found_out():
    log = study()
    late = log.k >= 4
    tired = np.where((log.response != UNSEEN) & late, 0, log.response).astype(np.int8)
    failed = set(posterior_checks(sampled(2), log.with_responses(tired), draws=200).failed["check"])
    assert {"last response", "last less first response"} <= failed


def test_prior_predictive_follows_kappa():
    table = prior_predictive(study(), 4, (0.0, 50.0), draws=200)
    runs = table[table["check"] == "mean run of equal responses"].set_index("kappa")
    assert runs.loc[50.0, "mean"] > runs.loc[0.0, "mean"] + 0.05
    assert table["check"].iloc[0] == "help rate"
    assert (table["low"] <= table["high"]).all()
    assert "kappa 50: help rate" in prior_sentence(table)


def test_draws_from_the_prior():
    layout = Layout(PUBLISHED, 3)
    models = prior_draws(layout, DirichletPrior(stay=7.0), 4000, np.random.default_rng(1))
    stay = models.transition[:, :, np.arange(3), np.arange(3)]
    assert stay.mean() == pytest.approx(8 / 10, abs=0.01)
    assert models.initial.mean(axis=0) == pytest.approx([1 / 3] * 3, abs=0.02)


def test_scores_and_many_schedules():
    log = random_log(CORRIDOR, people=80)
    rng = np.random.default_rng(1)
    found = posterior_checks(posterior_of([random_model(rng, 2, CORRIDOR)] * 20), log)
    assert {"condition plain", "round 0"} <= set(found.table["check"])
    total = found.table.loc[found.table["check"].str.startswith("condition"), "observed"].sum()
    assert total == pytest.approx(value_of_response(CORRIDOR)[log.response[log.response != UNSEEN]].sum())
