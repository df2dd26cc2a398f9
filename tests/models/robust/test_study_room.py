"""Studies too large to be valued are refused before anything is worked out."""

import re
import time

import numpy as np
import pytest

from analysis.next_studies import Asked
from analysis.robust_study import robust_study
from analysis.simulate import calibrated_truth
from models.errors import InputError
from models.model_draws import ModelDraws
from models.planning.schedule import Schedule
from models.protocol import PUBLISHED
from models.robust import study_data
from models.robust.draw_groups import DrawGroups
from models.robust.sample_information import sample_information
from models.robust.study_design import Arm, NextStudy
from models.robust.study_room import LARGEST, LONGEST, check_room, study_room


def draws_of(n):
    t = calibrated_truth()
    return ModelDraws(
        PUBLISHED, np.tile(t.initial, (n, 1)), np.tile(t.transition, (n, 1, 1, 1)),
        np.tile(t.emission, (n, 1, 1, 1)), np.full(n, 1 / n), {}, t.state_names, t.reward,
    )  # fmt: skip


def random_actions(letters):
    return NextStudy.of_arms(f"random actions over {letters}", [Arm.random(PUBLISHED, letters)])


LARGE = random_actions("HRHRHRHRHRH")


def test_the_estimate_counts_what_is_worked_out(monkeypatch):
    counted = []
    real = NextStudy.history_probabilities

    def counting(self, draws):
        out = real(self, draws)
        counted.append(out.size)
        return out

    monkeypatch.setattr(NextStudy, "history_probabilities", counting)
    draws, study = draws_of(40), random_actions("HRH")
    groups = DrawGroups.of(draws, 1)
    study_data.simulated_weights(study, draws, groups, (5, 10), range(50), 1)
    # The truths' own rows are looked up once more, to draw the participants.
    assert study_room([study], 40, (5, 10), 50).probabilities <= sum(counted) <= 2 * 40 * study.n_histories


def test_larger_is_longer():
    small, large = (study_room([LARGE], n, (50,), 200) for n in (500, 4000))
    assert large.seconds == pytest.approx(8 * small.seconds)
    assert large.bytes > small.bytes
    assert study_room([LARGE, random_actions("HRH")], 500, (50,), 200).seconds > small.seconds


def test_refused_with_numbers_and_a_way_out():
    with pytest.raises(InputError) as caught:
        check_room([random_actions("HRH"), LARGE], 100_000, (50, 100), 200)
    text = str(caught.value)
    assert text.startswith(f"study {LARGE.name!r}: found 131,072 histories x 100,000 draws x 200 data sets (about ")
    assert f"wanted at most {LONGEST / 60:.0f} minutes and {LARGEST / 1e9:.0f} GB" in text
    fewer = int(re.search(r"about ([\d,]+) draws or fewer", text)[1].replace(",", ""))
    check_room([random_actions("HRH"), LARGE], fewer, (50, 100), 200)


def test_nothing_is_worked_out_before(monkeypatch):
    schedule = Schedule.of(draws_of(60_000), "HR")
    started = time.perf_counter()
    for work in (
        lambda: sample_information(schedule, LARGE, (50,), replicates=200),
        lambda: robust_study(schedule, asked=[Asked(LARGE, (50,))]),
    ):
        with pytest.raises(InputError, match="131,072 histories x 60,000 draws"):
            work()
    assert time.perf_counter() - started < 2
