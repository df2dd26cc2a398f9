"""The mixed analysis of variance, against R and against least squares on the long table."""

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from analysis.anova import mixed_anova
from analysis.anova_logistic import logistic_twin
from analysis.sphericity import contrasts, sphericity
from models.errors import InputError
from models.glmm import LogisticMixedModel
from tests.analysis.anova_cases import measures, oracle_data, oracle_numbers, study

TABLES = [
    ("mixed5x2", dv, f"afex_type{t}", t) for dv in ("score", "tokens", "help") for t in (2, 3)
] + [("mixed5x2_unbal", "score", f"type{t}", t) for t in (2, 3)]  # fmt: skip


def compare(table, rows):
    """Every number R prints, to 1e-8."""
    for row in rows:
        mine = table.set_index("effect").loc[row["effect"].strip()]
        assert mine["f"] == pytest.approx(row["F"], rel=1e-8)
        assert mine["p"] == pytest.approx(row["Pr(>F)"], rel=1e-8)
        assert mine["mean_square_error"] == pytest.approx(row["MSE"], rel=1e-8)
        assert mine["partial_eta_squared"] == pytest.approx(row["pes"], rel=1e-8)
        assert mine["generalized_eta_squared"] == pytest.approx(row["ges"], rel=1e-8)
        assert (mine["df1"], mine["df2"]) == (row["num Df"], row["den Df"])


@pytest.mark.parametrize(("name", "dv", "key", "ss_type"), TABLES)
def test_agrees_with_afex(shared, name, dv, key, ss_type):
    oracle = oracle_numbers(shared)
    rows = oracle["unbal"][key] if "unbal" in name else oracle[dv][key]
    compare(mixed_anova(oracle_data(shared, name, dv), ss_type).table, rows)


def test_type_matters_for_time_only_and_only_where_groups_differ_in_size(shared):
    data = oracle_data(shared, "mixed5x2_unbal")
    two, three = (mixed_anova(data, t).table.set_index("effect")["f"] for t in (2, 3))
    assert two["time"] == pytest.approx(73.11683135497, rel=1e-11)
    assert three["time"] == pytest.approx(67.19, abs=5e-3)
    assert two.drop("time").to_numpy() == pytest.approx(three.drop("time").to_numpy(), rel=1e-12)
    assert "Type II)" in mixed_anova(data, 2).notes[1]


def test_sums_of_squares_agree_with_aov(shared):
    for dv in ("score", "tokens", "help"):
        oracle, table = oracle_numbers(shared)[dv], mixed_anova(oracle_data(shared, "mixed5x2", dv)).table
        squares = [row["Sum Sq"] for row in (oracle["aov_between"][0], *oracle["aov_within"][:2])]
        assert table["sum_of_squares"].to_numpy() == pytest.approx(squares, rel=1e-8)


def test_nine_rounds_with_corrections(shared):
    oracle = oracle_numbers(shared)["nine"]
    result = mixed_anova(oracle_data(shared, "mixed5x9", within="round"))
    compare(result.table, oracle["none"])
    form = result.sphericity
    wanted = oracle["pval.adj"][0]
    assert form.greenhouse_geisser == pytest.approx(wanted["GG eps"], rel=1e-11)  # .636, not .582
    assert form.huynh_feldt == pytest.approx(wanted["HF eps"], rel=1e-11)
    for row, effect in zip(oracle["pval.adj"], ("round", "policy:round"), strict=True):
        mine = result.table.set_index("effect").loc[effect]
        assert mine["p_gg"] == pytest.approx(row["Pr(>F[GG])"], rel=1e-8)
        assert mine["p_hf"] == pytest.approx(row["Pr(>F[HF])"], rel=1e-8)
    assert np.isnan(result.table.set_index("effect").loc["policy", "p_gg"])
    assert "F(5.09, 483.51)" in result.sentence
    assert "Greenhouse-Geisser corrected" in result.sentence


def test_mauchly_against_r_whose_second_order_term_counts_times_for_contrasts(shared):
    oracle = oracle_numbers(shared)["nine"]["mauchly"][0]
    form = mixed_anova(oracle_data(shared, "mixed5x9", within="round")).sphericity
    assert form.w == pytest.approx(oracle["Test statistic"], rel=1e-10)
    assert form.p == pytest.approx(oracle["p-value"], abs=1e-8)
    # R and car write 3 p where Anderson has 3 q, q = p - 1: a slip in the small second-order term, here undone.
    q, df, log_w = 8, 95, np.log(form.w)
    rho = 1 - (2 * q**2 + q + 2) / (6 * q * df)
    z, f = -df * rho * log_w, q * (q + 1) / 2 - 1
    extra = (q + 2) * (q - 1) * (q - 2) * 3 / (288 * (df * q * rho) ** 2)
    theirs = form.p + extra * (stats.chi2.sf(z, f + 4) - stats.chi2.sf(z, f))
    assert theirs == pytest.approx(oracle["p-value"], rel=1e-9)


def test_mauchly_is_uniform_where_sphericity_holds():
    rng = np.random.default_rng(5)
    p = []
    for _ in range(1500):
        x = rng.normal(size=(18, 3))
        p.append(sphericity(x.T @ x, 18).p)
    assert stats.kstest(p, "uniform").pvalue > 0.01


# -- an outside oracle for any sizes: least squares with one column a parameter ------------------------------
def long_design(data):
    """Sum-to-zero columns of groups, times and their products; columns of people within groups."""
    n, m = data.score.shape
    k = len(data.groups)

    def coded(code, levels):
        return np.vstack([np.eye(levels - 1), -np.ones(levels - 1)])[code]

    group, time = coded(np.repeat(data.group, m), k), coded(np.tile(np.arange(m), n), m)
    both = (group[:, :, None] * time[:, None, :]).reshape(n * m, -1)
    person = np.repeat(np.eye(n), m, axis=0)
    return group, time, both, person, data.score.ravel()


def residual(y, *parts):
    x = np.column_stack(parts)
    return float(np.sum((y - x @ np.linalg.lstsq(x, y, rcond=None)[0]) ** 2))


@given(
    st.lists(st.integers(2, 6), min_size=2, max_size=4), st.integers(2, 4), st.integers(0, 1000),
    st.sampled_from([0.0, 1e6]),
)  # fmt: skip
def test_equals_least_squares_comparisons(sizes, times, seed, offset):
    frame = study(sizes, times, seed).assign(score=lambda t: t["score"] + offset)
    data = measures(frame)
    _, time, both, person, y = long_design(data)
    # Person columns span the groups: within effects are comparisons given them.
    wanted = {
        3: residual(y, person, both) - residual(y, person, time, both),
        2: residual(y, person) - residual(y, person, time),
    }
    interaction = residual(y, person, time) - residual(y, person, time, both)
    error = residual(y, person, time, both)
    for ss_type, time_squares in wanted.items():
        table = mixed_anova(data, ss_type).table.set_index("effect")
        assert table.loc["time", "sum_of_squares"] == pytest.approx(time_squares, rel=1e-5)
        assert table.loc["policy:time", "sum_of_squares"] == pytest.approx(interaction, rel=1e-5)
        assert table.loc["time", "mean_square_error"] * table.loc["time", "df2"] == pytest.approx(error, rel=1e-5)
    means = data.score.mean(axis=1)
    assert table.loc["policy", "f"] == pytest.approx(
        stats.f_oneway(*(means[data.group == g] for g in range(len(sizes)))).statistic, rel=1e-5
    )


@given(st.integers(0, 1000), st.floats(0.001, 1000), st.floats(-1e4, 1e4))
def test_scale_order_of_rows_and_labels_do_not_matter(seed, scale, shift):
    frame = study(seed=seed)
    one = mixed_anova(measures(frame))
    other = frame.assign(score=frame["score"] * scale + shift, id=frame["id"].map(lambda i: f"person {99 - i}"))
    two = mixed_anova(measures(other.sample(frac=1, random_state=seed)))
    for column in ("f", "p", "p_gg", "p_hf", "generalized_eta_squared"):
        assert two.table[column].to_numpy() == pytest.approx(one.table[column].to_numpy(), rel=1e-5, nan_ok=True)
    assert two.sphericity.w == pytest.approx(one.sphericity.w, rel=1e-5)


@given(st.integers(0, 1000), st.integers(3, 6))
def test_epsilons_lie_between_their_bounds(seed, times):
    form = mixed_anova(measures(study(times=times, seed=seed))).sphericity
    assert 1 / (times - 1) - 1e-12 <= form.greenhouse_geisser <= form.huynh_feldt <= 1
    assert 0 <= form.p <= 1


def test_two_times_are_the_difference_of_two_values():
    data = measures(study((5, 5), 2))
    change = data.score[:, 1] - data.score[:, 0]
    table = mixed_anova(data).table.set_index("effect")
    t = stats.ttest_ind(change[data.group == 0], change[data.group == 1])
    assert table.loc["policy:time", "f"] == pytest.approx(t.statistic**2)
    assert table.loc["policy:time", "p"] == pytest.approx(t.pvalue)
    assert table["p_gg"].iloc[1:].to_numpy() == pytest.approx(table["p"].iloc[1:].to_numpy(), rel=1e-14)


def test_perfectly_spherical_and_perfectly_unspherical_errors():
    assert sphericity(np.eye(4), 30).greenhouse_geisser == pytest.approx(1)
    assert sphericity(np.eye(4), 30).p == pytest.approx(1)
    line = np.zeros((4, 4))
    line[0, 0] = 1.0
    form = sphericity(line, 30)
    assert (form.greenhouse_geisser, form.w, form.p) == (0.25, 0.0, 0.0)
    assert np.isnan(sphericity(np.eye(4), 3).p)
    c = contrasts(5)
    assert c.T @ c == pytest.approx(np.eye(4))
    assert c.sum(axis=0) == pytest.approx(np.zeros(4))


def test_cells_have_means_and_pooled_intervals(shared):
    oracle = oracle_numbers(shared)["score"]["emmeans_mixed_by_time_tukey"]
    data = oracle_data(shared, "mixed5x2")
    cells = mixed_anova(data).cells.set_index(["time", "group"])
    for row in oracle:
        first, second = row["contrast"].split(" - ")
        a, b = (cells.loc[(row["time"], name)] for name in (first, second))
        assert a["mean"] - b["mean"] == pytest.approx(row["estimate"], abs=1e-8)
        # Both halves have the pooled variance of that time and 95 degrees of freedom.
        half = stats.t.ppf(0.975, row["df"]) * row["SE"] / np.sqrt(2)
        assert a["high"] - a["mean"] == pytest.approx(half, rel=1e-8)
        assert b["mean"] - b["low"] == pytest.approx(half, rel=1e-8)


def test_intervals_follow_their_level():
    data = measures(study())
    wide, narrow = (mixed_anova(data, level=level).cells for level in (0.99, 0.5))
    assert (wide["high"] - wide["low"] > narrow["high"] - narrow["low"]).all()


def test_nothing_to_test_against_is_said():
    frame = study((4, 4), 2)
    rigid = frame.assign(score=frame["policy"].str[1].astype(float) + frame["time"] * 3.0)
    with pytest.raises(InputError, match="no differences of means over time"):
        mixed_anova(measures(rigid))
    parallel = frame.assign(score=frame["id"] * 1.5 + frame["time"] * 3.0)
    with pytest.raises(InputError, match="no differences over time between people of the same policy"):
        mixed_anova(measures(parallel))


@pytest.mark.parametrize(("ss_type", "level", "message"), [(1, 0.95, "wanted 2 or 3"), (3, 1.0, "between 0 and 1")])
def test_other_types_and_levels_are_refused(ss_type, level, message):
    with pytest.raises(InputError, match=message):
        mixed_anova(measures(study()), ss_type, level)


# -- the logistic mixed model beside it -----------------------------------------------------------------------
def test_a_binary_outcome_gets_the_logistic_model(shared):
    data = oracle_data(shared, "mixed5x2", "help")
    assert "0 or 1" in mixed_anova(data).notes[-1]
    twin = logistic_twin(data, 2)
    assert (twin.ss_type, twin.title) == (2, "Logistic mixed model, likelihood-ratio tests (Type II)")
    assert twin.table["effect"].tolist() == ["policy", "time", "policy:time"]
    assert twin.table["df"].tolist() == [4, 1, 4]
    # R puts the sd of this outcome at zero too, where the model is a plain logistic regression: deviances by hand.
    y = data.score
    assert twin.sd == 0

    def deviance(cells):
        fitted = {key: np.mean(values) for key, values in cells.items()}
        return -2 * sum(
            len(v) * (stats.entropy([fitted[k], 1 - fitted[k]]) * -1) for k, v in cells.items() if 0 < fitted[k] < 1
        )

    saturated = {(g, t): y[data.group == g, t] for g in range(5) for t in range(2)}
    by_time = {t: y[:, t] for t in range(2)}
    both = twin.table.set_index("effect")["chi_squared"]
    # policy given time, and the interaction given both, add up to everything but time.
    assert both["policy"] + both["policy:time"] == pytest.approx(deviance(by_time) - deviance(saturated), rel=1e-6)


PATTERNS = {"a": (9, 4, 2, 10), "b": (5, 6, 1, 17), "c": (9, 3, 5, 8)}
"""People by group who respond 00, 01, 10, 11 at two times."""

LME4 = {
    3: {"policy": 4.864750859, "time": 1.359581229, "policy:time": 3.756586561},
    2: {"policy": 4.668100979, "time": 1.201967410, "policy:time": 3.756586561},
}
"""Likelihood ratios of PATTERNS by R 4.2.2, lme4 1.1.31: glmer, nAGQ = 25, bobyqa with rhoend 1e-10, contr.sum.

Type III leaves the columns of one effect out of `model.matrix(~ g * t)`, Type II the effect out of `~ g + t`."""


def binary_study(patterns=PATTERNS):
    rows = []
    for group, counts in patterns.items():
        for pattern, count in zip(((0, 0), (0, 1), (1, 0), (1, 1)), counts, strict=True):
            for i in range(count):
                name = f"{group}{pattern}{i}"
                rows += [{"id": name, "policy": group, "time": t, "score": y} for t, y in enumerate(pattern)]
    return pd.DataFrame(rows)


@pytest.mark.parametrize("ss_type", [2, 3])
def test_logistic_tests_of_both_types_are_those_of_lme4(ss_type):
    twin = logistic_twin(measures(binary_study()), ss_type)
    found = twin.table.set_index("effect")["chi_squared"].to_dict()
    assert found == pytest.approx(LME4[ss_type], abs=2e-6)
    assert twin.sd == pytest.approx(2.5418227, abs=2e-5)
    assert twin.ss_type == ss_type


def test_a_cell_at_the_ceiling_still_has_tests():
    """Everybody in b responds at the second time: no estimate of the interaction, but its likelihood ratio."""
    ceiling = {"a": (2, 5, 5, 8), "b": (0, 5, 0, 15), "c": (4, 6, 4, 6), "d": (2, 3, 5, 10)}
    lme4 = {  # R 4.2.2, lme4 1.1.31: as for LME4
        3: {"policy": 15.53599, "time": 3.979394, "policy:time": 7.74287},
        2: {"policy": 11.24347, "time": 0.7879604, "policy:time": 7.74287},
    }
    for ss_type, wanted in lme4.items():
        twin = logistic_twin(measures(binary_study(ceiling)), ss_type)
        found = twin.table.set_index("effect")["chi_squared"].to_dict()
        assert found == pytest.approx(wanted, abs=2e-4)
        said = " ".join(twin.notes)
        assert "policy b at time 1 (all 20 are 1)" in said
        assert "no finite estimate of some effect: its tests are of the value that the likelihood rises to" in said
        assert "left out" not in said


def test_type_three_is_the_default_and_knows_no_order_of_groups():
    turned = {group: PATTERNS[group] for group in ("c", "a", "b")}
    one, other = (logistic_twin(measures(binary_study(p))) for p in (PATTERNS, turned))
    assert one.ss_type == 3
    np.testing.assert_allclose(one.table["chi_squared"], other.table["chi_squared"], atol=1e-6)
    assert one.table["full"].tolist()[:2] == ["policy + time + policy:time"] * 2
    assert one.table["restricted"].tolist() == ["time + policy:time", "policy + policy:time", "policy + time"]


def test_other_types_of_logistic_tests_are_refused():
    with pytest.raises(InputError, match="type of the tests: found 1, wanted 2 or 3"):
        logistic_twin(measures(binary_study()), 1)


def test_an_outcome_with_other_values_has_no_logistic_model():
    with pytest.raises(InputError, match="wanted 0 or 1"):
        logistic_twin(measures(study()))


def test_a_separated_cell_is_said():
    frame = study((12, 12), 2)
    rng = np.random.default_rng(3)
    values = np.where(frame["policy"] == "g1", 1.0, rng.integers(0, 2, len(frame)).astype(float))
    twin = logistic_twin(measures(frame.assign(score=values)))
    assert "Only one value of score in policy g1 at time 0 (all 12 are 1); policy g1 at time 1" in twin.notes[0]
    assert "x1" not in " ".join(twin.notes)
    # What g1 did over time is at infinity whatever the other group did: time and interaction can be anything.
    p = twin.table.set_index("effect")["p"]
    assert p["policy"] < 1e-4
    assert p.drop("policy").isna().all()
    assert "No test of time or policy:time" in twin.notes[-1]


@pytest.mark.parametrize("other", [(9, 4, 2, 10), (3, 20, 1, 2)])
def test_infinite_cells_of_opposite_sign_leave_a_main_effect_without_test(other):
    """All of a respond at the end, all of b at the start: their changes cancel whatever c does."""
    data = measures(binary_study({"a": (0, 9, 0, 8), "b": (0, 0, 9, 8), "c": other}))
    three, two = (logistic_twin(data, t) for t in (3, 2))
    p = three.table.set_index("effect")["p"]
    assert np.isnan(p["time"])
    assert p.drop("time").notna().all()
    assert "No test of time: both models" in three.notes[-1]
    assert two.table["p"].notna().all()
    # What it would have been: no time effect costs nothing.
    group, time = np.repeat(data.group, 2), np.tile([0.5, -0.5], len(data.group))
    apart = np.column_stack([group == 0, group == 1]) - 1.0 * (group == 2)[:, None]
    design = np.column_stack([np.ones(len(group)), apart, time, apart * time[:, None]])
    people = np.repeat(np.arange(len(data.group)), 2)
    full, without = (
        LogisticMixedModel(data.score.ravel(), x, people).fit(warn=False) for x in (design, np.delete(design, 3, 1))
    )
    assert full.compare_lr_test(without)[0] == pytest.approx(0.0, abs=1e-4)


def test_a_flat_cell_leaves_all_effects_their_tests():
    frame = binary_study({"a": (9, 4, 2, 10), "b": (0, 0, 12, 13)})  # all of b respond at time 0
    three, two = (logistic_twin(measures(frame), t) for t in (3, 2))
    # R 4.2.2, lme4 1.1.31: as for LME4.
    assert three.table["chi_squared"].tolist() == pytest.approx([10.22288, 14.83929, 21.25294], abs=1e-4)
    assert two.table["chi_squared"].tolist() == pytest.approx([5.086192, 5.799808, 21.25294], abs=1e-4)
    assert "policy b at time 0 (all 25 are 1)" in three.notes[0]
    assert not any("left out" in note for note in three.notes)
