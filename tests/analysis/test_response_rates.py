import numpy as np
import pytest
from scipy import stats

from analysis.response_rates import measure_name, measure_range, response_rates
from models.errors import InputError
from models.protocol import PUBLISHED
from tests.analysis.report_cases import CORRIDOR, log_of, random_log


def helpers(pattern):
    """One run a person of a single event; 1 helps."""
    return log_of([(i, 0, "c", [("signal", "help" if h else "no_help")]) for i, h in enumerate(pattern)])


def test_one_response_a_person_gives_the_wilson_interval():
    row = response_rates(helpers([1] * 8 + [0] * 2), {}).iloc[0]
    exact = stats.binomtest(8, 10).proportion_ci(0.95, method="wilson")
    assert (row.responses, row.people) == (10, 10)
    assert row.rate == 0.8
    assert (row.low, row.high) == pytest.approx((exact.low, exact.high))


@pytest.mark.parametrize("level", [0.5, 0.99])
def test_level_is_the_callers(level):
    row = response_rates(helpers([1] * 8 + [0] * 2), {}, level).iloc[0]
    exact = stats.binomtest(8, 10).proportion_ci(level, method="wilson")
    assert (row.low, row.high) == pytest.approx((exact.low, exact.high))


def test_repeating_everybody_adds_no_information():
    people = [1] * 6 + [0] * 4
    once = response_rates(helpers(people), {}).iloc[0]
    events = [("signal", "help"), ("signal", "no_help")]
    many = log_of([(i, 0, "c", [events[not h]] * 5) for i, h in enumerate(people)])
    row = response_rates(many, {}).iloc[0]
    assert row.responses == 50
    assert row.rate == once.rate
    # Not less doubt, and a little more: here the spread between people had to be estimated.
    assert once.low - 0.1 < row.low < once.low
    assert once.high < row.high < once.high + 0.1


def test_everybody_the_same_counts_people_not_responses():
    many = log_of([(i, 0, "c", [("signal", "help")] * 7) for i in range(4)])
    row = response_rates(many, {}).iloc[0]
    exact = stats.binomtest(4, 4).proportion_ci(0.95, method="wilson")
    assert (row.rate, row.low, row.high) == pytest.approx((1.0, exact.low, 1.0))


def coverage(chances, rate):
    """How often the interval holds a rate, over studies of five responses a person; ``chances`` of each study.

    All studies make one log, in which each is a group: groups know nothing of each other.
    """
    runs = []
    for study, (chance, rng) in enumerate(chances):
        for p in chance:
            events = [("signal", "help" if rng.random() < p else "no_help") for _ in range(5)]
            runs.append((len(runs), 0, str(study), events))
    log = log_of(runs)
    rows = response_rates(log, {"study": log.condition[log.run_of_event]})
    assert len(rows) == study + 1
    return ((rows["low"] <= rate) & (rate <= rows["high"])).mean()


def test_interval_of_correlated_responses_covers_as_often_as_it_says():
    def chances():
        for seed in range(150):
            rng = np.random.default_rng(seed)
            yield rng.beta(0.4, 0.4, size=80), rng

    assert 0.90 <= coverage(chances(), 0.5) <= 0.99


def test_interval_of_ten_people_covers_often_enough():
    """Ten people, five responses each, correlation .5 within a person, a rate of .8."""
    rng = np.random.default_rng(1)
    chances = ((rng.beta(0.8, 0.2, size=10), rng) for _ in range(400))  # correlation 1 / (0.8 + 0.2 + 1)
    assert coverage(chances, 0.8) >= 0.92


def test_a_group_has_the_row_it_would_have_alone():
    log = random_log(PUBLISHED)
    rows = response_rates(log, {"condition": log.condition[log.run_of_event]})
    for number, row in rows.set_index("condition").iterrows():
        alone = response_rates(log.select(conditions=[log.conditions[number]]), {}).iloc[0]
        assert row.tolist() == pytest.approx(alone.tolist(), rel=1e-12)


def test_groups_are_those_with_responses():
    log = log_of(
        [
            (0, 0, "a", [("signal", "help"), ("help", "none"), ("signal", "missing")]),
            (1, 0, "b", [("no_signal", "no_help"), ("help", "none"), ("signal", "help")]),
        ]
    )
    table = response_rates(log, {"k": log.k})
    assert list(table["k"]) == [0, 2]
    assert list(table["responses"]) == [2, 1]


def test_more_responses_give_a_mean_score_with_a_t_interval():
    log = log_of(
        [(i, 0, "c", [("ask", r)]) for i, r in enumerate(["refused", "late", "helped", "helped"])], CORRIDOR
    )
    row = response_rates(log, {}).iloc[0]
    values = [0.0, 0.5, 1.0, 1.0]
    low, high = stats.t.interval(0.95, 3, np.mean(values), stats.sem(values))
    assert (row.rate, row.low, row.high) == pytest.approx((np.mean(values), low, high))
    assert measure_name(CORRIDOR) == "mean response score"
    assert measure_range(CORRIDOR) == (0.0, 1.0)


def test_one_person_has_no_interval_of_a_mean():
    row = response_rates(log_of([(1, 0, "c", [("ask", "late")])], CORRIDOR), {}).iloc[0]
    assert row.rate == 0.5
    assert np.isnan([row.low, row.high]).all()


def test_rates_do_not_depend_on_the_order_of_people():
    log = random_log(PUBLISHED)
    shuffled = log.to_frame().sample(frac=1, random_state=1)
    again = type(log).from_frame(shuffled)
    assert response_rates(log, {"k": log.k}).equals(response_rates(again, {"k": again.k}))


def test_a_level_that_is_none_is_refused():
    with pytest.raises(InputError, match="between 0 and 1"):
        response_rates(helpers([1]), {}, 1.5)
