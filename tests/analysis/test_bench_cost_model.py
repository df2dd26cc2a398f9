"""The cost model: exact on exact curves, honest about what it has not seen, right about what was measured."""

import math

import numpy as np
import pytest

from analysis.bench.cost_model import FORMS, LEVEL, Term, fit_cost
from analysis.bench.cost_prediction import amount, predictions
from analysis.bench.curve_point import random_log
from analysis.bench.curves import AXES
from analysis.bench.halves import halves, judge_halves
from analysis.bench.results import STORED, points_of, read_results
from analysis.bench.work_sizes import drivers, most_nodes, walked
from models.errors import InputError

LINE = (Term({"n": (0.5, 2.0)}),)


def points(law, sizes):
    return [{"n": float(n), "seconds": law(n)} for n in sizes]


# -- fitting ---------------------------------------------------------------------------------------
@pytest.mark.parametrize(("a", "b", "p"), [(0.5, 2e-3, 1.0), (1e-3, 1e-6, 1.3), (0.0, 3.0, 0.7)])
def test_the_smaller_half_of_an_exact_curve_gives_the_larger_exactly(a, b, p):
    def law(n):
        return a + b * n**p

    model = fit_cost(LINE, points(law, np.geomspace(10, 1e4, 9)), "seconds")
    for n in (1e5, 1e7):
        assert model.predict({"n": n}).value == pytest.approx(law(n), rel=1e-5)
    assert model.exponents[0]["n"] == pytest.approx(p, abs=1e-6)


def test_two_drivers_and_a_fixed_exponent():
    terms = (Term({"n": (1.0, 1.0)}), Term({"n": (0.8, 1.2), "s": (0.5, 3.0)}))
    sizes = [(n, s) for n in (10, 1e2, 1e3, 1e4) for s in (2, 4, 8)]
    rows = [{"n": n, "s": s, "y": 1e-4 + 2e-6 * n + 1e-7 * n**1.1 * s**2} for n, s in sizes]
    model = fit_cost(terms, rows, "y")
    assert model.predict({"n": 1e6, "s": 12}).value == pytest.approx(1e-4 + 2 + 1e-7 * 1e6**1.1 * 144, rel=1e-4)


def test_exponents_stay_inside_their_bounds():
    model = fit_cost((Term({"n": (0.9, 1.2)}),), points(lambda n: n**3.0, np.geomspace(1, 1e3, 8)), "seconds")
    assert model.exponents[0]["n"] == pytest.approx(1.2)
    assert model.scatter > 0.5  # and what does not fit is said


def test_intervals_hold_what_they_promise():
    """Noise of 10% on a known curve: new points lie inside the interval about as often as its level says."""
    rng, inside, trials = np.random.default_rng(3), 0, 200
    sizes = np.geomspace(10, 1e4, 12)
    for _ in range(trials):
        rows = [{"n": n, "seconds": (0.1 + 0.01 * n) * math.exp(0.1 * rng.normal())} for n in sizes]
        found = fit_cost(LINE, rows, "seconds").predict({"n": 3e3})
        inside += found.low <= (0.1 + 30.0) * math.exp(0.1 * rng.normal()) <= found.high
    assert inside / trials == pytest.approx(LEVEL, abs=0.04)


def test_a_size_beyond_what_was_measured_is_called_so_and_is_less_sure():
    rng = np.random.default_rng(1)
    rows = [{"n": n, "seconds": 0.01 * n * math.exp(0.05 * rng.normal())} for n in np.geomspace(10, 1e4, 12)]
    model = fit_cost(LINE, rows, "seconds")
    widths = []
    for n in (1e3, 1e5, 1e8):
        found = model.predict({"n": n})
        widths.append(math.log(found.high / found.low))
        assert found.beyond == (("n",) if n > 1e4 else ())
        assert found.words.startswith("extrapolated beyond what was measured") == (n > 1e4)
    assert widths == sorted(widths)
    assert widths[2] > 2 * widths[0]


def test_what_cannot_be_fitted_is_refused():
    with pytest.raises(InputError, match="more than the 3 parameters"):
        fit_cost(LINE, points(lambda n: n, [1, 2, 3]), "seconds")
    with pytest.raises(InputError, match="above zero"):
        fit_cost(LINE, points(lambda n: n - 1, [1, 2, 3, 4, 5]), "seconds")
    model = fit_cost(LINE, points(lambda n: n, [1, 2, 3, 4, 5]), "seconds")
    with pytest.raises(InputError, match="cost, n: found 0"):
        model.predict({"n": 0.0})


# -- sizes -----------------------------------------------------------------------------------------
@pytest.mark.parametrize(("people", "rounds"), [(1, 4), (50, 3), (500, 9)])
def test_no_tree_has_more_nodes_than_the_worst_case(people, rounds):
    nodes = random_log(people, rounds).tree().n_nodes
    assert nodes <= most_nodes(people, rounds)
    assert nodes >= 0.6 * most_nodes(people, rounds)


def test_coin_tossers_use_the_published_protocol():
    log = random_log(200, 5)
    assert (log.n_runs, log.n_events) == (200, 1_000)
    shown = np.asarray(log.protocol.emission_index)[log.action] >= 0
    np.testing.assert_array_equal(log.response >= 0, shown)


def test_the_planner_s_own_limit_is_the_model_s():
    assert walked(10, 19, 4) > 8 * walked(10, 15, 4)
    with pytest.raises(InputError, match="histories"):
        walked(10, 41, 4)
    assert drivers(people=100, rounds=3)["nodes"] == most_nodes(100, 3)


# -- predictions -----------------------------------------------------------------------------------
def made(operation, law, sizes):
    return [{"operation": operation, **s, "seconds": law(s), "memory": 1e8 + 10 * law(s)} for s in sizes]


def test_predictions_cover_the_operations_that_the_sizes_speak_of():
    rounds = [{"game_rounds": float(n)} for n in np.geomspace(10, 1e4, 8)]
    found = predictions(made("game", lambda s: 1e-3 * s["game_rounds"], rounds), game_rounds=1e6)
    assert [row["operation"] for row in found] == ["game"]
    assert found[0]["seconds"]["value"] == pytest.approx(1e3, rel=1e-3)
    assert found[0]["extrapolated"] == ["game_rounds"]
    with pytest.raises(InputError, match="--people"):
        predictions(made("game", lambda s: 1.0, rounds), states=4)
    with pytest.raises(InputError, match="bench curves"):
        predictions([], game_rounds=5)


@pytest.mark.parametrize(("value", "words"), [(3e-7, "0.3 us CPU"), (45.0, "45 s CPU"), (172_800.0, "2 days CPU")])
def test_amounts_for_people(value, words):
    assert amount(value, "seconds") == words


# -- measured curves -------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def stored():
    found = points_of(read_results(STORED))
    assert found, "no cost curves are stored: prosocial bench curves --out reports/evidence/bench.json"
    return found


def test_every_curve_is_stored_with_repeats_and_ranges(stored):
    assert {p["axis"] for p in stored} == {axis.name for axis in AXES}
    assert {p["operation"] for p in stored} == set(FORMS)
    for p in stored:
        assert 0 < p["low"] <= p["seconds"] <= p["high"]
        assert p["repeats"] >= 3
        assert p["memory"] > 1e7


def test_the_smaller_halves_of_the_measured_curves_predict_the_larger(stored):
    small, large = halves(stored)
    assert len(small) + len(large) == len(stored)
    assert len(large) >= 0.3 * len(stored)
    found = judge_halves(stored)
    assert {(f.operation, f.quantity) for f in found} == {(o, q) for o, forms in FORMS.items() for q in forms}
    inside = sum(f.inside for f in found) / len(found)
    assert inside >= LEVEL - 0.05
    # An interval that holds everything would say nothing: most are within a factor of five either way.
    narrow = [f.predicted.high / f.predicted.value < 5 for f in found]
    assert np.mean(narrow) > 0.8
