"""Figures of the uncertainty views, and the report section made of them."""

import re
import xml.etree.ElementTree as ET

import matplotlib as mpl
import numpy as np
import pytest

from analysis.causal import causal_effects
from analysis.figures.chain_ranks import chain_ranks
from analysis.figures.checks import predictive_checks
from analysis.figures.contraction import contraction_dots
from analysis.figures.effects import contrast_by_state, effect_by_round
from analysis.figures.forest import forest
from analysis.figures.style import axes, style, to_svg
from analysis.predictive_checks import posterior_checks
from analysis.report.build import build_report
from analysis.report.registry import SECTIONS
from analysis.uncertainty import KNOWN, PARTLY, contraction, contrasts
from models.protocol import PUBLISHED
from tests.analysis.posterior_cases import sampled, study
from tests.analysis.report_cases import CORRIDOR, data_set, random_log


def by_state(ax=None):
    table = contrasts(sampled(2)).table
    return contrast_by_state(table[table["action"] == "help"], scale=100, unit="percentage points", ax=ax)


def effect(ax=None, action="signal", log=None):
    rows = causal_effects(sampled(2), study() if log is None else log).of(action)
    return effect_by_round(rows, scale=100, unit="percentage points", title=action, ax=ax)


def entries(ax=None):
    table = contraction(sampled(2)).table.assign(em=0.5, boot_low=0.4, boot_high=0.6)
    return forest(table, list(table["entry"]), title="every entry", ax=ax)


def crowded(ax=None):
    return effect(ax, "help", random_log(PUBLISHED, rounds=40))


def far_off(ax=None):
    table = posterior_checks(sampled(2), study(), draws=20).table
    return predictive_checks(table.assign(observed=table["mean"] + 9 * table["sd"], outside=True), ax=ax)


PLOTS = {
    "contraction": lambda ax=None: contraction_dots(
        contraction(sampled(4)).table, known=KNOWN, partly=PARTLY, title="4 states", ax=ax
    ),
    "contrasts": by_state,
    "effects": effect,
    "many rounds": crowded,
    "forest": entries,
    "checks": lambda ax=None: predictive_checks(posterior_checks(sampled(2), study(), draws=20).table, ax=ax),
    "far off": far_off,
    "ranks": lambda ax=None: chain_ranks(np.random.default_rng(1).normal(size=(4, 100)), title="noise", ax=ax),
}


def words(ax):
    return " ".join(t.get_text() for t in ax.figure.findobj(mpl.text.Text))


@pytest.mark.parametrize("name", list(PLOTS))
def test_same_svg_every_time_labelled_and_on_given_axes(name):
    before = dict(mpl.rcParams)
    first, second = (to_svg(PLOTS[name]()) for _ in range(2))
    assert first == second
    assert dict(mpl.rcParams) == before
    assert ET.fromstring(first).tag.endswith("svg")
    with style():
        given = axes()
    assert PLOTS[name](given) is given
    assert given.get_xlabel()
    assert given.get_ylabel()


def test_figures_say_what_matters():
    assert "randomised arms, raw" in words(effect())
    assert "of it carried over" in words(effect())
    assert "of it carried over" not in words(effect(action="help"))
    assert "randomised arms, raw" not in words(crowded())
    assert "+9 sd" in words(far_off())
    assert ">.99" in words(by_state())
    table = contraction(sampled(2)).table
    held = table.assign(contraction=table["contraction"].where(table["table"] != "moves: help"))
    assert "held fixed" in words(contraction_dots(held, known=KNOWN, partly=PARTLY))


# -- the section -----------------------------------------------------------------------------------
ENTRY = [entry for entry in SECTIONS if entry.key == "uncertainty"]


def build(log, out, kind, states):
    return build_report(
        data_set(log, kind=kind), states=states, quick=True, out=out, sections=ENTRY, date="2026-01-31"
    )


@pytest.fixture(scope="module")
def built(short_reports, tmp_path_factory):
    return build(study(), tmp_path_factory.mktemp("report"), "simulated", (2,))


def test_section_shows_everything(built):
    section, _ = built.sections
    text = " ".join(section.sentences)
    assert section.omitted is None
    assert [f.key for f in section.figures] == [
        f"{key}-2" for key in ("contraction", "contrasts", "effects", "checks", "forest", "ranks")
    ]
    assert {t.key for t in section.tables} == {"effects-table-2", "kappa-2", "prior-predictive-2", "posterior-2"}
    assert "At two states the data determine the transition tables" in text
    assert "known from the data (contraction above .80)" in text
    assert "the randomised arms differ by" in text
    assert "Conditioned on" in text
    assert "say nothing about people" in text
    assert all(len(alt) > 20 for f in section.figures for alt in f.alt)


def test_a_shut_gate_is_a_banner(built):
    page = built.html.read_text(encoding="utf-8")
    assert "Convergence gate FAILED" in page
    assert re.search(r'class="[^"]*warning[^"]*"[^>]*>[^<]*Convergence gate FAILED', page)
    assert "quick report with few draws" in page


def test_fits_are_found_again(built, store_of_this_file, tmp_path):
    kept = {p: p.stat().st_mtime_ns for p in store_of_this_file.glob("*.nc")}
    assert len(kept) == 3  # kappa 2, 0, 5
    again = build(study(), tmp_path, "simulated", (2,))
    assert {p: p.stat().st_mtime_ns for p in store_of_this_file.glob("*.nc")} == kept
    assert again.html.read_bytes() == built.html.read_bytes()


def test_other_protocols_real_people_and_one_state(short_reports, tmp_path):
    section, _ = build(random_log(CORRIDOR, people=40, rounds=5), tmp_path, "real", (1,)).sections
    text = " ".join(section.sentences)
    assert "At one state no transition table is learned." in text
    assert "points of score" in text
    assert "NOT RANDOMISED" in text
    assert "simulated, so" not in text
    assert section.figures
