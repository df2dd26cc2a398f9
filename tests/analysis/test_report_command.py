"""The command `prosocial report`."""

import json

import pytest

from analysis.report import build
from models.errors import InputError
from tests.analysis.command import run_captured as run
from tests.analysis.event_text import text as event_text
from tests.analysis.report_page import ALL_SECTIONS

pytestmark = pytest.mark.usefixtures("short_reports")


def test_run_length_of_the_command_line_goes_before_the_card(capsys, tmp_path, monkeypatch):
    seen = []

    def stop(dataset, **options):
        seen.append((dataset.card.run_length, options["command"]))
        raise InputError("enough")

    monkeypatch.setattr(build, "build_report", stop)
    for given in ((), ("--run-length", "random")):
        assert run(capsys, "report", "--out", tmp_path, *given)[0] == 2
    assert [length for length, _ in seen] == ["unstated", "random"]
    assert "--run-length random" in seen[1][1]


def test_command(capsys, tmp_path):
    status, out, err = run(
        capsys, "report", "--states", "2", "--condition", "help+signal", "--quick", "--out", tmp_path, "--seed",
        "3", "--json", "-",
    )  # fmt: skip
    assert status == 0, err
    content = json.loads(out)
    assert content.keys() >= {"html", "pdf", "sections", "seconds"}
    assert content["pdf"] is None
    assert [s["key"] for s in content["sections"]] == ALL_SECTIONS
    assert content["quick"] is True
    assert content["states"] == [2]
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "prosocial report --quick --data simulated_study1 --condition help+signal --states 2 --seed 3" in text
    assert "condition help+signal: 164 of 540 people" in text
    assert "not for citation" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--data", "nonsense"), "registered data set"),
        (("--condition", "nonsense"), "--condition"),
        (("--states", "two"), "--states"),
        (("--pin", "dance"), "--pin"),
    ],
)
def test_unusable_arguments(capsys, tmp_path, arguments, message):
    status, _, err = run(capsys, "report", "--quick", "--out", tmp_path / "new", *arguments)
    assert status == 2
    assert message in err
    assert "Traceback" not in err
    assert not (tmp_path / "new").exists()


def test_what_is_read_is_never_overwritten(capsys, tmp_path):
    path = tmp_path / "two.csv"
    path.write_text(event_text())
    status, _, err = run(capsys, "report", "--data", path, "--json", path, "--out", tmp_path / "new")
    assert (status, err) == (2, f"prosocial: --json: found '{path}', wanted another file than --data\n")
    page = tmp_path / "report.html"
    page.write_text(event_text())
    status, _, err = run(capsys, "report", "--data", page, "--out", tmp_path)
    assert status == 2
    assert "--out, report.html: found" in err
    status, _, err = run(capsys, "report", "--protocol", page, "--out", tmp_path)
    assert "wanted another file than --protocol" in err
    assert path.read_text() == page.read_text() == event_text()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--out", ""), "--out: found '', wanted the name of a folder"),
        (("--out", "/proc/new"), "/proc, where no file can be made"),
        (("--run-length", "long"), "--run-length: found 'long', wanted random or fixed"),
    ],
)
def test_options_are_checked_before_any_work(capsys, arguments, message):
    status, _, err = run(capsys, "report", "--quick", *arguments)
    assert status == 2
    assert message in err


def test_a_folder_that_cannot_be_one_is_refused_before_any_work(capsys, tmp_path):
    (tmp_path / "file").write_text("x")
    status, _, err = run(capsys, "report", "--quick", "--out", tmp_path / "file")
    assert status == 2
    assert "--out" in err
