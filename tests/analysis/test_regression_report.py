"""Figures of the regression, and the report section made of them."""

import re
import xml.etree.ElementTree as ET
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from analysis import bayes_twin as twin_module
from analysis.datasets import load
from analysis.figures.odds import odds_forest, rates_beside, residual_classes
from analysis.figures.quadrature import rules_near_ceiling
from analysis.figures.signal_by_state import signal_effects
from analysis.figures.style import to_svg
from analysis.quadrature_study import quadrature_study
from analysis.regression import regress
from analysis.regression_checks import by_condition, residuals
from analysis.regression_sources import LAPLACE, QUADRATURE, long_form, of_fit, of_print
from analysis.report.build import build_report
from analysis.report.registry import SECTIONS
from analysis.report.section import Figure, NotSupported, Omitted, Origin, Points, Table, Text
from analysis.report.sections import regression as section
from analysis.report.sections.regression_states import by_state
from analysis.signal_by_state import NEXT, SAME, signal_by_state
from tests.analysis.posterior_cases import sampled
from tests.analysis.regression_cases import mixed_study
from tests.analysis.report_cases import CORRIDOR, data_set, log_of, random_log
from tests.analysis.test_regression import made_up_twin

ENTRIES = [entry for entry in SECTIONS if entry.key in ("provenance", "regression")]


@pytest.fixture(scope="module")
def fitted():
    log = mixed_study()
    return log, regress(log)


@pytest.fixture(scope="module")
def quick(tmp_path_factory):
    """The bundled study: the design the printed numbers belong to."""
    out = tmp_path_factory.mktemp("regression")
    return build_report(load("simulated_study1"), states=(2,), quick=True, out=out, sections=ENTRIES)


# -- figures ---------------------------------------------------------------------------------------------
def forest(rows):
    table = pd.DataFrame(rows, columns=["term", "source", "estimate", "low", "high"])
    return odds_forest(table, sources=["printed", "AGHQ"])


def plots(fitted):
    log, regression = fitted
    checked = residuals(regression, log)
    by_state = signal_by_state(sampled(2), "signal", regression.marginal["signal"])
    study = quadrature_study((0.0, 2.0), replicates=3)
    long = long_form([of_fit(LAPLACE, regress(log, "laplace")), of_fit(QUADRATURE, regression)])
    return {
        "forest": lambda: odds_forest(long, sources=[LAPLACE, QUADRATURE]),
        "rates": lambda: rates_beside(by_condition(regression, log), measure="help rate"),
        "residuals": lambda: residual_classes(checked.by, limit=checked.limit),
        "states": lambda: signal_effects(
            by_state.table[by_state.table["quantity"] == SAME], regression=by_state.regression.difference,
        ),
        "rules": lambda: rules_near_ceiling(study.summary, "sd", truth=study.sd, ylabel="sd"),
    }  # fmt: skip


@pytest.mark.parametrize("name", ["forest", "rates", "residuals", "states", "rules"])
def test_figures_are_the_same_bytes_every_time(fitted, name):
    draw = plots(fitted)[name]
    first = to_svg(draw())
    assert first == to_svg(draw())
    ET.fromstring(first)


def test_the_forest_keeps_to_its_axis_whatever_the_numbers():
    ax = forest([("x", "AGHQ", 2e9, 0.0, np.inf), ("x", "printed", 2.0, 1.0, 4.0), ("y", "AGHQ", 1e-6, 1e-9, 2.0)])
    low, high = ax.get_xlim()
    assert 1e-3 <= low < 1 < high <= 1e3
    to_svg(ax)
    stars = [line for line in ax.lines if line.get_marker() == "*"]
    assert [line.get_label() for line in stars] == ["printed"]


def test_the_forest_of_one_number_has_a_range():
    low, high = forest([("x", "AGHQ", 1.0, 1.0, 1.0)]).get_xlim()
    assert low < 1 < high


# -- the section -----------------------------------------------------------------------------------------
def test_the_section_has_its_parts(quick):
    made = quick.sections[-2]
    assert made.omitted is None
    assert [t.key for t in made.tables] == [
        "regression-odds", "regression-models", "regression-tests", "regression-sources", "regression-readings",
        "regression-coverage-table", "regression-states-table-signal-2",
    ]  # fmt: skip
    assert [f.key for f in made.figures] == [
        "regression-forest", "regression-rates", "regression-residuals", "regression-coverage",
        "regression-ceiling", "regression-states-signal-2",
    ]  # fmt: skip
    told = " ".join(made.sentences)
    for text in (
        "Odds, not likelihood: robot_help", "10.42 times more likely", "interaction is not significant",
        "The Bayesian twin was not run: this is a quick report", "Agreement is no replication", "At 2 states",
    ):  # fmt: skip
        assert text in told


def test_printed_and_simulated_never_share_a_badge(quick):
    made = quick.sections[-2]
    printed = {b.key for b in (*made.tables, *made.figures) if Origin.PRINTED in b.origin}
    assert printed == {"regression-sources", "regression-forest"}
    page = quick.html.read_text(encoding="utf-8")
    cells = re.findall(r"<t[dh]([^>]*)>([^<]*)</t[dh]>", page)
    assert {attrs for attrs, text in cells if text in ("10.42", "5.09 to 21.32", "43.87")} == {' class="printed"'}


def test_other_studies_have_no_printed_numbers(tmp_path):
    data = data_set(mixed_study(people=80), kind="real")
    made = build_report(data, states=(1,), quick=True, out=tmp_path, sections=ENTRIES).sections[-2]
    assert all(Origin.PRINTED not in b.origin for b in (*made.tables, *made.figures))
    assert "printed" not in next(t for t in made.tables if t.key == "regression-sources").frame
    assert "10.42" not in " ".join(made.sentences)
    left_out = [b for b in made.flat() if isinstance(b, Omitted)]
    assert [b.reason for b in left_out] == ["with one state there is nothing that an effect could depend on"]


@pytest.mark.parametrize(
    ("log", "reason"),
    [
        (lambda: random_log(CORRIDOR), "knows two responses, and this protocol has 3"),
        (lambda: mixed_study(people=8), "fewer than 10 people"),
        (lambda: mixed_study().select(conditions=["help+signal"]), "factors that vary: found none"),
        (lambda: log_of([(i, 0, "a", [("signal" if i % 2 else "no_signal", "help")] * 3) for i in range(20)]),
         "a success in all 60 trials"),
    ],
)  # fmt: skip
def test_what_cannot_be_regressed_is_left_out_in_words(log, reason):
    made = log()
    with pytest.raises(NotSupported) as error:
        section.make(SimpleNamespace(log=made, protocol=made.protocol))
    assert reason in error.value.reason


def test_without_a_signal_there_is_no_effect_by_state():
    log = mixed_study().select(conditions=["help+no-signal", "no-help+no-signal"])
    regression = regress(log)
    assert [t.name for t in regression.table.constant] == ["signal"]
    with pytest.raises(NotSupported, match="more than one action"):
        by_state(SimpleNamespace(shown_states=(2,)), regression)


def test_the_twin_stands_in_its_column(fitted, monkeypatch):
    log, regression = fitted
    context = SimpleNamespace(
        effort=SimpleNamespace(quick=False), seed=1, progress=None, is_published_design=False, published={},
        origin=Origin.SIMULATED,
    )  # fmt: skip
    laplace = regress(log, "laplace")
    monkeypatch.setattr(section, "why_absent", lambda: "")
    monkeypatch.setattr(section, "bayes_twin", lambda *args, **kwargs: made_up_twin(min_ess=10.0))
    (part,) = section._sources(context, regression, laplace)
    table = next(b for b in part.blocks if isinstance(b, Table))
    assert "SAMPLING FAILED" in table.frame["Bayesian twin"].iloc[0]
    assert any(isinstance(b, Text) and b.kind == "warning" and "do not rely" in b.text for b in part.blocks)
    monkeypatch.setattr(section, "why_absent", twin_module.why_absent)
    monkeypatch.setattr(twin_module, "find_spec", lambda name: None)
    (part,) = section._sources(context, regression, laplace)
    assert any(isinstance(b, Text) and "bambi is not installed" in b.text for b in part.blocks)


def test_printed_numbers_are_drawn_as_such():
    from analysis.design import published

    ax = odds_forest(long_form([of_print(published())]), sources=["printed"])
    assert {line.get_marker() for line in ax.lines if line.get_label() == "printed"} == {"*"}


def test_cautions_are_points_and_alternative_texts_are_numbers(quick):
    made = quick.sections[-2]
    assert any(isinstance(b, Points) and b.lead == "What not to conclude" for b in made.flat())
    for figure in made.figures:
        assert isinstance(figure, Figure)
        assert all(re.search(r"\d", alt) for alt in figure.alt)


def test_next_round_and_same_round_are_two_panels(quick):
    figure = quick.sections[-2].figures[-1]
    assert len(figure.panels) == 2
    assert SAME in figure.alt[0]
    assert NEXT in figure.alt[1]
