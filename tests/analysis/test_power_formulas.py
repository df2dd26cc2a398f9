"""Power by formula: against statsmodels, simulation and the numbers worked out for the two studies."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from statsmodels.stats.power import FTestAnovaPower

from analysis.anova import mixed_anova
from analysis.power_formulas import FTestDesign, curve_people, power, power_curve, sample_size
from analysis.power_printed import printed_sizes
from analysis.repeated_measures import RepeatedMeasures
from models.errors import InputError

TWO_BY_TWO = FTestDesign("fixed", 4, df=1)
ONE_WAY = FTestDesign("fixed", 4)
INTERACTION = FTestDesign("interaction", 5, times=2, rho=0.5)


def test_numbers_of_the_two_studies():
    """f = .25, alpha = .05, power .95, as G*Power computes them."""
    assert sample_size(TWO_BY_TWO) == 210
    assert power(TWO_BY_TWO, 200) == pytest.approx(0.940, abs=5e-4)
    assert (sample_size(ONE_WAY), sample_size(ONE_WAY, balanced=True)) == (279, 280)
    assert sample_size(FTestDesign("between", 4, times=5, rho=0.5)) == 169
    assert power(FTestDesign("between", 4, times=5, rho=0.642), 200) == pytest.approx(0.95, abs=1e-4)
    assert sample_size(INTERACTION) == 80
    assert power(FTestDesign("interaction", 5, times=2, rho=0.427), 90) == pytest.approx(0.95, abs=1e-4)
    assert sample_size(FTestDesign("interaction", 5, times=9, rho=0.5)) == 36
    assert sample_size(FTestDesign("interaction", 5, times=9, rho=0.5, epsilon=0.23)) == 90
    assert power(INTERACTION, 100) == pytest.approx(0.986, abs=5e-4)
    assert power(FTestDesign("between", 5, times=2, rho=0.5), 100) == pytest.approx(0.600, abs=5e-4)


@given(st.integers(2, 9), st.integers(12, 400), st.floats(0.05, 0.8), st.sampled_from([0.001, 0.05, 0.2]))
def test_one_way_equals_statsmodels(groups, n, f, alpha):
    theirs = FTestAnovaPower().power(f, n, alpha, k_groups=groups)
    assert power(FTestDesign("fixed", groups), n, f, alpha) == pytest.approx(theirs, rel=1e-8)


def test_number_of_people_equals_statsmodels():
    for groups, f, wanted in ((3, 0.25, 0.8), (4, 0.25, 0.95), (6, 0.1, 0.9)):
        theirs = FTestAnovaPower().solve_power(f, None, 0.05, wanted, k_groups=groups)
        assert sample_size(FTestDesign("fixed", groups), f, 0.05, wanted) == int(np.ceil(theirs - 1e-6))


designs = st.one_of(
    st.builds(FTestDesign, st.just("fixed"), st.integers(2, 6)),
    st.builds(FTestDesign, st.just("between"), st.integers(2, 6), st.integers(2, 9), st.floats(-0.1, 0.9)),
    st.builds(
        FTestDesign, st.sampled_from(["within", "interaction"]), st.integers(2, 6), st.integers(2, 9),
        st.floats(-0.1, 0.9), st.just(1.0),
    ),
)  # fmt: skip


@given(designs, st.floats(0.1, 0.6), st.floats(0.3, 0.97), st.booleans())
def test_the_number_of_people_is_the_smallest_that_does(design, f, wanted, balanced):
    n = sample_size(design, f, 0.05, wanted, balanced)
    step = design.groups if balanced else 1
    assert power(design, n, f) >= wanted
    assert n % step == 0
    if n - step >= design.fewest_people:
        assert power(design, n - step, f) < wanted


@given(designs, st.integers(20, 300), st.floats(0.02, 0.5))
def test_power_grows_with_people_and_effect_and_is_alpha_without_one(design, n, f):
    assert 0.05 < power(design, n, f) <= power(design, n + 10, f)
    assert power(design, n, f) <= power(design, n, f * 1.1)
    assert power(design, n, 1e-9) == pytest.approx(0.05, abs=1e-6)


def test_correlation_helps_within_and_hurts_between():
    for kind, better in (("within", 0.7), ("interaction", 0.7), ("between", 0.2)):
        worse = 0.9 - better
        assert sample_size(FTestDesign(kind, 4, 5, rho=better)) < sample_size(FTestDesign(kind, 4, 5, rho=worse))


@pytest.mark.parametrize("kind", ["between", "within", "interaction"])
def test_the_formulas_hold_for_simulated_studies(kind):
    """Studies with that f, rho and N, analysed by the mixed ANOVA: the share of significant tests is the power."""
    groups, times, n, rho, f, studies = 3, 4, 24, 0.4, 0.3, 1000
    rng = np.random.default_rng(3)
    effect = {
        "between": np.array([-1.0, 0, 1])[:, None] * np.ones(times),
        "within": np.array([[-1.0, 1, -1, 1]] * 3),
    }
    effect["interaction"] = np.array([-1.0, 0, 1])[:, None] * np.array([1.0, -1, 1, -1])
    mean = effect[kind] * f / np.sqrt(np.mean(effect[kind] ** 2))
    root = np.linalg.cholesky(rho + (1 - rho) * np.eye(times))
    group = np.repeat(np.arange(groups), n // groups)
    names = tuple("abc")
    hits = 0
    for _ in range(studies):
        score = mean[group] + rng.normal(size=(n, times)) @ root.T
        data = RepeatedMeasures(score, group, tuple(map(str, range(n))), names, tuple("1234"))
        p = mixed_anova(data).table["p"].to_numpy()
        hits += p[("between", "within", "interaction").index(kind)] < 0.05
    expected = power(FTestDesign(kind, groups, times, rho), n, f)
    low, high = stats.binom.ppf([0.0005, 0.9995], studies, expected)
    assert 0.2 < expected < 0.99
    assert low <= hits <= high


def test_curves():
    at = curve_people(INTERACTION, 80)
    assert at[0] == 6
    assert at[-1] == 120
    curve = power_curve(INTERACTION, at)
    assert (np.diff(curve) > 0).all()
    assert curve[at.tolist().index(80) if 80 in at else -1] >= 0.95


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"kind": "mixed", "groups": 3}, "design: found 'mixed', wanted one of fixed, between"),
        ({"kind": "fixed", "groups": 1}, "design fixed, groups: found 1, wanted at least 2"),
        ({"kind": "fixed", "groups": 4, "times": 2}, "design fixed, times: found 2, wanted 1"),
        ({"kind": "fixed", "groups": 4, "df": 4}, "design fixed, df: found 4, wanted from 1 to 3"),
        ({"kind": "between", "groups": 4, "times": 2, "df": 1}, "design between, df: found 1, wanted none"),
        ({"kind": "within", "groups": 0, "times": 2}, "design within, groups: found 0, wanted at least 1"),
        ({"kind": "within", "groups": 2, "times": 1}, "design within, times: found 1, wanted at least 2"),
        ({"kind": "within", "groups": 2, "times": 3, "rho": 1.0}, "rho: found 1.0, wanted above -0.5 and below 1"),
        ({"kind": "within", "groups": 2, "times": 3, "rho": -0.5}, "rho: found -0.5, wanted above -0.5"),
        ({"kind": "within", "groups": 2, "times": 3, "epsilon": 0.4}, "epsilon: found 0.4, wanted from 0.5"),
        ({"kind": "interaction", "groups": 2, "times": 3, "epsilon": 1.1}, "epsilon: found 1.1, wanted from 0.5"),
    ],
)
def test_impossible_designs_are_refused(arguments, message):
    with pytest.raises(InputError, match=message):
        FTestDesign(**arguments)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: power(ONE_WAY, 4), "people: found 4, wanted at least 5, more than the 4 groups"),
        (lambda: power(ONE_WAY, 40, -0.1), "effect size f: found -0.1, wanted a positive number"),
        (lambda: power(ONE_WAY, 40, 0.1, 1.0), "alpha: found 1.0, wanted between 0 and 1"),
        (lambda: sample_size(ONE_WAY, wanted=0.04), "power: found 0.04, wanted above alpha"),
        (
            lambda: sample_size(ONE_WAY, f=1e-6),
            "effect size f: found 1e-06, wanted one that 10,000,000 people show",
        ),
    ],
)
def test_impossible_questions_are_refused(call, message):
    with pytest.raises(InputError, match=message):
        call()


def test_printed_sizes_are_compared_and_never_claimed():
    result = printed_sizes()
    table = result.table
    assert (table["printed"] == table["study"].map({"study1": 200, "study2": 90})).all()
    assert not (table["n"] == table["printed"]).any()
    row = table[(table["kind"] == "between") & (table["study"] == "study1")].iloc[0]
    assert row["matching_rho"] == pytest.approx(0.642, abs=5e-4)
    row = table[(table["kind"] == "interaction") & (table["times"] == 2)].iloc[0]
    assert row["matching_rho"] == pytest.approx(0.427, abs=5e-4)
    assert row["power_at_participants"] == pytest.approx(0.986, abs=5e-4)
    row = table[(table["kind"] == "interaction") & (table["times"] == 9)].iloc[0]
    assert row["matching_epsilon"] == pytest.approx(0.229, abs=5e-4)
    for _, row in table.iterrows():
        for name in ("rho", "epsilon"):
            value = row[f"matching_{name}"]
            if np.isfinite(value):
                fixed = {"rho": row["rho"], "epsilon": row["epsilon"], name: value}
                design = FTestDesign(row["kind"], row["groups"], row["times"], **fixed)
                assert power(design, row["printed"]) == pytest.approx(0.95, abs=1e-9)
    assert "closest among the usual settings is 210" in result.sentence
    assert "closest among the usual settings is 80" in result.sentence
    assert "none can be called its own" in result.sentence
