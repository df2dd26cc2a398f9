"""Log predictive under the mixed model: integrals on a grid, both signs of sigma, doubt without information."""

import numpy as np
import pytest
from scipy.special import expit, logsumexp

from models.glmm import LogisticMixedModel
from models.glmm_data import Patterns, Rule
from models.mixed_predictive import WIDEST, NormalBelief, mixed_log_predictive

Z, WEIGHT = np.polynomial.hermite_e.hermegauss(60)
WEIGHT = WEIGHT / WEIGHT.sum()


def people(rng, n, rows, intercept, sd):
    group = np.repeat(np.arange(n), rows)
    eta = intercept + sd * rng.standard_normal(n)[group]
    return (rng.random(len(group)) < expit(eta)).astype(float), group


def patterns(y, group):
    ones = np.ones(len(y))
    return Patterns.from_rows(ones[:, None], 0 * ones, y, ones, ones, group)


@pytest.mark.parametrize(("sd_rest", "sd_held"), [(1.2, 1.5), (0.0, 1.0), (0.0, 0.0)])
def test_the_integral_is_that_on_a_grid(sd_rest, sd_held):
    """Also where sigma is estimated at zero, and the integrand has a mode on either side of it."""
    rng = np.random.default_rng(5)
    y, group = people(rng, 80, 4, 0.4, sd_rest)
    maximum = LogisticMixedModel(y, np.ones(len(y)), groups=group).fit(warn=False)._results.maximum
    belief = NormalBelief.of(maximum)
    held, code = people(rng, 60, 5, 1.0, sd_held)
    found = mixed_log_predictive(belief, belief.draws(500, 1), patterns(held, code), Rule.hermite(25), 1)

    root = np.linalg.cholesky(belief.covariance)
    axis = np.linspace(-8, 8, 321)
    u = np.stack(np.meshgrid(axis, axis, indexing="ij"), axis=-1).reshape(-1, 2)
    log_weight = -0.5 * (u**2).sum(axis=1)
    log_weight -= logsumexp(log_weight)
    theta = belief.centre + u @ root.T
    pairs, times = np.unique(np.bincount(code, held), return_counts=True)
    p = expit(theta[:, :1] + theta[:, 1:] * Z)
    value = sum(
        n * np.log((p**hits * (1 - p) ** (5 - hits)) @ WEIGHT) for hits, n in zip(pairs, times, strict=True)
    )
    assert found.joint == pytest.approx(float(logsumexp(log_weight + value)), abs=max(4 * found.error, 1e-4))
    assert found.error < 0.06
    again = mixed_log_predictive(belief, belief.draws(500, 1), patterns(held, code), Rule.hermite(25), 1)
    assert (again.joint, again.error) == (found.joint, found.error)
    other = mixed_log_predictive(belief, belief.draws(500, 1), patterns(held, code), Rule.hermite(25), 2)
    assert other.joint != found.joint
    assert abs(other.joint - found.joint) < 5 * np.hypot(found.error, other.error)


def test_draws_have_the_moments_of_the_belief():
    root = np.array([[0.5, 0.0], [0.2, 0.3]])
    belief = NormalBelief(np.array([1.0, 3.0]), root)
    theta = belief.draws(40_000, 3)
    assert np.allclose(theta.mean(axis=0), [1, 3], atol=0.02)
    assert np.allclose(np.cov(theta.T), root @ root.T, atol=0.01)
    low = NormalBelief(np.array([1.0, 0.0]), root).draws(2000, 3)
    assert (low[:, 1] >= 0).all()
    assert low[:, 1].mean() == pytest.approx(np.hypot(0.2, 0.3) * np.sqrt(2 / np.pi), abs=0.02)


def test_a_direction_without_information_gets_the_widest_doubt():
    rng = np.random.default_rng(3)
    y, group = people(rng, 60, 4, 0.0, 1.0)
    x = np.column_stack([np.ones(len(y)), (np.arange(len(y)) < 40).astype(float)])
    y[:40] = 1.0  # separated
    maximum = LogisticMixedModel(y, x, groups=group).fit(warn=False)._results.maximum
    belief = NormalBelief.of(maximum)
    assert np.sqrt(np.linalg.eigvalsh(belief.covariance)[-1]) == pytest.approx(WIDEST, rel=0.05)
    assert np.isfinite(belief.draws(10, 1)).all()
