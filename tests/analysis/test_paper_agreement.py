"""The rules that decide whether a number of ours agrees with a printed one."""

import math

import numpy as np
import pytest
from scipy.stats import norm

from analysis.paper_agreement import (
    MOST,
    Agreement,
    Word,
    apart,
    as_printed,
    chances,
    concluded,
    counted,
    follows,
    inside,
    mostly,
    overall,
    readings,
    statistics,
    unchecked,
    written,
)
from models.errors import InputError


# -- what follows from other printed numbers -------------------------------------------------------
def test_what_rounds_to_the_printed_number_follows_and_nothing_else():
    rng = np.random.default_rng(1)
    for value in rng.normal(0, 30, 200):
        digits = int(rng.integers(1, 5))
        printed = round(float(value), digits)
        unit = 10.0 ** -len(str(printed).partition(".")[2])  # a number does not keep zeros at its end
        assert follows(printed, float(value)).word in (Word.AGREES, Word.ROUNDING)
        for off in (-2, -1, 1, 2):
            assert follows(printed, printed + off * unit).word is Word.CONTRADICTS


def test_a_range_follows_as_soon_as_it_touches_what_rounds_to_the_number():
    assert follows(6.44, 6.40, 6.435).word is Word.ROUNDING
    assert follows(6.44, 6.40, 6.434).word is Word.CONTRADICTS
    assert follows(6.44, 6.445, 6.5).word is Word.ROUNDING
    assert follows(6.44, 6.446, 6.5).text.endswith("6.446 to 6.5 follows")
    assert follows(540, 540).text == "agrees"
    with pytest.raises(InputError, match="lower end first"):
        follows(1.0, 2.0, 1.0)


# -- counts, names, settings -----------------------------------------------------------------------
def test_counts_agree_if_they_are_the_same():
    assert counted(("a", "b"), ("a", "b")).word is Word.AGREES
    assert counted(("a", "b"), ("b", "a")).text == "differs: not the same"
    assert counted(30, 30, taken_over=True).word is Word.TAKEN
    assert counted(30, 31, taken_over=True).text == "differs: by +1"


# -- intervals and errors --------------------------------------------------------------------------
def test_what_scatters_is_compatible_and_never_agrees_beyond_rounding():
    """No number within its error is said to agree, unless its digits are the printed ones."""
    rng = np.random.default_rng(3)
    for ours in rng.normal(10.0, 1.0, 300):
        found = (
            apart(10.0, float(ours), 1.0),
            statistics(10.0, float(ours)),
            inside(10.0, float(ours), float(ours) - 2.5, float(ours) + 2.5),
        )
        same = abs(ours - 10.0) <= 0.05
        for agreement in found:
            near = agreement.distance is not None and abs(agreement.distance) <= 1
            wanted = Word.ROUNDING if same else Word.COMPATIBLE if near else Word.DIFFERS
            assert agreement.word is wanted


def test_inside_says_where_the_printed_number_lies():
    assert inside(1.0, 3.0, 1.0, 4.0).distance == 1.0
    assert inside(4.5, 3.0, 1.0, 4.0).distance == -1.5
    assert inside(4.5, 3.0, 1.0, 4.0).text == "differs: by −1.5"
    assert inside(3.0, 3.0, 3.0, 3.0).word is Word.AGREES
    assert inside(2.0, 3.0, 3.0, 3.0).distance == math.inf
    with pytest.raises(InputError, match="one that holds 5"):
        inside(1.0, 5.0, 1.0, 4.0)


def test_equal_digits_go_before_the_interval():
    found = inside(67, 67.438, 67.2, 67.67)
    assert (found.word, found.distance) == (Word.ROUNDING, 1.0)
    assert inside(67, 67.6, 67.2, 67.67).word is Word.DIFFERS


def test_two_studies_of_one_truth_agree_in_95_of_100_pairs():
    """The rate at which the rules err is the one they claim: simulated pairs, the same truth behind both."""
    rng = np.random.default_rng(2)
    n = 4_000
    errors = rng.uniform(0.1, 0.6, (n, 2))
    logs = 1.3 + errors * rng.standard_normal((n, 2))
    zs = 4.0 + rng.standard_normal((n, 2))
    ratio = [
        apart(float(np.exp(a)), float(np.exp(b)), math.hypot(*e), log=True).word is not Word.DIFFERS
        for (a, b), e in zip(logs, errors, strict=True)
    ]
    z = [statistics(*map(float, pair)).word is not Word.DIFFERS for pair in zs]
    chi2 = [statistics(*map(float, pair**2), chi_squared=True).word is not Word.DIFFERS for pair in zs]
    for shares in (ratio, z, chi2):
        assert np.mean(shares) == pytest.approx(0.95, abs=4 * math.sqrt(0.95 * 0.05 / n))


def test_distances_count_standard_errors():
    assert apart(10.0, 13.0, 1.0).distance == pytest.approx(3 / MOST)
    assert apart(10.0, 13.0, 1.0).text == "differs: by +3, +3.0 standard errors"
    assert apart(10.0, 9.0, 1.0).text == "compatible: −1.0 standard errors"
    with pytest.raises(InputError, match="above 0"):
        apart(1.0, 2.0, 0.0)


def test_p_values_are_compared_by_the_z_they_stand_for():
    for limit in (0.001, 0.077):
        least = norm.isf(limit / 2)
        edge = least - MOST * math.sqrt(2)
        for shift, word in ((1e-6, Word.COMPATIBLE), (-1e-6, Word.DIFFERS)):
            if edge + shift > 0:
                assert chances(f"<{limit}", float(2 * norm.sf(edge + shift))).word is word
        for p in (0.01 * limit, 0.999 * limit):
            assert chances(f"<{limit}", p).text == "agrees"
        for p in (limit, 1.001 * limit):
            assert chances(f"<{limit}", p).text.startswith(f"compatible: not below {limit}")
    with pytest.raises(InputError, match=r"such as <0\.001"):
        chances("0.03", 0.01)


# -- conclusions -----------------------------------------------------------------------------------
def test_conclusions():
    assert mostly(0.6, 0.51, 0.7).word is Word.AGREES
    assert mostly(0.4, 0.3, 0.49).word is Word.DIFFERS
    assert mostly(0.6, 0.5, 0.7).word is Word.OPEN
    assert [concluded(h).word for h in (True, False, None)] == [Word.AGREES, Word.DIFFERS, Word.OPEN]
    assert readings([True]).word is Word.AGREES
    assert readings([None, None]).text.startswith("not decided: it holds in 0 of 2")
    for wrong in (lambda: mostly(0.5, 0.6, 0.7), lambda: readings([])):
        with pytest.raises(InputError):
            wrong()


def test_the_worst_of_several_speaks_for_a_number():
    every = [Agreement(word) for word in Word]
    assert overall(every).word is Word.CONTRADICTS
    assert overall(every[1:]).word is Word.DIFFERS
    assert overall([Agreement(Word.AGREES), Agreement(Word.OPEN)]).word is Word.OPEN
    assert overall([Agreement(Word.AGREES), Agreement(Word.COMPATIBLE)]).word is Word.COMPATIBLE
    assert overall([unchecked("x"), Agreement(Word.TAKEN)]).word is Word.TAKEN
    with pytest.raises(InputError):
        overall([])


def test_numbers_are_written_with_proper_minus_signs():
    assert [written(v, 3) for v in (-0.221, 12806.1, -math.inf, 0.0)] == ["−0.221", "12,806", "−∞", "0"]
    assert as_printed(-40.2) == "−40.2"
