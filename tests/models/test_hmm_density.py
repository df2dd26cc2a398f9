"""The density on unconstrained coordinates: value, gradient, maps there and back, draws from the prior."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from scipy import special, stats

from models.draw_kernels import constrained, history_log_likelihoods
from models.errors import InputError
from models.hmm_density import LOGIT, SIMPLEX, HmmDensity
from models.parameters import STICKY, Layout, checked_pins
from models.protocol import PUBLISHED, Response
from tests.models.test_protocol import THREE
from tests.random_cases import cases, random_run, tree_of
from tests.reference import recursions


# -- the specification -----------------------------------------------------------------------------------
def sampled_rows(density):
    """(row, slice of coordinates, is it a Beta?) in the order initial, transition, emission."""
    layout, at, out = density.layout, 0, []
    held = {layout.protocol.action(a) for a in density.pins}
    s, n_actions, _, _ = layout.sizes
    for i, row in enumerate(layout.rows):
        width = row.stop - row.start
        pinned = 1 <= i <= n_actions * s and (i - 1) // s in held
        if width == 1 or pinned:
            continue
        out.append((row, slice(at, at + width - 1), i > n_actions * s and width == 2))
        at += width - 1
    return out, at


def top_of(density):
    return int(np.argmax(density.layout.protocol.scores))


def tables_of(density, x):
    """Theta of x, complex x too, one row at a time."""
    theta = density.layout.uniform.astype(np.result_type(x, float))
    layout = density.layout
    for action, table in density.pins.items():
        held = np.eye(layout.n_states) if table is None else table
        layout.unpack(theta)[1][layout.protocol.action(action)] = held
    for row, own, beta in sampled_rows(density)[0]:
        if beta:
            p = 1 / (1 + np.exp(-x[own][0]))
            theta[row] = [1 - p, p] if top_of(density) == 1 else [p, 1 - p]
        else:
            z = np.append(x[own], -x[own].sum())
            powers = np.exp(z - z.real.max())
            theta[row] = powers / powers.sum()
    return theta


def log_jacobian(p):
    """Of the map from x to all entries but the last, by the determinant of its matrix of derivatives."""
    n = len(p)
    derivative = (np.diag(p) - np.outer(p, p)) @ np.vstack([np.eye(n - 1), -np.ones(n - 1)])
    return np.linalg.slogdet(derivative[:-1])[1]


def reference(density, runs, x):
    theta = tables_of(density, x)
    index = density.layout.emission_index
    value = sum(recursions.log_likelihood(run, *density.layout.unpack(theta), index) for run in runs)
    for row, _, beta in sampled_rows(density)[0]:
        p, alpha = theta[row], density.alpha[row]
        if beta:
            top = top_of(density)
            value += stats.beta.logpdf(p[top], alpha[top], alpha[1 - top]) + np.log(p[0]) + np.log(p[1])
        else:
            value += stats.dirichlet.logpdf(p / p.sum(), alpha) + log_jacobian(p)
    return value


def reference_gradient(density, runs, x):
    """Complex steps through likelihood, priors and Jacobians (together: alpha times log p)."""
    gradient = np.empty(len(x))
    index = density.layout.emission_index
    for i in range(len(x)):
        moved = x.astype(complex)
        moved[i] += 1e-200j
        theta = tables_of(density, moved)
        value = sum(recursions.log_likelihood(run, *density.layout.unpack(theta), index) for run in runs)
        value += sum(np.sum(density.alpha[row] * np.log(theta[row])) for row, _, _ in sampled_rows(density)[0])
        gradient[i] = value.imag / 1e-200
    return gradient


# -- random densities ------------------------------------------------------------------------------------
@st.composite
def densities(draw):
    """A density with random prior and pins, the runs behind it, and a generator for points."""
    case = draw(cases(max_states=4))
    protocol = case.protocol
    if draw(st.booleans()):  # the better response comes first
        turned = tuple(Response(r.name, -r.score) for r in protocol.responses)
        protocol = replace(protocol, responses=turned)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    names = draw(st.lists(st.sampled_from(protocol.action_names), unique=True))
    n = case.n_states
    pins = {a: None if rng.random() < 0.3 else rng.dirichlet(np.ones(n), size=n) for a in names}
    layout = Layout(protocol, n)
    alpha = 0.3 + rng.gamma(2.0, size=layout.size)
    return HmmDensity(case.tree(), layout, alpha, pins), case.runs, rng


@given(densities())
def test_the_density_is_likelihood_times_prior_times_jacobian(given_density):
    density, runs, rng = given_density
    rows, dimension = sampled_rows(density)
    assert density.dimension == dimension
    assert density.plan.kind.tolist() == [LOGIT if beta else SIMPLEX for _, _, beta in rows]
    x = 1.5 * rng.normal(size=dimension)
    value, gradient = density(x)
    assert value == pytest.approx(reference(density, runs, x), rel=1e-9, abs=1e-9)
    np.testing.assert_allclose(gradient, reference_gradient(density, runs, x), rtol=1e-9, atol=1e-9)


@given(densities())
def test_the_gradient_is_that_of_the_value(given_density):
    density, _, rng = given_density
    x = rng.normal(size=density.dimension)
    _, gradient = density(x)
    step = 1e-5
    for i in range(density.dimension):
        moved = step * np.eye(density.dimension)[i]
        slope = (density(x + moved)[0] - density(x - moved)[0]) / (2 * step)
        assert gradient[i] == pytest.approx(slope, rel=1e-6, abs=1e-6)


@given(densities())
def test_far_out_the_density_is_still_right(given_density):
    density, runs, rng = given_density
    x = rng.choice([-30.0, 30.0], size=density.dimension)
    value, gradient = density(x)
    assert np.isfinite(value)
    assert np.all(np.isfinite(gradient))
    theta = density.theta(x)
    wanted = density.constant
    index = density.layout.emission_index
    wanted += sum(recursions.log_space_likelihood(run, *density.layout.unpack(theta), index) for run in runs)
    for row, own, beta in sampled_rows(density)[0]:
        if beta:
            logs = special.log_expit([-x[own][0], x[own][0]])[:: 1 if top_of(density) == 1 else -1]
        else:
            logs = special.log_softmax(np.append(x[own], -x[own].sum()))
        wanted += density.alpha[row] @ logs
    assert value == pytest.approx(wanted, rel=1e-9)


@given(densities(), st.sampled_from([1.0, 30.0]))
def test_there_and_back(given_density, scale):
    density, _, rng = given_density
    x = scale * rng.uniform(-1, 1, size=density.dimension)
    theta = density.theta(x)
    np.testing.assert_allclose(theta, tables_of(density, x), rtol=1e-9, atol=1e-13)
    assert np.all(theta >= 0)
    assert all(theta[row].sum() == pytest.approx(1, abs=1e-12) for row in density.layout.rows)
    for action, table in checked_pins(density.layout, density.pins).items():
        held = density.layout.unpack(theta)[1][density.layout.protocol.action(action)]
        assert np.array_equal(held, table)
    np.testing.assert_allclose(density.unconstrained(theta), x, rtol=1e-9, atol=1e-9)


def test_coordinates_of_probabilities_that_round_to_one():
    """1 - p would be zero; the other entry knows better."""
    density = published(2)
    x = np.full(density.dimension, 40.0)
    theta = density.theta(x)
    assert theta.max() == 1.0
    np.testing.assert_allclose(density.unconstrained(theta), x, rtol=1e-12)


@given(densities())
@example((HmmDensity(tree_of([[(0, 0)]], THREE), Layout(THREE, 1), np.ones(Layout(THREE, 1).size), {}), [], None))
def test_a_point_of_the_prior_is_a_point(given_density):
    density, _, _ = given_density
    x = density.prior_point(3)
    assert x.shape == (density.dimension,)
    assert np.all(np.isfinite(x))
    assert np.array_equal(x, density.prior_point(3))


def published(states, pins=None, prior=STICKY):
    rng = np.random.default_rng(0)
    layout = Layout(PUBLISHED, states)
    runs = [random_run(rng, PUBLISHED, 5, 0.1) for _ in range(50)]
    return HmmDensity(tree_of(runs, PUBLISHED), layout, 1 + prior.pseudo_counts(layout), pins or {})


def test_moments_of_the_prior():
    """All means and variances within 4.5 standard errors of the Dirichlet's."""
    density = published(3, {"help": None})
    rng = np.random.default_rng(8)
    n = 4000
    theta = np.stack([density.theta(density.prior_point(rng)) for _ in range(n)])
    free = density.layout.free_entries({"help": np.eye(3)})
    assert np.ptp(theta[:, ~free], axis=0).max() == 0
    for row in density.layout.rows:
        if not free[row.start]:
            continue
        alpha = density.alpha[row]
        mean, variance = stats.dirichlet.mean(alpha), stats.dirichlet.var(alpha)
        draws = theta[:, row]
        assert np.all(np.abs(draws.mean(0) - mean) < 4.5 * np.sqrt(variance / n))
        kurtosis = np.mean((draws - mean) ** 4, axis=0) / variance**2
        assert np.all(np.abs(draws.var(0, ddof=1) / variance - 1) < 4.5 * np.sqrt((kurtosis - 1) / n))


# -- many draws at once ----------------------------------------------------------------------------------
@given(densities())
def test_kernels_over_many_draws_equal_one_at_a_time(given_density):
    density, runs, rng = given_density
    x = rng.normal(size=(2, 3, density.dimension))
    theta = constrained(density, x)
    assert theta.shape == (2, 3, density.layout.size)
    by_history = history_log_likelihoods(density.tree, density.layout, theta)
    assert by_history.shape == (2, 3, density.tree.n_histories)
    history = np.searchsorted(density.tree.terminals, density.tree.run_node)
    for i in np.ndindex(2, 3):
        assert np.array_equal(theta[i], density.theta(x[i]))
        tables = density.layout.unpack(theta[i])
        wanted = [recursions.log_likelihood(run, *tables, density.layout.emission_index) for run in runs]
        np.testing.assert_allclose(by_history[i][history], wanted, rtol=1e-10, atol=1e-12)


# -- refusals --------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("alpha", "message"),
    [
        (np.ones(3), r"prior, parameters: found \(3,\), wanted \(26,\)"),
        (np.zeros(26), "prior, parameters: found 0.0, wanted finite positive numbers"),
        (np.full(26, np.inf), "wanted finite positive numbers"),
        (np.full(26, np.nan), "wanted finite positive numbers"),
    ],
)
def test_priors_that_are_none(alpha, message):
    with pytest.raises(InputError, match=message):
        HmmDensity(tree_of([[(2, 0)]], PUBLISHED), Layout(PUBLISHED, 2), alpha, {})


def test_points_on_the_boundary_have_no_coordinates():
    density = published(2)
    theta = density.layout.uniform.copy()
    theta[:2] = 0, 1
    with pytest.raises(InputError, match=r"starting point, probability: found 0\.0, wanted positive entries"):
        density.unconstrained(theta)
