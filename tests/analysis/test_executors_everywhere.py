"""Everything that takes an executor gives it work that pickles by name, and finds the same with it as without."""

import numpy as np
import pandas as pd
import pytest

from analysis.calibration import calibrate
from analysis.calibration_replicate import CalibrationSettings
from analysis.interval_coverage import CoverageSettings, interval_coverage
from analysis.pair_differences import same_model_test
from analysis.power_simulation import (
    STUDY1_SD,
    STUDY1_TRUTH,
    MixedModelPower,
    mixed_model_power,
    rows_of_table,
    study1_rows,
)
from analysis.quadrature_study import quadrature_study
from analysis.simulate import simulate_study1
from models.baum_welch import BaumWelch
from models.bootstrap import bootstrap_fit
from models.nuts import NutsSettings
from models.parameters import STICKY
from models.people_folds import assign_folds, held_out_log_predictive
from models.planning.batch import solve_draws
from models.planning.latent import LatentBatch
from models.planning.schedule import Schedule
from models.robust.own_plans import own_plans
from models.sensitivity.endless_steps import EndlessSteps
from models.smc import SmcSettings
from models.study_density import ModelSpec, StudyDensity
from tests.executors import Pickling
from tests.models.sensitivity.sensitivity_cases import cases_of, some_draws, some_rewards
from tests.planning_cases import mode_processes, sticky_draws

LARGEST = 400_000
"""Bytes of one submission in these small studies."""

SEARCH = BaumWelch(2, restarts=5, finalists=2, rounds=1)


@pytest.fixture(scope="module")
def study():
    return simulate_study1(participants=60)


def fitted(study, executor):
    fit = SEARCH.fit(study, executor=executor)
    return [fit.log_likelihood, fit.model.transition, fit.screened]


def bootstrapped(study, executor):
    found = bootstrap_fit(SEARCH.fit(study), study, 10, executor=executor)
    return [found.transition, found.log_likelihood]


def left_out(study, executor):
    density = StudyDensity(study, ModelSpec(2, STICKY, {})).density
    theta = np.random.default_rng(1).uniform(0.2, 0.8, (30, len(density.template)))
    return [
        held_out_log_predictive(
            study, density, theta, assign_folds(study, 3, 1), SmcSettings(40, moves=1), executor=executor
        )
    ]


def solved(study, executor):
    found = solve_draws(LatentBatch(sticky_draws(6, 2), mode_processes()["alternating"], 0.9), executor=executor)
    return [found.lower, found.upper]


def planned(study, executor):
    found = own_plans(Schedule.of(sticky_draws(6, 2), "HRHRH"), executor)
    return [found.values, found.first_values]


def sensitive(study, executor):
    draws = some_draws(3, 3)
    cases = cases_of(draws, some_rewards(1, draws), 0.5)
    found = EndlessSteps(draws, executor=executor).decide(cases)
    return [found.choice, found.chance]


def powered(study, executor):
    plan = MixedModelPower(study1_rows(), STUDY1_TRUTH, STUDY1_SD, ("signal",), (40,), studies=5)
    frame = pd.DataFrame({"x": [0, 1, 0, 1], "y": [0, 1, 1, 0], "g": [1, 1, 2, 2]})
    rows = rows_of_table(frame, "y ~ x + (1|g)")
    own = MixedModelPower(rows, {"Intercept": 0.0, "x": 0.5}, 1.0, ("x",), (30,), studies=5)
    return [mixed_model_power(settings, executor=executor).table for settings in (plan, own)]


def covered(study, executor):
    return [interval_coverage(CoverageSettings(people=40, studies=2), executor=executor).table]


def approximated(study, executor):
    return [quadrature_study((0.0,), people=30, replicates=10, executor=executor).table]


def compared(study, executor):
    return [same_model_test(study, study, 1, SEARCH, replicates=4, executor=executor).null]


def calibrated(study, executor):
    tiny = CalibrationSettings(2, 2, participants=40, sampler=NutsSettings(draws=100, tune=100, chains=2))
    (run,) = calibrate([tiny], executor=executor).runs
    return [r.ranks for r in run.replicates]


EVERY = (
    fitted, bootstrapped, left_out, solved, planned, sensitive, powered, covered, approximated, compared,
    calibrated,
)  # fmt: skip


@pytest.mark.parametrize("work", EVERY)
def test_work_pickles_by_name_and_is_the_same(work, study):
    pickling = Pickling()
    for one, other in zip(work(study, pickling), work(study, None), strict=True):
        if isinstance(one, pd.DataFrame):
            pd.testing.assert_frame_equal(one, other, check_exact=True)
        else:
            np.testing.assert_array_equal(one, other)
    assert pickling.sent
    assert max(pickling.sent) < LARGEST
