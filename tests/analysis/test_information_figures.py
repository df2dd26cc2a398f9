"""Plots of the value of information: what they show, and that odd results can be drawn."""

from dataclasses import replace

import numpy as np
import pytest

from analysis.figures.information import information_by_block, information_by_people
from analysis.figures.style import to_svg
from models.robust.block_worth import BlockWorth, PartialInformation
from models.robust.study_worth import SampleInformation, StudyWorth

BLOCKS = PartialInformation(
    (
        BlockWorth("transition[help]", 0.8, 0.1, 1.0, 0.9, 4, 12),
        BlockWorth("emission", 1.6, 0.2, 1.7, 1.6, 4, 8),
        BlockWorth("initial", -0.1, 0.1, 0.05, 0.0, 2, 3),
        BlockWorth("transition[signal]", 0.0, 0.0, 0.0, 0.0, 1, 0),
    ),
    perfect=2.1, pool=2.0, plans=30, folds=4, chains=4,
)  # fmt: skip


def curves(effective=(900.0, 12.0), exact=True):
    rows = tuple(
        StudyWorth(name, n, w * n / 500, 0.05, 0.9 * w * n / 500, 0.05, w, 0.1, 2.2, 2.1, e, 0.5)
        for name, w in (("one", 0.6), ("two", 1.1))
        for n, e in zip((100, 500), effective, strict=True)
    )
    return SampleInformation(
        rows, np.zeros((2, 2, 2)), np.zeros((2, 2, 2)), ("one", "two"), (100, 500), 2.1, "HRHRH", 1, exact
    )


def test_blocks_in_order_beside_perfect_knowledge():
    ax = information_by_block(BLOCKS)
    assert [t.get_text() for t in ax.get_yticklabels()] == [
        "how each state responds", "how help moves people", "how signal moves people", "how people start"
    ]  # fmt: skip
    assert [p.get_width() for p in ax.patches] == pytest.approx([1.6, 0.8, 0.0])
    assert ax.get_xlim()[1] > 2.1
    assert "held fixed" in [t.get_text() for t in ax.texts]
    assert any(np.allclose(line.get_xdata(), 2.1) for line in ax.lines)


def test_what_is_known_exactly_has_bars_only():
    rows = [replace(r, se=float("nan"), worth=max(r.worth, 0.0), exact=True) for r in BLOCKS.rows]
    ax = information_by_block(replace(BLOCKS, rows=tuple(rows), exact=True))
    assert [p.get_width() for p in ax.patches] == pytest.approx([1.6, 0.8, 0.0])
    assert [t.get_text() for t in ax.get_legend().get_texts()] == ["all tables (perfect knowledge)", "exact"]
    assert "the same in all" in [t.get_text() for t in ax.texts]


def test_curves_below_perfect_knowledge():
    ax = information_by_people(curves())
    drawn = [c[0] for c in ax.containers]
    assert [line.get_ydata() for line in drawn] == pytest.approx(np.array([[0.12, 0.6], [0.22, 1.1]]))
    hollow = [line for line in ax.lines if line.get_markerfacecolor() == "white"]
    assert [len(line.get_xdata()) for line in hollow] == [1, 1]
    assert ax.get_legend().get_title().get_text() == "hollow: too few draws left"
    assert [t.get_text() for t in ax.get_xticklabels()] == ["100", "500"]
    plain = information_by_people(curves((900.0, 300.0), exact=False))
    assert not [line for line in plain.lines if line.get_markerfacecolor() == "white"]
    assert "at least" in plain.get_ylabel()


def test_studies_of_other_sizes_side_by_side():
    first = curves((900.0, 300.0))
    other = StudyWorth("three", 50, 0.3, 0.02, float("nan"), float("nan"), 0.3, 0.1, 2.2, 2.1, 900.0, 0.5)
    zero = np.zeros((2, 1, 1))
    ax = information_by_people(
        [first, SampleInformation((other,), zero, zero, ("three",), (50,), 2.1, "HRHRH", 1, True)]
    )
    assert [t.get_text() for t in ax.get_xticklabels()] == ["50", "100", "500"]
    assert [t.get_text() for t in ax.get_legend().get_texts()] == ["one", "two", "three"]


def test_nothing_worth_knowing():
    none = BlockWorth("initial", 0.0, float("nan"), 0.0, 0.0, 1, 0)
    ax = information_by_block(PartialInformation((none,), 0.0, 0.0, 1, 4, None))
    assert ax.get_xlim() == (0.0, 1.0)
    silent = StudyWorth("one", 5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 500.0, 0.0, True)
    zero = np.zeros((2, 1, 1))
    ax = information_by_people(SampleInformation((silent,), zero, zero, ("one",), (5,), 0.0, "H", 1, True))
    assert ax.get_ylim() == (0.0, 1.0)


@pytest.mark.parametrize("draw", [lambda: information_by_block(BLOCKS), lambda: information_by_people(curves())])
def test_same_bytes_every_time(draw):
    assert to_svg(draw()) == to_svg(draw())
