"""Traps of a search: the chance that too few restarts mislead against drawing, ranks, errors, and the figure."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.em_traps import (
    bootstrap_beside_truth,
    chance_ahead,
    climb_ends,
    error_by_people,
    schedule_ranks,
    shares_inside,
)
from analysis.simulate import calibrated_truth, simulate_study1
from models.baum_welch import BaumWelch
from models.bootstrap import bootstrap_fit
from models.errors import InputError


def test_chance_ahead_is_what_drawing_finds():
    rng = np.random.default_rng(1)
    left, right = rng.integers(0, 6, 12).astype(float), rng.integers(0, 7, 9).astype(float)
    numbers = [1, 2, 5]
    for n, found in zip(numbers, chance_ahead(left, right, numbers), strict=True):
        drawn = rng.choice(left, (60_000, n)).max(axis=1) > rng.choice(right, (60_000, n)).max(axis=1)
        assert found == pytest.approx(drawn.mean(), abs=4 * 0.5 / np.sqrt(60_000))
    every = [a > b for a in left for b in right]
    assert chance_ahead(left, right, [1])[0] == pytest.approx(np.mean(every))


def test_ties_and_certainty():
    assert chance_ahead([1.0], [1.0], [1, 3]).tolist() == [0, 0]
    assert chance_ahead([2.0], [1.0], [1, 3]).tolist() == [1, 1]
    with pytest.raises(InputError, match=r"^chance ahead, climbs: found \(0, 1\), wanted at least one of each"):
        chance_ahead([], [1.0], [1])


@pytest.fixture(scope="module")
def small():
    return simulate_study1(participants=300, seed=3)


def test_climbs_are_counted_and_capped(small):
    short, long = (climb_ends(small, 2, 6, cap) for cap in (3, 300))
    assert short.shape == long.shape == (6,)
    assert (np.diff(short) >= 0).all()
    assert short.max() < long.max()


def test_ranks_of_two_states():
    log = simulate_study1(participants=20_000, seed=1)
    table = schedule_ranks(log, (2,))
    assert table.loc["all together", "2 states"] == "13 of 13"
    assert table.loc["HRHRH", "2 states"] == "11 of 13"  # alternation: products of two tables only
    assert len(table) == 7


def test_error_falls_with_people():
    truth = calibrated_truth()
    two = BaumWelch(2, restarts=5, seed=1).fit(simulate_study1(participants=2_000, seed=1)).model
    search = BaumWelch(2, restarts=6, finalists=3, seed=1)
    found = error_by_people({"two": two, "four": truth}, (300, 30_000), search, seed=2)
    assert found["two"][1] < found["two"][0] / 2
    fit = search.fit(simulate_study1(truth=two, participants=300, seed=2))
    assert found["two"][0] == np.abs(fit.model.transition - two.transition).mean()


def test_the_figure_holds_every_entry_and_shares_are_counted(small):
    fit = BaumWelch(2, restarts=5, seed=1).fit(small)
    bootstrap = bootstrap_fit(fit, small, 6, seed=1)
    left = bootstrap_beside_truth(fit.model, bootstrap, fit.model)
    right = left.figure.axes[1]
    assert [t.get_text() for t in left.get_yticklabels()] == [
        "no signal, s0",
        "no signal, s1",
        "signal, s0",
        "signal, s1",
    ]
    assert len(right.get_yticklabels()) == 8
    wanted = fit.model.emission[..., fit.model.protocol.response_names.index("help")].ravel()
    assert np.array_equal(left.lines[0].get_xdata(), wanted)
    shares = shares_inside(bootstrap, fit.model, 0.98)
    low, high = bootstrap.interval("transition", 0.98)
    inside = (low <= fit.model.transition) & (fit.model.transition <= high)
    assert shares["transition"] == inside.mean()
    with pytest.raises(InputError, match="bootstrap beside truth, states of the truth: found 4, wanted 2"):
        bootstrap_beside_truth(fit.model, bootstrap, replace(calibrated_truth()))
