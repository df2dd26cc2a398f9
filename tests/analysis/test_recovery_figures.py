"""Figures of stored evidence: the same bytes every time, labelled, and true to their numbers."""

import numpy as np
import pandas as pd
import pytest
from matplotlib.colors import to_hex
from scipy import stats

from analysis.figures.rank_ecdf import rank_ecdf
from analysis.figures.recovery import LEARNERS, recovery_coverage, recovery_errors, states_found
from analysis.figures.style import COLOURS, to_svg

TABLE = pd.DataFrame(
    {"table": ["moves: no_help", "moves: no_help", "effects"], "em_rmse": [0.3, 0.4, 0.1], "rmse": [0.1, 0.1, 0.05],
     "prior_rmse": [0.2, 0.2, 0.2], "coverage_50": [0.0, 1.0, 0.5], "coverage_90": [0.5, 1.0, 0.9]}
)  # fmt: skip
CHOSEN = pd.DataFrame(
    {"name": ["LOO", "LOO", "BIC", "BIC"], "states": [2, 3, 2, 3], "share": [0.25, 0.75, 0.96, 0.04]}
)
UNIFORM = np.arange(100)
RANKS = {"even": UNIFORM, "low": UNIFORM // 2}
PLOTS = {
    "errors": lambda: recovery_errors(TABLE, title="Errors"),
    "coverage": lambda: recovery_coverage(TABLE, 20),
    "found": lambda: states_found(CHOSEN, 3),
    "ranks": lambda: rank_ecdf(RANKS, 99, level=0.01, tests=2),
}


@pytest.mark.parametrize("name", list(PLOTS))
def test_same_bytes_every_time_and_labelled(name):
    ax = PLOTS[name]()
    assert to_svg(ax) == to_svg(PLOTS[name]())
    assert ax.get_xlabel()
    assert ax.get_ylabel()


def test_bars_of_errors_are_root_mean_squares():
    ax = recovery_errors(TABLE)
    bars = [line for line in ax.lines if line.get_linewidth() == 2.4]
    found = [(to_hex(line.get_color()).upper(), float(line.get_xdata()[0])) for line in bars]
    wanted = [
        (to_hex(colour).upper(), float(np.sqrt(np.mean(part[column] ** 2))))
        for column, _, colour, _, _ in LEARNERS
        for _, part in TABLE.groupby("table", sort=False)
    ]
    assert [c for c, _ in found] == [c for c, _ in wanted]
    assert [x for _, x in found] == pytest.approx([x for _, x in wanted])
    assert [label.get_text() for label in ax.get_yticklabels()] == ["moves: no help", "effects"]


def test_bands_of_coverage_are_binomial():
    ax = recovery_coverage(TABLE, 20)
    spans = sorted((p.get_x(), p.get_x() + p.get_width()) for p in ax.patches)
    assert spans[1] == pytest.approx([stats.binom.ppf(p, 20, 0.9) / 20 for p in (0.025, 0.975)])
    assert spans[0] == pytest.approx((0.3, 0.7))


def test_bars_of_chosen_states_add_up_and_small_ones_have_no_number():
    ax = states_found(CHOSEN, 3)
    bars = [p for p in ax.patches if p.get_height() == pytest.approx(0.62)]
    assert [p.get_width() for p in bars] == pytest.approx([0.25, 0.75, 0.96, 0.04])
    assert [p.get_hatch() for p in bars] == [None, "////", None, "////"]
    assert [t.get_text() for t in ax.texts] == ["2", "3", "2"]
    assert [t.get_text() for t in ax.get_legend().get_texts()] == ["2", "3, the truth"]


def test_the_farthest_line_is_named_and_leaves_the_band():
    ax = rank_ecdf(RANKS, 99, level=0.01, tests=2)
    assert [t.get_text() for t in ax.texts] == ["low"]
    worst = next(line for line in ax.lines if to_hex(line.get_color()).upper() == COLOURS[1])
    half = stats.kstwo.ppf(1 - 0.005, 100)
    assert max(worst.get_ydata()) == pytest.approx(0.5)
    assert max(worst.get_ydata()) > half
    even = next(line for line in ax.lines if to_hex(line.get_color()).upper() == COLOURS[0])
    np.testing.assert_allclose(even.get_ydata(), 0, atol=1e-12)
