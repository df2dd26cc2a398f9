"""Maxima that quadrature makes itself: the exact likelihood refuses them, and finds its own."""

import json
import warnings
from dataclasses import asdict

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime, minimize
from scipy.special import expit, log_expit

from models.errors import InputError
from models.glmm import LogisticMixedModel
from models.glmm_climb import climb
from models.glmm_data import Likelihood, Rule
from models.glmm_exact import ExactLikelihood, exact_log_likelihood
from models.glmm_exact_maximum import exact_maximum
from models.glmm_nodes import LOWER, WRONG, check_nodes
from models.glmm_optimise import maximise
from models.glmm_variance import variance_test
from models.glmm_warnings import ConvergenceWarning, QuadratureWarning, SeparationWarning
from tests.models.test_glmm_kernel import Rows
from tests.models.test_glmm_model import study
from tests.reference import glmm_exact as reference

FORMULA = "y ~ a + c + (1|g)"


def nearly_separated():
    """Sixteen small studies near the ceiling, two or three outcomes a person, one continuous covariate."""
    rng = np.random.default_rng(7)
    for _ in range(16):
        groups, rows = int(rng.integers(20, 120)), int(rng.integers(2, 4))
        g = np.repeat(np.arange(groups), rows)
        a, c = rng.integers(0, 2, len(g)), rng.normal(size=len(g))
        u = rng.normal(size=groups) * rng.choice([0.5, 1.4, 4])
        eta = rng.choice([2.0, 3.5, 5]) + rng.choice([1, 3]) * a + 0.4 * c + u[g]
        yield pd.DataFrame({"y": (rng.random(len(g)) < 1 / (1 + np.exp(-eta))).astype(int), "a": a, "c": c, "g": g})


@pytest.fixture(scope="module")
def studies():
    return list(nearly_separated())


def integral(data):
    """Maximum of the likelihood on a dense even grid, by scipy: ``(value, theta)``."""
    u = np.linspace(-8.5, 8.5, 1701)  # good to a standard deviation of 60: poles lie pi / sd from the real line
    weight = np.exp(-u * u / 2) / np.sqrt(2 * np.pi) * (u[1] - u[0])
    x = np.column_stack([np.ones(len(data)), data["a"], data["c"]])
    sign = np.where(data["y"] > 0, 1.0, -1.0)[:, None]
    start = np.flatnonzero(np.diff(data["g"], prepend=-1))
    length = np.diff([*start, len(data)])

    def fall(theta):
        eta = (x @ theta[:-1])[:, None] + theta[-1] * u
        p = np.exp(np.add.reduceat(log_expit(sign * eta), start))
        group = p @ weight
        slope = np.repeat(p * weight / group[:, None], length, axis=0) * sign * expit(-sign * eta)
        return -np.log(group).sum(), -np.append(x.T @ slope.sum(1), (slope @ u).sum())

    with np.errstate(all="ignore"):  # where it rises for ever
        found = minimize(fall, [2, 1, 0.3, 4.0], jac=True, method="BFGS", options={"gtol": 1e-6, "maxiter": 60})
    return -found.fun, found.x


# -- the exact likelihood as something to climb ----------------------------------------------------------
@given(st.integers(0, 10**6), st.sampled_from([0.0, 0.3, 2.0, -2.0, 60.0]))
def test_the_gradient_is_that_of_the_specification(seed, sd):
    rng = np.random.default_rng(seed)
    patterns = Rows.random(rng).patterns()
    theta = np.append(rng.normal(size=3) * max(1.0, 0.5 * abs(sd)), sd)
    likelihood = ExactLikelihood(patterns)
    value, gradient = likelihood(theta)
    assert value == pytest.approx(reference.exact_log_likelihood(patterns, theta), rel=1e-9)
    numbers = approx_fprime(theta, lambda t: reference.exact_log_likelihood(patterns, t), 1e-6)
    assert gradient == pytest.approx(numbers, rel=1e-4, abs=1e-4)
    assert patterns.multiplicity @ likelihood.scores == pytest.approx(gradient, rel=1e-12, abs=1e-12)
    assert patterns.multiplicity @ likelihood.values + patterns.constant == pytest.approx(value)


def test_its_gradient_is_that_of_good_quadrature():
    rng = np.random.default_rng(3)
    patterns = Rows.random(rng).patterns()
    theta = np.append(rng.normal(size=3), 0.9)
    exact, fine = ExactLikelihood(patterns)(theta), Likelihood(patterns, Rule.hermite(51))(theta)
    assert exact[0] == pytest.approx(fine[0], abs=1e-9)
    assert exact[1] == pytest.approx(fine[1], abs=1e-7)


def test_the_exact_maximum_of_ordinary_data_is_that_of_quadrature():
    model = LogisticMixedModel.from_formula("help ~ signal + age + (1|person)", study(120, seed=2))
    best = maximise(model.patterns, model.rule)
    found = exact_maximum(best.coordinates.patterns(model.patterns), best)
    assert found.theta == pytest.approx(best.top, abs=1e-4)
    assert found.value == pytest.approx(best.value, abs=1e-6)


def test_many_patterns_are_climbed_on_a_part_first(monkeypatch):
    model = LogisticMixedModel.from_formula("help ~ signal + age + (1|person)", study(120, seed=2))
    best = maximise(model.patterns, model.rule)
    working = best.coordinates.patterns(model.patterns)
    whole = exact_maximum(working, best)
    monkeypatch.setattr("models.glmm_exact_maximum.MANY_EXACT", 20)
    monkeypatch.setattr("models.glmm_exact_maximum.PART_EXACT", 15)
    assert working.n_patterns > 20
    found = exact_maximum(working, best)
    assert found.value == pytest.approx(whole.value, abs=1e-6)
    assert found.theta == pytest.approx(whole.theta, abs=1e-3)


# -- a finite maximum that no search by quadrature ends at -----------------------------------------------
def test_a_finite_maximum_is_not_denied(studies):
    """Outcomes are separated within all groups, and the likelihood at infinity is still not the highest."""
    value, theta = integral(studies[5])
    result = LogisticMixedModel.from_formula(FORMULA, studies[5]).fit(warn=False)
    assert result.escape.limit is not None
    assert result.escape.limit.value < value - 0.2
    assert result.escape.finite == pytest.approx(value, abs=1e-4)
    assert not result.escape.any
    assert not any(note.category is SeparationWarning for note in result.notes)
    check = result.node_check
    assert (check.best_exact, check.best_sd) == pytest.approx((value, theta[-1]), abs=0.02)
    fine = LogisticMixedModel.from_formula(FORMULA, studies[5], quadrature=101).fit(warn=False)
    assert fine.converged
    assert fine.bse.notna().all()
    assert fine.llf == pytest.approx(value, abs=0.05)


@pytest.mark.parametrize("number", range(16))
def test_no_verdict_contradicts_the_integral(studies, number):
    """Whatever is said of infinity, the exact likelihood at scipy's maximum does not exceed it."""
    value, theta = integral(studies[number])
    result = LogisticMixedModel.from_formula(FORMULA, studies[number]).fit(warn=False)
    if result.escape.within_groups:
        assert theta[-1] > 60 or value <= result.escape.limit.value + 2e-3
        assert result.llf == result.escape.limit.value
        assert f"rises to {result.llf:.4f}" in str(result.summary())
    elif not result.escape.any and theta[-1] < 60:
        if result.llf != pytest.approx(value, abs=WRONG):
            assert result.node_check.best_exact == pytest.approx(value, abs=1e-4)
            said = " ".join(note.text for note in result.notes)
            assert f"maximum, {result.node_check.best_exact:.4f}, at sd" in said
        if result.converged:
            at = reference.exact_log_likelihood(result.model.patterns, np.asarray(result.params))
            assert at == pytest.approx(value, abs=LOWER)
        assert result.escape.limit is None or result.escape.finite == pytest.approx(value, abs=1e-3)


# -- maxima of the rule's own making ---------------------------------------------------------------------
def test_an_artefact_is_refused_with_the_numbers(studies):
    value, theta = integral(studies[3])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        result = LogisticMixedModel.from_formula(FORMULA, studies[3]).fit()
    check = result.node_check
    assert result.sd > 1.9 * theta[-1]  # it stands far from the maximum, and its log-likelihood is none
    assert check.exact == pytest.approx(
        reference.exact_log_likelihood(result.model.patterns, np.asarray(result.params)), abs=1e-6
    )
    assert check.log_likelihood - check.exact > 1
    assert check.best_exact == pytest.approx(value, abs=1e-5)
    assert check.best_sd == pytest.approx(theta[-1], abs=0.02)
    said = {w.category: str(w.message) for w in caught}
    assert ConvergenceWarning in said
    assert "not to be believed" in said[QuadratureWarning]
    for number in (check.exact, check.log_likelihood, check.best_exact):
        assert f"{number:.4f}" in said[QuadratureWarning]
    assert f"sd {check.best_sd:.5g}" in said[QuadratureWarning]
    assert not result.converged
    assert result.conf_int(method="profile").isna().all(axis=None)
    assert f"{result.llf:.4f} ({check.exact:.4f} exactly)" in str(result.summary())
    # The variance is tested by the likelihood's own maximum.
    assert variance_test(result).lr == pytest.approx(2 * (value - result.maximum.pooled_value), abs=1e-4)
    restricted = LogisticMixedModel.from_formula("y ~ c + (1|g)", studies[3]).fit(warn=False)
    with pytest.raises(InputError, match="without a maximum"):
        result.compare_lr_test(restricted)
    json.dumps(asdict(check))


def test_the_finer_rule_searches_from_its_own_starts(studies):
    model = LogisticMixedModel.from_formula(FORMULA, studies[3])
    result = model.fit(warn=False)
    finer = LogisticMixedModel.from_formula(FORMULA, studies[3], quadrature=51).fit(warn=False)
    stuck = climb(Likelihood(model.patterns, Rule.hermite(51)), np.asarray(result.params))
    assert stuck.theta[-1] > 15  # what the check gave before
    assert result.node_check.finer_sd == pytest.approx(finer.sd, rel=1e-3)
    assert result.node_check.refitted


def test_every_fit_whose_likelihood_is_wrong_says_so(studies):
    for data in studies:
        for nodes in (9, 15, 25, 51):
            result = LogisticMixedModel.from_formula(FORMULA, data, quadrature=nodes).fit(warn=False)
            if result.escape.within_groups or result.boundary:
                continue
            patterns, theta = result.model.patterns, np.asarray(result.params)
            off = abs(result.maximum.value - exact_log_likelihood(patterns, theta))
            told = [n.text for n in result.notes if n.category is QuadratureWarning]
            assert (off > WRONG) == any("the log-likelihood there is" in text for text in told)


def test_few_nodes_are_an_approximation_by_choice(studies):
    result = LogisticMixedModel.from_formula(FORMULA, studies[4], quadrature="laplace").fit(warn=False)
    assert result.node_check.wrong
    assert result.converged
    assert np.isnan(result.node_check.best_exact)
    assert "the log-likelihood there is about -" in result.node_check.text


@settings(max_examples=20)
@given(st.integers(0, 10**6))
def test_ordinary_fits_never_ask_the_exact_likelihood(seed):
    model = LogisticMixedModel.from_formula("help ~ signal + age + (1|person)", study(60, seed=seed))
    check = check_nodes(model.patterns, model.rule, maximise(model.patterns, model.rule))
    assert np.isnan(check.exact)
    assert not check.wrong
    assert not check.elsewhere


def test_many_groups_are_compared_on_a_part(studies, monkeypatch):
    model = LogisticMixedModel.from_formula(FORMULA, studies[3])
    best = maximise(model.patterns, model.rule)
    monkeypatch.setattr("models.glmm_nodes.MANY", 40)
    monkeypatch.setattr("models.glmm_nodes.PART", 35)
    check = check_nodes(model.patterns, model.rule, best)
    assert check.wrong
    assert check.elsewhere
    assert check.best_exact == pytest.approx(integral(studies[3])[0], abs=1e-4)
