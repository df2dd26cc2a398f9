"""Stored results of the benchmarks, and the page that is made from them."""

import copy
import json
import math
import re
import runpy
from pathlib import Path

import pytest

from analysis.bench import end_to_end, results, startup, timing
from analysis.bench.page import page, plain
from analysis.bench.results import STORED, SUITES, added, judged, measure, read_results, sentence, suites
from analysis.bench.timing import Row, Target, Timing, environment, ranges
from analysis.evidence import FOLDER
from models.errors import InputError
from tests.analysis.command import run_captured


def row(name, ours=2.0, met=None, goal=None, target="", **more):
    return Row(name, ours, None, None, "s CPU", target=target, met=met, goal=goal, **more).to_dict()


def suite(*rows, quick=False, **more):
    return {
        "date": "2026-01-02", "quick": quick, "command": "prosocial bench em", "load": [0.5, 1.25], "processors": 2,
        "seconds": 12.0, "rows": list(rows), "points": [], "environment": {"python": "3.13.1", "numpy": "2.5.0"},
    } | more  # fmt: skip


GOAL = Target("<=", 1.0, "ours")


def content():
    em = suite(
        row("a met one", 0.5, True, GOAL, "<= 1 s"), row("a missed one", 7.25, False, GOAL, "<= 1 s"),
        row("no target", 3.0), row("an unclear one", 2.0, None, GOAL, "<= 1 s", note="the machine was busy"),
    )  # fmt: skip
    return added(None, {"em": em})


# -- rows and targets ------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("sense", "yes", "no"),
    [(">=", 2.0, 1.99), ("<=", 2.0, 2.01), (">", 2.01, 2.0), ("<", 1.99, 2.0), ("within", 0.5, 0.49)],
)
def test_targets_hold(sense, yes, no):
    target = Target(sense, 2.0)
    assert target.holds(yes)
    assert not target.holds(no)
    assert not target.holds(math.nan)


def test_targets_that_say_nothing_are_refused():
    with pytest.raises(InputError, match="one of >="):
        Target("=", 1.0)
    with pytest.raises(InputError, match="measured"):
        Target("<=", 1.0, "cost a draw")
    assert Row("x", 1.0, None, None, "s", goal=Target("<=", 1.0, "cost a draw", 0.5)).measured == 0.5


def test_a_row_carries_ranges_and_repeats():
    ours, peer = Timing.of([1.0, 3.0, 2.0]), Timing.of([10.0, 30.0])
    made = Row("x", 2e3, 20.0, 10.0, "ms CPU", **ranges(ours, 1e3, peer)).to_dict()
    assert (made["ours_range"], made["repeats"]) == ((1e3, 3e3), 3)
    assert (made["peer_range"], made["peer_repeats"]) == ((10.0, 30.0), 2)
    assert ours.rates(6.0) == (2.0, 6.0)


def test_the_environment_names_no_machine_and_no_path():
    import getpass
    import platform

    text = json.dumps(environment())
    assert platform.node() not in text.split('"')
    assert "/" not in re.sub(r"[A-Za-z]+/[A-Za-z]+", "", environment()["processor"])
    assert f'"{getpass.getuser()}"' not in text


# -- stored results --------------------------------------------------------------------------------
def test_results_are_added_to_suite_by_suite():
    before = content()
    after = added(before, {"game": suite(row("played", 1.0)), "em": suite(row("again", 1.0))})
    assert list(after["suites"]) == ["em", "game"]
    assert [r["name"] for r in after["suites"]["em"]["rows"]] == ["again"]
    assert before["sentence"] == "Of 3 targets 1 were met and 1 missed; 1 could not be judged."
    assert "less sure: game." in sentence({"suites": {"game": suite(quick=True)}})


def test_every_suite_is_there():
    assert set(suites()) <= set(SUITES)
    assert {"em", "bayes", "glmm", "planning", "robust", "game", "startup", "end_to_end", "curves"} <= set(suites())


def test_a_suite_is_measured_with_its_load_and_points(monkeypatch):
    def run(*, quick, progress):
        yield Row("a", 1.0, None, None, "s")
        yield {"axis": "x", "seconds": 2.0}

    monkeypatch.setattr(startup, "run", run)
    seen = []
    found = measure("startup", quick=True, each=seen.append)
    assert [r.name for r in seen] == ["a"]
    assert found["points"] == [{"axis": "x", "seconds": 2.0}]
    assert found["command"] == "prosocial bench startup --quick"
    assert len(found["load"]) == 2


def test_what_are_no_results_is_refused(tmp_path):
    with pytest.raises(InputError, match="no such file"):
        read_results(tmp_path / "none.json")
    (tmp_path / "other.json").write_text('{"rows": []}')
    with pytest.raises(InputError, match="no suites"):
        read_results(tmp_path / "other.json")


def test_the_command_adds_to_a_file(monkeypatch, tmp_path, capsys):
    def run(*, quick, progress):
        yield Row("a missed one", 2.0, None, None, "s", target="<= 1 s", met=False, goal=GOAL)

    monkeypatch.setattr(startup, "run", run)
    out = tmp_path / "bench.json"
    out.write_text(json.dumps(content()))
    status, said, err = run_captured(capsys, "bench", "startup", "--quick", "--out", out)
    assert status == 0, err
    assert "TARGET MISSED" in said
    stored = read_results(out)
    assert list(stored["suites"]) == ["em", "startup"]
    assert "Of 4 targets" in stored["sentence"]


def test_sizes_belong_to_predictions(capsys):
    status, _, err = run_captured(capsys, "bench", "em", "--people", "1e6")
    assert status == 2
    assert "predict" in err


def test_the_command_predicts(tmp_path, capsys):
    points = [
        {"operation": "game", "axis": "rounds of the game", "game_rounds": n, "seconds": 1e-3 * n,
         "memory": 1e8 + 1e3 * n} for n in (10, 30, 100, 300, 1_000, 3_000)
    ]  # fmt: skip
    (tmp_path / "b.json").write_text(json.dumps(added(None, {"curves": suite(points=points)})))
    status, said, err = run_captured(
        capsys, "bench", "predict", "--game-rounds", "1e6", "--curves", tmp_path / "b.json"
    )
    assert status == 0, err
    assert "extrapolated beyond what was measured (game_rounds)" in said
    assert "17 min CPU (95% interval" in said


# -- the page --------------------------------------------------------------------------------------
def sections(text):
    return re.findall(r"^## (.+?)(?: \{.*)?$", text, flags=re.MULTILINE)


def test_missed_targets_come_first():
    text, _ = page(content())
    assert sections(text)[:3] == [
        "Targets that were missed", "Targets that could not be judged", "Targets that were met"
    ]  # fmt: skip
    assert text.index("a missed one") < text.index("an unclear one") < text.index("a met one")
    missed = text[text.index("## Targets that were missed") : text.index("## Targets that could")]
    assert "&lt;= 1 s" in missed
    assert "**7.25**" in missed


def test_the_page_changes_with_the_results():
    before = content()
    after = copy.deepcopy(before)
    changed = after["suites"]["em"]["rows"][0]
    changed["ours"], changed["measured"], changed["met"] = 4.5, 4.5, False
    old, new = page(before)[0], page(added(after, {}))[0]
    assert "**4.5**" in new
    assert "**4.5**" not in old
    assert new.index("a met one") < new.index("## Targets that could not be judged") < old.index("a met one")
    assert "Of 3 targets 0 were met and 2 missed" in new
    after["suites"]["em"]["environment"]["numpy"] = "9.9.9"
    assert "9.9.9" in page(after)[0]


def test_the_page_says_load_date_command_and_machine():
    text, _ = page(content())
    assert "No results are stored of: bayes (the posterior), " in text
    for words in ("2026-01-02", "0.5 and 1.25", "`prosocial bench em`", "3.13.1"):
        assert words in text


def test_text_in_tables_is_harmless():
    assert plain("a|b <script>") == "a&#124;b &lt;script&gt;"


@pytest.fixture(scope="module")
def stored():
    return read_results(STORED)


def test_stored_targets_are_judged_by_their_numbers(stored):
    """What the suites call met is what the numbers say, where there is no further condition."""
    judged_rows = [r for rows in judged(stored).values() for _, r in rows if r["met"] is not None]
    assert judged_rows
    for r in judged_rows:
        goal = r["goal"]
        assert goal is not None, r["name"]
        holds = Target(goal["sense"], goal["number"], goal["of"], goal["measured"]).holds(r["measured"])
        assert holds == r["met"] or (goal["also"] and holds), r["name"]


def test_stored_rows_have_ranges_around_their_medians(stored):
    for name, found in stored["suites"].items():
        assert found["rows"] or found["points"], name
        for r in found["rows"]:
            if r["ours_range"] and r["repeats"] > 1:
                assert r["ours_range"][0] <= r["ours"] * (1 + 1e-9), r["name"]
                assert r["ours"] <= r["ours_range"][1] * (1 + 1e-9), r["name"]
            if r["peer"] is None and r["peer_name"]:
                assert r["note"], r["name"]


@pytest.fixture(scope="module")
def stored_page(stored):
    return page(stored)


def test_the_stored_page_holds_every_target_and_the_figures(stored, stored_page):
    text, figures = stored_page
    for rows in judged(stored).values():
        for _, r in rows:
            assert plain(r["name"]) in text
    for name in re.findall(r'src="([^"]+\.svg)"', text):
        assert figures[name].startswith("<svg")
        assert "xmlns=" in figures[name][:500]
    assert str(Path(__file__).parents[2]) not in text
    assert str(Path.home()) + "/" not in text


def test_the_site_makes_the_page_from_the_stored_results(stored_page):
    config_of = pytest.importorskip("mkdocs.config.defaults")
    structure = pytest.importorskip("mkdocs.structure.files")
    plugins = pytest.importorskip("mkdocs.plugins")
    hook = runpy.run_path(str(FOLDER.parent / "docs" / "hooks" / "benchmarks.py"))
    config = config_of.MkDocsConfig()
    config.load_dict({"site_name": "x", "site_dir": "nowhere", "use_directory_urls": False})
    config.plugins = plugins.PluginCollection()
    config.plugins._current_plugin = None  # as while no plugin runs
    files = hook["on_files"](structure.Files([]), config)
    text, figures = stored_page
    assert files.get_file_from_path(hook["PAGE"]).content_string == text
    assert {f.src_uri for f in files} == {hook["PAGE"], *figures}
    site = (FOLDER.parent / "docs" / "mkdocs.yml").read_text(encoding="utf-8")
    assert "hooks/benchmarks.py" in site
    assert hook["PAGE"] in site


# -- new suites ------------------------------------------------------------------------------------
def test_processes_are_timed_from_start_to_end():
    import sys

    found = startup.started([sys.executable, "-c", "sum(range(3_000_000))"], 3)
    assert found.cpu.repeats == 3
    assert 0.005 < found.cpu.low <= found.cpu.median <= found.cpu.high < 10
    assert found.wall.low > 0.8 * found.cpu.low


def test_the_clock_is_not_judged_on_a_busy_machine(monkeypatch):
    slow = startup.Started(Timing.of([0.3]), Timing.of([2.0]))
    monkeypatch.setattr(timing, "load", lambda: 50.0)
    cpu, wall = startup.rows("x", slow, 0.4)
    assert (cpu.met, wall.met) == (True, None)
    assert "not judged" in wall.note
    monkeypatch.setattr(timing, "load", lambda: 0.0)
    assert [r.met for r in startup.rows("x", slow, 0.4)] == [True, False]


def test_reports_are_made_in_a_cache_of_their_own(monkeypatch):
    calls = []

    def once(command, environment=None):
        calls.append((command[3:], environment["PROSOCIAL_CACHE"]))
        return 1.0, 2.0

    monkeypatch.setattr(end_to_end, "once", once)
    rows = list(end_to_end.run(quick=False))
    assert len({cache for _, cache in calls}) == 3
    assert all(command[0] == "report" for command, _ in calls)
    assert [r.name for r in rows][:3] == [
        "report --quick, nothing compiled, no stored fits", "report --quick, no stored fits",
        "report --quick, stored fits",
    ]  # fmt: skip
    assert results.SUITES["end_to_end"]
