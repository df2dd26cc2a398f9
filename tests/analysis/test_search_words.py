"""How many random starts a search had, and how many were followed: in words that agree with the fits."""

from dataclasses import replace

import pytest

from analysis.report.build import build_report
from analysis.report.search_words import search_words
from models.baum_welch import AGREEMENT, BaumWelch
from models.protocol import PUBLISHED
from tests.analysis.report_cases import random_log, small_study, some


@pytest.fixture(scope="module")
def log():
    return random_log(PUBLISHED, people=30)


def test_starts_and_final_runs_are_those_of_the_fits(log):
    one = BaumWelch(2, restarts=20, finalists=4, rounds=1).fit(log)
    assert (one.restarts, one.runs_in_final_stage) == (20, 4)
    assert search_words([one]).startswith("2 states: 20 random starts, each of 100 maps, of which the 4 best were")
    several = BaumWelch(4, restarts=20, finalists=4, rounds=3).fit(log)
    rounds = several.restarts // 20
    assert rounds > 1, "this search is to need another round"
    text = search_words([one, several])
    assert f" 4 states: {20 * rounds} random starts in {rounds} rounds of 20, each of 100 maps, of which" in text
    assert f"the 4 best of each round, {4 * rounds} in all," in text
    assert f"fewer than {AGREEMENT} of these final runs agreed" in text


def test_searches_that_went_alike_are_told_together(log):
    fits = [replace(BaumWelch.paper(k), restarts=5).fit(log) for k in (1, 2)]
    end = "until the gain stayed below the tolerance or the cap was met."
    assert search_words(fits) == f"1 and 2 states: 5 random starts, all followed {end}"


@pytest.mark.usefixtures("short_reports")
def test_the_report_says_it_beside_its_settings(tmp_path):
    made = build_report(small_study(), states="1,2", quick=True, out=tmp_path, sections=some("states"))
    settings = next(b for b in made.sections[-1].blocks if b.key == "settings-and-software").blocks
    told = settings[0].text
    assert told.startswith("Restarts are random starts; final runs are those that were followed to the end.")
    assert f"Longer search: {search_words(made.study.fits.values())}" in told
    assert f"Published procedure: {search_words(made.study.paper_fits.values())}" in told
