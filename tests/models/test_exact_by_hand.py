"""The mixed model's exact likelihood on groups made by hand: values, derivatives, and where the line is cut.

Small and quick, also where kernels are interpreted.
"""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import expit, log_expit

from models import glmm_exact
from models.glmm_data import Patterns
from models.glmm_exact import CLOSE, MARKS, NEAR_MODE, NEGLIGIBLE, WIDTHS, ExactLikelihood, exact_log_likelihood
from tests.models.quadrature_cases import GROUPS, differences, patterns_of
from tests.reference import glmm_exact as exact_reference


@pytest.mark.parametrize("s", [0.0, 0.4, 0.6, -2.0, 40.0])
@pytest.mark.parametrize("name", ["one outcome", "single outcomes", "some of several"])
def test_the_exact_likelihood_and_every_derivative(name, s):
    patterns = patterns_of(*GROUPS[name])
    theta = np.append(np.array(GROUPS[name][0], float), s)
    likelihood = ExactLikelihood(patterns)
    value, gradient = likelihood(theta)
    assert exact_log_likelihood(patterns, theta) == value
    assert value == pytest.approx(exact_reference.exact_log_likelihood(patterns, theta), rel=1e-10, abs=1e-10)
    slopes = differences(lambda t: exact_reference.exact_log_likelihood(patterns, t), theta, 1e-4)
    np.testing.assert_allclose(gradient, slopes, rtol=2e-5, atol=2e-6 * max(1.0, sum(GROUPS[name][2])))
    np.testing.assert_allclose(likelihood.scores[0], gradient, rtol=1e-14)
    assert likelihood.calls == 1


def test_the_exact_likelihood_adds_groups_up():
    design = np.array([[1, 0.5], [1, -0.2], [1, 0.1], [1, 0.5], [1, -0.2], [1, 2.0], [1, 1.0]])
    offset = np.array([0.0, 0.3, -0.3, 0.0, 0.3, 0.1, 0.0])
    hits, m = np.array([1.0, 0, 2, 1, 0, 0, 1]), np.array([1.0, 2, 3, 1, 2, 1, 1])
    patterns = Patterns.from_rows(design, offset, hits, m, np.ones(7), np.array([0, 0, 1, 2, 2, 3, 3]))
    for theta in (np.array([0.2, -0.6, 1.3]), np.array([9.0, -0.6, 30.0]), np.array([-9.0, 3.0, 3.0])):
        value, gradient = ExactLikelihood(patterns)(theta)
        plain = lambda t: exact_reference.exact_log_likelihood(patterns, t)  # noqa: E731
        assert value == pytest.approx(plain(theta), rel=1e-11)
        np.testing.assert_allclose(gradient, differences(plain, theta, 1e-4), rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("s", [0.05, 0.3, -0.8, 3.0, 12.0])
@pytest.mark.parametrize("trials", [80, 1000, 100_000])
def test_the_exact_likelihood_of_many_trials(trials, s):
    """However narrow the integrand: its width, not a standard deviation, is what the line is cut by."""
    for hits in (0, trials // 50, trials // 2, trials):
        for eta in (-4.0, 0.0, 1.3):
            patterns = patterns_of([eta, 0.5], [hits, trials - hits], [trials, trials])
            theta = np.array([eta, 0.5, s])
            value, gradient = ExactLikelihood(patterns)(theta)
            want = exact_reference.exact_log_likelihood(patterns, theta)
            assert value - patterns.constant == pytest.approx(want - patterns.constant, rel=1e-13, abs=2e-10)
            slopes = differences(lambda t, p=patterns: exact_log_likelihood(p, t), theta)
            np.testing.assert_allclose(gradient, slopes, rtol=1e-6, atol=1e-8 * trials + 1e-5)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(1, 6), st.floats(0.01, 50), st.sampled_from([1.0, 20.0, 2000.0]))
def test_the_exact_likelihood_of_any_group(seed, n_rows, s, largest):
    rng = np.random.default_rng(seed)
    trials = np.ceil(largest ** rng.uniform(0, 1, n_rows))
    eta = rng.normal(0, rng.choice([0.5, 3.0, 30.0]), n_rows)
    hits = np.where(rng.random(n_rows) < 0.3, 0.0, rng.binomial(trials.astype(int), rng.random(n_rows)))
    patterns, theta = patterns_of(eta, hits, trials), np.append(eta, s)
    want = exact_reference.exact_log_likelihood(patterns, theta)
    rounded = 1e-15 * (trials @ (1 + np.abs(eta)))  # of the terms that are added up
    assert exact_log_likelihood(patterns, theta) == pytest.approx(want, rel=1e-11, abs=1e-11 + rounded)


def test_the_line_is_cut_in_the_modes_own_widths_and_at_every_edge():
    """Every cut by hand: widths from the mode, growing steps, marks around edges, none closer than half a width."""
    eta, hits, trials = np.array([1.0, -6.0]), np.array([400.0, 0.0]), np.array([1000.0, 1.0])
    for s in (0.5, -3.0):
        mode, width, top = glmm_exact._peak(eta, hits, trials, 0, 2, s)
        grid = np.linspace(mode - 3 * width, mode + 3 * width, 2001)
        heights = np.array([plain_log_integrand(u, eta, hits, trials, s) for u in grid])
        assert abs(grid[heights.argmax()] - mode) < 0.02 * width
        assert top == pytest.approx(plain_log_integrand(mode, eta, hits, trials, s), abs=1e-9)
        middle = len(grid) // 2
        bend = (heights[middle + 50] - 2 * heights[middle] + heights[middle - 50]) / (grid[50] - grid[0]) ** 2
        assert width == pytest.approx(1 / np.sqrt(-bend), rel=0.01)
        cuts = glmm_exact._cuts(eta, hits, trials, 0, 2, s, MARKS, mode, width, top)
        assert (np.diff(cuts) > CLOSE * min(width, 1 / abs(s))).all()
        for end, inside in ((cuts[0], -1), (cuts[-1], 1)):
            fallen = top - plain_log_integrand(end, eta, hits, trials, s)
            assert fallen >= NEGLIGIBLE  # no more than a tenth of the way beyond
            before = top - plain_log_integrand(mode + 0.9 * (end - mode), eta, hits, trials, s)
            assert before <= NEGLIGIBLE, inside
        wanted = [mode, *(mode + k * width for k in range(-WIDTHS, WIDTHS + 1))]
        wanted += [(m + edge - 1.0) / s for m in MARKS for edge in (np.log(400), -np.log(600))]
        wanted = [u for u in wanted if cuts[0] < u < cuts[-1]]
        assert max(np.abs(cuts - u).min() for u in wanted) <= CLOSE * min(width, 1 / abs(s))


ROWS = np.array([9.0, 1.0, -6.0, 0.5, 0.0, 5.0, 2.5, -3.0, 9.0])
HITS = np.array([9.0, 400.0, 0.0, 7.0, 0.0, 1.0, 30_000.0, 0.0, 9.0])
TRIALS = np.array([9.0, 1000.0, 1.0, 7.0, 12.0, 1.0, 100_000.0, 90.0, 9.0])
"""Rows of several groups in one array, of which kernels are given some."""


@pytest.mark.parametrize("s", [0.0, 0.02, 0.5, -3.0, 30.0, -200.0])
@pytest.mark.parametrize("rows", [slice(1, 3), slice(3, 5), slice(5, 6), slice(6, 8), slice(0, 9), slice(3, 4)])
def test_every_cut_of_the_line(rows, s):
    """The peak and its width, where the integrand has become negligible, and the cuts in between, all of them."""
    eta, hits, trials = ROWS[rows], HITS[rows], TRIALS[rows]
    given = ROWS, HITS, TRIALS, rows.start, rows.stop, s
    mode, width, top = glmm_exact._peak(*given)
    p = expit(eta + s * mode)
    assert width == pytest.approx((1 + s * s * np.sum(trials * p * (1 - p))) ** -0.5, rel=1e-12)
    step = (s * np.sum(hits * expit(-eta - s * mode) - (trials - hits) * p) - mode) * width**2
    assert abs(step) <= NEAR_MODE * width
    assert top == pytest.approx(plain_log_integrand(mode, eta, hits, trials, s), rel=1e-12, abs=1e-12)
    ends = [glmm_exact._end(*given, mode, sign * width, top) for sign in (-1, 1)]
    for sign, end in zip((-1, 1), ends, strict=True):
        assert np.sign(end) == sign
        fallen = [top - plain_log_integrand(mode + part * end, eta, hits, trials, s) for part in (1.0, 0.89)]
        assert fallen[1] < NEGLIGIBLE <= fallen[0] * (1 + 1e-12)
    cuts = glmm_exact._cuts(*given, MARKS, mode, width, top)
    np.testing.assert_allclose(
        cuts, exact_reference.cut_line(eta, hits, trials, s, mode, width, *ends), rtol=1e-12, atol=1e-12
    )


@pytest.mark.parametrize("far", [0.3, 1.0, 7.0])
def test_steps_do_not_grow_beyond_one_standard_deviation(far):
    """Whatever the width; marks that are nowhere leave the steps alone."""
    nothing = np.zeros(1)
    for width in (0.004, 0.2, 0.9, 1.0):
        top = plain_log_integrand(far, nothing, nothing, nothing, 0.0)
        cuts = glmm_exact._cuts(nothing, nothing, nothing, 0, 1, 0.0, MARKS, far, width, top)
        ends = [glmm_exact._end(nothing, nothing, nothing, 0, 1, 0.0, far, sign * width, top) for sign in (-1, 1)]
        wanted = exact_reference.cut_line(nothing, nothing, nothing, 0.0, far, width, *ends)
        np.testing.assert_allclose(cuts, wanted, rtol=1e-12, atol=1e-12)
        assert np.diff(cuts).max() < 1.0 + width / 2 + 1e-12  # a whole step, and one too near to the end


@pytest.mark.parametrize("x", [0.0, 1e-9, 0.5, 3.0, 40.0, 800.0])
def test_both_probabilities_and_what_they_add_up_to_in_logarithms(x):
    for sign in (1, -1):
        softplus, p, q = glmm_exact._logistic(sign * x)
        assert softplus == pytest.approx(np.logaddexp(0, sign * x), rel=1e-14)
        assert (p, q) == pytest.approx((expit(sign * x), expit(-sign * x)), rel=1e-14, abs=0)


def plain_log_integrand(u, eta, hits, trials, s):
    x = eta + s * u
    return np.sum(hits * log_expit(x) + (trials - hits) * log_expit(-x)) - 0.5 * u * u
