"""Every turn of the check of the nodes: its parts (likelihoods, searches, exact values) give known numbers."""

from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from models import glmm_nodes
from models.glmm_climb import FAR
from models.glmm_data import MANY, Rule
from models.glmm_nodes import (
    COARSE_PRECISION,
    DISAGREE,
    LOWER,
    MANY_NODES,
    PRECISION,
    SETTLED,
    SMALL_STEP,
    WRONG,
    check_nodes,
)
from models.glmm_optimise import FEW_NODES, PART

FINE, COARSE = 15, FEW_NODES
SD = 2.0
TOP = np.array([0.5, -0.75, SD])
CURVATURE = np.diag([-4.0, -1.0, -25.0])
"""Standard errors a half, one and a fifth."""


@dataclass
class Part:
    """Patterns, which only count themselves."""

    n_patterns: int = 10
    cut: int = 0

    def part(self, size):
        return Part(size, cut=size)


@dataclass
class World:
    """What the replaced parts answer, and what they were asked."""

    values: dict = field(default_factory=dict)
    gradients: dict = field(default_factory=dict)
    exact: dict = field(default_factory=dict)
    ends: dict = field(default_factory=dict)
    peak: tuple = (-9.0, 3.5)
    own: float = 2.6
    climbs: list = field(default_factory=list)
    exact_asked: int = 0
    maximised: list = field(default_factory=list)

    def likelihood(self, patterns, rule):
        def call(theta):
            np.testing.assert_array_equal(theta, TOP)
            return self.values[rule.n_nodes], np.array([0.0, 0.0, self.gradients.get(rule.n_nodes, 0.0)])

        call.rule, call.patterns = rule, patterns
        return call

    def climb(self, likelihood, start, *, inverse, stop):
        np.testing.assert_array_equal(start, TOP)
        self.climbs.append((likelihood.rule.n_nodes, likelihood.patterns.cut, inverse is not None, stop))
        return SimpleNamespace(theta=np.array([0.4, 0.1, self.ends[likelihood.rule.n_nodes]]))

    def exact_value(self, patterns, theta):
        assert patterns.cut == 0  # the exact value is that of all the data
        self.exact_asked += 1
        return self.exact[float(theta[-1])]

    def exact_maximum(self, patterns, best):
        assert patterns.cut == 0
        return SimpleNamespace(value=self.peak[0], theta=np.array([0.1, 0.2, self.peak[1]]))

    def maximise(self, patterns, rule):
        self.maximised.append(rule.n_nodes)
        return SimpleNamespace(
            theta=np.array([0.3, 0.1, self.own]), top=np.array([0.0, 0.0, np.nan]), value=-3.0 - rule.n_nodes
        )


@pytest.fixture
def world(monkeypatch):
    made = World(values={FINE: -10.0, 2 * FINE + 1: -10.0, COARSE: -10.0, 2 * COARSE + 1: -10.0})
    monkeypatch.setattr(glmm_nodes, "Likelihood", made.likelihood)
    monkeypatch.setattr(glmm_nodes, "climb", made.climb)
    monkeypatch.setattr(glmm_nodes, "exact_log_likelihood", made.exact_value)
    monkeypatch.setattr(glmm_nodes, "exact_maximum", made.exact_maximum)
    monkeypatch.setattr(glmm_nodes, "maximise", made.maximise)
    return made


def best(value=-10.0, curvature=CURVATURE, boundary=False):
    coordinates = SimpleNamespace(patterns=lambda patterns: patterns)
    # The sd is the same in the parameters themselves and in working coordinates; coefficients are not.
    return SimpleNamespace(
        theta=np.array([7.0, 8.0, SD]), top=TOP, value=value, curvature=curvature, boundary=boundary,
        coordinates=coordinates,
    )  # fmt: skip


def checked(nodes=FINE, people=10, exact=True, **fit):
    return check_nodes(Part(people), Rule.hermite(nodes), best(**fit), exact)


def steps(length):
    """Gradient of the sd whose Newton step is so many standard errors long."""
    return 5.0 * length


def test_a_short_step_stands_for_a_new_fit(world):
    for length in (0.0, 0.05, -0.09):
        world.gradients[2 * FINE + 1] = steps(length)
        found = checked()
        assert (found.nodes, found.finer_nodes, found.sd, found.log_likelihood) == (FINE, 31, SD, -10.0)
        assert found.finer_sd == pytest.approx(SD + 0.2 * length)
        assert found.standard_error == pytest.approx(0.2)
        assert found.refitted is False
        assert np.isnan([found.exact, found.best_exact, found.best_sd]).all()
    assert (world.climbs, world.exact_asked, world.maximised) == ([], 0, [])


def test_on_the_boundary_nothing_is_asked(world):
    world.values.clear()
    found = checked(boundary=True)
    assert (found.finer_sd, found.refitted) == (SD, False)
    assert np.isnan([found.standard_error, found.exact]).all()


@pytest.mark.parametrize(("length", "given"), [(0.11, True), (0.99 * FAR, True), (1.01 * FAR, False)])
@pytest.mark.parametrize(("nodes", "stop"), [(FINE, PRECISION), (COARSE, COARSE_PRECISION), (12, PRECISION)])
def test_a_long_step_asks_for_a_new_fit(world, nodes, stop, length, given):
    """From the curvature at the estimate, unless the way is too long for it."""
    finer = 2 * nodes + 1
    world.values |= {nodes: -10.0, finer: -10.0}
    world.gradients[finer], world.ends[finer] = steps(-length), 2.5
    found = checked(nodes)
    assert (found.finer_sd, found.refitted, found.standard_error) == (2.5, True, pytest.approx(0.2))
    assert world.climbs == [(finer, 0, given, stop)]
    assert (world.exact_asked, world.maximised) == (0, [])


def test_how_long_a_step_may_be(world):
    world.ends[31] = 2.5
    for length, refitted in ((0.999 * SMALL_STEP, False), (1.001 * SMALL_STEP, True)):
        world.gradients[31] = steps(length)
        assert checked().refitted is refitted


def test_without_curvature_there_is_no_step(world):
    """The likelihoods are still held against each other."""
    flat = np.diag([-4.0, -1.0, 0.0])
    found = checked(curvature=flat)
    assert np.isnan([found.finer_sd, found.standard_error, found.exact]).all()
    world.values[31], world.exact[SD] = -10.5, -10.5
    found = checked(curvature=flat)
    assert (found.exact, found.best_exact, found.best_sd) == (-10.5, -9.0, 3.5)
    assert np.isnan([found.finer_sd, found.standard_error]).all()
    assert found.refitted is False
    # Of very many groups too: without curvature nothing says that the estimate would stay.
    assert checked(people=MANY + 1, curvature=flat).exact == -10.5


def test_a_curvature_of_the_wrong_sign_gives_no_standard_error(world):
    found = checked(curvature=np.diag([-4.0, -1.0, 25.0]))
    assert found.standard_error == 0.0


def test_the_exact_value_is_asked_where_the_rules_disagree(world):
    world.exact[SD] = -10.0
    for off, asked in ((0.99 * DISAGREE, 0), (-0.99 * DISAGREE, 0), (1.01 * DISAGREE, 1), (-1.01 * DISAGREE, 1)):
        world.values[31], world.exact_asked = -10.0 + off, 0
        found = checked()
        assert world.exact_asked == asked
        assert np.isnan(found.exact) == (not asked)
        assert np.isnan(found.best_exact)  # a rule that is right needs no other maximum
        world.exact_asked = 0
        assert np.isnan(checked(exact=False).exact)
        assert world.exact_asked == 0


def test_a_rule_that_is_wrong_is_held_against_the_exact_maximum(world):
    world.values[31] = -10.2
    for off, wrong in ((0.99 * WRONG, False), (1.01 * WRONG, True)):
        world.exact = {SD: -10.0 - off, 2.5: -10.0, world.own: -10.1}
        world.ends[31] = 2.5
        found = checked()
        assert found.exact == -10.0 - off
        assert (found.best_exact, found.best_sd) == pytest.approx((-9.0, 3.5) if wrong else (np.nan, np.nan),
                                                                  nan_ok=True)  # fmt: skip
        assert found.refitted is wrong  # as the maximum is elsewhere, even with a short step


def test_a_maximum_close_by_asks_for_no_new_fit(world):
    world.values[31], world.exact[SD] = -10.2, -10.2
    for above, refitted in ((0.99 * LOWER, False), (1.01 * LOWER, True)):
        world.peak = (-10.2 + above, 2.1)
        world.exact |= {2.5: -10.2, world.own: -10.3}
        world.ends[31] = 2.5
        found = checked()
        assert found.refitted is refitted
        assert found.finer_sd == (2.5 if refitted else SD)
        assert found.best_exact == -10.2 + above


@pytest.mark.parametrize(("own", "want"), [(-9.5, 2.6), (-9.7, 2.5), (-9.6, 2.5)])
def test_of_two_fits_by_the_finer_rule_the_better_one_counts(world, own, want):
    """Better by the exact value; from the estimate a search may stay on the coarser rule's own hill."""
    world.values[31] = -10.4
    world.exact = {SD: -10.5, 2.5: -9.6, 2.6: own}
    world.ends[31] = 2.5
    found = checked()
    assert world.maximised == [31]
    assert (found.finer_sd, found.refitted) == (want, True)


def test_a_coarse_rule_is_an_approximation_by_choice(world):
    """It is told how wrong it is, by many nodes where these agree; there is no search for other maxima."""
    few, many = MANY_NODES
    error = 2.0
    for apart, told in ((0.99 * SETTLED * error, "many nodes"), (1.01 * SETTLED * error, "exactly")):
        for sign in (1, -1):
            world.values |= {few: -12.0 + sign * apart, many: -12.0, 2 * COARSE + 1: -11.0}
            world.exact, world.exact_asked, world.ends[2 * COARSE + 1] = {SD: -12.3}, 0, 2.5
            world.gradients[2 * COARSE + 1] = steps(0.5)
            found = checked(COARSE)
            assert found.exact == (-12.0 if told == "many nodes" else -12.3)
            assert world.exact_asked == (told == "exactly")
            assert found.wrong
            assert np.isnan([found.best_exact, found.best_sd]).all()
            assert (found.finer_sd, found.refitted) == (2.5, True)
    assert world.maximised == []


def test_one_node_more_than_few_is_held_against_the_exact_value(world):
    nodes = FEW_NODES + 1
    world.values |= {nodes: -10.0, 2 * nodes + 1: -11.0}
    world.exact = {SD: -12.3, 2.5: -1.0, world.own: -2.0}
    world.ends[2 * nodes + 1] = 2.5
    found = checked(nodes)
    assert (found.exact, found.best_exact) == (-12.3, -9.0)


def test_many_groups_are_compared_by_a_part_of_them(world):
    world.ends = {FINE: 2.25, 31: 2.5}
    found = checked(people=MANY + 1)
    assert (found.finer_sd, found.refitted) == (SD + 0.25, True)  # the part's own estimate is another
    assert found.standard_error == pytest.approx(0.2)
    assert world.climbs == [(FINE, PART, True, PRECISION), (31, PART, True, PRECISION)]
    world.climbs.clear()
    assert checked(people=MANY).refitted is False
    assert world.climbs == []


def test_of_many_groups_small_errors_add_up_to_something_even_where_they_move_no_estimate(world):
    """The exact value is asked where the rules' gradients on the part differ by a step, and their values do."""
    world.ends = {FINE: 2.25, 31: 2.5}
    for ours, finer, asked in ((0.3, 0.39, 0), (0.3, 0.41, 1), (0.41, 0.3, 1), (0.5, 0.5, 0)):
        for value, differs in ((-10.0, False), (-10.4, True)):
            world.gradients = {FINE: steps(ours), 31: steps(finer)}
            world.values[31], world.exact, world.exact_asked = value, {SD: -10.0}, 0
            checked(people=MANY + 1)
            assert world.exact_asked == (asked and differs)
    # The part's likelihood by the rule itself counts, not the fit's, which is that of all the groups.
    world.gradients = {FINE: steps(0.3), 31: steps(0.5)}
    world.values |= {FINE: -4.0, 31: -4.0}
    world.exact_asked = 0
    checked(people=MANY + 1)
    assert world.exact_asked == 0


def test_the_table_of_rules(world, monkeypatch):
    """The parameters under each rule, then the log-likelihood."""
    monkeypatch.setattr(glmm_nodes, "unwrapped", lambda results: results)
    monkeypatch.setattr(glmm_nodes, "kept", lambda model, what, where: getattr(model, what))
    data = SimpleNamespace(param_names=("(Intercept)", "x", "sd"))
    results = SimpleNamespace(model=SimpleNamespace(data=data, patterns=Part()))
    table = glmm_nodes.node_table(results, nodes=(1, 7))
    assert table.index.tolist() == [1, 7]
    assert table.index.name == "nodes"
    assert table.columns.tolist() == ["(Intercept)", "x", "sd", "log-likelihood"]
    np.testing.assert_array_equal(table, [[0.3, 0.1, 2.6, -4.0], [0.3, 0.1, 2.6, -10.0]])
