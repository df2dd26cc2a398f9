import numpy as np
import pytest

from analysis.design import published, study1_design
from analysis.simulate import calibrated_truth, simulate_study1
from models.errors import InputError
from models.histories import UNSEEN


def test_the_published_design_at_540():
    log = simulate_study1()
    assert log.study == "simulated_study1"
    assert log.participant.tolist() == list(range(1, 541))
    assert set(log.sequence) == {0}
    sizes = dict(zip(log.conditions, np.bincount(log.condition).tolist(), strict=True))
    assert sizes == {"help+no-signal": 177, "help+signal": 164, "no-help+signal": 104, "no-help+no-signal": 95}
    schedules, counts = np.unique(log.schedules().astype(str), return_counts=True)
    assert set(schedules) == {"RRHHH", "HRRHH", "HHRRH", "RHRHH", "HRHRH", "RHHRH"}
    assert counts.min() > 60  # 90 expected, standard deviation 8.7


def test_the_action_is_constant_within_a_person_and_fits_the_condition():
    log = simulate_study1(participants=60)
    for i in range(log.n_runs):
        helping, signalling = log.conditions[log.condition[i]].replace("-", "_").split("+")
        used = {log.protocol.action_names[a] for a in log.action[log.offsets[i] : log.offsets[i + 1]]}
        assert used == {helping, signalling}


def test_responses_show_exactly_where_the_human_may_help():
    log = simulate_study1(participants=60)
    letters = np.array(list("".join(log.schedules())))
    assert np.array_equal(letters == "H", log.response != UNSEEN)
    assert log.n_missing == 0


def test_largest_remainder_gives_every_size():
    design = study1_design()
    shares = np.array([c.participants for c in design.conditions]) / design.participants
    for n in (1, 2, 3, 5, 99, 540, 541, 10_000):
        sizes = design.allocation(n)
        assert sizes.sum() == n
        assert np.all(np.abs(sizes - shares * n) < 1)
    assert design.allocation(540).tolist() == [177, 164, 104, 95]


def test_one_person_has_one_condition():
    log = simulate_study1(participants=1)
    assert (log.n_runs, len(log.conditions)) == (1, 1)


def test_many_people_show_the_expected_help_rates():
    log = simulate_study1(participants=40_000)
    seen = log.response != UNSEEN
    condition = log.condition[log.run_of_event]
    rates = [log.response[seen & (condition == i)].mean() for i in range(4)]
    expected = {"help+no-signal": 0.88, "help+signal": 0.91, "no-help+signal": 0.75, "no-help+no-signal": 0.69}
    for name, rate in zip(log.conditions, rates, strict=True):
        assert rate == pytest.approx(expected[name], abs=0.012), name


def test_seed_one_is_no_freak():
    log = simulate_study1()
    seen = log.response != UNSEEN
    condition = log.condition[log.run_of_event]
    for i, expected in enumerate((0.88, 0.91, 0.69, 0.75)):  # in the order of the sorted names
        assert log.response[seen & (condition == i)].mean() == pytest.approx(expected, abs=0.045)


def test_seeds_differ_and_repeat():
    first, again, other = (simulate_study1(participants=50, seed=s) for s in (3, 3, 4))
    assert np.array_equal(first.response, again.response)
    assert not np.array_equal(first.condition, other.condition)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"participants": 0}, "participants: found 0, wanted at least 1"),
        ({"seed": -1}, "seed: found -1, wanted an integer of at least 0"),
    ],
)
def test_unusable_arguments(arguments, message):
    with pytest.raises(InputError) as caught:
        simulate_study1(**arguments)
    assert str(caught.value) == message


def test_printed_numbers_are_at_hand(shared):
    import json

    assert published() == json.loads((shared / "paper" / "published.json").read_text())


def test_calibrated_truth_is_the_one_of_the_design(shared):
    from models.model_files import read_model

    ours, theirs = calibrated_truth(), read_model(shared / "data" / "calibrated_truth.json")
    assert np.array_equal(ours.transition, theirs.transition)
    assert np.array_equal(ours.emission, theirs.emission)
    assert np.array_equal(ours.initial, theirs.initial)
