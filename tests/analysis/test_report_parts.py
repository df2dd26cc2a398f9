import csv
import io
import re
import xml.etree.ElementTree as ET
from functools import partial

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from analysis.figures.style import axes
from analysis.report import build
from analysis.report.analysis_plan import EXPLORATORY, PLANNED, read_analysis_plan
from analysis.report.drawings import Drawings
from analysis.report.latex import escaped, latex
from analysis.report.output_map import output_map, plot_functions
from analysis.report.parts import MARK_COLUMN, QUICK_MARK, write_parts
from analysis.report.registry import Entry
from analysis.report.section import Figure, Origin, Part, Section, Table, Text
from analysis.report.summary import summarised
from models.errors import InputError
from tests.analysis.command import result_of, run
from tests.analysis.report_cases import small_study, some

PNG = b"\x89PNG\r\n\x1a\n"
DATE = "2026-01-31"
build_report = partial(build.build_report, parts=True)
pytestmark = pytest.mark.usefixtures("short_reports")


@pytest.fixture(scope="module")
def small():
    return small_study()


@pytest.fixture(scope="module")
def report(small, tmp_path_factory):
    out = tmp_path_factory.mktemp("report")
    return build_report(
        small, states=(2,), quick=True, out=out, date=DATE, sections=some("provenance", "study", "states")
    )


def index(report):
    with (report.parts.folder / "index.csv").open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


# -- the files -------------------------------------------------------------------------------------
def test_every_figure_and_table_is_a_file_and_listed(report):
    listed = index(report)
    shown = [b.key for s in report.sections for b in s.flat() if isinstance(b, Figure | Table)]
    assert [row["key"] for row in listed] == shown
    named = {name for row in listed for name in row["files"].split()}
    there = {p.name for p in report.parts.folder.iterdir()}
    assert there == named | {"index.csv", "methods.txt", "summary.txt"}
    assert all(row["origin"] and row["made_by"] and row["caption"] for row in listed)
    assert report.parts.figures + report.parts.tables == len(listed)


def test_parts_hold_the_summary(report):
    lines = (report.parts.folder / "summary.txt").read_text(encoding="utf-8").splitlines()
    assert len(lines) > 1
    for line, answer in zip(lines, summarised(report.sections), strict=True):
        assert line.startswith(f"{answer.question.value} [")
        assert "simulated" in line


def test_numbers_are_those_of_the_page(report):
    page = report.html.read_text(encoding="utf-8")
    for row in index(report):
        place = page.index(f'id="{row["key"]}"')
        found = re.search(r"<strong>(Figure|Table) \d+", page[place:])
        assert found[0] == f"<strong>{row['output']}"


def test_figures_can_be_read(report):
    pictures = sorted(report.parts.folder.glob("*.png"))
    assert pictures
    assert all(p.read_bytes().startswith(PNG) for p in pictures)
    for path in report.parts.folder.glob("*.svg"):
        assert ET.parse(path).getroot().tag == "{http://www.w3.org/2000/svg}svg"
    assert {p.stem for p in pictures} == {p.stem for p in report.parts.folder.glob("*.svg")}


def test_csv_holds_the_numbers_as_computed(report):
    for section in report.sections:
        for table in section.tables:
            (path,) = report.parts.folder.glob(f"table-??-{table.key}.csv")
            back = pd.read_csv(path)
            assert list(back.columns) == [str(c) for c in table.frame.columns]
            for column in table.frame.columns:
                if pd.api.types.is_float_dtype(table.frame[column]):
                    np.testing.assert_array_equal(back[column], table.frame[column])


def test_latex_is_ascii_with_as_many_cells_as_the_page(report):
    for section in report.sections:
        for table in section.tables:
            text = latex(table)
            assert text.isascii()
            body = text[text.rindex(r"\toprule") : text.index(r"\bottomrule")]
            lines = [line for line in body.splitlines() if line.endswith(r"\\") and "multicolumn" not in line]
            assert len(lines) == len(table.frame) + (not table.facts)
            assert {len(re.findall(r"(?<!\\)&", line)) + 1 for line in lines} == {len(table.frame.columns)}
            assert table.origin[0].label in text


def test_latex_escapes_what_latex_takes_for_commands():
    text = r"50% of $x_1 & \alpha {~} #2 ^ <b>|c|"
    out = escaped(text)
    plain = re.sub(r"\\textbackslash\{\}|\\textasciitilde\{\}|\\textasciicircum\{\}", "", out)
    assert not re.search(r"(?<!\\)[%&#_{}]|[~^]", plain)
    assert escaped("\N{SNOWMAN}") == r"\symbol{9731}"


def test_parts_replace_those_of_the_report_before_and_nothing_else(small, tmp_path):
    chosen = some("provenance")
    build_report(small, states=(2,), quick=True, out=tmp_path, date=DATE, sections=chosen)
    stale = tmp_path / "parts" / "table-99-old.csv"
    stale.write_text("old")
    build_report(small, states=(2,), quick=True, out=tmp_path, date=DATE, sections=chosen)
    assert not stale.exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["parts", "report.html"]
    (tmp_path / "parts" / "index.csv").unlink()
    (tmp_path / "parts" / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match="folder of other files"):
        build_report(small, states=(2,), quick=True, out=tmp_path, date=DATE, sections=chosen)
    assert (tmp_path / "parts" / "mine.txt").read_text() == "keep"


def test_a_failure_leaves_the_last_parts_alone(small, tmp_path):
    build_report(small, states=(2,), quick=True, out=tmp_path, date=DATE, sections=some("provenance"))
    before = {p.name: p.read_bytes() for p in (tmp_path / "parts").iterdir()}

    def draw():
        raise RuntimeError("no such plot")

    bad = Entry("bad", "Bad", lambda _: (Figure("bad-figure", (draw,), "c", ("alt",), (Origin.DEFINITION,)),))
    with pytest.raises(RuntimeError, match="no such plot"):
        build_report(small, states=(2,), quick=True, out=tmp_path, date=DATE, sections=(bad,))
    assert {p.name: p.read_bytes() for p in (tmp_path / "parts").iterdir()} == before
    assert not [p for p in tmp_path.iterdir() if p.name.startswith(".")]


def test_without_parts_nothing_else_is_written(small, tmp_path):
    chosen = some("provenance")
    result = build.build_report(small, states=(2,), quick=True, out=tmp_path, date=DATE, sections=chosen)
    assert result.parts is None
    assert [p.name for p in tmp_path.iterdir()] == ["report.html"]


# -- quick reports say so wherever they are pasted -------------------------------------------------
def test_every_part_of_a_quick_report_is_marked(report):
    folder = report.parts.folder
    assert {row[MARK_COLUMN] for row in index(report)} == {QUICK_MARK}
    tables = [path.read_text() for path in folder.glob("*.tex")]
    assert tables
    for text in tables:
        assert text.splitlines()[0].startswith("% Needs ")
        assert text.splitlines()[0].endswith(f" {QUICK_MARK}")
        assert rf" {QUICK_MARK}}}\label" in text
    for path in folder.glob("*.svg"):
        root = ET.parse(path).getroot()
        assert next((e.tag, e.text) for e in root) == ("{http://www.w3.org/2000/svg}desc", QUICK_MARK)
    for path in folder.glob("*.png"):
        with Image.open(path) as picture:
            picture.verify()
            assert picture.info["Comment"] == QUICK_MARK


def test_no_part_of_a_full_report_is_marked(report, tmp_path):
    drawings, made = Drawings(pictures=True), report.sections
    written = write_parts(output_map(made, {}), drawings, tmp_path / "parts", "methods", quick=False)
    with (written.folder / "index.csv").open(newline="", encoding="utf-8") as stream:
        assert {row[MARK_COLUMN] for row in csv.DictReader(stream)} == {""}
    for path in written.folder.iterdir():
        if path.suffix in (".tex", ".svg", ".png"):
            assert b"citation" not in path.read_bytes(), path
        if path.suffix == ".svg":
            marked = (report.parts.folder / path.name).read_text(encoding="utf-8")
            assert marked.replace(f"<desc>{QUICK_MARK}</desc>", "") == path.read_text(encoding="utf-8")
    for figure in (b for s in made for b in s.flat() if isinstance(b, Figure)):
        for panel, path in zip(
            drawings.of(figure), sorted(written.folder.glob(f"figure-??-{figure.key}*.png")), strict=True
        ):
            assert path.read_bytes() == panel.png


# -- what makes what -------------------------------------------------------------------------------
def test_makers_of_figures_are_plot_functions_that_exist(report):
    import importlib

    for row in index(report):
        for name in row["made_by"].split(", "):
            module, _, function = name.rpartition(".")
            if row["output"].startswith("Figure"):
                assert module.startswith("analysis.figures.")
                assert callable(getattr(importlib.import_module(module), function))
            else:
                importlib.import_module(name)


def test_plot_functions_are_read_off_lambdas_partials_and_inner_functions():
    from functools import partial

    from analysis.figures import curves
    from analysis.figures.reward import reward_by_state

    def inner():
        def draw():
            return curves.curves({})

        return draw

    made = Figure(
        "f", (partial(reward_by_state, None), inner(), lambda: axes()), "c", ("a", "b", "c"), (Origin.DEFINITION,)
    )
    assert plot_functions(made) == ["analysis.figures.reward.reward_by_state", "analysis.figures.curves.curves"]


# -- planned and exploratory -----------------------------------------------------------------------
PLAN = """
title = "A plan"
date = 2026-01-05
where = "a registry"
[[planned]]
results = ["study", "criteria-by-states"]
why = "people help more once they were helped"
"""


@pytest.fixture
def plan(tmp_path):
    path = tmp_path / "plan.toml"
    path.write_text(PLAN)
    return path


def test_everything_is_planned_or_exploratory(small, plan, tmp_path):
    chosen = some("provenance", "study", "states")
    result = build_report(
        small, states=(2,), quick=True, out=tmp_path, date=DATE, sections=chosen, plan=read_analysis_plan(plan)
    )
    status = {row["key"]: (row["section"], row["status"]) for row in index(result)}
    for key, (section, found) in status.items():
        planned = section == "study" or key == "criteria-by-states"
        assert found == (PLANNED if planned else EXPLORATORY)
    page = result.html.read_text(encoding="utf-8")
    shown = [s for s in status.values() if s[0] != "appendix"]
    assert page.count('badge badge-planned"') == sum(s == PLANNED for _, s in shown)
    assert "Whether the plan was written before" in page


def test_a_plan_for_what_is_not_there_is_refused_with_what_looks_like_it(small, plan, tmp_path):
    plan.write_text(PLAN.replace("criteria-by-states", "criteria-by-state"))
    with pytest.raises(InputError, match=r"plan.toml, planned entry 1, results.*criteria-by-states"):
        build_report(
            small, states=(2,), quick=True, out=tmp_path / "out", date=DATE, sections=some("study", "states"),
            plan=read_analysis_plan(plan),
        )  # fmt: skip
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("title = ", "not valid TOML"),
        (PLAN.replace("title", "titel"), "key: found 'titel'"),
        (PLAN.replace('"A plan"', '" "'), "title"),
        (PLAN.replace("2026-01-05", '"soon"'), "a day, as 2026-03-01"),
        (PLAN.replace("2026-01-05", "3"), "date"),
        (PLAN.replace('["study", "criteria-by-states"]', '"study"'), "a list of keys"),
        (PLAN.replace('"criteria-by-states"', '"study"'), "every result once"),
        (PLAN.replace("why", "because"), "key: found 'because'"),
        (PLAN.split("[[planned]]", maxsplit=1)[0], "at least one"),
        ("planned = 3\n" + PLAN.split("[[planned]]", maxsplit=1)[0], "at least one"),
        (
            "planned = [3]\n" + PLAN.split("[[planned]]", maxsplit=1)[0],
            "planned entry 1: found int, wanted a [[planned]] table with results and why: results = [",
        ),
    ],
)
def test_malformed_plans_are_refused(plan, text, message):
    plan.write_text(text)
    with pytest.raises(InputError) as error:
        read_analysis_plan(plan)
    assert message in str(error.value)
    assert "plan.toml" in str(error.value)


def test_no_such_plan_and_no_text(tmp_path, capsys):
    assert run("report", "--quick", "--plan", tmp_path / "none.toml", "--out", tmp_path / "o") == 2
    assert "no such analysis plan" in capsys.readouterr().err
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    with pytest.raises(InputError, match="not UTF-8"):
        read_analysis_plan(tmp_path / "bytes.toml")
    with pytest.raises(InputError, match="is a folder, a TOML file was wanted"):
        read_analysis_plan(tmp_path)


def test_status_is_inherited_from_parts():
    table = Table("t", pd.DataFrame({"a": [1]}), "c", (Origin.DEFINITION,))
    section = Section("S", "s", (Text("x"), Part("P", "p", (table,))))
    (found,) = output_map([section], {"s": "m"}, lambda keys: PLANNED if "p" in keys else EXPLORATORY)
    assert (found.above, found.status, found.maker, found.name) == (("s", "p"), PLANNED, "m", "Table 1")


# -- the paragraph on methods ----------------------------------------------------------------------
def test_methods_name_sizes_settings_and_the_digest(report, small):
    text = (report.parts.folder / "methods.txt").read_text()
    assert "20 simulated people" in text
    assert small.digest[:16] in text
    assert "not for citation" in text
    for fit in report.study.fits.values():
        assert f"{fit.restarts} random starts, {fit.runs_in_final_stage} of them run on" in text
    keys = {row["key"] for row in csv.DictReader(io.StringIO((report.parts.folder / "index.csv").read_text()))}
    claims = {
        "No-U-Turn": ("contraction-", "posterior-", "robust-"), "AIC and BIC": ("criteria",),
        "mixed models": ("regression-models",), "analysis of variance": ("anova-table",),
        "backward induction": ("plan-values-",), "leave-one": ("loo-",),
    }  # fmt: skip
    for claim, starts in claims.items():
        assert (claim in text) <= any(key.startswith(starts) for key in keys), claim


def test_the_command_says_where_parts_are(tmp_path, capsys):
    log = tmp_path / "events.csv"
    from tests.analysis.event_text import text

    log.write_text(text())
    out = tmp_path / "out"
    words = ("report", "--data", log, "--states", "1", "--quick", "--out", out)
    content = result_of(capsys, *words)
    assert content["parts"] == str(out / "parts")
    (out / "parts" / "index.csv").unlink()
    assert run(*words) == 2
    assert "folder of other files" in capsys.readouterr().err


def test_a_file_is_of_the_kind_and_title_that_the_user_says(tmp_path, capsys):
    from tests.analysis.event_text import text

    log = tmp_path / "events.csv"
    log.write_text(text())
    words = ("report", "--data", log, "--states", "1", "--quick", "--no-parts", "--out", tmp_path / "out")
    content = result_of(capsys, *words, "--kind", "real", "--title", "My pilot")
    assert content["kind"] == "real"
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "<h1>My pilot</h1>" in page
    assert "badge-real" in page
    assert "is the word of whoever made this report" in page
    assert run(*words, "--kind", "imagined") == 2
    assert "real or simulated" in capsys.readouterr().err
    assert run("report", "--kind", "real", "--quick", "--out", tmp_path / "out") == 2
    assert "has a card of its own" in capsys.readouterr().err
    assert run("report", "--compare", log, "frd2012", "--title", "My pilot", "--out", tmp_path / "out") == 2
    assert "--title" in capsys.readouterr().err
