"""Groups: tables tied or not, the same likelihood as group by group, refusals."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from analysis.simulate import simulate_study1
from models.bayesian_fit import fit
from models.errors import InputError
from models.groups import (
    TABLES,
    EmptyGroupWarning,
    GroupedLayout,
    Groups,
    ManyGroupsWarning,
    SmallGroupWarning,
)
from models.histories import UNSEEN
from models.hmm_density import HmmDensity
from models.nuts import NutsSettings
from models.parameters import DirichletPrior, Layout
from models.person_offset import PersonOffset
from models.protocol import PUBLISHED
from models.study_density import ModelSpec, StudyDensity
from tests.models.test_protocol import THREE
from tests.models.test_simulation import design_of
from tests.random_cases import random_run, random_tables
from tests.reference import recursions

PRIOR = DirichletPrior(initial=1.5, transition=1.2, emission=2.0, stay=1.0)
SOME_DIFFER = [("initial",), ("emission",), ("transition",), ("initial", "emission"), ("transition", "initial")]


def study(protocol, differ, seed=1, n_groups=3, people=None, pins=None):
    rng = np.random.default_rng(seed)
    runs = [random_run(rng, protocol, int(k), 0.2) for k in rng.integers(1, 6, size=30)]
    log = design_of(runs, protocol)
    group = np.concatenate([np.arange(n_groups), rng.integers(n_groups, size=len(runs) - n_groups)])
    groups = Groups("age", tuple("abc"[:n_groups]), group, differ)
    return StudyDensity(log, ModelSpec(2, PRIOR, pins or {}, groups, people)), runs


@given(st.sampled_from(SOME_DIFFER), st.integers(0, 1000), st.sampled_from([PUBLISHED, THREE]))
def test_the_likelihood_is_that_of_every_group_under_its_own_tables(differ, seed, protocol):
    made, runs = study(protocol, differ, seed)
    rng = np.random.default_rng(seed)
    own = [random_tables(rng, protocol, 2) for _ in range(3)]
    shared = random_tables(rng, protocol, 2)
    tables = [[g[i] if TABLES[i] in differ else shared[i] for i in range(3)] for g in own]
    full = np.concatenate([np.concatenate([t[i].ravel() for t in tables]) for i in range(3)])
    layout = made.layout
    theta = np.empty(layout.size)
    theta[layout.index] = full
    np.testing.assert_array_equal(theta[layout.index], full)  # tied entries agree, so nothing was overwritten
    wanted = [
        recursions.log_likelihood(run, *tables[g], Layout(protocol, 2).emission_index)
        for run, g in zip(runs, made.spec.groups.run_group, strict=True)
    ]
    np.testing.assert_allclose(made.log_likelihoods(theta), wanted, rtol=1e-10, atol=1e-12)
    for i, table in enumerate(layout.unpack(theta)):
        np.testing.assert_array_equal(table.ravel(), np.concatenate([t[i].ravel() for t in tables]))


@pytest.mark.parametrize("differ", SOME_DIFFER)
@pytest.mark.parametrize("people", [None, PersonOffset(nodes=5)])
def test_the_gradient_is_that_of_the_value(differ, people):
    density = study(PUBLISHED, differ, people=people, pins={"signal": None})[0].density
    x = np.random.default_rng(3).normal(size=density.dimension)
    _, gradient = density(x)
    for i in range(len(x)):
        step = np.zeros(len(x))
        step[i] = 1e-5
        slope = (8 * (density(x + step)[0] - density(x - step)[0])
                 - (density(x + 2 * step)[0] - density(x - 2 * step)[0])) / 12e-5  # fmt: skip
        assert gradient[i] == pytest.approx(slope, rel=1e-6, abs=1e-6)


def test_equal_tables_in_all_groups_give_the_plain_likelihood():
    made, _ = study(PUBLISHED, ("initial", "emission"))
    plain = HmmDensity(made.log.tree(), made.layout.base, made.density.alpha, {})
    theta = plain.theta(np.random.default_rng(1).normal(size=plain.dimension))
    grouped = made.log_likelihoods(made.layout.tied(theta))
    np.testing.assert_allclose(
        grouped, StudyDensity(made.log, ModelSpec(2, PRIOR)).log_likelihoods(theta), rtol=1e-12
    )


def test_only_differing_tables_are_learned_once_a_group():
    layout = GroupedLayout(PUBLISHED, 3, ("a", "b"), ("initial",))
    base = Layout(PUBLISHED, 3)
    assert layout.size == base.size + 3
    assert layout.row_kinds.count("initial") == 2
    assert GroupedLayout(PUBLISHED, 3, ("a", "b"), ("transition",)).size == base.size + 4 * 9


def test_a_fit_finds_groups_that_start_differently():
    """Half of the people start helpful, half do not; everything else is shared."""
    log = simulate_study1(participants=1600, seed=3)
    first_response = log.response[log.offsets[:-1] + np.array(
        [np.argmax(log.response[a:b] >= 0) for a, b in zip(log.offsets[:-1], log.offsets[1:], strict=True)]
    )]  # fmt: skip
    groups = Groups.by_person(
        log,
        {int(p): ("late", "early")[int(r)] for p, r in zip(log.participant, first_response, strict=True)},
        "kind",
    )
    posterior = fit(log, 2, groups=groups, sampler=NutsSettings(draws=400, tune=400, chains=2))
    early, late = (posterior.of_group(g).table("initial")[:, 1].mean() for g in ("early", "late"))
    assert early > late + 0.3
    assert posterior.of_group("early").draws().n_draws == 800
    assert "initial[s1 | early]" in posterior.summary().index
    assert "transition[help,s0,s1]" in posterior.summary().index
    with pytest.raises(InputError, match="pick one with of_group"):
        posterior.draws()
    with pytest.raises(InputError, match="group: found 'middle'"):
        posterior.of_group("middle")


def test_the_group_of_a_condition_is_its_condition():
    log = simulate_study1(participants=40)
    groups = Groups.by_condition(log)
    assert groups.labels == tuple(log.conditions)
    assert groups.tree(log).n_runs == log.n_runs
    weights = groups.emission_weights(log).reshape(4, 2)
    np.testing.assert_array_equal(weights.sum(axis=0), log.emission_weights)
    for c, name in enumerate(log.conditions):
        np.testing.assert_array_equal(weights[c], log.select(conditions=[name]).emission_weights)


@pytest.mark.parametrize(("arguments", "found"), [
    ({"differ": ("moves",)}, "found 'moves'"),
    ({"differ": ()}, "found none"),
    ({"differ": TABLES}, "found all of them"),
    ({"labels": ("a",), "run_group": np.zeros(3, int)}, "at least two groups"),
    ({"labels": ("a", "a")}, "labels that differ"),
    ({"run_group": np.array([0, 2, 1])}, "found 2, wanted 0..1"),
    ({"labels": ("a", "b", "c")}, "wanted 0..2|runs in group c"),
])  # fmt: skip
def test_groups_that_make_no_sense_are_refused(arguments, found):
    given_ = {"by": "age", "labels": ("a", "b"), "run_group": np.array([0, 1, 1]), "differ": ("initial",)}
    with pytest.raises(InputError, match=found):
        Groups(**{**given_, **arguments})


def test_people_without_a_value_and_other_logs_are_refused():
    log = simulate_study1(participants=40)
    with pytest.raises(InputError, match=r"participant 3 has no value \(nor have 37 others\)"):
        Groups.by_person(log, {1: "a", 2: "b"}, "age")
    groups = Groups.by_condition(log)
    with pytest.raises(InputError, match="runs: found 40, wanted 44, as in the log"):
        groups.tree(simulate_study1(participants=44))


def grouped(sizes, log):
    """Groups of the given numbers of people, the rest in group 0."""
    group = np.zeros(log.n_runs, dtype=np.int64)
    at = 0
    for g, size in enumerate(sizes, start=1):
        group[at : at + size] = g
        at += size
    return Groups("age", tuple(f"g{i}" for i in range(len(sizes) + 1)), group)


def test_thin_groups_are_warned_of_by_name(recwarn):
    log = simulate_study1(participants=200)
    grouped([10, 30], log).warn_of_thin_ones(log)
    assert not recwarn.list
    with pytest.warns(SmallGroupWarning, match=r"groups by age: fewer than 10 people in g1 \(9\), g3 \(2\); what"):
        grouped([9, 40, 2], log).warn_of_thin_ones(log)
    with pytest.warns(ManyGroupsWarning, match="groups by age: 12 groups, more than 10; covariates are categories"):
        grouped([10] * 11, log).warn_of_thin_ones(log)
    response = log.response.copy()
    silent = grouped([20], log)
    response[silent.run_group[log.run_of_event] == 1] = UNSEEN
    with pytest.warns(EmptyGroupWarning, match="groups by age: nobody in g1 has a recorded response"):
        silent.warn_of_thin_ones(replace(log, response=response))


def test_a_fit_of_thin_groups_warns():
    log = simulate_study1(participants=40)
    short = NutsSettings(draws=10, tune=50, chains=2)
    with pytest.warns(SmallGroupWarning):
        fit(log, 1, groups=grouped([5], log), sampler=short)
