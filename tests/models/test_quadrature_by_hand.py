"""The mixed model's quadrature on groups made by hand: every path of the kernel, every derivative, row by row.

Values are held against the rule in plain numpy and the integral on a fine even grid, derivatives against
differences of those. Small and quick, also where kernels are interpreted.
"""

import numpy as np
import pytest
from scipy.special import expit

from models.glmm_data import Likelihood, Patterns, Rule
from models.glmm_kernel import REACH, logistic
from models.glmm_nodes import DISAGREE, LOWER, TOLERATED, WRONG, NodeCheck, check_nodes
from models.glmm_optimise import maximise
from tests.models.quadrature_cases import GROUPS, differences, patterns_of
from tests.reference import glmm as reference
from tests.reference import glmm_exact as exact_reference


def rule_value(group, n_nodes):
    _, hits, m = (np.array(part, float) for part in group)
    return lambda theta: reference.group(theta[:-1], hits, m, theta[-1], n_nodes)[0]


# -- adaptive quadrature -------------------------------------------------------------------------------
@pytest.mark.parametrize("s", [0.8, -1.5, 5.0])
@pytest.mark.parametrize("n_nodes", [1, 2, 3, 6])
@pytest.mark.parametrize("name", sorted(GROUPS))
def test_value_mode_scale_and_every_derivative_of_the_rule(name, n_nodes, s):
    eta, hits, m = (np.array(part, float) for part in GROUPS[name])
    theta = np.append(eta, s)
    likelihood = Likelihood(patterns_of(*GROUPS[name]), Rule.hermite(n_nodes))
    value, gradient = likelihood(theta)
    want, mode, scale = reference.group(eta, hits, m, s, n_nodes)
    assert value - likelihood.patterns.constant == pytest.approx(want, rel=1e-10, abs=1e-10)
    assert likelihood.modes[0] == pytest.approx(mode, rel=1e-9, abs=1e-9)
    assert likelihood.scales[0] == pytest.approx(scale, rel=1e-9)
    slopes = differences(rule_value(GROUPS[name], n_nodes), theta)
    size = 1e-6 * max(1.0, m.sum(), abs(want))
    np.testing.assert_allclose(gradient, slopes, rtol=1e-5, atol=size)
    np.testing.assert_allclose(likelihood.scores[0], gradient, rtol=1e-14)
    # How the mode moves, by every predictor and by s: where the next search starts.
    moves = differences(lambda t: reference.mode(t[:-1], hits, m, t[-1]), theta)
    np.testing.assert_allclose(likelihood._drift, moves[:-1], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(likelihood._drift_in_s[0], moves[-1], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(likelihood._eta, eta, rtol=1e-15)
    assert likelihood._before[0] == s


@pytest.mark.parametrize("s", [0.05, -0.1])
@pytest.mark.parametrize("order", [[0, 1, 2], [1, 0, 2], [0, 2, 1]])
def test_a_surprise_anywhere_in_a_group_is_summed_in_logarithms(order, s):
    """Where little else is improbable, whether a product of probabilities would underflow is told by one row."""
    rows = [np.array(part, float)[order] for part in GROUPS["ten surprises among others"]]
    value, gradient = Likelihood(patterns_of(*rows), Rule.hermite(3))(np.append(rows[0], s))
    assert value - patterns_of(*rows).constant == pytest.approx(reference.group(*rows, s, 3)[0], rel=1e-12)
    assert np.isfinite(gradient).all()


@pytest.mark.parametrize("n_nodes", [2, 3, 5])
def test_a_mode_close_by_whose_nodes_are_far_is_summed_in_logarithms(n_nodes):
    """A hundred of a hundred: plain exponentials would overflow at the farthest node."""
    eta, hits, s = np.array([2.3]), np.array([100.0]), 50.0
    patterns = patterns_of(eta, hits, hits)
    value, gradient = Likelihood(patterns, Rule.hermite(n_nodes))(np.append(eta, s))
    assert value - patterns.constant == pytest.approx(reference.group(eta, hits, hits, s, n_nodes)[0], rel=1e-11)
    assert np.isfinite(gradient).all()


@pytest.mark.parametrize("n_nodes", [1, 4])
def test_groups_are_added_up_by_how_many_share_them(n_nodes):
    """Different lengths one after the other, in the same workspace; covariates, an offset, and people alike."""
    design = np.array([[1, 0.5], [1, -0.2], [1, 0.1], [1, 0.5], [1, -0.2], [1, 2.0], [1, 1.0]])
    offset = np.array([0.0, 0.3, -0.3, 0.0, 0.3, 0.1, 0.0])
    hits, m = np.array([1.0, 0, 2, 1, 0, 0, 1]), np.array([1.0, 2, 3, 1, 2, 1, 1])
    group = np.array([0, 0, 1, 2, 2, 3, 3])
    patterns = Patterns.from_rows(design, offset, hits, m, np.ones(7), group)
    assert patterns.multiplicity.tolist() == [2, 1, 1]
    likelihood = Likelihood(patterns, Rule.hermite(n_nodes))
    for theta in (np.array([0.2, -0.6, 1.3]), np.array([-0.5, 0.4, 0.7]), np.array([0.2, -0.6, 0.0])):
        value, gradient = likelihood(theta)
        plain = lambda t: reference.log_likelihood(t, design, offset, hits, m, group, n_nodes)  # noqa: E731
        assert value - patterns.constant == pytest.approx(plain(theta), rel=1e-12)
        np.testing.assert_allclose(gradient, differences(plain, theta), rtol=1e-6, atol=1e-7)
        np.testing.assert_allclose(gradient, patterns.multiplicity @ likelihood.scores, rtol=1e-13, atol=1e-15)


def test_a_search_for_the_mode_may_start_anywhere():
    eta, hits, m = (np.array(part, float) for part in GROUPS["some of several"])
    likelihood = Likelihood(patterns_of(*GROUPS["some of several"]), Rule.hermite(3))
    for s in (0.5, -3.0, 20.0):
        fresh = Likelihood(likelihood.patterns, likelihood.rule)(np.append(eta, s))
        for guess in (-1e6, -20.0, 0.1, 7.0, 1e6):
            likelihood.modes[:] = guess
            value, gradient = likelihood(np.append(eta, s))
            assert likelihood.modes[0] == pytest.approx(reference.mode(eta, hits, m, s), rel=1e-10)
            assert value == pytest.approx(fresh[0], rel=1e-13)
            np.testing.assert_allclose(gradient, fresh[1], rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("eta", [0.0, 1e-9, -3.0, 40.0, -40.0, 800.0, -800.0])
def test_both_tails_to_full_precision(eta):
    p, q = logistic(eta)
    assert p == pytest.approx(expit(eta), rel=1e-15, abs=0)
    assert q == pytest.approx(expit(-eta), rel=1e-15, abs=0)
    assert (
        REACH < 700 - 2 * 150
    )  # plain products of both outcomes' probabilities fit into a double with room to spare


# -- how much the nodes matter -------------------------------------------------------------------------
def check(**changed):
    given = {
        "nodes": 25, "finer_nodes": 51, "sd": 1.0, "finer_sd": 1.25, "standard_error": 25.0, "refitted": False,
        "log_likelihood": -10.0,
    }  # fmt: skip
    return NodeCheck(**{**given, **changed})


def test_what_a_check_says_of_itself():
    assert check().change == 0.25
    assert check(sd=1.25, finer_sd=1.0).change == -0.25
    # A change of just as much as is tolerated is not dependence; more is, in either direction.
    assert TOLERATED == 0.01
    for error, dependent in ((25.0, False), (24.9, True), (25.1, False)):
        assert check(standard_error=error).dependent == dependent
        assert check(sd=1.25, finer_sd=1.0, standard_error=error).dependent == dependent
    assert not check(standard_error=np.nan).dependent
    for off, wrong in ((WRONG * 0.99, False), (WRONG * 1.01, True)):
        assert check(exact=-10 + off).wrong == wrong
        assert check(exact=-10 - off).wrong == wrong
    assert not check().wrong
    for above, elsewhere in ((LOWER * 0.99, False), (LOWER * 1.01, True), (-1.0, False)):
        assert check(exact=-11.0, best_exact=-11 + above).elsewhere == elsewhere
    assert check(exact=0.0, log_likelihood=WRONG).wrong is False
    assert check(exact=0.0, best_exact=LOWER).elsewhere is False


def test_a_check_in_words():
    assert check().text == "sd 1 with 25 nodes, 1.25 with 51 (+2.5e-01)"
    assert check(nodes=1, finer_nodes=3).text == "sd 1 with Laplace, 1.25 with 3 (+2.5e-01)"
    found = check(exact=-10.5, best_exact=-9.25, best_sd=0.5).text
    assert found == (
        "sd 1 with 25 nodes, 1.25 with 51 (+2.5e-01)"
        "; the log-likelihood there is -10.5000 exactly, not -10.0000, and has its maximum, -9.2500, at sd 0.5"
    )
    assert check(nodes=11, exact=-10.52).text.endswith("; the log-likelihood there is about -10.5, not -10.0000")
    assert check(nodes=12, exact=-10.52).text.endswith(
        "; the log-likelihood there is -10.5200 exactly, not -10.0000"
    )
    assert "likelihood" not in check(exact=-10.01).text


def people(seed, sd, n=25, rows=4):
    rng = np.random.default_rng(seed)
    group = np.repeat(np.arange(n), rows)
    design = np.column_stack([np.ones(n * rows), rng.integers(0, 2, n * rows)]).astype(float)
    hits = (rng.random(n * rows) < expit(design @ [0.2, 0.8] + sd * rng.normal(size=n)[group])).astype(float)
    ones = np.ones(n * rows)
    return Patterns.from_rows(design, np.zeros(n * rows), hits, ones, ones, group)


def test_a_check_of_a_fit_is_that_of_a_new_fit():
    patterns = people(1, 1.5)
    for nodes, refitted in ((1, True), (15, False)):
        rule, finer = Rule.hermite(nodes), Rule.hermite(2 * nodes + 1)
        best, again = maximise(patterns, rule), maximise(patterns, finer)
        found = check_nodes(patterns, rule, best)
        assert (found.nodes, found.finer_nodes, found.refitted) == (nodes, 2 * nodes + 1, refitted)
        assert found.sd == best.theta[-1]
        assert found.log_likelihood == best.value
        error = np.sqrt(np.linalg.inv(-best.hessian)[-1, -1])
        assert found.standard_error == pytest.approx(error, rel=1e-5)
        assert found.finer_sd == pytest.approx(again.theta[-1], abs=0.02 * error)
        assert found.change != 0.0
        if nodes == 1:
            assert found.wrong == (
                abs(best.value - exact_reference.exact_log_likelihood(patterns, best.theta)) > WRONG
            )
            assert np.isnan(check_nodes(patterns, rule, best, exact=False).exact)
            truth = exact_reference.exact_log_likelihood(patterns, best.theta)
            assert found.exact == pytest.approx(truth, abs=0.05 * abs(truth - best.value))
            assert np.isnan(found.best_exact)
            assert abs(best.value - truth) > DISAGREE
        else:
            assert np.isnan(found.exact)


def test_without_variance_every_rule_agrees():
    # People who are more alike than by chance.
    ones, group = np.ones(40), np.repeat(np.arange(10), 4)
    patterns = Patterns.from_rows(ones[:, None], 0 * ones, np.tile([1.0, 0.0, 0.0, 1.0], 10), ones, ones, group)
    best = maximise(patterns, Rule.hermite(5))
    assert best.boundary
    found = check_nodes(patterns, Rule.hermite(5), best)
    assert (found.sd, found.finer_sd, found.change, found.refitted) == (0.0, 0.0, 0.0, False)
    assert np.isnan(found.standard_error)
    assert np.isnan(found.exact)
    assert not found.dependent
