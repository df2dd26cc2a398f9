"""Sections that plan, where there is nothing to plan: the reason once, and no introduction to what is not there."""

from functools import partial

import pytest

from analysis.report.build import build_report
from analysis.report.section import NotSupported, Omitted, Part, Text, with_something
from analysis.simulate import simulate_study1
from models.reward import Reward
from tests.analysis.report_cases import data_set, some

PLANNING = ("plan", "robust", "sensitivity", "safeguards")
DATE = "2026-01-31"


def part(key, *blocks):
    return Part(f"part {key}", key, blocks)


def test_a_part_that_shows_something_keeps_all():
    parts = [part("a", Omitted("plans", "no")), part("b", Text("Said."), Omitted("a figure", "flat"))]
    assert with_something(parts) == tuple(parts)
    assert with_something([]) == ()
    assert with_something([part("empty")]) == (part("empty"),)


def test_reasons_are_said_once_or_with_their_part():
    with pytest.raises(NotSupported) as error:
        with_something([part(key, Omitted("plans", "nobody acts")) for key in "ab"])
    assert error.value.reason == "nobody acts"
    with pytest.raises(NotSupported) as error:
        with_something([part("a", Omitted("plans", "nobody acts")), part("b", Omitted("plans", "one state"))])
    assert error.value.reason == "part a: nobody acts; part b: one state"


@pytest.fixture(scope="module")
def baseline(short_reports):
    log = simulate_study1(participants=80, seed=3).select(conditions=["no-help+no-signal"])
    return data_set(log, kind="simulated")


@pytest.mark.parametrize("reward", [None, "own"], ids=["the paper's reward", "a stated reward"])
def test_control_arms_alone_are_told_once_a_section(reward, baseline, tmp_path):
    own = {2: Reward.of_values([0.0, 12.0])} if reward else None
    made = build_report(
        baseline, states="2,3", quick=True, out=tmp_path, date=DATE, sections=some(*PLANNING), reward=own
    )  # fmt: skip
    page = made.html.read_text(encoding="utf-8")
    for key, section in zip(PLANNING, made.sections, strict=False):
        assert section.key == key
        assert section.blocks == ()
        assert section.omitted == "the data say nothing about help or signal, so there is nothing to decide"
    assert page.count("so there is nothing to decide") == len(PLANNING) + page.count("Nothing is said here: ")
    assert "Values are in" not in page
    assert "followed through all histories" not in page


@pytest.mark.parametrize("stated", [False, True], ids=["the paper's reward", "a stated reward"])
def test_one_state_is_told_once_a_section(stated, short_reports, tmp_path):
    """With one state nothing is decided either, whoever met which action."""
    study = data_set(simulate_study1(participants=40), kind="simulated")
    reward = {1: Reward.of_values([5.0])} if stated else None
    build = partial(build_report, study, states="1", quick=True, date=DATE, sections=some(*PLANNING))
    made = build(out=tmp_path, reward=reward)
    for section in made.sections[:-1]:
        assert section.blocks == (), section.key
        assert "with one state" in section.omitted
