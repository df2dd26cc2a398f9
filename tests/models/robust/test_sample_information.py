"""The value of a next study: against sums over all data sets, and what holds of it."""

from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from models.errors import InputError
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED, Protocol
from models.robust import sample_information as module
from models.robust.information import perfect_information
from models.robust.own_plans import own_plans
from models.robust.plan_table import PlanTable
from models.robust.sample_information import enumerated_information, sample_information
from models.robust.study_design import Arm, NextStudy
from models.robust.study_worth import SampleInformation, StudyWorth
from tests.models.robust.information_cases import cloud, constant, contested, doubts, next_studies
from tests.reference.information import sample_value

CLOSE = {"rel": 1e-9, "abs": 1e-9}


@settings(max_examples=25)
@given(doubts(max_draws=3, max_events=3), next_studies(), st.integers(1, 2))
def test_enumeration_equals_the_definition(schedule, study, people):
    if study.n_histories**people > 300:
        people = 1
    found = enumerated_information(schedule, study, people)
    assert found == pytest.approx(sample_value(schedule, study, people), **CLOSE)
    assert 0 <= found <= perfect_information(schedule).value + 1e-9


@pytest.mark.parametrize("kinds", [1, 2])
@pytest.mark.parametrize("seed", [3, 4, 12])
def test_simulation_equals_enumeration(seed, kinds):
    """One and two participants, a few draws: without bias, and with the error that it says."""
    schedule = Schedule.of(contested(seed, 4), "HRH")
    studies = [constant("H"), NextStudy("varying", (Arm.random(PUBLISHED, "HRH"),))]
    found = sample_information(schedule, studies, [1, 2], replicates=2000, kinds=kinds)
    worth = []
    for row, (study, n) in zip(found.rows, [(s, n) for s in studies for n in (1, 2)], strict=True):
        wanted = enumerated_information(schedule, study, n, kinds=kinds)
        assert wanted == pytest.approx(sample_value(schedule, study, n, kinds), **CLOSE) or n == 2
        assert abs(row.pathwise - wanted) <= 4 * row.pathwise_se + 1e-9
        assert abs(row.worth - wanted) <= 4 * row.se + 1e-9
        worth.append(wanted)
    assert kinds == 2 or max(worth) > 0


def test_standard_errors_are_the_scatter():
    schedule, study = Schedule.of(contested(12, 4), "HRH"), constant("HRH")
    rows = [sample_information(schedule, study, [4], replicates=100, seed=s).rows[0] for s in range(60)]
    wanted = enumerated_information(schedule, study, 4)
    for name in ("worth", "pathwise"):
        values = np.array([getattr(r, name) for r in rows])
        said = np.mean([getattr(r, {"worth": "se", "pathwise": "pathwise_se"}[name]) for r in rows])
        assert values.std(ddof=1) == pytest.approx(said, rel=0.35)
        assert abs(values.mean() - wanted) < 4 * values.std(ddof=1) / np.sqrt(60)
    assert np.mean([r.se for r in rows]) <= 1.05 * np.mean([r.pathwise_se for r in rows])


@settings(max_examples=20)
@given(doubts(), next_studies(), st.integers(0, 99))
def test_never_negative_and_never_more_than_perfect(schedule, study, seed):
    found = sample_information(schedule, study, [1, 3, 10], replicates=30, seed=seed)
    assert np.all(found.gains >= 0)
    assert np.all(found.gains <= found.ceilings + 1e-9)
    perfect = perfect_information(schedule).value
    for row in found.rows:
        assert row.evpi == perfect == found.perfect
        assert 0 <= row.pathwise <= row.perfect + 1e-9
        assert 0 <= row.worth <= perfect


def test_rises_with_participants_and_ends_at_perfect():
    schedule, study = Schedule.of(contested(12, 4), "HRH"), constant("HRH")
    exact = [enumerated_information(schedule, study, n) for n in range(1, 8)]
    assert np.all(np.diff(exact) >= -1e-12)
    assert exact[-1] > 1.2 * exact[0] > 0
    found = sample_information(schedule, study, [1, 4, 16, 64, 5000], replicates=400)
    worth = [r.worth for r in found.rows]
    assert np.all(np.diff(worth) > -2 * found.rows[0].se)
    assert worth[-1] == pytest.approx(found.perfect, rel=0.01)


def test_one_draw_and_a_silent_design_are_worth_nothing():
    silent = constant("RR", name="nobody answers")
    schedule = Schedule.of(contested(12, 4), "HRH")
    found = sample_information(schedule, [silent, constant("H")], [5], replicates=20)
    assert found.row("nobody answers", 5).worth == 0 == enumerated_information(schedule, silent, 5)
    assert "worth nothing: nobody shows a response" in found.row("nobody answers", 5).sentence
    assert found.best.study == "constant"
    assert "nobody shows" in sample_information(schedule, silent, [5], replicates=2).sentence
    certain = sample_information(Schedule.of(contested(12, 1), "HRH"), constant("HRH"), [5, 50], replicates=20)
    assert [r.worth for r in certain.rows] == [0, 0]
    assert "would change the plan" in certain.sentence


def test_duplicates_of_draws_change_nothing():
    draws, study = contested(12, 3), constant("HRH")
    keep, share = np.array([0, 1, 1, 2]), np.array([1, 0.5, 0.5, 1])
    more = replace(
        draws, initial=draws.initial[keep], transition=draws.transition[keep], emission=draws.emission[keep],
        weight=draws.weight[keep] * share,
    )  # fmt: skip
    one, other = (Schedule.of(d, "HRH") for d in (draws, more))
    assert enumerated_information(other, study, 3) == pytest.approx(enumerated_information(one, study, 3), **CLOSE)
    a, b = (sample_information(s, study, [3, 9], replicates=50) for s in (one, other))
    assert b.gains == pytest.approx(a.gains, abs=1e-9)


def test_nothing_depends_on_the_executor():
    schedule = Schedule.of(cloud(2, 40), "HRH")
    studies = [constant("HRH"), NextStudy("varying", (Arm.random(PUBLISHED, "HRH"),))]
    done = []
    plain = sample_information(schedule, studies, [3, 8], replicates=120, progress=lambda *x: done.append(x))
    assert done[-1] == (3, 3)
    with ThreadPoolExecutor(1) as one:
        assert np.array_equal(
            sample_information(schedule, studies, [3, 8], replicates=120, executor=one).gains, plain.gains
        )
    # A study, a size or fewer replicates more or less leave the others as they were.
    alone = sample_information(schedule, studies[1], [8], replicates=30)
    assert alone.gains[:, 0, 0] == pytest.approx(plain.gains[:30, 1, 1], rel=1e-9, abs=1e-12)


def test_held_out_draws_bracket_what_more_draws_say():
    """With 120 draws the two estimates lie on either side of what 4,000 draws say, and there they meet."""
    draws, study = cloud(8, 4000), NextStudy("varying", (Arm.random(PUBLISHED, "HRHRH"),))
    large = sample_information(Schedule.of(draws, "RHRH"), study, [60], replicates=400).rows[0]
    assert large.held_out == pytest.approx(large.worth, rel=0.05, abs=2 * large.held_out_se)
    assert large.worth > 5 * large.se
    small = []
    for part in range(12):
        keep = slice(120 * part, 120 * part + 120)
        some = replace(
            draws, initial=draws.initial[keep], transition=draws.transition[keep], emission=draws.emission[keep],
            weight=np.full(120, 1 / 120),
        )  # fmt: skip
        row = sample_information(Schedule.of(some, "RHRH"), study, [60], replicates=100).rows[0]
        small.append((row.worth, row.held_out))
    high, low = np.mean(small, axis=0)
    error = np.std(small, axis=0, ddof=1) / np.sqrt(12)
    assert low < 0.8 * high
    assert high > large.worth + 2 * error[0]
    assert low < large.held_out - 2 * error[1]


def test_nothing_is_held_out_of_few_draws():
    few, silent = (
        sample_information(Schedule.of(cloud(2, n), "HRH"), study, [3], replicates=30).rows[0]
        for n, study in ((99, constant("HRH")), (200, constant("RR")))
    )
    assert np.isnan(few.held_out)
    assert silent.held_out == 0


@pytest.mark.slow
def test_other_processes_find_the_same():
    schedule = Schedule.of(cloud(2, 40), "HRH")
    plain = sample_information(schedule, constant("HRH"), [3, 8], replicates=120)
    with ProcessPoolExecutor(2) as processes:
        found = sample_information(schedule, constant("HRH"), [3, 8], replicates=120, executor=processes)
    assert found.gains == pytest.approx(plain.gains, rel=1e-12, abs=1e-12)


def test_a_pool_is_a_lower_bound():
    schedule, study = Schedule.of(cloud(2, 60), "HRHRH"), constant("HRH")
    full = sample_information(schedule, study, [5, 50], replicates=60)
    plans = own_plans(schedule).plans
    few, many = (
        sample_information(schedule, study, [5, 50], replicates=60, pool=PlanTable.of(schedule, plans[:n]))
        for n in (1, len(plans))
    )
    assert np.all(few.gains <= many.gains + 1e-12)
    assert np.all(many.gains <= full.gains + 1e-9)
    assert many.rows[1].worth > 0.5 * full.rows[1].worth > 0
    assert not many.exact
    assert "at least" in many.sentence
    none = sample_information(schedule, study, [5], replicates=60, pool=PlanTable.of(schedule, []))
    assert none.rows[0].worth == 0


def test_common_luck_makes_differences_surer():
    schedule = Schedule.of(cloud(2, 60), "HRHRH")
    studies = [constant("HRH", name="a"), constant("HRH", helping="no_help", name="b"), constant("HRH", name="c")]
    found = sample_information(schedule, studies, [40], replicates=200)
    assert found.difference("a", "c", 40) == (0, 0)
    mean, se = found.difference("a", "b", 40)
    rows = [found.row(n, 40) for n in "ab"]
    assert se < np.hypot(rows[0].se, rows[1].se) * 1.02
    assert mean == pytest.approx(rows[0].worth - rows[1].worth, abs=4 * se)


def row(**changes):
    plain = {"study": "x", "people": 200, "worth": 0.8123, "se": 0.051, "held_out": 0.75, "held_out_se": 0.07,
             "pathwise": 0.9, "pathwise_se": 0.1,
             "perfect": 2.3, "evpi": 2.1, "effective": 300.0, "changed": 0.5}  # fmt: skip
    return StudyWorth(**(plain | changes))


def test_sentences():
    assert row().sentence == (
        "200 more people under x would be worth 0.81 reward units a person (standard error 0.05), 0.75 for plans "
        "scored on draws that did not choose them, of 2.1 that perfect knowledge would be worth."
    )
    assert row(people=1).sentence.startswith("1 more person under x")
    gains = row(served=1000, cost=2.0)
    assert gains.sure == pytest.approx(min(gains.worth, gains.held_out))
    assert gains.net == pytest.approx(1000 * gains.sure - 400)
    assert gains.sentence.endswith(
        f"with 1,000 people served at a cost of 2 a participant, the study gains {gains.net:.0f} in all."
    )
    little = row(served=100, cost=2.0)
    assert little.sentence.endswith(f"the study loses {-little.net:.0f} in all.")
    assert "scored" not in row(held_out=float("nan")).sentence
    few = row(effective=42.3)
    assert not few.enough
    assert few.sentence.endswith(
        "(42 effective draws are left after such data, 100 wanted: too few to say; take more draws)."
    )


def test_what_too_few_draws_are_left_for_is_not_said():
    for left, words in ((1.2, "1 effective draw is left"), (19.4, "19 effective draws are left")):
        none = row(effective=left)
        assert not none.sayable
        assert none.sentence == (
            f"What 200 more people under x would be worth cannot be said from these draws: {words} after such "
            "data, 100 wanted; take more draws."
        )
    assert row(effective=20.0).sayable
    assert row(effective=1.0, sampled=False).sayable
    assert row(effective=1.0, sampled=False).sentence.startswith("200 more people under x would be worth 0.81")


def test_studies_of_which_nothing_can_be_said_take_nothing_away_from_the_doubt():
    def told(*rows):
        return SampleInformation(
            tuple(rows), np.zeros(0), np.zeros(0), ("x",), (1, 2)[: len(rows)], 2.1, "HR", 1, True
        )

    none = told(row(effective=1.2), row(effective=0.8, worth=2.0, held_out=2.0))
    assert none.sentence == (
        "What these studies would be worth cannot be said from these draws: at most 1 effective draw is left after "
        "such data, 100 wanted; take more draws."
    )
    # A larger number that cannot be said does not stand before a smaller one that can, with a warning.
    one = told(row(effective=30.0, worth=0.5, held_out=0.4), row(effective=1.0, worth=2.0, held_out=2.0))
    assert one.best is one.rows[0]
    assert one.sentence.startswith(
        "The best of these studies, by what is sure of it, takes away 19% to 24% of what doubt costs: 200 more"
    )
    nothing = told(row(effective=30.0, worth=0.0, held_out=0.0), row(effective=1.0))
    assert nothing.sentence.endswith("as far as these draws can say; take more draws.")
    assert told(row(worth=0.0, held_out=0.0)).sentence.endswith("more data of this kind are worth nothing.")


def test_the_best_study_is_net_of_its_cost():
    schedule = Schedule.of(cloud(2, 300), "HRHRH")
    free = sample_information(schedule, constant("HRH"), [2, 20, 100], replicates=100)
    assert free.best.sure == max(r.sure for r in free.rows if r.enough)
    dear = sample_information(schedule, constant("HRH"), [2, 20, 100], replicates=100, served=10, cost=5)
    assert dear.best.people == 2
    assert "is worth its cost" in dear.sentence
    assert list(dear.table["net"]) == [r.sure * 10 - 5 * r.people for r in dear.rows]
    assert len(free.sentences) == 1


def test_what_is_refused():
    schedule, study = Schedule.of(contested(1, 2), "HR"), constant("H")
    other = replace(PUBLISHED, name="other")
    assert isinstance(other, Protocol)

    def refused(match, *arguments, **options):
        with pytest.raises(InputError, match=match):
            sample_information(schedule, *arguments, **options)

    refused(r"participants of a study: found \[0\]", study, [0])
    refused(r"participants of a study: found \[2.5\]", study, [2.5])
    refused(r"participants of a study: found \[\]", study, [])
    refused(r"simulated data sets: found 1, wanted at least 2", study, [1], replicates=1)
    refused(r"people served: found 0", study, [1], served=0)
    refused(r"cost of a participant: found -1", study, [1], cost=-1)
    refused(r"studies, names: found constant, constant", [study, study], [1])
    refused(r"studies, names: found none", [], [1])
    refused(r"kinds of people: found 3", study, [1], kinds=3)
    refused(r"study 'x', protocol: found 'other'", NextStudy("x", (Arm.random(other, "H"),)), [1])
    refused(r"pool, draws: found 3", study, [1], pool=PlanTable.of(Schedule.of(contested(1, 3), "HR"), []))
    strange = perfect_information(Schedule.of(contested(1, 4), "HR"))
    refused(r"perfect information, draws", study, [1], perfect=strange)
    with pytest.raises(InputError, match=r"weights: found|sum of weights: found"):
        Schedule.of(contested(1, 2), "HR", weight=[0.5, 0.6])
    found = sample_information(schedule, study, [1], replicates=2)
    with pytest.raises(InputError, match=r"study: found 'y', wanted one of constant"):
        found.row("y", 1)
    with pytest.raises(InputError, match=r"found 7, wanted one of 1"):
        found.row("constant", 7)


def test_too_many_data_sets(monkeypatch):
    monkeypatch.setattr(module, "MOST_DATA_SETS", 10)
    with pytest.raises(InputError, match=r"data sets: found 35, wanted at most 10"):
        enumerated_information(Schedule.of(contested(1, 2), "HR"), constant("HRH"), 4)
