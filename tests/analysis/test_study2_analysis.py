"""Outcomes and tests of study 2, against the same tests on the event log's table and against other libraries."""

from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from statsmodels.stats.proportion import proportion_confint

from analysis.anova import mixed_anova
from analysis.design import published
from analysis.posthoc import PersonValues, tukey
from analysis.printed_study2 import anova_beside, comparisons_beside, implied_errors, implied_sentence, in_words
from analysis.repeated_measures import RepeatedMeasures
from analysis.study2_analysis import analyse, comparison_rows, help_model, help_table
from analysis.study2_outcomes import (
    BELIEF,
    CUMULATIVE,
    OBSERVED,
    OUTCOMES,
    TEAM,
    by_round,
    first_and_last,
    means,
    person_values,
    relative_to,
)
from analysis.study2_policies import LS_POMDP, NEVER, PAPER
from models.errors import InputError
from models.glmm import LogisticMixedModel
from tests.analysis.study2_cases import made_up, random_study


@pytest.fixture(scope="module")
def study():
    return random_study(3)


@pytest.fixture(scope="module")
def found(study):
    return analyse(study)


# -- outcomes --------------------------------------------------------------------------------------
def test_first_and_last_are_those_of_the_event_log(study):
    """The long table of the log, through the path that any file takes, gives the same analyses."""
    frame = study.log.to_frame()
    frame["cumulative"] = frame.groupby("participant")["team_tokens"].cumsum()
    frame["help"] = (frame["observation"] == "help").astype(float)
    for key, column, rounds in ((TEAM, "team_tokens", (0, 8)), (CUMULATIVE, "cumulative", (0, 8)),
                                (OBSERVED, "help", (0, 8))):  # fmt: skip
        long = frame[frame["k"].isin(rounds)]
        data = RepeatedMeasures.from_frame(long, dv=column, between="condition", within="k", subject="participant")
        theirs = mixed_anova(data).table[["f", "p", "df1", "df2"]]
        assert mixed_anova(first_and_last(study, key)).table[["f", "p", "df1", "df2"]].to_numpy() == pytest.approx(
            theirs.to_numpy(), rel=1e-9
        )


def test_person_values_are_one_a_person(study):
    assert person_values(study, TEAM).value == pytest.approx(study.team.mean(axis=1))
    assert person_values(study, CUMULATIVE).value == pytest.approx(study.team.sum(axis=1))
    assert person_values(study, OBSERVED, "first").value == pytest.approx(study.helped[:, 0])
    with pytest.raises(InputError, match="outcome: found 'joy'"):
        person_values(study, "joy")


def test_intervals_by_round(study):
    table = by_round(study, TEAM).set_index(["policy", "round"])
    for policy in study.policies:
        values = study.team[study.of(policy)]
        low, high = stats.t.interval(0.95, len(values) - 1, values.mean(axis=0), stats.sem(values))
        assert table.loc[policy, "low"].to_numpy() == pytest.approx(low)
        assert table.loc[policy, "high"].to_numpy() == pytest.approx(high)
    shares = by_round(study, OBSERVED)
    assert shares["round"].unique().tolist() == [1, 3, 5, 7, 9]
    for row in shares.itertuples():
        low, high = proportion_confint(round(row.mean * row.n), row.n, method="wilson")
        assert (row.low, row.high) == pytest.approx((low, high), abs=1e-12)


def test_cumulative_tokens_relative_to_never(study):
    table = relative_to(study, CUMULATIVE).set_index(["policy", "round"])
    base = study.cumulative[study.of(NEVER)]
    for policy in study.policies:
        values = study.cumulative[study.of(policy)]
        for k in (0, 8):
            row = table.loc[(policy, k + 1)]
            assert row["mean"] == pytest.approx(values[:, k].mean() - base[:, k].mean())
            if policy == NEVER:
                assert row["low"] == row["high"] == 0
            else:
                welch = stats.ttest_ind(values[:, k], base[:, k], equal_var=False).confidence_interval(0.95)
                assert (row["low"], row["high"]) == pytest.approx((welch.low, welch.high))
    with pytest.raises(InputError, match="reference policy: found 'nobody'"):
        relative_to(study, CUMULATIVE, "nobody")


def test_means_hold_what_the_robot_did(study):
    table = means(study).set_index(["outcome", "policy"])
    assert set(table.index.get_level_values(0)) == {*OUTCOMES, "top_state_probability", "costly_actions", "reward"}
    own = study.of("always")
    assert table.loc[("costly_actions", "always"), "mean"] == study.costly[own].mean()
    assert np.isnan(table.loc[("costly_actions", "always"), "first"])
    assert table.loc[(BELIEF, "always"), "last"] == pytest.approx(study.believed_state[own, -1].mean())


def test_an_outcome_measured_once_has_no_first_and_last():
    short = made_up(
        np.array([[50], [52], [49], [51]]), np.array([[1], [0], [1], [1]]), names=PAPER[:2], letters="H"
    )
    with pytest.raises(InputError, match="at least two at which it is measured"):
        first_and_last(short, TEAM)
    assert "mixed ANOVA of team performance" in analyse(short).left_out


# -- tests -----------------------------------------------------------------------------------------
def test_comparisons_are_fed_one_value_a_person(study, found):
    frame = pd.DataFrame(
        {"id": np.arange(study.n_people), "policy": np.array(study.policies)[study.policy],
         "tokens": study.team.mean(axis=1)}
    )  # fmt: skip
    other = tukey(PersonValues.from_frame(frame, dv="tokens", between="policy", subject="id"))
    wanted = {frozenset((r.group, r.reference)): (abs(r.difference), r.p) for r in other.table.itertuples()}
    for row in found.tukey[TEAM].table.itertuples():
        assert (abs(row.difference), row.p) == pytest.approx(wanted[frozenset((row.group, row.reference))])
    # As printed: the other policy less the paper's own.
    with_own = [r for r in found.tukey[TEAM].table.itertuples() if r.reference == LS_POMDP]
    assert [r.group for r in with_own] == list(PAPER[1:])
    assert set(found.dunnett[TEAM].table["reference"]) == {LS_POMDP}
    rows = comparison_rows(found.tukey)
    assert len(rows) == 10 * len(OUTCOMES)
    assert {"outcome", "group", "reference", "difference", "p"} <= rows[0].keys()


def test_printed_numbers_stand_beside(found):
    table = anova_beside(found, published()).set_index(["outcome", "effect"])
    assert table.loc[("observed help", "policy"), "printed_f"] == 2.8911
    assert table.loc[("observed help", "policy"), "printed_p"] == 0.0263
    assert np.isnan(table.loc[("believed state", "policy"), "printed_f"])
    own = found.anovas[OBSERVED].table.set_index("effect")
    assert table.loc[("observed help", "time"), "simulated_f"] == own.loc["time", "f"]
    pairs = comparisons_beside(found, published()).set_index(["outcome", "policy"])
    assert pairs.loc[("mean team performance", "never"), "printed_difference"] == -12.96
    assert pairs.loc[("mean observed help", "myopic"), "printed_p"] == 0.0003
    row = found.tukey[TEAM].table.set_index(["group", "reference"]).loc[("never", LS_POMDP)]
    assert pairs.loc[("mean team performance", "never"), "simulated_difference"] == row["difference"]


def test_printed_comparisons_imply_one_standard_error():
    """What the printed p values say of the spread of people, recomputed from Tukey's distribution."""
    table = implied_errors(published())
    for row in table.itertuples():
        q = abs(row.difference) / ((row.low + row.high) / 2) * np.sqrt(2)
        digits = len(str(row.p).partition(".")[2])
        assert stats.studentized_range.sf(q, 5, 95) == pytest.approx(row.p, abs=0.75 * 10.0**-digits)
    own = table[table["measure"] == "observed help"]
    assert own["low"].max() < own["high"].min()
    assert "one error fits all of them" in implied_sentence(published())


# -- observed help ---------------------------------------------------------------------------------
def test_the_model_of_all_responses_is_that_of_its_formula(study, found):
    frame = help_table(study)
    assert frame["time"].unique().tolist() == [-0.5, -0.25, 0.0, 0.25, 0.5]
    fits = [LogisticMixedModel.from_formula(f"helped ~ {right} + (1|participant)", frame).fit(warn=False)
            for right in ("policy * time", "policy + time", "time")]  # fmt: skip
    tests = found.help_model.tests.set_index("effect")
    assert tests.loc["policy:time", "chi_squared"] == pytest.approx(2 * (fits[0].llf - fits[1].llf))
    assert tests.loc["policy", "chi_squared"] == pytest.approx(2 * (fits[1].llf - fits[2].llf))
    assert tests["df"].tolist() == [4, 4]
    assert tests.loc["policy", "p"] == pytest.approx(stats.chi2.sf(tests.loc["policy", "chi_squared"], 4))
    for row in found.help_model.odds.itertuples():
        assert row.low < row.odds_ratio < row.high
        mine, base = study.helped[study.of(row.policy)].mean(), study.helped[study.of(LS_POMDP)].mean()
        assert (row.odds_ratio > 1) == (mine > base)
    assert "Logistic mixed model of all responses" in found.help_model.sentence


def test_everybody_helps():
    rng = np.random.default_rng(2)
    flat = made_up(rng.integers(40, 60, (20, 9)), np.ones((20, 5)), rng.random((20, 9)))
    result = analyse(flat)
    assert OBSERVED not in result.anovas
    assert result.twin is None
    assert result.help_model is None
    assert set(result.anovas) == {TEAM, CUMULATIVE, BELIEF}
    assert any("not possible here" in s and "observed help" in s for s in result.sentences)
    with pytest.raises(InputError, match="values that differ"):
        help_model(flat)


def test_one_policy_under_which_everybody_helps_is_named():
    rng = np.random.default_rng(4)
    helped = rng.random((40, 5)) < 0.6
    helped[np.arange(40) % 5 == 1] = 1
    model = help_model(made_up(rng.integers(40, 60, (40, 9)), helped))
    assert model.notes[0].startswith("One outcome only under always (always helped)")


def test_a_reference_that_is_none(study):
    with pytest.raises(InputError, match="reference policy: found 'nobody'"):
        analyse(study, "nobody")


def test_chances_in_words(found):
    plain = anova_beside(found, published())
    words = in_words(plain)
    for name in ("simulated_p", "printed_p"):
        for before, after in zip(plain[name], words[name], strict=True):
            assert after == ("" if np.isnan(before) else "< .001" if before < 0.001 else f"{before:.3f}")
    assert "< .001" in set(words["printed_p"])
    pairs = in_words(comparisons_beside(found, published()))
    assert not any(v == 0 for name in pairs if "_p" in name or "dunnett" in name for v in pairs[name])


def test_sentences_name_every_outcome(found):
    assert len(found.sentences) == len(OUTCOMES)
    for sentence, own in zip(found.sentences, OUTCOMES.values(), strict=True):
        assert f"Mixed ANOVA of {own.name}" in sentence
        assert "Dunnett" in sentence


def test_figures_draw_what_the_tables_hold(study):
    from analysis.figures.study2 import claim_shares, four_panels, printed_in_place

    tables = [(o.name, o.unit, by_round(study, key)) for key, o in OUTCOMES.items()]
    figure = four_panels(tables, study.letters)
    assert len(figure.axes) == 4
    for ax, (title, _, table) in zip(figure.axes, tables, strict=True):
        assert ax.get_title(loc="left") == title
        for line, policy in zip(ax.lines, study.policies, strict=True):
            own = table[table["policy"] == policy]
            assert line.get_ydata() == pytest.approx(own["mean"])
            assert np.round(line.get_xdata()) == pytest.approx(own["round"])
    assert [t.get_text() for t in figure.figure.legends[0].get_texts()] == list(study.policies)
    shares = pd.DataFrame([
        {"claim": c, "name": c, "planner": p, "whole": c == "a", "share": s, "low": s / 2, "high": (1 + s) / 2}
        for c, s in (("a", 0.1), ("b", 0.9)) for p in ("one", "two")
    ])  # fmt: skip
    ax = claim_shares(shares)
    assert [line.get_xdata().tolist() for line in ax.lines[:2]] == [[0.1, 0.9], [0.1, 0.9]]
    bold = [t.get_text() for t in ax.get_yticklabels() if t.get_fontweight() == "bold"]
    assert bold == ["a"]
    numbers = pd.DataFrame([
        {"label": "x", "learning": k, "q05": 1, "q25": 2, "q50": 3.0, "q75": 4, "q95": 50, "printed": 7.0}
        for k in ("em", "truth")
    ])  # fmt: skip
    drawn = SimpleNamespace(ax=printed_in_place(numbers, xlabel="F", log=True))
    stars = [line for line in drawn.ax.lines if line.get_marker() == "*"]
    assert stars[0].get_xdata().tolist() == [7.0]
