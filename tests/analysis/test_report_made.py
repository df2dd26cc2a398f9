"""How a report is put together: what fails, what is left out and what is added."""

import pandas as pd
import pytest

from analysis.figures.style import axes
from analysis.report.build import build_report
from analysis.report.registry import Entry
from analysis.report.section import Figure, NotSupported, Origin, Table, Text
from tests.analysis.report_cases import small_study, some

pytestmark = pytest.mark.usefixtures("short_reports")
DATE = "2026-01-31"


@pytest.fixture
def small():
    return small_study()


def entry(*blocks):
    return Entry("extra", "Extra", lambda context: blocks)


def figure(draw):
    return Figure("mine", (draw,), "A caption", ("An alternative text",), (Origin.DEFINITION,))


def test_a_failing_figure_fails_the_report_and_leaves_the_last_one(small, tmp_path):
    def broken():
        raise ZeroDivisionError("no ink")

    (tmp_path / "report.html").write_text("the last good one")
    with pytest.raises(ZeroDivisionError, match="no ink") as caught:
        build_report(small, states="1", quick=True, out=tmp_path, sections=[entry(figure(broken))])
    assert "figure 'mine'" in caught.value.__notes__[0]
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]
    assert (tmp_path / "report.html").read_text() == "the last good one"


def test_a_failing_section_fails_the_report(small, tmp_path):
    def broken(context):
        raise KeyError("no such thing")

    with pytest.raises(KeyError) as caught:
        build_report(small, states="1", quick=True, out=tmp_path, sections=[Entry("extra", "Extra", broken)])
    assert "section 'extra'" in caught.value.__notes__[0]


def test_a_reason_is_printed_for_what_is_left_out(small, tmp_path):
    def unsupported(context):
        raise NotSupported("the moon is <full>")

    made = build_report(small, states="1", quick=True, out=tmp_path, sections=[Entry("x", "Extra", unsupported)])
    assert made.sections[0].omitted == "the moon is <full>"
    assert "Reason: the moon is &lt;full&gt;." in made.html.read_text(encoding="utf-8")


def test_adding_a_section_is_one_function_and_one_line(small, tmp_path):
    extra = entry(Text("A finding of -3.5 nats."), figure(lambda: axes()))
    known = some("provenance", "states", "limits")
    made = build_report(small, states="1", quick=True, out=tmp_path, sections=[*known, extra])
    text = made.html.read_text(encoding="utf-8")
    assert [s.key for s in made.sections] == ["provenance", "states", "limits", "extra", "appendix"]
    assert "A finding of −3.5 nats." in text


def test_two_figures_with_one_key_are_a_mistake(small, tmp_path):
    twice = entry(figure(lambda: axes()), figure(lambda: axes()))
    with pytest.raises(ValueError, match="same key"):
        build_report(small, states="1", quick=True, out=tmp_path, sections=[twice])


def test_parts_without_origin_or_text_cannot_be_made():
    with pytest.raises(ValueError, match="origin"):
        Figure("a", (lambda: axes(),), "caption", ("alt",), ())
    with pytest.raises(ValueError, match="alternative texts"):
        Figure("a", (lambda: axes(),), "caption", (), (Origin.REAL,))
    frame = pd.DataFrame({"x": [1]})
    with pytest.raises(ValueError, match="origin"):
        Table("a", frame, "caption", ())
    with pytest.raises(ValueError, match="printed columns"):
        Table("a", frame, "caption", (Origin.REAL,), printed=("x",))
    with pytest.raises(ValueError, match="no column y"):
        Table("a", frame, "caption", (Origin.REAL,), formats={"y": "d"})
