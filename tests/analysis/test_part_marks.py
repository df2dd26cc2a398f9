"""What must not be relied on says so in every file of a report, also in a full one: LaTeX, pictures, the index."""

import csv
from dataclasses import replace
from functools import partial

import pandas as pd
import pytest
from PIL import Image

from analysis.figures.style import axes
from analysis.report.build import build_report
from analysis.report.context import ReportContext
from analysis.report.drawings import Drawings
from analysis.report.output_map import output_map
from analysis.report.parts import MARK_COLUMN, QUICK_MARK, write_parts
from analysis.report.section import Figure, Origin, Part, Points, Section, Table, Text
from models.cautions import caution_line
from tests.analysis.draws_cases import failed
from tests.analysis.report_cases import small_study, some

FAILED = caution_line(("the posterior failed its convergence gate",))
DATE = "2026-01-31"


def table(key):
    return Table(key, pd.DataFrame({"a": [1.5]}), f"Caption of {key}.", (Origin.SIMULATED,))


def figure(key):
    return Figure(key, (partial(axes, 2.0, 2.0),), f"Caption of {key}.", ("nothing",), (Origin.SIMULATED,))


MARKED = Section(
    "Section", "section",
    (
        table("above"),
        Part("two", "two", (
            Text("It failed.", "warning", "DOUBT."), table("beside"), figure("drawn"),
            Part("in", "in", (
                Text("More.", "warning", "MORE."), Text("Same.", "warning", "DOUBT."), table("inner"),
            )),
        )),
        Part("three", "three", (table("other"), Points(("Not this.",), "Not to be relied on", "LATER."))),
        Text("Only said.", "warning"),
    ),
)  # fmt: skip


def test_warnings_mark_what_stands_in_their_part_and_nothing_else():
    marks = {output.block.key: output.mark for output in output_map([MARKED], {})}
    assert marks == {
        "above": "", "beside": "DOUBT.", "drawn": "DOUBT.", "inner": "DOUBT. MORE.", "other": "LATER."
    }  # fmt: skip


def written(folder, quick):
    write_parts(output_map([MARKED], {}), Drawings(pictures=True), folder, "methods", quick=quick)
    with (folder / "index.csv").open(newline="", encoding="utf-8") as stream:
        return {row["key"]: row for row in csv.DictReader(stream)}


@pytest.mark.parametrize("quick", [False, True], ids=["full", "quick"])
def test_every_file_carries_its_marks(quick, tmp_path):
    folder = tmp_path / "parts"
    rows = written(folder, quick)
    for key, marks in (
        ("above", []),
        ("beside", ["DOUBT."]),
        ("inner", ["DOUBT.", "MORE."]),
        ("other", ["LATER."]),
    ):
        mark = " ".join([*marks, *[QUICK_MARK] * quick])
        assert rows[key][MARK_COLUMN] == mark
        (path,) = folder.glob(f"table-??-{key}.tex")
        first, caption = path.read_text().splitlines()[0], path.read_text()
        assert first.endswith(f"}}. {mark}" if mark else "}.")
        assert rf"Caption of {key}.{f' {mark}' if mark else ''}}}\label" in caption
    mark = " ".join(["DOUBT.", *[QUICK_MARK] * quick])
    (svg,), (png,) = (list(folder.glob(f"figure-??-drawn.{end}")) for end in ("svg", "png"))
    assert f"<desc>{mark}</desc>" in svg.read_text(encoding="utf-8")
    with Image.open(png) as picture:
        assert picture.info["Comment"] == mark


@pytest.mark.usefixtures("short_reports")
@pytest.mark.parametrize("passed", [False, True], ids=["gate failed", "gate passed"])
def test_tables_of_a_full_report_say_that_the_posterior_failed(passed, tmp_path, monkeypatch):
    gate = failed()
    if passed:
        gate = type(gate)(0, 1.001, 900.0, 800.0, "initial[s0]")
    assert gate.passed == passed
    plain = ReportContext.posterior
    monkeypatch.setattr(ReportContext, "posterior", lambda *asked: replace(plain(*asked), gate=gate))
    report = build_report(
        small_study(), states=(2,), quick=False, parts=True, out=tmp_path, date=DATE,
        sections=some("provenance", "uncertainty"),
    )  # fmt: skip
    folder = report.parts.folder
    (tex,) = folder.glob("table-??-posterior-2.tex")
    assert (FAILED in tex.read_text().splitlines()[0]) == (not passed)
    assert (rf" {FAILED}}}\label" in tex.read_text()) == (not passed)
    (facts,) = folder.glob("table-??-data.tex")
    assert FAILED not in facts.read_text()
    assert all("citation" not in path.read_text() for path in folder.glob("*.tex"))
