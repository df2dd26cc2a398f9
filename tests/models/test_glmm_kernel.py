"""The compiled marginal likelihood: its twin, brute force, exact gradients, and the corners."""

from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from models.glmm_data import Likelihood, Patterns, Rule
from models.glmm_pooled import pooled_logistic
from tests.reference import glmm as reference


@dataclass(frozen=True)
class Rows:
    """A random study in rows."""

    design: np.ndarray
    offset: np.ndarray
    successes: np.ndarray
    trials: np.ndarray
    weights: np.ndarray
    group: np.ndarray

    @classmethod
    def random(cls, rng, n_groups=6, most_rows=4, most_trials=3, continuous=True):
        group = np.repeat(np.arange(n_groups), rng.integers(1, most_rows + 1, n_groups))
        n = len(group)
        x = rng.normal(size=n) if continuous else rng.integers(0, 2, n)
        trials = rng.integers(1, most_trials + 1, n)
        return cls(
            np.column_stack([np.ones(n), rng.integers(0, 2, n), x]).astype(float), rng.choice([0.0, 0.5], n),
            rng.binomial(trials, rng.uniform(0.1, 0.9, n)).astype(float), trials.astype(float),
            np.ones(n), group,
        )  # fmt: skip

    def patterns(self, **options):
        return Patterns.from_rows(
            self.design, self.offset, self.successes, self.trials, self.weights, self.group, **options
        )


seeds = st.integers(0, 10**6)
sds = st.floats(-6, 6).filter(lambda s: abs(s) > 1e-3)


@given(seeds, sds, st.sampled_from([1, 2, 3, 7, 25]))
def test_the_likelihood_is_that_of_the_specification(seed, s, n_nodes):
    rng = np.random.default_rng(seed)
    rows = Rows.random(rng)
    theta = np.append(rng.normal(size=3), s)
    likelihood = Likelihood(rows.patterns(compress=False), Rule.hermite(n_nodes))
    value, _ = likelihood(theta)
    want = reference.log_likelihood(
        theta, rows.design, rows.offset, rows.successes, rows.trials, rows.group, n_nodes
    )
    assert value - likelihood.patterns.constant == pytest.approx(want, rel=1e-11, abs=1e-11)
    for i in range(6):
        mine = rows.group == i
        eta = rows.offset[mine] + rows.design[mine] @ theta[:-1]
        one, mode, scale = reference.group(eta, rows.successes[mine], rows.trials[mine], s, n_nodes)
        got = likelihood.values[i], likelihood.modes[i], likelihood.scales[i]
        assert got == pytest.approx((one, mode, scale), rel=1e-9, abs=1e-9)


@given(seeds, sds, st.sampled_from([1, 2, 3, 7, 25]))
def test_the_gradient_is_that_of_the_rule_used(seed, s, n_nodes):
    rng = np.random.default_rng(seed)
    patterns = Rows.random(rng, most_trials=2).patterns()
    theta = np.append(rng.normal(size=3), s)
    likelihood = Likelihood(patterns, Rule.hermite(n_nodes))
    _, gradient = likelihood(theta)
    scores = likelihood.scores.copy()
    for i in range(4):
        step = np.zeros(4)
        step[i] = 1e-5
        up, _ = likelihood(theta + step)
        values = likelihood.values.copy()
        down, _ = likelihood(theta - step)
        assert gradient[i] == pytest.approx((up - down) / 2e-5, rel=1e-6, abs=2e-7)
        assert scores[:, i] == pytest.approx((values - likelihood.values) / 2e-5, rel=1e-6, abs=2e-7)
    assert gradient == pytest.approx(patterns.multiplicity @ scores, abs=1e-11)


@given(seeds, st.floats(0.05, 2.0))
def test_many_nodes_give_the_integral(seed, s):
    rng = np.random.default_rng(seed)
    rows = Rows.random(rng, n_groups=2)
    beta = rng.normal(size=3)
    likelihood = Likelihood(rows.patterns(compress=False), Rule.hermite(101))
    likelihood(np.append(beta, s))
    for i in range(2):
        mine = rows.group == i
        eta = rows.offset[mine] + rows.design[mine] @ beta

        def density(u, eta=eta, mine=mine):
            return np.exp(reference.log_joint(u, eta, rows.successes[mine], rows.trials[mine], s))

        integral = quad(density, -12, 12, epsabs=0, epsrel=1e-12, limit=400)[0] / np.sqrt(2 * np.pi)
        assert likelihood.values[i] == pytest.approx(np.log(integral), abs=1e-8)


@given(seeds, sds, st.sampled_from([1, 4, 25]))
def test_the_likelihood_is_even_in_the_standard_deviation(seed, s, n_nodes):
    rng = np.random.default_rng(seed)
    likelihood = Likelihood(Rows.random(rng).patterns(), Rule.hermite(n_nodes))
    theta = np.append(rng.normal(size=3), s)
    value, gradient = likelihood(theta)
    mirrored = theta * [1, 1, 1, -1]
    other, other_gradient = likelihood(mirrored)
    assert other == pytest.approx(value, rel=1e-13)
    assert other_gradient * [1, 1, 1, -1] == pytest.approx(gradient, rel=1e-8, abs=1e-10)


@given(seeds, st.sampled_from([1, 2, 25]))
def test_without_variance_every_rule_is_the_logistic_regression(seed, n_nodes):
    rng = np.random.default_rng(seed)
    rows = Rows.random(rng)
    beta = rng.normal(size=3)
    patterns = rows.patterns()
    value, gradient = Likelihood(patterns, Rule.hermite(n_nodes))(np.append(beta, 0.0))
    want = reference.pooled(beta, rows.design, rows.offset, rows.successes, rows.trials) + patterns.constant
    assert value == pytest.approx(want, rel=1e-12)
    assert gradient[-1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("s", [3.0, 40.0, 400.0, -400.0])
@pytest.mark.parametrize("shift", [0.0, 30.0, -900.0])
def test_extreme_parameters_stay_finite_and_equal_the_specification(s, shift):
    rows = Rows.random(np.random.default_rng(5), most_trials=9)
    theta = np.array([0.5 + shift, 1.0, -1.0, s])
    likelihood = Likelihood(rows.patterns(), Rule.hermite(25))
    value, gradient = likelihood(theta)
    want = reference.log_likelihood(theta, rows.design, rows.offset, rows.successes, rows.trials, rows.group, 25)
    assert value - likelihood.patterns.constant == pytest.approx(want, rel=1e-9)
    assert np.all(np.isfinite(gradient))


def test_large_counts_take_the_other_path_to_the_same_value():
    rng = np.random.default_rng(3)
    n = 12
    trials = np.full(n, 500.0)
    rows = Rows(
        np.ones((n, 1)), np.zeros(n), rng.binomial(500, 0.3, n) * 1.0, trials, np.ones(n), np.arange(n) // 3
    )
    theta = np.array([-0.8, 0.7])
    patterns = rows.patterns()
    value, gradient = Likelihood(patterns, Rule.hermite(25))(theta)
    want = reference.log_likelihood(theta, rows.design, rows.offset, rows.successes, trials, rows.group, 25)
    assert value - patterns.constant == pytest.approx(want, rel=1e-12)
    h = 1e-6
    for i, e in enumerate(np.eye(2)):
        up, down = (Likelihood(patterns, Rule.hermite(25))(theta + sign * h * e)[0] for sign in (1, -1))
        assert gradient[i] == pytest.approx((up - down) / (2 * h), rel=1e-5)


@pytest.mark.parametrize("s", [4.0, 10.0, 50.0, -10.0])
def test_guarded_search_finds_modes_where_plain_newton_cycles(s):
    eta, y, m = np.full(3, -4.0), np.ones(3), np.ones(3)

    def plain(u):
        p = 1 / (1 + np.exp(-eta - s * u))
        return u + (s * np.sum(y - p) - u) / (1 + s * s * np.sum(p * (1 - p)))

    u, want = 0.0, reference.mode(eta, y, m, s)
    for _ in range(60):
        u = plain(u)
    assert min(abs(u - want), abs(plain(u) - want)) > 0.1  # what the guard is for
    likelihood = Likelihood(
        Patterns.from_rows(np.ones((3, 1)), eta + 4, y, m, m, np.zeros(3, int)), Rule.hermite(1)
    )
    for guess in (0.0, -30.0, 30.0, 5.0):
        likelihood.modes[:] = guess
        likelihood(np.array([-4.0, s]))
        assert likelihood.modes[0] == pytest.approx(want, rel=1e-10)


@pytest.mark.parametrize("bad", [np.inf, -np.inf, np.nan, 1e308])
@pytest.mark.parametrize("position", [0, 3])
def test_a_call_without_a_finite_value_spoils_none_after_it(bad, position):
    patterns = Rows.random(np.random.default_rng(8)).patterns()
    theta = np.array([0.3, -0.5, 0.4, 1.2])
    fresh, used = Likelihood(patterns, Rule.hermite(5)), Likelihood(patterns, Rule.hermite(5))
    used(np.where(np.arange(4) == position, bad, theta))
    value, gradient = used(theta)
    want, want_gradient = fresh(theta)
    assert value == pytest.approx(want, rel=1e-13)
    assert gradient == pytest.approx(want_gradient, rel=1e-10, abs=1e-11)


@given(seeds)
def test_where_the_calls_before_were_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    used = Likelihood(Rows.random(rng).patterns(), Rule.hermite(7))
    for scale in (0.01, 0.1, 1.0, 5.0, 1e-6, 0.0):
        theta = np.append(rng.normal(size=3), 1.3) + scale * rng.normal(size=4)
        value, gradient = used(theta)
        want, want_gradient = Likelihood(used.patterns, used.rule)(theta)
        assert value == pytest.approx(want, rel=1e-13)
        assert gradient == pytest.approx(want_gradient, rel=1e-9, abs=1e-10)


@given(seeds)
def test_the_hessian_is_the_derivative_of_the_gradient(seed):
    rng = np.random.default_rng(seed)
    likelihood = Likelihood(Rows.random(rng).patterns(), Rule.hermite(9))
    theta = np.append(rng.normal(size=3), 1.3)
    hessian = likelihood.hessian(theta)
    h = 1e-4
    for i, e in enumerate(np.eye(4)):
        near = (likelihood(theta + h * e)[1] - likelihood(theta - h * e)[1]) / (2 * h)
        far = (likelihood(theta + 2 * h * e)[1] - likelihood(theta - 2 * h * e)[1]) / (4 * h)
        assert hessian[i] == pytest.approx((4 * near - far) / 3, rel=1e-6, abs=1e-6)
    assert np.array_equal(hessian, hessian.T)


@given(seeds)
def test_pooled_regression_is_that_of_statsmodels(seed):
    from statsmodels.genmod.families import Binomial
    from statsmodels.genmod.generalized_linear_model import GLM

    rows = Rows.random(np.random.default_rng(seed), n_groups=40)
    beta, value = pooled_logistic(rows.patterns())
    outcome = np.column_stack([rows.successes, rows.trials - rows.successes])
    fit = GLM(outcome, rows.design, family=Binomial(), offset=rows.offset).fit(tol=1e-12)
    assert beta == pytest.approx(fit.params, abs=1e-7)
    assert value == pytest.approx(fit.llf, rel=1e-10)
