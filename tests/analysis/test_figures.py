import re
import xml.etree.ElementTree as ET

import matplotlib as mpl
import numpy as np
import pandas as pd
import pytest

from analysis.figures.beliefs import initial_belief, observation_curves
from analysis.figures.curves import curves
from analysis.figures.flow import still_going
from analysis.figures.responses import rate_by_round, rate_heat_map
from analysis.figures.reward import reward_by_state
from analysis.figures.state_graph import farthest_move, state_graph
from analysis.figures.state_number import information_criteria, log_likelihoods, optima
from analysis.figures.style import COLOURS, LINES, MARKERS, axes, style, styled, to_svg
from analysis.figures.transitions import RowEvidence, transition_table
from models.baum_welch import BaumWelch
from models.protocol import PUBLISHED
from tests.analysis.report_cases import random_log

NAMES = ("non-prosocial", "low-prosocial", "mid-prosocial", "high-prosocial")
TABLE = np.random.default_rng(1).dirichlet(np.ones(4), 4)
LEARNED = RowEvidence(silent=False, pinned=False, visits=np.array([50.0, 4.9, 12.0, 1000.0]), weak=5.0)
SILENT = RowEvidence(silent=True, pinned=False, visits=np.zeros(4), weak=5.0)
PINNED = RowEvidence(silent=False, pinned=True, visits=np.zeros(4), weak=5.0)
RATES = pd.DataFrame({"k": range(4), "responses": 9, "rate": 0.5, "low": [0.3, 0.3, 0.3, np.nan], "high": 0.7})
CELLS = pd.DataFrame({"condition": ["a", "b"], "schedule": ["HR", "RH"], "rate": [0.1, 0.9], "people": [3, 4]})
GOING = pd.DataFrame({"condition": ["a", "a", "b"], "k": [0, 1, 0], "share": [1.0, 0.5, 1.0]})
FITS = [
    BaumWelch.paper(2).fit(random_log(PUBLISHED)),
    BaumWelch(2, restarts=4, finalists=2).fit(random_log(PUBLISHED)),
]

PLOTS = {
    "rate by round": lambda ax=None: rate_by_round(RATES, measure="help rate", limits=(0, 1), ax=ax),
    "heat map": lambda ax=None: rate_heat_map(
        CELLS, rows="condition", columns="schedule", limits=(0, 1), row_order=["a", "b"], column_order=["HR", "RH"],
        ax=ax,
    ),
    "still going": lambda ax=None: still_going(GOING, ax=ax),
    "log-likelihoods": lambda ax=None: log_likelihoods({2: -9.0, 3: -8.0}, {2: -9.5, 3: -8.0}, (3, -7.0), ax=ax),
    "criteria": lambda ax=None: information_criteria({2: 9.0, 3: 8.0}, {2: 7.0, 3: 9.0}, ax=ax),
    "optima": lambda ax=None: optima(FITS[1], FITS[0], ax=ax),
    "transitions": lambda ax=None: transition_table(TABLE, NAMES, "no_help", LEARNED, ax=ax),
    "no evidence": lambda ax=None: transition_table(TABLE, NAMES, "signal", SILENT, ax=ax),
    "held fixed": lambda ax=None: transition_table(np.eye(4), NAMES, "no_signal", PINNED, ax=ax),
    "curves": lambda ax=None: observation_curves(
        {"signal": TABLE[0], "no_signal": TABLE[1]}, {"signal": (TABLE[0] - 0.1, TABLE[0] + 0.1)}, NAMES,
        measure="probability of help", limits=(0, 1), ax=ax,
    ),
    "initial": lambda ax=None: initial_belief(TABLE[0], None, NAMES, ax=ax),
    "reward": lambda ax=None: reward_by_state((45, 48, 56, 67), (0.001, 0.06, 0.09), NAMES, cost=15, ax=ax),
}  # fmt: skip
GRAPHS = {
    "graph": lambda ax=None: state_graph(TABLE, NAMES, "help", LEARNED, ax=ax),
    "silent graph": lambda ax=None: state_graph(TABLE, NAMES, "help", SILENT, ax=ax),
}


def words(ax):
    return " ".join(t.get_text() for t in ax.figure.findobj(mpl.text.Text))


@pytest.mark.parametrize("name", [*PLOTS, *GRAPHS])
def test_draws_the_same_svg_every_time_and_leaks_no_setting(name):
    draw = (PLOTS | GRAPHS)[name]
    before = dict(mpl.rcParams)
    first, second = to_svg(draw()), to_svg(draw())
    assert first == second
    assert dict(mpl.rcParams) == before
    assert ET.fromstring(first).tag.endswith("svg")
    assert "<image" not in first
    assert "<text" not in first
    assert "<style" not in first
    assert not re.search(r"20\d\d-\d\d", first)


@pytest.mark.parametrize("name", list(PLOTS))
def test_axes_are_labelled_and_returned(name):
    with style():
        given = axes()
    assert PLOTS[name](given) is given
    assert given.get_xlabel()
    assert given.get_ylabel()


def test_figures_ignore_the_users_settings():
    plain = to_svg(PLOTS["curves"]())
    with mpl.rc_context({"font.size": 30, "axes.facecolor": "red", "svg.fonttype": "none"}):
        assert to_svg(PLOTS["curves"]()) == plain


@pytest.mark.parametrize("name", ["$\\foo$", "$5", "日本語"])
def test_names_of_conditions_are_drawn_as_they_are(name):
    table = GOING.assign(condition=GOING["condition"].replace("a", name))
    ax = still_going(table)
    assert name in words(ax)
    assert ET.fromstring(to_svg(ax)).tag.endswith("svg")


def test_logarithmic_axes_need_no_mathtext():
    ax = curves({"a": ([1.0, 10.0, 1000.0], [1.0, 2.0, 3.0])}, xlabel="x", ylabel="y", log_x=True, log_y=True)
    to_svg(ax)
    assert "$" not in words(ax)


def test_styled_keeps_the_function_and_its_result():
    @styled
    def draw(a: int, *, b: int = 2) -> int:
        """Say something."""
        return a + b + int(mpl.rcParams["font.size"])

    assert draw(1, b=3) == 4 + 9
    assert draw.__doc__ == "Say something."


def test_series_differ_without_colour():
    styles = list(zip(MARKERS, map(str, LINES), strict=True))
    assert len(set(styles)) == len(styles) == len(COLOURS) == len(set(MARKERS)) == len(set(map(str, LINES)))


def test_the_printed_number_has_its_own_marker_and_label():
    ax = PLOTS["log-likelihoods"]()
    (star,) = [line for line in ax.lines if line.get_marker() == "*"]
    assert star.get_label() == "printed in the paper (other data)"
    assert star.get_linestyle() == "None"
    assert len(star.get_xdata()) == 1


def test_rows_say_what_stands_behind_them():
    shown = words(PLOTS["transitions"]())
    ticks = [t.get_text() for t in PLOTS["transitions"]().get_yticklabels()]
    assert ticks == ["s0 non", "† s1 low", "s2 mid", "s3 high"]
    assert "1,000.0" in shown
    silent = words(PLOTS["no evidence"]())
    assert "no evidence" in silent
    assert not re.search(r"\.\d\d", silent)
    assert "held fixed" in words(PLOTS["held fixed"]())


def test_boundary_estimates_are_told_from_rounded_ones():
    table = np.array([[1.0, 0.0], [0.002, 0.998]])
    shown = words(transition_table(table, ("s0", "s1"), "help", RowEvidence(False, False, np.full(2, 9.0), 5.0)))
    assert "<.01" in shown
    assert ">.99" in shown


def test_graph_labels_only_moves_worth_it():
    table = np.array([[0.9, 0.1, 0.0], [0.03, 0.96, 0.01], [0.0, 0.005, 0.995]])
    ax = state_graph(table, ("s0", "s1", "s2"), "help", RowEvidence(False, False, np.full(3, 9.0), 5.0))
    shown = words(ax)
    assert ".10" in shown
    assert ".03" not in shown
    arrows = [p for p in ax.patches if isinstance(p, mpl.patches.FancyArrowPatch)]
    assert len(arrows) == 3
    assert farthest_move(table) == 1
    assert "?" in words(GRAPHS["silent graph"]())


def test_optima_count_every_restart():
    ax = optima(FITS[1], FITS[0])
    heights = [p.get_height() for p in ax.patches]
    assert sum(h for h in heights if h > 0) == FITS[1].runs_in_final_stage
    assert -sum(h for h in heights if h < 0) == 30


def test_many_rounds_become_a_band():
    many = pd.DataFrame({"k": range(40), "responses": 9, "rate": 0.5, "low": 0.3, "high": 0.7})
    ax = rate_by_round(many, measure="help rate", limits=(0, 1))
    assert len(ax.collections) == 1
    assert not ax.texts


def test_a_cell_without_responses_says_so():
    assert words(PLOTS["heat map"]()).count("no\nresponse") == 2


def test_an_interval_that_leaves_out_its_estimate_is_drawn_where_it_is():
    low, high = np.full(2, 0.1), np.full(2, 0.3)
    ax = observation_curves(
        {"signal": np.array([0.2, 0.9])}, {"signal": (low, high)}, ("s0", "s1"), measure="p", limits=(0, 1)
    )
    ends = [tuple(segment[:, 1]) for c in ax.collections for segment in c.get_segments()]
    assert ends == [pytest.approx((0.1, 0.3))] * 2
