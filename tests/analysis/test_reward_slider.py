"""Sliders over r and costs: what the page holds, and in a browser what it shows in every cell it is asked for."""

import base64
import json
import re

import numpy as np
import pytest
from matplotlib.colors import to_hex

from analysis.figures.reward_slider import SHADES, TOSS, show_slider, slider_html, whole_grid
from analysis.figures.style import SEQUENTIAL, to_svg
from analysis.sensitivity import decider_of
from analysis.simulate import calibrated_truth
from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.sensitivity.reward_grid import RewardGrid, decide_grid
from tests.random_cases import make_protocol, random_tables

R, COSTS = (0.08, 0.001, 0.06), (15.0, 0.0, 30.0, 5.0)
READING = "two-step-terminal"


@pytest.fixture(scope="module")
def layers():
    truth = calibrated_truth()
    rng = np.random.default_rng(1)
    # Models that disagree, so that some cells are a toss.
    others = [LatentStatePOMDP(*random_tables(rng, truth.protocol, truth.n_states)) for _ in range(23)]
    out = {}
    for name, models in {"truth </script>": [truth], "draws & more": [truth, *others]}.items():
        draws = ModelDraws.from_models(models)
        grid = RewardGrid.of(ModelDraws.from_models([truth]), R, COSTS)
        out[name] = decide_grid(decider_of(READING, draws), grid, 1.0)
    return out


@pytest.fixture(scope="module")
def page(layers):
    return slider_html(layers)


def data_of(page):
    return json.loads(re.search(r'<script type="application/json" class="data">(.*?)</script>', page, re.DOTALL)[1])


def told(found, row):
    """What a row of the decisions says, in the page's words."""
    acts = {0: "help", 1: "signal"}[row["k"]]
    if found.n_draws == 1:
        return row["action"].replace("_", " ")
    share = round(100 * row["shares"][acts])
    return f"{acts} in {share}% of {found.n_draws} draws" + (", a toss" if row["verdict"] == "coin toss" else "")


def test_it_holds_every_cell_in_rising_order(layers, page):
    data = data_of(page)
    assert data["r"] == sorted(R)
    assert data["costs"] == [sorted(COSTS)] * 2
    assert [layer["name"] for layer in data["layers"]] == list(layers)
    tosses = 0
    for layer, found in zip(data["layers"], layers.values(), strict=True):
        cells = np.frombuffer(base64.b64decode(layer["cells"]), dtype=np.uint8).reshape(3, 4, 4, 2)
        for row in found.rows():
            place = (
                data["r"].index(row["r"]),
                *(data["costs"][i].index(row[f"cost_{a}"]) for i, a in enumerate(data["actions"])),
            )
            code = int(cells[(*place, row["k"])])
            assert code % TOSS == round(100 * row["shares"][("help", "signal")[row["k"]]])
            assert (code >= TOSS) == (row["verdict"] == "coin toss")
            tosses += code >= TOSS
    assert tosses


def test_it_fetches_nothing_and_says_the_same_twice(layers, page):
    assert slider_html(layers) == page
    assert not re.search(r"https?:(?!//www\.w3\.org/2000/svg)|@[A-Z]+\d?@|\bimport\b|fetch\(|src=", page)
    assert page.count("<script") == page.count("</script>") == 2


def test_without_scripts_the_first_setting_is_said(layers):
    page = slider_html(layers, start=(0.079, 16, 4))
    assert re.search(r'class="at">([^<]+)<', page)[1] == "At r 0.08, cost of help 15, cost of signal 5"
    row = [
        r for r in next(iter(layers.values())).rows() if (r["r"], r["cost_help"], r["cost_signal"]) == (0.08, 15, 5)
    ]
    said = f"Step 0, human needs help: {told(next(iter(layers.values())), row[0])}. "
    said += f"Step 1, robot needs help: {told(next(iter(layers.values())), row[1])}."
    assert re.search(r'class="done">([^<]+)<', page)[1] == said


def test_the_reward_that_is_varied_is_shown_first(page):
    assert 'class="at">At r 0.06, cost of help 15, cost of signal 15<' in page


def test_what_cannot_be_shown(layers):
    found = next(iter(layers.values()))
    with pytest.raises(InputError, match=r"^sliders, layers: found 0, wanted at least one$"):
        slider_html({})
    other = decide_grid(decider_of(READING, ModelDraws.from_models([calibrated_truth()])), RewardGrid.of(
        ModelDraws.from_models([calibrated_truth()])), 1.0)  # fmt: skip
    with pytest.raises(InputError, match=r"^sliders, layer b: found another grid, wanted the same"):
        slider_html({"a": found, "b": other})


def test_one_cost_only_is_refused():
    protocol = make_protocol([True, False], [2, 1], 2)
    draws = ModelDraws.from_models(
        [LatentStatePOMDP(*random_tables(np.random.default_rng(2), protocol, 2), protocol)]
    )
    found = decide_grid(decider_of(READING, draws), RewardGrid.of(draws, (0.05,), (1.0, 2.0)), 1.0)
    with pytest.raises(InputError, match=r"^sliders, costs that are varied: found 1, wanted two$"):
        slider_html({"a": found})


def test_in_a_notebook_with_its_caption(layers, monkeypatch):
    shown = []
    monkeypatch.setattr("IPython.display.display", shown.append)
    show_slider(layers, "truth", "Move it.")
    assert shown[0].data.startswith('<div class="reward-slider"')
    assert shown[1].data == "*Simulated truth.* Move it."


def test_the_whole_grid_covers_every_cell_once_in_its_shade(layers):
    ax = whole_grid(layers)
    *cells, _ = ax.patches
    area: dict = {}
    for patch in cells:
        colour = to_hex(patch.get_facecolor()), patch.get_hatch() is not None
        for outline in patch.get_path().to_polygons():
            width, height = np.ptp(outline, axis=0)
            area[colour] = area.get(colour, 0) + round(width * height)
    wanted: dict = {}
    for found in layers.values():
        for row in found.rows():
            share = round(100 * row["shares"][("help", "signal")[row["k"]]])
            shade = to_hex(SEQUENTIAL(round(share / 100 * (SHADES - 1)) / (SHADES - 1)))
            key = shade, row["verdict"] == "coin toss"
            wanted[key] = wanted.get(key, 0) + 1
    assert area == wanted
    names = [text.get_text() for text in ax.texts]
    assert [n for n in names if n in layers] == list(layers)
    assert to_svg(ax) == to_svg(whole_grid(layers))


# -- in a browser ----------------------------------------------------------------------------------
SET = """([layer, ...at]) => {
  const root = document.querySelector(".reward-slider");
  root.querySelector("select").value = layer;
  root.querySelectorAll("input").forEach((input, n) => { input.value = at[n]; });
  root.querySelector("input").dispatchEvent(new Event("input"));
  return root.querySelector(".done").textContent;
}"""


def test_the_browser_says_what_was_decided(browser, layers, page):
    tab, errors = browser.new_page(), []
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.on("request", lambda request: errors.append(request.url))
    tab.set_content(f"<!doctype html><body>{page}{page}</body>")
    assert tab.locator(".maps:visible").count() == 2
    first = re.search(r'class="done">([^<]+)<', page)[1]
    assert tab.locator(".done").all_inner_texts() == [first, first]
    r, costs = sorted(R), sorted(COSTS)
    for n, found in enumerate(layers.values()):
        rows = found.rows()
        for one, two in zip(rows[::2], rows[1::2], strict=True):
            at = [r.index(one["r"]), costs.index(one["cost_help"]), costs.index(one["cost_signal"])]
            wanted = f"Step 0, human needs help: {told(found, one)}. Step 1, robot needs help: {told(found, two)}."
            assert tab.evaluate(SET, [n, *at]) == wanted
    assert errors == []
    tab.close()


def test_a_click_sets_both_costs_and_pictures_follow(browser, layers, page):
    tab = browser.new_page()
    tab.set_content(f"<!doctype html><body>{page}</body>")
    tab.evaluate(SET, [0, 1, 0, 0])
    size = len(COSTS)
    tab.locator(".maps svg >> nth=1").locator("rect[fill^='#']").nth(3 * size + 1).click()
    assert [tab.locator("input").nth(n).input_value() for n in range(3)] == ["1", "3", "1"]
    found = next(iter(layers.values()))
    shades = data_of(page)["shades"]
    fills = tab.locator(".maps svg >> nth=0").locator("rect[fill^='#']")
    rows = [x for x in found.rows() if x["k"] == 0 and x["r"] == 0.06]
    acts = {(x["cost_help"], x["cost_signal"]): x["action"] == "help" for x in rows}
    wanted = [shades[-1] if acts[a, b] else shades[0] for a in sorted(COSTS) for b in sorted(COSTS)]
    assert len(set(wanted)) == 2
    assert fills.evaluate_all("all => all.map(e => e.getAttribute('fill'))") == wanted
    tab.close()
