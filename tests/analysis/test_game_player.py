"""The player of a recorded round: what it holds, and in a browser what it shows, pixel by pixel."""

import base64
import io
import json
import re

import numpy as np
import pytest
from PIL import Image

from analysis.game_player import NAMES, player_html, show_round
from analysis.game_scenes import simulated_round
from models.errors import InputError
from models.game.parameters import GameParameters
from models.game.record import replay
from models.game.render import Painter
from models.game.render_walks import glides

SHORT = GameParameters(round_ticks=300, trap_tick=60)
CELL = 24


@pytest.fixture(scope="module")
def played():
    return simulated_round("robot", True, True, 1, parameters=SHORT)


@pytest.fixture(scope="module")
def page(played):
    return player_html(played, cell=CELL)


def data_of(page):
    return json.loads(re.search(r'<script type="application/json" class="data">(.*?)</script>', page, re.DOTALL)[1])


def picture_of(address):
    content = base64.b64decode(address.removeprefix("data:image/png;base64,"))
    return np.asarray(Image.open(io.BytesIO(content)).convert("RGB")).astype(int)


def test_it_holds_every_tick(played, page):
    data, views = data_of(page), list(replay(played))
    assert len(data["players"]) == len(views) == data["end"] + 1
    for view, (index, *players) in zip(views, data["players"], strict=True):
        human, robot, state, *things = data["things"][index]
        assert (human, robot) == (view.human_collected, view.robot_collected)
        assert ("trapped" in data["states"][state]) == (view.trapped is not None)
        names = [NAMES[number] for number in things[::3]]
        assert names.count("human_token") == len(view.human_tokens)
        assert names.count("red") == sum(colour == "red" for _, colour in view.doors)
        assert ("cage" in [NAMES[number] for number in players[::3]]) == (view.trapped is not None)
    assert views[data["trap"]].trapped == "robot"
    assert views[data["trap"] - 1].trapped is None


def test_it_fetches_nothing_and_says_the_same_twice(played, page):
    assert player_html(played, cell=CELL) == page
    assert not re.search(r"https?:|//[a-z]|@[A-Z]+@|\bimport\b|fetch\(", re.sub(r"base64,[\w+/=]+", "", page))
    assert set(re.findall(r'(?:src|href)="([^,"]*)', page)) == {"data:image/png;base64"}
    assert len(page) < 120_000


def test_without_scripts_a_moment_is_shown(played, page):
    shown = int(re.search(r'value="(\d+)" step', page)[1])
    painter, views = Painter(played.layout, SHORT.round_ticks, CELL), list(replay(played))
    assert painter.lit(views[shown])
    poster = picture_of(re.search(r'class="poster" alt="[^"]+" src="([^"]+)"', page)[1])
    assert np.array_equal(poster, painter.frame(views[shown])[painter.header :])


def test_a_round_without_a_trap(played):
    quiet = simulated_round(parameters=GameParameters(round_ticks=30))
    data = data_of(player_html(quiet, cell=12))
    assert data["trap"] == -1
    assert data["states"] == [""]


@pytest.mark.parametrize("shown", [-1, 301])
def test_a_tick_that_is_not_there(played, shown):
    with pytest.raises(InputError, match=f"^player, tick shown: found {shown}, wanted 0 to 300$"):
        player_html(played, shown=shown)


def test_in_a_notebook_with_its_caption(played, monkeypatch):
    shown = []
    monkeypatch.setattr("IPython.display.display", shown.append)
    show_round(played, "simulated", "A round.")
    assert shown[0].data.startswith('<div class="token-game"')
    assert shown[1].data == "*Simulated.* A round."


# -- in a browser ----------------------------------------------------------------------------------
GO_TO = """tick => {
  const slider = document.querySelector("input");
  slider.value = tick;
  slider.dispatchEvent(new Event("input"));
  return document.querySelector("canvas").toDataURL();
}"""


def test_the_browser_shows_what_the_painter_paints(browser, played, page):
    tab, errors = browser.new_page(), []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.on("request", lambda request: request.url.startswith("data:") or errors.append(request.url))
    tab.set_content(f"<!doctype html><body>{page}{page}</body>")
    tab.wait_for_selector("canvas:visible")
    painter, views = Painter(played.layout, SHORT.round_ticks, CELL), list(replay(played))
    ways = glides(views, (SHORT.human_step_ticks, SHORT.robot_step_ticks))
    trap = data_of(page)["trap"]
    for tick in (0, 3, trap, trap + 1, trap + 5, 222, 300):
        shown = picture_of(tab.evaluate(GO_TO, tick))
        wanted = painter.frame(views[tick], tuple(ways[tick, 0]), tuple(ways[tick, 1]))[painter.header :]
        assert np.abs(shown - wanted).max() <= 2  # a browser rounds opacity in its own way
        assert tab.inner_text(".human") == str(views[tick].human_collected)
    assert tab.locator("canvas:visible").count() == 2
    assert tab.locator("img:visible").count() == 0
    tab.click(".trap >> nth=0")
    assert tab.get_attribute(".token-game >> nth=0", "data-tick") == str(trap)
    assert errors == []
    tab.close()


def test_it_plays(browser, page):
    tab = browser.new_page()
    tab.set_content(f"<!doctype html><body>{page}</body>")
    tab.wait_for_selector("canvas:visible")
    tab.evaluate(GO_TO, 290)
    tab.select_option("select", "4")
    tab.click("button.play")
    assert tab.inner_text("button.play") == "Pause"
    tab.wait_for_function("document.querySelector('.token-game').dataset.tick === '300'", timeout=10_000)
    assert tab.inner_text("button.play") == "Play"
    assert tab.inner_text(".clock") == "0:00"
    tab.click("button.play")
    tab.wait_for_function("Number(document.querySelector('.token-game').dataset.tick) < 290", timeout=10_000)
    tab.click("button.play")
    assert tab.inner_text("button.play") == "Play"
    tab.close()
