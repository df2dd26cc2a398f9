"""Axes name the unit of the reward that results were made with."""

from dataclasses import replace

import pytest

from analysis.figures.axis_names import PERSON, a_person, with_unit
from analysis.figures.information import information_by_block, information_by_people
from analysis.figures.robust import caution, plan_comparison
from analysis.simulate import calibrated_truth
from models.planning.schedule import Schedule
from models.reward import UNIT
from models.robust.candidates import standard_candidates
from models.robust.frontier import frontier
from models.robust.pricing import price
from tests.analysis.test_information_figures import BLOCKS, curves


def schedule(unit):
    truth = calibrated_truth()
    return Schedule.of(replace(truth, reward=replace(truth.reward, unit=unit)), "HRH")


def test_a_person():
    assert with_unit("value", a_person("points")) == "value (points a person)"
    assert a_person(UNIT) == PERSON


@pytest.mark.parametrize("unit", [UNIT, "points"])
def test_axes_say_it(unit):
    s = schedule(unit)
    labels = [
        plan_comparison(price(s, standard_candidates(s))).get_xlabel(),
        caution({"here": frontier(s, (1.0, 0.5))})[0].get_ylabel(),
        information_by_block(replace(BLOCKS, unit=unit)).get_xlabel(),
        information_by_people(replace(curves(), unit=unit)).get_ylabel(),
    ]
    assert [label.replace("\n", " ").partition(" (")[2] for label in labels] == [f"{unit} a person)"] * 4
