"""The command ``replicate game``: its file, its words and its refusals."""

import json
import re

import pytest
import typer
from typer.testing import CliRunner

from analysis import game_settings
from analysis.cli_game import replicate_game_command
from analysis.evidence import NEEDED, read_evidence
from analysis.game_calibration import calibrate_game
from analysis.study2_evidence import game_settings as settings_of_the_game
from models.errors import InputError
from models.game.layout import packaged
from models.game.parameters import GameParameters


@pytest.fixture
def run(monkeypatch):
    """The command on its own, with two settings to try and few restarts."""
    tried = tuple(
        game_settings.GameSetting(name, packaged(), GameParameters(round_ticks=ticks))
        for name, ticks in (("default", GameParameters().round_ticks), ("short", 600))
    )
    monkeypatch.setattr("analysis.game_settings.settings_tried", lambda: tried)
    app = typer.Typer()
    app.command()(replicate_game_command)
    few = ("--studies", "2", "--tried", "2", "--participants", "40")
    return lambda *options: CliRunner().invoke(app, [*few, *(str(o) for o in options)])


def test_what_is_stored(run, tmp_path):
    done = run("--out", tmp_path / "game.json", "--seed", 4)
    assert done.exit_code == 0, done.output
    content = json.loads((tmp_path / "game.json").read_text())
    assert set(NEEDED) <= content.keys()
    stored = read_evidence("game", tmp_path)
    assert not stored.stale
    assert stored.content["command"] == (
        "prosocial replicate game --studies 2 --tried 2 --participants 40 --seed 4"
    )
    own = calibrate_game(studies=2, participants=40, seed=4)
    assert [row["measured"] for row in content["table"]] == pytest.approx(own.table["measured"].tolist(), rel=1e-12)
    assert content["game"] == settings_of_the_game()
    assert {row["setting"] for row in content["search"]} == {"default", "short"}
    assert content["learning"]["table"][0]["log"] == "direct simulation"
    assert content["learning"]["table"][0]["seconds"] is None
    assert own.sentence in content["sentence"]
    assert own.sentence in done.output
    for row in own.table.itertuples():
        name = row.quantity.replace("x_s", "x of state ")
        assert re.search(
            rf"^ *{name}, {row.unit} +{row.measured:.2f} +{row.printed:.2f} ", done.output, re.MULTILINE
        ), name
    assert re.search(r"quantity +simulated +printed +difference +percent +se +sd", done.output)
    assert "Settings tried, simulated, 2 studies each" in done.output
    assert "brackets: beyond lowest and highest printed x by 2 standard errors" in done.output
    assert re.search(r"^ *short +60\.0 +0\.5 +45\.0 ", done.output, re.MULTILINE)
    widest = max(len(line) for line in done.output.splitlines()[:10])
    assert widest <= 80


def test_without_a_search(run):
    done = run("--tried", 0, "--json", "-", "--quiet")
    assert done.exit_code == 0, done.output
    content = json.loads(done.output)
    assert (content["search"], content["search_studies"]) == ([], 0)
    assert "settings bracket" not in content["sentence"]


def test_one_study_has_no_standard_error(run):
    done = run("--tried", 1)
    assert isinstance(done.exception, InputError)
    assert str(done.exception).startswith("--tried: found 1")
