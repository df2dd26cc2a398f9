"""Power by simulation: the mixed model, and the contraction of transition tables."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import optimize, special, stats

from analysis.design import study1_design
from analysis.power_contraction import (
    ALL_MOVES,
    ContractionPower,
    contraction_power,
    schedules_design,
)
from analysis.power_curves import reached, wilson_interval
from analysis.power_simulation import (
    STREAM,
    STUDY1_SD,
    STUDY1_TRUTH,
    MixedModelPower,
    _one_study,
    binary_patterns,
    coefficients_from,
    mixed_model_power,
    rows_of_table,
    study1_rows,
)
from analysis.simulate import simulate_study1
from models.errors import InputError
from models.glmm_data import Likelihood, Rule
from models.glmm_optimise import maximise
from models.lspomdp import LatentStatePOMDP
from models.nuts import NutsSettings
from models.protocol import PUBLISHED

DESIGN = study1_rows()


def settings(**changes):
    given = {
        "design": DESIGN, "coefficients": STUDY1_TRUTH, "sd": STUDY1_SD, "tested": ("signal",), "people": (200,),
        "studies": 150,
    }  # fmt: skip
    return MixedModelPower(**{**given, **changes})


# -- where a curve reaches a value -----------------------------------------------------------------------------
def test_reached_interpolates_over_the_square_root():
    people = np.array([100.0, 400.0, 900.0])
    value = np.array([0.1, 0.2, 0.3])
    found = reached(people, value, value - 0.05, value + 0.05, 0.25)
    assert found.n == pytest.approx(25**2)
    assert found.low == pytest.approx(20**2)
    assert found.high == pytest.approx(900)
    assert found.words == "reached at about 625 people (simulation error: 400 to 900)"
    assert reached(people, value, value - 0.05, value + 0.05, 0.9).words == "not reached by 900 people"
    assert reached(people, value, value, value, 0.05).words == "reached by 100 people, the fewest simulated"
    open_end = reached(people, value, value - 0.2, value + 0.3, 0.25)
    assert "below 100 to beyond 900" in open_end.words
    assert open_end.to_dict()["high"] is None
    assert open_end.to_dict()["n"] == 625


@given(st.lists(st.floats(0, 1), min_size=2, max_size=6), st.floats(0.05, 0.95))
def test_the_answer_lies_between_its_simulation_errors(values, wanted):
    value = np.array(values)
    people = 100.0 * np.arange(1, len(value) + 1)
    found = reached(people, value, value - 0.1, value + 0.1, wanted)
    n, low, high = (np.inf if np.isnan(v) else v for v in (found.n, found.low, found.high))
    assert low <= n <= high


def test_wilson_intervals_equal_scipys():
    for hits, trials in ((0, 9), (3, 20), (400, 400), (57, 400)):
        theirs = stats.binomtest(hits, trials).proportion_ci(method="wilson")
        low, high = wilson_interval(np.array([float(hits)]), trials)
        assert (low[0], high[0]) == pytest.approx((theirs.low, theirs.high))


# -- the mixed model -------------------------------------------------------------------------------------------
def test_study1_has_the_published_arms_and_schedules():
    rng = np.random.default_rng(1)
    exog, person = DESIGN.study(540, rng)
    assert DESIGN.columns == ("Intercept", "signal", "robot_help")
    arms = pd.DataFrame(exog[np.searchsorted(person, np.arange(540))], columns=DESIGN.columns)
    sizes = arms.groupby(["robot_help", "signal"]).size()
    assert sizes.loc[[(1, 0), (1, 1), (0, 1), (0, 0)]].tolist() == [177, 164, 104, 95]
    responses = np.bincount(person)
    lengths = {letters.count("H") for letters in study1_design().schedules}
    assert set(responses) == lengths
    # The log of a study drawn by the other route has as many responses, up to chance.
    other = simulate_study1(participants=540).n_responses_recorded
    assert abs(len(person) - other) < 5 * np.sqrt(540)


def test_size_and_power_are_what_theory_says():
    null = mixed_model_power(settings(coefficients={**STUDY1_TRUTH, "signal": 0.0}, studies=400, people=(300,)))
    low, high = stats.binom.ppf([0.0005, 0.9995], 400, 0.05) / 400
    assert null.table["power"].between(low, high).all()
    # Without any spread of people the model is a logistic regression, whose power by Wald follows from its
    # information; an estimated spread above zero, and the normal limit, make the two differ by a hundredth or two.
    truth = {"Intercept": -0.4, "signal": 0.45, "robot_help": 0.2}
    found = mixed_model_power(settings(coefficients=truth, sd=0.0, studies=400)).table.set_index("test")
    exog, _ = DESIGN.study(200, np.random.default_rng(2))
    p = special.expit(exog @ np.array(list(truth.values())))
    error = np.sqrt(np.linalg.inv(exog.T @ (exog * (p * (1 - p))[:, None]))[1, 1])
    expected = stats.norm.sf(1.96 - 0.45 / error)
    assert 0.5 < expected < 0.95
    assert found.loc["wald", "power"] == pytest.approx(
        expected, abs=4 * np.sqrt(expected * (1 - expected) / 400) + 0.02
    )


def test_more_people_have_more_power_and_results_do_not_know_their_workers():
    plan = settings(people=(60, 400), studies=60)
    one = mixed_model_power(plan)
    with ThreadPoolExecutor(3) as pool:
        several = mixed_model_power(plan, executor=pool)
    pd.testing.assert_frame_equal(one.table, several.table)
    rows = one.table.set_index(["test", "people"])["power"]
    assert rows[("wald", 400)] > rows[("wald", 60)]
    # A size asked for alone gives what it gives among others; another seed does not.
    alone = mixed_model_power(settings(people=(400,), studies=60))
    assert alone.table["power"].tolist() == one.table["power"].tolist()[2:]
    other = mixed_model_power(settings(people=(400,), studies=60, seed=2))
    assert other.table["rate"].iloc[0] != alone.table["rate"].iloc[0]
    assert "60 studies a size" in one.sentence(0.8)
    assert one.reached(0.999).words == "not reached by 400 people"


def test_studies_without_a_maximum_count_as_not_significant_and_are_said():
    extreme = {"Intercept": 6.0, "signal": 0.0, "robot_help": 0.0}
    result = mixed_model_power(settings(coefficients=extreme, sd=0.1, people=(10,), studies=30))
    assert (result.table["without_maximum"] > 0.5).all()
    assert (result.table["power"] < 0.5).all()
    assert "had no maximum" in result.sentence(0.8)


def test_separated_studies_have_a_likelihood_ratio():
    """Few people and a large effect: often nobody fails under it, which is no reason to call it not significant."""
    result = mixed_model_power(settings(tested=("robot_help",), people=(20,), studies=100))
    rows = result.table.set_index("test")
    assert rows.loc["wald", "without_maximum"] > 0.2
    assert rows.loc["likelihood_ratio", "without_maximum"] < 0.1
    assert rows.loc["likelihood_ratio", "power"] > rows.loc["wald", "power"] + 0.15


def test_a_separated_study_has_the_p_of_its_suprema():
    """By the likelihood itself, with the coefficient that runs off held far out."""
    plan = settings(tested=("robot_help",), people=(20,))
    beta = np.array([plan.coefficients[name] for name in plan.design.columns])
    rule, tested = Rule.hermite(plan.nodes), np.array([name == "robot_help" for name in plan.design.columns])
    checked = 0
    for index in range(40):
        rng = np.random.default_rng(np.random.SeedSequence(plan.seed, spawn_key=(STREAM, 20, index)))
        exog, y, person = plan.design.respond(20, beta, plan.sd, rng)
        wald, p, _ = _one_study(20, plan, index)
        full, null = (binary_patterns(x, y, person) for x in (exog, exog[:, ~tested]))
        helped = y[exog[:, tested][:, 0] == 1]
        below = maximise(null, rule)
        left = exog[:, tested][:, 0] == 0
        if not (np.isnan(wald) and helped.all() and 0 < y[left].mean() < 1 and below.converged):
            continue

        def fall(free, data=full):
            value, gradient = Likelihood(data, rule)(np.array([free[0], free[1], 40.0, free[2]]))
            return -value, -gradient[[0, 1, 3]]

        found = optimize.minimize(fall, [1.0, 0.5, 1.0], jac=True, method="BFGS")
        if abs(found.x[-1]) > 3 or below.theta[-1] > 3:
            continue  # far out quadrature is another matter
        assert p == pytest.approx(stats.chi2.sf(2 * (-found.fun - below.value), 1), rel=1e-3)
        checked += 1
    assert checked >= 3


def test_a_design_given_by_example():
    kinds = pd.DataFrame({"who": ["a", "a", "b", "b", "b"], "dose": [0, 1, 0, 1, 2], "arm": list("xxyyy")})
    design = rows_of_table(kinds, "y ~ dose + arm + (1|who)")
    assert design.columns == ("Intercept", "arm[T.y]", "dose")
    exog, person = design.study(5, np.random.default_rng(1))
    assert np.sort(np.bincount(person)).tolist() in ([2, 2, 2, 3, 3], [2, 2, 3, 3, 3])
    for i in range(5):
        assert sorted(exog[person == i][:, 2]) == ([0, 1] if (person == i).sum() == 2 else [0, 1, 2])
    coefficients = coefficients_from(design.columns, {"arm[T.y]": 2.0, "dose": 1.0}, 0.3)
    assert coefficients == {"Intercept": 0.3, "arm[T.y]": pytest.approx(np.log(2)), "dose": 0.0}
    # Two columns tested together.
    result = mixed_model_power(
        settings(design=design, coefficients=coefficients, tested=("arm[T.y]", "dose"), studies=20)
    )
    assert result.table["power"].between(0, 1).all()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"tested": ("age",)}, "coefficient: found 'age', wanted one of Intercept, signal, robot_help"),
        ({"tested": ()}, "tested columns: found none"),
        ({"tested": ("Intercept", "signal", "robot_help")}, "tested columns: found all columns"),
        ({"coefficients": {"Intercept": 1.0}}, "coefficients: found Intercept, wanted also signal, robot_help"),
        ({"sd": -1.0}, "coefficients and sd: found -1.0"),
        ({"coefficients": {**STUDY1_TRUTH, "signal": np.inf}}, "coefficients and sd: found inf"),
        ({"people": (200, 100)}, r"people: found \[200, 100\], wanted different numbers of at least 3, ascending"),
        ({"studies": 1}, "studies: found 1, wanted at least 2"),
        ({"alpha": 0.0}, "alpha: found 0.0, wanted between 0 and 1"),
    ],
)
def test_impossible_simulations_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        settings(**changes)


def test_impossible_designs_and_truths_are_refused():
    frame = pd.DataFrame({"who": [1, 2], "dose": [0.0, 1.0]})
    with pytest.raises(InputError, match="table, columns: found who, dose, wanted also 'person'"):
        rows_of_table(frame, "y ~ dose + (1|person)")
    with pytest.raises(InputError, match="formula: found 'a - b ~ dose"):
        rows_of_table(frame, "a - b ~ dose + (1|who)")
    with pytest.raises(InputError, match="column who: found no value"):
        rows_of_table(frame.assign(who=[1, None]), "y ~ dose + (1|who)")
    with pytest.raises(InputError, match="odds ratio: found 'age', wanted one of"):
        coefficients_from(DESIGN.columns, {"age": 2.0})
    with pytest.raises(InputError, match=r"odds ratio of signal: found 0\.0, wanted a positive number"):
        coefficients_from(DESIGN.columns, {"signal": 0.0})


# -- contraction -----------------------------------------------------------------------------------------------
def two_states():
    """People who move and respond so clearly that a few hundred of them tell nearly everything."""
    stay = np.array([[0.9, 0.1], [0.15, 0.85]])
    go = np.array([[0.4, 0.6], [0.05, 0.95]])
    names = PUBLISHED.action_names
    tables = {"no_help": stay, "help": go, "no_signal": stay, "signal": stay}
    transition = np.stack([tables[name] for name in names])
    emission = np.array([[[0.95, 0.05], [0.05, 0.95]], [[0.9, 0.1], [0.03, 0.97]]])
    return LatentStatePOMDP(np.array([0.5, 0.5]), transition, emission, PUBLISHED)


TINY = NutsSettings(draws=60, tune=60, chains=2)


@pytest.fixture(scope="module")
def learned():
    designs = {"published": study1_design(), "HRHRHRHRH": schedules_design(["HRHRHRHRH"])}
    return contraction_power(ContractionPower(two_states(), designs, (30, 600), studies=3, sampler=TINY))


def test_more_people_and_longer_schedules_tell_more(learned):
    rows = learned.table.set_index(["design", "people", "table"])["mean"]
    for design in ("published", "HRHRHRHRH"):
        assert rows[(design, 600, ALL_MOVES)] > rows[(design, 30, ALL_MOVES)]
    assert rows[("HRHRHRHRH", 600, ALL_MOVES)] > rows[("published", 30, ALL_MOVES)]
    assert (learned.table["mean"] <= 1).all()
    assert set(learned.tables) == {ALL_MOVES, "initial", *(f"moves: {a}" for a in PUBLISHED.action_names)} | {
        "responses: no_signal", "responses: signal"
    }  # fmt: skip


def test_averages_and_errors_are_those_of_the_studies(learned):
    part = learned.values[(learned.values["design"] == "published") & (learned.values["people"] == 600)]
    row = learned.table.set_index(["design", "people", "table"]).loc[("published", 600, "moves: help")]
    ends = stats.t.interval(0.9, 2, part["moves: help"].mean(), stats.sem(part["moves: help"]))
    assert (row["low"], row["high"]) == pytest.approx(ends)
    share = learned.share_above(0.3).set_index(["design", "people"])["share"]
    assert share[("published", 600)] == pytest.approx((part[ALL_MOVES] >= 0.3).mean())


def test_the_answer_is_a_number_of_people_or_that_it_is_not_reached(learned):
    assert learned.reached(0.999).words == "not reached by 600 people"
    value = learned.table.set_index(["design", "people", "table"])["mean"]
    middle = (value[("published", 30, ALL_MOVES)] + value[("published", 600, ALL_MOVES)]) / 2
    assert 30 < learned.reached(middle).n < 600
    assert learned.sentence(0.999).startswith(
        "Expected contraction 0.999 of all moves at 2 states (3 studies a size): "
    )
    with pytest.raises(InputError, match="table: found 'moves: dance', wanted one of all moves"):
        learned.reached(0.5, "moves: dance")


def test_contraction_does_not_know_its_workers_nor_its_company():
    plan = ContractionPower(two_states(), {"HRH": schedules_design(["HRH"])}, (40,), studies=2, sampler=TINY)
    one = contraction_power(plan)
    with ThreadPoolExecutor(1) as pool:
        other = contraction_power(plan, executor=pool)
    pd.testing.assert_frame_equal(one.values, other.values)
    designs = {"RRH": schedules_design(["RRH"]), "HRH": schedules_design(["HRH"])}
    among = contraction_power(ContractionPower(two_states(), designs, (40,), studies=2, sampler=TINY))
    own = among.values[among.values["design"] == "HRH"].reset_index(drop=True)
    pd.testing.assert_frame_equal(own, one.values)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"designs": {}}, "designs: found 0, wanted at least one"),
        ({"people": (0, 5)}, r"people: found \[0, 5\], wanted different positive numbers"),
        ({"studies": 1}, "studies: found 1, wanted at least 2"),
    ],
)
def test_impossible_studies_are_refused(changes, message):
    given = {"truth": two_states(), "designs": {"a": study1_design()}, "people": (10,)}
    with pytest.raises(InputError, match=message):
        ContractionPower(**{**given, **changes})


def test_impossible_schedules_are_refused():
    with pytest.raises(InputError, match="schedule: found 'RR', wanted at least one H"):
        schedules_design(["RR"])
    with pytest.raises(InputError, match="letter 2: found 'X'"):
        schedules_design(["HX"])
