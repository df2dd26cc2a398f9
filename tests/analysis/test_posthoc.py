"""Tukey and Dunnett: against R, scipy, adaptive quadrature and what must hold for any data."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, special, stats

from analysis.dunnett import dunnett_critical, dunnett_tail
from analysis.posthoc import PersonValues, dunnett, tukey
from models.errors import InputError
from tests.analysis.anova_cases import measures, oracle_data, oracle_numbers, study

SQUARE_ROOT_2 = np.sqrt(2)


def values(sizes=(5, 9, 4), seed=1):
    rng = np.random.default_rng(seed)
    group = np.repeat(np.arange(len(sizes)), sizes)
    names = tuple(f"g{g}" for g in range(len(sizes)))
    return PersonValues(rng.normal(size=len(group)) + 0.5 * group, group, names, "value")


# -- Tukey ---------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("dv", ["score", "tokens", "help"])
@pytest.mark.parametrize("key", ["tukey_final", "tukey_subjmeans"])
def test_tukey_agrees_with_r(shared, dv, key):
    data = oracle_data(shared, "mixed5x2", dv)
    check_tukey(
        tukey(PersonValues.at(data) if key == "tukey_final" else PersonValues.mean(data)),
        oracle_numbers(shared)[dv][key],
    )


def test_tukey_kramer_agrees_with_r(shared):
    check_tukey(
        tukey(PersonValues.at(oracle_data(shared, "mixed5x2_unbal"))),
        oracle_numbers(shared)["unbal"]["tukey_final"],
    )


def check_tukey(result, rows):
    table = result.table.set_index(["group", "reference"])
    assert len(table) == len(rows)
    for row in rows:
        mine = table.loc[tuple(row["pair"].split("-"))]
        se = mine["standard_error"]
        assert mine["difference"] == pytest.approx(row["diff"], abs=1e-10 * se)
        assert mine["p"] == pytest.approx(row["p adj"], abs=1e-8)
        # R's quantile of the studentized range is 7e-9 off (its search stops there): in standard errors.
        assert mine["low"] == pytest.approx(row["lwr"], abs=1e-8 * se)
        assert mine["high"] == pytest.approx(row["upr"], abs=1e-8 * se)


def test_each_time_and_the_mean_agree_with_contrasts_of_the_mixed_model(shared):
    oracle, data = oracle_numbers(shared)["score"], oracle_data(shared, "mixed5x2")
    rows = [
        ({**row}, tukey(PersonValues.at(data, row["time"]))) for row in oracle["emmeans_mixed_by_time_tukey"][::7]
    ]
    rows += [({**row}, tukey(PersonValues.mean(data))) for row in oracle["emmeans_mixed_marginal_tukey"][::4]]
    for row, result in rows:
        first, second = row["contrast"].split(" - ")
        mine = result.table.set_index(["group", "reference"]).loc[(second, first)]
        assert -mine["difference"] == pytest.approx(row["estimate"], rel=1e-9)
        assert mine["standard_error"] == pytest.approx(row["SE"], rel=1e-10)
        assert mine["p"] == pytest.approx(row["p.value"], abs=1e-8)
        assert mine["df"] == row["df"]


def test_feeding_all_rows_as_if_independent_would_change_the_answer(shared):
    """What is fed matters: adjusted p .034 with all 200 rows, .13 with the 100 people's means."""
    oracle, data = oracle_numbers(shared)["score"], oracle_data(shared, "mixed5x2")
    right = tukey(PersonValues.mean(data)).table.set_index(["group", "reference"]).loc[("P2", "P1"), "p"]
    everything = PersonValues(data.score.ravel(), np.repeat(data.group, 2), data.groups, "all rows")
    wrong = tukey(everything).table.set_index(["group", "reference"]).loc[("P2", "P1"), "p"]
    assert wrong == pytest.approx(oracle["tukey_allrows"][0]["p adj"], abs=1e-8)
    assert (round(wrong, 3), round(right, 2)) == (0.034, 0.13)


def test_repeated_rows_are_refused_with_the_reason():
    frame = study((4, 4), 2)
    with pytest.raises(
        InputError, match=r"row \d+: found id \d+ again, wanted one row a person: .*not independent"
    ):
        PersonValues.from_frame(frame, dv="score", between="policy", subject="id")
    one = frame[frame["time"] == 1]
    people = PersonValues.from_frame(one, dv="score", between="policy", subject="id")
    # Groups are in order of appearance, so pairs may point the other way.
    mine = np.sort(tukey(people).table["p"])
    assert mine == pytest.approx(np.sort(tukey(PersonValues.at(measures(frame), "1")).table["p"]))


@settings(max_examples=10)
@given(st.lists(st.integers(2, 9), min_size=2, max_size=4), st.integers(0, 1000))
def test_tukey_equals_scipy(sizes, seed):
    people = values(sizes, seed)
    theirs = stats.tukey_hsd(*(people.value[people.group == g] for g in range(len(sizes))))
    interval = theirs.confidence_interval(0.95)
    for row in tukey(people).table.itertuples():
        a, b = people.groups.index(row.group), people.groups.index(row.reference)
        assert row.p == pytest.approx(theirs.pvalue[a, b], abs=1e-9)
        assert (row.low, row.high) == pytest.approx((interval.low[a, b], interval.high[a, b]), rel=1e-7, abs=1e-7)


def test_two_groups_are_a_t_test():
    people = values((6, 11))
    t = stats.ttest_ind(people.value[people.group == 1], people.value[people.group == 0])
    for result in (tukey(people), dunnett(people, "g0")):
        row = result.table.iloc[0]
        assert (row["t"], row["p"]) == pytest.approx((t.statistic, t.pvalue), rel=1e-8)
        assert (row["low"], row["high"]) == pytest.approx(tuple(t.confidence_interval()), rel=1e-8)


# -- Dunnett -------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("dv", ["score", "tokens", "help"])
def test_dunnett_agrees_with_emmeans_as_far_as_its_random_integration_goes(shared, dv):
    rows = oracle_numbers(shared)[dv]["emmeans_dunnett_exact_final"]
    table = dunnett(PersonValues.at(oracle_data(shared, "mixed5x2", dv)), "P1").table.set_index("group")
    for row in rows:
        mine = table.loc[row["contrast"].split(" - ")[0]]
        assert mine["difference"] == pytest.approx(row["estimate"], rel=1e-9, abs=1e-12)
        assert mine["standard_error"] == pytest.approx(row["SE"], rel=1e-9)
        assert mine["p"] == pytest.approx(row["p.value"], abs=1e-4)
        assert mine["low"] == pytest.approx(row["lower.CL"], abs=2e-3 * row["SE"])
        assert mine["high"] == pytest.approx(row["upper.CL"], abs=2e-3 * row["SE"])


def test_the_oracles_smallest_dunnett_p_is_impossible_and_ours_is_not(shared):
    """Adjusting for four comparisons cannot make p smaller than without; R's random integration did."""
    row = oracle_numbers(shared)["tokens"]["emmeans_dunnett_exact_final"][-1]
    single = 2 * stats.t.sf(row["t.ratio"], row["df"])
    assert row["p.value"] < single
    ours = dunnett_tail(row["t.ratio"], np.full(4, 20.0), 20.0, row["df"])
    assert single < ours < 4 * single


def by_adaptive_quadrature(c, sizes, reference, df):
    load, rest = np.sqrt(sizes / (sizes + reference)), np.sqrt(reference / (sizes + reference))

    def given_scale(s):
        def inside(z):
            reach = special.ndtr((c * s - load * z) / rest) - special.ndtr((-c * s - load * z) / rest)
            return np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi) * np.prod(reach)

        return integrate.quad(inside, -11, 11, epsabs=1e-12, epsrel=1e-12, limit=400, points=(-2, 0, 2))[0]

    def weighted(s):
        return stats.chi.pdf(s * np.sqrt(df), df) * np.sqrt(df) * given_scale(s)

    low, high = stats.chi.ppf([1e-14, 1 - 1e-14], df) / np.sqrt(df)
    return 1 - integrate.quad(weighted, low, high, epsabs=1e-11, epsrel=1e-11, limit=400)[0]


@pytest.mark.parametrize(
    ("c", "sizes", "reference", "df"),
    [(2.5, [20, 20, 20, 20], 20, 95), (1.1, [3, 9, 14], 6, 28), (3.3, [40, 5], 4, 12), (0.05, [8, 8], 8, 21)],
)
def test_the_tail_equals_adaptive_quadrature(c, sizes, reference, df):
    sizes = np.array(sizes, dtype=float)
    assert dunnett_tail(c, sizes, reference, df) == pytest.approx(
        by_adaptive_quadrature(c, sizes, reference, df), abs=1e-9
    )


@pytest.mark.parametrize(
    ("comparisons", "df", "critical"),
    [(2, 5, 3.03), (4, 20, 2.65), (9, 30, 2.86), (3, 60, 2.41), (2, 10, 2.57)],
)
def test_published_critical_values(comparisons, df, critical):
    """Dunnett (1964), New tables for multiple comparisons with a control, Biometrics 20: two-sided 5%."""
    assert dunnett_critical(0.95, np.full(comparisons, 7.0), 7.0, df) == pytest.approx(critical, abs=0.0051)


@given(st.integers(0, 1000), st.integers(2, 4))
def test_dunnett_equals_scipys_random_integration(seed, groups):
    rng = np.random.default_rng(seed)
    people = values(tuple(rng.integers(3, 9, groups)), seed)
    table = dunnett(people, "g0").table
    samples = [people.value[people.group == g] for g in range(groups)]
    theirs = stats.dunnett(*samples[1:], control=samples[0], rng=np.random.default_rng(1))
    assert table["t"].to_numpy() == pytest.approx(theirs.statistic, rel=1e-9)
    assert table["p"].to_numpy() == pytest.approx(theirs.pvalue, abs=5e-3)


@given(
    st.floats(0.01, 40),
    st.lists(st.integers(1, 300), min_size=1, max_size=4),
    st.integers(1, 300),
    st.integers(1, 500),
)
def test_the_tail_lies_between_one_comparison_and_the_sum_of_all(c, sizes, reference, df):
    single = 2 * float(special.stdtr(df, -c))
    tail = dunnett_tail(c, np.array(sizes, dtype=float), float(reference), df)
    assert single * (1 - 1e-7) <= tail <= min(1.0, len(sizes) * single) * (1 + 1e-7)


@settings(max_examples=15)
@given(st.integers(0, 1000), st.sampled_from([0.5, 0.8, 0.95, 0.999]))
def test_intervals_hold_zero_exactly_where_p_says_so(seed, level):
    people = values((4, 7, 5, 3), seed)
    for table in (tukey(people, level).table, dunnett(people, "g1", level).table):
        outside = (table["low"] > 0) | (table["high"] < 0)
        assert (outside == (table["p"] < 1 - level)).all()


def test_simultaneous_intervals_cover_together_as_often_as_they_say():
    rng = np.random.default_rng(8)
    sizes, studies = (4, 9, 6), 4000
    critical = dunnett_critical(0.9, np.array([4.0, 6.0]), 9.0, 16)
    groups = [rng.normal(size=(studies, n)) for n in sizes]
    pooled = sum(g.var(axis=1, ddof=1) * (n - 1) for g, n in zip(groups, sizes, strict=True)) / 16
    t = [
        (groups[g].mean(axis=1) - groups[1].mean(axis=1)) / np.sqrt(pooled * (1 / sizes[g] + 1 / 9)) for g in (0, 2)
    ]
    hits = int((np.abs(t).max(axis=0) < critical).sum())
    low, high = stats.binom.ppf([0.001, 0.999], studies, 0.9)
    assert low <= hits <= high


# -- refusals ------------------------------------------------------------------------------------------------
def test_bad_input_is_refused():
    data = measures(study())
    with pytest.raises(InputError, match="reference level of policy: found 'P9', wanted one of "):
        dunnett(PersonValues.at(data), "P9")
    with pytest.raises(InputError, match="also 'x', as asked for"):
        PersonValues.at(data, "x")
    with pytest.raises(InputError, match="level: found 1, wanted between 0 and 1"):
        tukey(PersonValues.at(data), 1)
    same = PersonValues(np.array([1.0, 1, 2, 2]), np.array([0, 0, 1, 1]), ("a", "b"), "tokens")
    with pytest.raises(InputError, match="tokens: found one value for all people of the same group"):
        tukey(same)
    with pytest.raises(InputError, match="found 2 people in 2 groups, wanted more people"):
        tukey(PersonValues(np.array([1.0, 2]), np.array([0, 1]), ("a", "b"), "tokens"))
    one = pd.DataFrame({"id": [1, 2], "policy": ["a", "a"], "score": [1.0, 2.0]})
    with pytest.raises(InputError, match=r"column policy: found one level \(a\)"):
        PersonValues.from_frame(one, dv="score", between="policy", subject="id")
    gap = one.assign(score=[1.0, np.nan], policy=["a", "b"])
    with pytest.raises(InputError, match="column score: found no value, wanted a number"):
        PersonValues.from_frame(gap, dv="score", between="policy", subject="id")


def test_sentences_name_the_rows_and_the_sure_differences(shared):
    result = tukey(PersonValues.at(oracle_data(shared, "mixed5x2")))
    assert result.sentence.startswith(
        "Tukey, score at time final, one value a person: 4 of 10 comparisons differ at 0.05"
    )
    assert "P5 - P4 +14.5 (7.17 to 21.9)" in result.sentence
