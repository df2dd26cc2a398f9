"""Study 1's regression: the table by brute force, lme4's numbers column by column, sentences of every verdict."""

import json
import math
import sys
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from analysis import bayes_twin as twin_module
from analysis.bayes_twin import Twin, bayes_twin, why_absent
from analysis.design import published
from analysis.printed_regression import consistency, implied_z, printed_terms
from analysis.quadrature_study import quadrature_study
from analysis.regression import NULL, regress
from analysis.regression_checks import by_condition, residuals
from analysis.regression_data import response_table
from analysis.regression_readings import MAIN, readings
from analysis.regression_sources import (
    LAPLACE,
    PRINTED,
    QUADRATURE,
    TWIN,
    long_form,
    of_fit,
    of_print,
    of_twin,
    side_by_side,
)
from analysis.regression_words import cautions, interaction_sentence, main_sentence, odds_sentence, rules_sentence
from models.errors import InputError
from models.histories import UNSEEN
from models.protocol import PUBLISHED
from tests.analysis.regression_cases import log_of_rows, mixed_study
from tests.analysis.report_cases import CORRIDOR, log_of, random_log


@pytest.fixture(scope="module")
def fitted():
    log = mixed_study()
    return log, regress(log)


# -- the table -------------------------------------------------------------------------------------------
def test_the_table_is_what_the_events_say(fitted):
    log, regression = fitted
    table = regression.table
    assert table.formula(table.main) == "help ~ signal + robot_help + (1|participant)"
    assert [(t.name, t.kind) for t in table.terms] == [("signal", "now"), ("robot_help", "assigned")]
    assert table.randomised
    wanted = []
    for run in range(log.n_runs):
        events = range(log.offsets[run], log.offsets[run + 1])
        names = [PUBLISHED.action_names[log.action[e]] for e in events]
        for k, e in enumerate(events):
            if log.response[e] == UNSEEN:
                continue
            condition = log.conditions[log.condition[run]]
            wanted.append(
                (
                    log.participant[run], condition, 0, k, int(log.response[e] == 1),
                    int(names[k] == "signal"), int(condition.startswith("help")), int("help" in names[:k]),
                    int(bool({"help", "no_help"} & set(names[:k]))),
                )
            )  # fmt: skip
    columns = ["participant", "condition", "sequence", "round", "help", "signal", "robot_help", "robot_help_so_far",
               "had_chance"]  # fmt: skip
    found = table.frame[columns]
    assert found.to_numpy().tolist() == [list(row) for row in wanted]
    assert (table.frame["robot_help"] > table.frame["robot_help_so_far"]).any()  # also before the first help


def test_actions_that_vary_within_people_are_taken_before_and_not_randomised():
    log = random_log(PUBLISHED, people=40, rounds=8)
    table = response_table(log)
    assert [(t.name, t.kind) for t in table.terms] == [("signal", "now"), ("help_before", "before")]
    assert not table.randomised
    assert "had_chance" in table.frame
    assert "Not randomised" in " ".join(cautions(regress(log)))


def test_what_cannot_be_regressed_is_refused_by_name():
    with pytest.raises(InputError, match="responses of the protocol: found refused, late, helped, wanted two"):
        response_table(random_log(CORRIDOR))
    one = mixed_study().select(conditions=["help+signal"])
    with pytest.raises(
        InputError, match=r"factors that vary: found none \(signal, robot_help\), wanted at least one"
    ):
        regress(one)
    always = log_of([(i, 0, "a", [("signal" if i % 2 else "no_signal", "help")] * 3) for i in range(20)])
    with pytest.raises(InputError, match="a success in all 60 trials"):
        regress(always)
    single = log_of(
        [(i, 0, "a", [("signal" if i % 2 else "no_signal", "help" if i % 3 else "no_help")]) for i in range(20)]
    )
    with pytest.raises(InputError, match="one trial in each of the 20 groups"):
        regress(single)


def test_factors_that_determine_each_other_are_refused():
    log = mixed_study().select(conditions=["help+signal", "no-help+no-signal"])
    with pytest.raises(InputError, match="'robot_help', which the other columns determine"):
        regress(log)


def test_an_empty_cell_has_no_interaction():
    log = mixed_study().select(conditions=["help+no-signal", "no-help+signal", "no-help+no-signal"])
    regression = regress(log)
    assert regression.interaction == ""
    assert "interaction" not in set(regression.tests["question"])
    assert "cannot be estimated" in interaction_sentence(regression)


# -- lme4 ------------------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def oracle(shared):
    folder = shared / "oracles" / "glmm"
    if not folder.is_dir():
        pytest.skip(f"{folder} is absent: fits by lme4 are kept outside the checkout")
    fits = {
        right: json.loads((folder / f"{name}.json").read_text(encoding="utf-8"))
        for right, name in {
            NULL: "sim540_null", "signal": "sim540_signal", "robot_help": "sim540_help",
            "signal + robot_help": "sim540", "signal + robot_help + signal:robot_help": "sim540_int",
        }.items()
    }  # fmt: skip
    return log_of_rows(pd.read_csv(folder / "sim540.csv")), fits


@pytest.mark.parametrize(("name", "quadrature", "key"), [(LAPLACE, "laplace", "nAGQ1_tight"),
                                                         (QUADRATURE, 25, "nAGQ25_tight")])  # fmt: skip
def test_columns_are_those_of_lme4(oracle, name, quadrature, key):
    log, fits = oracle
    regression = regress(log, quadrature)
    assert set(regression.fits) == set(fits)
    source = of_fit(name, regression)
    want = fits[regression.table.main][key]
    for i, term in enumerate(("signal", "robot_help"), start=1):
        row = source.terms.loc[term]
        b, se = want["coef"][term], want["se"][i]
        assert math.log(row["estimate"]) == pytest.approx(b, abs=1e-4)
        assert row["z"] == pytest.approx(b / se, rel=1.5e-3)
        assert math.log(row["high"]) == pytest.approx(b + 1.959964 * se, abs=2e-3)
        assert math.log(row["low"]) == pytest.approx(b - 1.959964 * se, abs=2e-3)
    assert source.sd[0] == pytest.approx(want["sd"], abs=1e-4)
    loglik = {right: fit[key]["logLik"] for right, fit in fits.items()}
    tests = regression.tests
    assert len(tests) == 6
    for row in tests.itertuples():
        chi2 = 2 * (loglik[row.full] - loglik[row.restricted])
        assert row.chi2 == pytest.approx(chi2, abs=5e-5)
        assert row.dAIC == pytest.approx(2 * row.df - chi2, abs=5e-5)
    wide = side_by_side([of_print(published()), source], regression).set_index("quantity")
    assert f"{math.exp(want['coef']['robot_help']):.2f}" == wide.loc["odds ratio of robot_help", name]


def test_models_are_ranked_by_aic(oracle):
    log, fits = oracle
    table = regress(log).models
    aic = {f"help ~ {right} + (1|participant)": fit["nAGQ25_tight"]["AIC"] for right, fit in fits.items()}
    assert table["AIC"].to_numpy() == pytest.approx(sorted(aic.values()), abs=1e-4)
    assert table["formula"].tolist() == sorted(aic, key=aic.get)


# -- printed ---------------------------------------------------------------------------------------------
def test_printed_numbers_are_shown_digit_by_digit(fitted):
    _, regression = fitted
    wide = side_by_side([of_print(published()), of_fit(QUADRATURE, regression)], regression)
    printed = wide[PRINTED].tolist()
    for text in ("10.42", "5.09 to 21.32", "6.44", "<0.001", "1.74", "0.94 to 3.22", "1.77", "<0.077", "43.87",
                 "\N{MINUS SIGN}40.2", "1.06"):  # fmt: skip
        assert text in printed
    assert wide[QUADRATURE].tolist().count("–") == 0


def test_whether_the_printed_numbers_can_all_be_right():
    help_line, signal_line, test_line, ratio_line, equation = consistency(published())
    assert "standard error of 0.365 and z = 6.41; 6.44 is printed, which rounding does not explain" in help_line
    assert "1.77 is printed, which agrees within rounding" in signal_line
    assert "ΔAIC = -41.87; -40.2 is printed, so the two cannot belong to one comparison" in test_line
    assert "1.06 as printed" in ratio_line
    assert "logit" in equation


def test_numbers_that_agree_are_said_to_agree():
    b, se = 0.75, 0.25
    numbers = {"odds_ratio": round(math.exp(b), 2), "ci95": [round(math.exp(b - 1.96 * se), 2),
               round(math.exp(b + 1.96 * se), 2)], "z": 3.0, "p": "0.003"}  # fmt: skip
    test = {"chi2": 10.0, "df": 1, "delta_aic": -8.0}
    made_up = {"study1": {"glmm": {"help": numbers, "signal": numbers, "help_vs_null": test}}}
    lines = consistency(made_up)
    assert all("agrees within rounding" in line for line in lines[:3])
    assert printed_terms(made_up).index.tolist() == ["robot_help", "signal"]
    error, z, least, most = implied_z(*map(float, (2.12, 1.3, 3.46)))
    assert least < z < most
    assert error == pytest.approx(math.log(3.46 / 1.3) / 3.92, rel=1e-4)


# -- words -----------------------------------------------------------------------------------------------
def test_odds_are_told_from_likelihood(fitted):
    _, regression = fitted
    found = regression.marginal["robot_help"]
    text = odds_sentence(regression, "robot_help")
    assert text.startswith("Odds, not likelihood: robot_help multiplies one person's odds by ")
    assert f"{found.probability.value / found.reference_probability.value:.2f} times as likely" in text
    odds = regression.odds_ratios.loc["robot_help", "estimate"]
    assert 1 < found.probability.value / found.reference_probability.value < found.odds_ratio.value < odds


def test_verdicts_follow_the_tests():
    strong = regress(mixed_study(people=400, robot_help=2.5, signal=0.0, seed=3))
    text = main_sentence(strong)
    assert "p < 0.001: significant at 0.05" in text
    assert "not significant at 0.05" in text
    assert "no proof that there is none" in interaction_sentence(strong)
    crossed = regress(mixed_study(people=600, robot_help=0.0, signal=0.0, interaction=3.0, seed=4))
    assert "The interaction is significant" in interaction_sentence(crossed)
    assert "no proof" not in interaction_sentence(crossed)


def test_laplace_is_called_what_it_is():
    log = mixed_study(people=400, intercept=4.0, sd=2.5, robot_help=1.0, seed=2)
    text = rules_sentence(regress(log), regress(log, "laplace"))
    assert "depends on the rule and is not the maximum" in text
    assert "Quadrature has settled" in text
    alike = log_of(  # nobody differs, so that every rule is exact
        [(i, 0, "ab"[i % 2], [("signal" if i % 2 else "no_signal", "help" if (i + k) % 2 else "no_help")
                             for k in range(4)]) for i in range(60)]
    )  # fmt: skip
    text = rules_sentence(regress(alike), regress(alike, "laplace"))
    assert "standard deviation 0.00 against 0.00" in text
    assert "is not the maximum" not in text
    assert "settled" not in text


def test_separation_is_in_the_cautions():
    runs = [
        (i, 0, "ab"[i % 2], [("signal" if i % 2 else "no_signal", "help" if i % 2 or k % 2 else "no_help")
                            for k in range(4)]) for i in range(40)
    ]  # fmt: skip
    regression = regress(log_of(runs))
    told = " ".join(cautions(regression))
    assert "SeparationWarning" in told
    assert "means anything" in told
    # Odds ratios run off, but likelihoods still can be compared.
    assert regression.odds_ratios.loc["signal", "estimate"] > 1e3
    assert not np.isfinite(regression.odds_ratios.loc["signal", "high"])
    assert regression.tests["chi2"].iloc[0] > 20


def test_without_a_maximum_there_is_no_test(fitted):
    _, regression = fitted

    class NoMaximum:
        comparable, params, aic = False, (0.0, 0.0), 0.0

    broken = replace(regression, fits={**regression.fits, NULL: NoMaximum()})
    tests = broken.tests.set_index("question")
    assert math.isnan(tests.loc["signal, alone against the null", "chi2"])
    assert tests.loc["signal, beside the others", "chi2"] == regression.tests["chi2"].iloc[0]


# -- checks and readings ---------------------------------------------------------------------------------
def test_rates_by_condition_are_the_data_and_the_model(fitted):
    log, regression = fitted
    table = by_condition(regression, log)
    frame = regression.table.frame
    for row in table.itertuples():
        part = frame[frame["condition"] == row.condition]
        assert row.rate == pytest.approx(part["help"].mean())
        predicted = regression.main.predict(part)
        assert row.predicted == pytest.approx(predicted.mean())
        assert row.predicted_low < row.predicted < row.predicted_high


def test_the_interval_of_an_average_is_that_of_one_row_where_rows_are_equal(fitted):
    from models.glmm_marginal import marginal_probabilities

    log, regression = fitted
    row = by_condition(regression, log).set_index("condition").loc["help+signal"]
    one = marginal_probabilities(regression.main, pd.DataFrame({"signal": [1], "robot_help": [1]})).iloc[0]
    assert row[["predicted", "predicted_low", "predicted_high"]].tolist() == pytest.approx(one.tolist())


def test_residuals_find_a_round_that_the_formula_misses():
    good = mixed_study(people=400)
    regression = regress(good)
    assert "show nothing against" in residuals(regression, good).sentence
    response = good.response.copy()
    last = (good.k == 4) & (response != UNSEEN)
    response[last] = (np.arange(last.sum()) % 4 == 0).astype(np.int8)
    bad = good.with_responses(response)
    found = residuals(regress(bad), bad)
    assert "round 4" in found.sentence
    assert "speak against the model" in found.sentence


def test_readings_change_what_they_say_they_change(fitted):
    _, regression = fitted
    found = readings(regression, 25)
    table = found.table.set_index(["reading", "term"])
    first = table.loc[(MAIN, "robot_help")]
    assert first["estimate"] == pytest.approx(regression.odds_ratios.loc["robot_help", "estimate"])
    assert set(found.table["reading"]) == {
        MAIN, "taken so far, not assigned", "responses after the first chance only",
        "with the round as a covariate",
    }  # fmt: skip
    after = table.loc[("responses after the first chance only", "robot_help")]
    assert after["rows"] == int((regression.table.frame["had_chance"] == 1).sum()) < first["rows"]
    assert not found.randomised["taken so far, not assigned"]
    assert "robot_help_so_far" in table.loc[("taken so far, not assigned", "signal"), "formula"]


@pytest.mark.parametrize(("low", "verdict"), [(0.5, "changes: b"), (1.2, "the same is said of its sign")])
def test_a_reading_that_changes_the_answer_is_named(low, verdict):
    from analysis.regression_readings import Readings

    rows = [{"reading": name, "term": "x", "estimate": 2.0, "low": end, "high": 4.0}
            for name, end in ((MAIN, 1.1), ("b", low))]  # fmt: skip
    assert verdict in Readings(pd.DataFrame(rows), {}, {}).sentence_of("x")


# -- the twin --------------------------------------------------------------------------------------------
def made_up_twin(**changes):
    terms = pd.DataFrame({"estimate": [2.0], "low": [1.1], "high": [4.0], "positive": [0.98]}, index=["signal"])
    values = {
        "terms": terms, "sd": 1.0, "sd_low": 0.5, "sd_high": 1.5, "divergences": 0, "max_rhat": 1.0,
        "min_ess": 900.0, "priors": "flat", "version": "9.9", "draws": 10, "chains": 2, "seed": 1,
    }  # fmt: skip
    return Twin(**(values | changes))


def test_the_column_says_that_there_is_no_twin(fitted, monkeypatch):
    _, regression = fitted
    monkeypatch.setattr(twin_module, "find_spec", lambda name: None)
    assert "bambi is not installed (the extra 'bayes-twin')" in why_absent()
    with pytest.raises(InputError, match="Bayesian twin: bambi is not installed"):
        bayes_twin(regression.table, "signal")
    wide = side_by_side([of_fit(QUADRATURE, regression), of_twin(None)], regression)
    assert wide[TWIN].iloc[0] == "not run"
    assert set(wide[TWIN].iloc[1:]) == {"–"}
    assert TWIN not in set(long_form([of_fit(QUADRATURE, regression), of_twin(None)])["source"])


@pytest.mark.parametrize("bad", [{"divergences": 3}, {"max_rhat": 1.05}, {"min_ess": 100.0}])
def test_a_twin_that_did_not_converge_says_so(fitted, bad):
    assert made_up_twin().passed
    assert "sampling passed" in made_up_twin().sentence
    failed = made_up_twin(**bad)
    assert not failed.passed
    assert "FAILED" in failed.sentence
    assert "FAILED" in side_by_side([of_twin(failed)], fitted[1])[TWIN].iloc[0]


def test_the_twin_is_shown_as_probability(fitted):
    wide = side_by_side([of_twin(made_up_twin())], fitted[1])
    assert "P(> 1) .98" in wide[TWIN].tolist()
    assert "0.50 to 1.50" in wide[TWIN].tolist()


@pytest.mark.slow
def test_the_twin_agrees_with_quadrature(fitted):
    if why_absent():
        pytest.skip(why_absent())
    _, regression = fitted
    found = bayes_twin(regression.table, regression.table.main, draws=500, tune=500, chains=2)
    ours = regression.odds_ratios
    assert found.divergences == 0
    for term in regression.terms:
        error = (np.log(ours.loc[term, "high"]) - np.log(ours.loc[term, "low"])) / 3.92
        assert abs(np.log(found.terms.loc[term, "estimate"] / ours.loc[term, "estimate"])) < 0.5 * error
    assert "bambi" in sys.modules


# -- Laplace near the ceiling ----------------------------------------------------------------------------
def test_laplace_fails_near_the_ceiling_and_quadrature_does_not():
    study = quadrature_study((0.0, 3.0), replicates=12)
    table = study.summary.set_index(["intercept", "rule"])
    assert table.loc[(3.0, "AGHQ"), "sd"] == pytest.approx(study.sd, abs=0.35)
    assert table.loc[(3.0, "Laplace"), "sd"] > 1.5 * study.sd
    assert table.loc[(0.0, "Laplace"), "sd"] == pytest.approx(study.sd, abs=0.3)
    assert table.loc[(3.0, "AGHQ"), "always"] > 0.8
    text = study.sentence
    assert f"estimated as {table.loc[(3.0, 'AGHQ'), 'sd']:.2f} by AGHQ" in text
    again = quadrature_study((0.0, 3.0), replicates=12)
    pd.testing.assert_frame_equal(study.table, again.table)
    part = quadrature_study((3.0,), replicates=3).table
    rows = study.table[(study.table["intercept"] == 3.0) & (study.table["replicate"] < 3)].reset_index(drop=True)
    pd.testing.assert_frame_equal(part, rows)


def test_a_study_of_too_few_people_is_refused():
    with pytest.raises(InputError, match="people: found 5"):
        quadrature_study(people=5)
