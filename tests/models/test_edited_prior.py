"""Hard constraints that tell states apart are found for every seed; those that treat states alike are not."""

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import pytest

from analysis.simulate import simulate_study1
from models.bayesian_hmm import build_model
from models.edited_model import examine
from models.errors import InputError
from models.study_density import ModelSpec, StudyDensity

SEEDS = range(20)


@pytest.fixture(scope="module")
def log():
    return simulate_study1(participants=100)


def constrained(log, states, allowed):
    with build_model(log, states) as model:
        pm.Potential("only", pt.switch(allowed(model), 0.0, -np.inf))
    return model, StudyDensity(log, ModelSpec(states))


def helping(model):
    return model["help_probability"]


APART = {
    "two in order": (2, lambda m: pt.all(helping(m)[:, 0] < helping(m)[:, 1])),
    "three in order": (3, lambda m: pt.all(pt.diff(helping(m), axis=1) > 0)),
    "four in order": (4, lambda m: pt.all(pt.diff(helping(m), axis=1) > 0)),
    "first state rare": (2, lambda m: m["initial"][0] < 0.25),
    "first of three rare": (3, lambda m: m["initial"][0] < 0.25),
    "last two": (4, lambda m: helping(m)[0, 2] < helping(m)[0, 3]),
}


SLOW = ("four in order", "first of three rare", "last two")


@pytest.mark.parametrize("case", [pytest.param(c, marks=[pytest.mark.slow] * (c in SLOW)) for c in APART])
def test_hard_constraints_that_tell_states_apart_are_refused_for_every_seed(case, log):
    states, allowed = APART[case]
    model, study = constrained(log, states, allowed)
    for seed in SEEDS:
        with pytest.raises(InputError, match=r"tells the states apart|impossible at each of 400 draws"):
            examine(model, study, seed)


ALIKE = {
    "no state rare": (2, lambda m: pt.all(m["initial"] > 0.1)),
    "helping differs": (3, lambda m: pt.all(pt.abs(helping(m)[:, :, None] - helping(m)[:, None]) < 0.9)),
}


@pytest.mark.parametrize("case", ALIKE)
def test_hard_constraints_that_treat_states_alike_are_accepted(case, log):
    states, allowed = ALIKE[case]
    model, study = constrained(log, states, allowed)
    for seed in SEEDS[:5]:
        examine(model, study, seed)


def test_an_ordering_transform_tells_states_apart(log):
    from pymc.distributions.transforms import ordered

    with build_model(log, 2) as model:
        pm.Normal("mean", 0, 1, shape=2, dims="state", transform=ordered, initval=[-1.0, 1.0])
    for seed in SEEDS[:5]:
        with pytest.raises(InputError, match="tells the states apart"):
            examine(model, StudyDensity(log, ModelSpec(2)), seed)


def test_a_constraint_nothing_meets_cannot_be_judged(log):
    model, study = constrained(log, 2, lambda m: m["initial"][0] > 2)
    with pytest.raises(InputError, match="impossible at each of 400 draws from the distributions"):
        examine(model, study, 1)


# -- what is no such model -------------------------------------------------------------------------------
def test_another_number_of_states_is_refused(log):
    with pytest.raises(InputError, match=r"edited model, initial, shape: found \(3,\), wanted \(2,\): 2 states"):
        examine(build_model(log, 3), StudyDensity(log, ModelSpec(2)), 1)


def test_an_improper_prior_is_refused(log):
    with build_model(log, 2) as model:
        pm.Flat("anything")
    with pytest.raises(InputError, match=r"nobody can draw from.*wanted proper ones, not pm\.Flat"):
        examine(model, StudyDensity(log, ModelSpec(2)), 1)


def test_a_discrete_variable_is_refused(log):
    with build_model(log, 2) as model:
        pm.Poisson("count", 3)
    with pytest.raises(
        InputError, match=r"edited model, count: found a discrete variable \(int64\), wanted contin"
    ):
        examine(model, StudyDensity(log, ModelSpec(2)), 1)


def test_what_is_no_model_is_refused(log):
    with pytest.raises(InputError, match=r"edited model: found a dict, wanted a pymc\.Model"):
        examine({}, StudyDensity(log, ModelSpec(2)), 1)
