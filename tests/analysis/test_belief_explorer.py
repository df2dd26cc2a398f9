"""The belief explorer: polygons against the plan itself, a browser's numbers against the project's own filter."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from analysis.belief_explorer import (
    CORNERS,
    area,
    explorer_html,
    largest_somewhere,
    pieces,
    regions,
    shares_in_words,
    show_explorer,
)
from analysis.simulate import calibrated_truth
from models.errors import InputError
from models.lspomdp import LatentStatePOMDP
from models.planning.latent import latent_problem
from models.planning.problems import problem as standard
from models.planning.solver import solve
from tests.random_cases import make_protocol, random_tables


@pytest.fixture(scope="module")
def truth():
    return calibrated_truth()


@pytest.fixture(scope="module")
def plans(truth):
    out = {}
    for name, costs in {"help 40 </script>": {"help": 40.0, "signal": 3.0}, "help 15 & 15": {}}.items():
        reward = replace(truth.reward, costs=costs)
        out[name] = solve(latent_problem(replace(truth, reward=reward)), 1e-4).policy
    return out


@pytest.fixture(scope="module")
def three():
    """Three states and three responses: nothing of the published protocol."""
    protocol = make_protocol([True, False], [3, 2], 3)
    tables = random_tables(np.random.default_rng(5), protocol, 3)
    return solve(latent_problem(LatentStatePOMDP(*tables, protocol), discount=0.8), 1e-4).policy


@pytest.fixture(scope="module")
def page(plans):
    return explorer_html(plans, held=1)


def beliefs(n, count=400, seed=0):
    rng = np.random.default_rng(seed)
    return np.concatenate([np.eye(n), rng.dirichlet(np.ones(n), count), rng.dirichlet(np.full(n, 0.2), count)])


def all_of(plans, three):
    return [*plans.values(), three]


# -- numbers ---------------------------------------------------------------------------------------
def test_pieces_are_the_look_ahead(plans, three):
    for plan in all_of(plans, three):
        for mode in range(len(plan.vocabulary.modes)):
            found, at = pieces(plan, mode), beliefs(len(plan.model.states[0]))
            wanted = plan.action_values_many(at, mode)
            for c in range(wanted.shape[1]):
                own = (at @ found.alpha[found.choice == c].T).max(axis=1)
                assert np.abs(own - wanted[:, c]).max() < 1e-8 * np.abs(wanted).max()


@given(st.integers(0, 2**32), st.integers(2, 5), st.integers(1, 9))
@settings(max_examples=40, deadline=None)
def test_vectors_left_out_are_largest_nowhere(seed, n, count):
    rng = np.random.default_rng(seed)
    vectors = rng.integers(-3, 4, (count, n)).astype(float)
    vectors = np.concatenate([vectors, vectors[:2], (vectors[:1] + vectors[-1:]) / 2 - 0.25])
    kept, at = largest_somewhere(vectors), beliefs(n, 200)
    assert np.allclose((at @ kept.T).max(axis=1), (at @ vectors.T).max(axis=1), atol=1e-8)
    assert len(np.unique(kept, axis=0)) == len(kept)
    for i in range(len(kept)):  # each of those that stay is needed
        others = np.delete(kept, i, axis=0)
        dense = beliefs(n, 4000, seed)
        assert len(others) == 0 or (dense @ kept[i]).max() >= (dense @ others.T).max(axis=1).min() - 1e-9


def inside(corners, points):
    """Whether points lie in a convex polygon, by the side of every edge."""
    flat, at = corners[:, :2], points[:, :2]
    edge = np.roll(flat, -1, axis=0) - flat
    away = at[:, None] - flat[None]
    cross = edge[None, :, 0] * away[..., 1] - edge[None, :, 1] * away[..., 0]
    return (cross >= -1e-12).all(axis=1) | (cross <= 1e-12).all(axis=1)


@pytest.mark.parametrize(("held", "share"), [(0, 0.0), (1, 0.127), (2, 0.4), (3, 0.9)])
def test_regions_are_where_the_plan_does_what_they_say(plans, held, share):
    points = beliefs(3, 1500)[3:]
    for plan in plans.values():
        for mode in range(2):
            found = regions(pieces(plan, mode), held, share)
            assert sum(area(r.corners) for r in found) == pytest.approx(1, abs=1e-9)
            full = np.insert((1 - share) * points, held, share, axis=1)
            values = plan.action_values_many(full, mode)
            sure = np.abs(values[:, 0] - values[:, 1]) > 1e-6
            assert sure.mean() > 0.9
            covered = np.zeros(len(points), dtype=int)
            for region in found:
                own = inside(region.corners, points)
                covered += own
                assert (np.argmax(values[own & sure], axis=1) == region.choice).all()
            assert (covered >= 1).all()


def test_three_states_and_ties(three):
    for mode in range(2):
        found = regions(pieces(three, mode))
        assert sum(area(r.corners) for r in found) == pytest.approx(1, abs=1e-9)
    same = pieces(three, 1)
    twice = same._replace(
        alpha=np.concatenate([same.alpha, same.alpha]), choice=np.r_[same.choice, same.choice + 1]
    )
    found = regions(twice)  # of two equally good actions it is the first
    assert sum(area(r.corners) for r in found) == pytest.approx(1, abs=1e-9)
    assert {r.choice for r in found} <= set(same.choice.tolist())


def test_shares_in_words(plans):
    plan = plans["help 40 </script>"]
    found = regions(pieces(plan, 0), 1, 0.6)
    assert re.fullmatch(r"Best in this triangle: (no_help on \d+%, )?help on \d+% of its area\.",
                        shares_in_words(found, list(plan.vocabulary.actions[0])))  # fmt: skip


# -- the page --------------------------------------------------------------------------------------
def data_of(page):
    return json.loads(re.search(r'<script type="application/json" class="data">(.*?)</script>', page, re.DOTALL)[1])


def test_it_fetches_nothing_and_says_the_same_twice(plans, page):
    assert explorer_html(plans, held=1) == page
    assert not re.search(r"https?:(?!//www\.w3\.org/2000/svg)|@[A-Z]+\d?@|\bimport\b|fetch\(|src=", page)
    assert page.count("<script") == page.count("</script>") == 2
    assert len(page) < 150_000


def test_without_scripts_the_start_is_said_and_drawn(plans, truth, page):
    first = next(iter(plans.values()))
    said = re.search(r'class="said" role="status">([^<]+)<', page)[1]
    action = first.action(truth.initial, 0).replace("_", " ")
    worth = max(first.action_values(truth.initial, 0).values())
    assert said == (
        "Human needs help. Believed: s0 non 9.0%, s1 low 12.7%, s2 mid 21.9%, s3 high 56.4%. "
        f"Best: {action}, worth {worth:.2f} reward units from here on."
    )
    poster = re.search(r'<svg class="poster".*?</svg>', page, re.DOTALL)[0]
    drawn = regions(pieces(first, 0), 1, float(truth.initial[1]))
    assert poster.count("<polygon") == len(drawn) + 1
    assert "Best in this triangle" in re.search(r"<title>(.*?)</title>", poster)[1]
    x, y = (truth.initial[[0, 2, 3]] / truth.initial[[0, 2, 3]].sum()) @ CORNERS
    assert f'cx="{x:.1f}" cy="{y:.1f}"' in poster


def test_what_cannot_be_shown(plans, three):
    with pytest.raises(InputError, match=r"^belief explorer, plans: found 0, wanted at least one$"):
        explorer_html({})
    with pytest.raises(
        InputError, match=r"^belief explorer, plan b: .*wanted modes, actions, states as the first$"
    ):
        explorer_html({"a": next(iter(plans.values())), "b": three})
    tiger = solve(standard("tiger"), 1e-2).policy
    with pytest.raises(InputError, match=r"^belief explorer, hidden states: found \[2\], wanted three or four"):
        explorer_html(tiger)
    with pytest.raises(InputError, match=r"^belief explorer, state held: found 4, wanted 0 to 3$"):
        explorer_html(plans, held=4)
    with pytest.raises(InputError, match="belief"):
        explorer_html(plans, belief=[0.5, 0.5, 0.5, 0.5])


def test_sums_that_are_too_many_are_refused(plans, monkeypatch):
    monkeypatch.setattr("analysis.belief_explorer.MOST", 3)
    with pytest.raises(
        InputError, match=r"^belief explorer, action .*sums of vectors: found \d+, wanted at most 3$"
    ):
        explorer_html(plans)


def test_in_a_notebook_with_its_caption(three, monkeypatch):
    shown = []
    monkeypatch.setattr("IPython.display.display", shown.append)
    show_explorer(three, "truth", "Move it.")
    assert shown[0].data.startswith('<div class="belief-explorer"')
    assert shown[1].data == "*Simulated truth.* Move it."


# -- in a browser ----------------------------------------------------------------------------------
@pytest.fixture
def opened(browser):
    tabs = []

    def open_page(content, motion="reduce"):
        tab, errors = browser.new_page(reduced_motion=motion), []
        tab.on("pageerror", lambda error: errors.append(str(error)))
        tab.on("request", lambda request: errors.append(request.url))
        tab.set_content(f"<!doctype html><body>{content}</body>")
        tabs.append((tab, errors))
        return tab

    yield open_page
    for tab, errors in tabs:
        assert errors == []
        tab.close()


def state_of(tab):
    told = tab.evaluate("() => ({...document.querySelector('.belief-explorer').dataset})")
    return {k: json.loads(told[k]) for k in ("belief", "values", "regions", "mode")}


def agrees(tab, plan, belief, mode, held):
    """What the browser has worked out at a belief, against the plan, its filter's belief and the polygons here."""
    told = state_of(tab)
    assert told["mode"] == mode
    assert np.abs(np.array(told["belief"]) - belief).max() < 1e-12
    wanted = plan.action_values_many(belief[None], mode)[0]
    assert np.abs(np.array(told["values"]) - wanted).max() < 1e-8 * np.abs(wanted).max()
    best = plan.vocabulary.actions[mode][int(np.argmax(wanted))].replace("_", " ")
    assert f"Best: {best}, worth {wanted.max():.2f} " in tab.inner_text(".said")
    ours = regions(pieces(plan, mode), held, 0.0 if held is None else float(belief[held]))
    assert [r["choice"] for r in told["regions"]] == [r.choice for r in ours]
    for theirs, mine in zip(told["regions"], ours, strict=True):
        # A corner may come twice, by rounding: each has one of the other polygon where it is.
        apart = np.abs(np.array(theirs["corners"])[:, None] - mine.corners[None]).max(axis=-1)
        assert max(apart.min(axis=0).max(), apart.min(axis=1).max()) < 1e-7


def test_the_browser_filters_as_the_project_does(opened, plans, truth, page):
    tab = opened(page + page)
    assert tab.locator("svg[role=application]:visible").count() == 2
    assert tab.locator("svg.poster:visible").count() == 0
    names = list(plans)
    for k, name in enumerate(names):
        tab.locator(".plans select >> nth=0").select_option(str(k))
        tab.locator(".again >> nth=0").click()
        model = plans[name].model
        belief, mode, responses = truth.initial, 0, ("no_help", "no_help", "help", "no_help")
        agrees(tab, plans[name], belief, mode, 1)
        for round_, response in enumerate(responses):
            for action, seen in (("help" if round_ % 2 else "no_help", None), ("signal", response)):
                words = "nothing is seen" if seen is None else seen.replace("_", " ")
                tab.locator(f"button[aria-label^='{action.replace('_', ' ')}: {words}']").first.click()
                belief = truth.update(belief, action, seen)
                mode = 1 - mode
                agrees(tab, plans[name], belief, mode, 1)
        # The same by the planner's own belief model, one step back.
        tab.locator(".back >> nth=0").click()
        before = np.array(state_of(tab)["belief"])
        again = model.update(1, before, 1, 1 + truth.protocol.response_names.index("no_help"), 0)
        assert np.abs(again - belief).max() < 1e-12


def test_probabilities_of_responses_are_told(opened, truth, page):
    tab = opened(page)
    tab.locator(".modes select").select_option("1")
    for action in ("no_signal", "signal"):
        chances = truth.response_probability(truth.initial, action)
        for response, p in zip(truth.protocol.response_names, chances, strict=True):
            label = f"{action}: {response} ({100 * p:.1f}%)".replace("_", " ")
            assert tab.locator(f"button[aria-label='{label}']").count() == 1


def test_faces_keys_and_sliders(opened, plans, page):
    plan, tab = next(iter(plans.values())), opened(page)
    for held in range(4):
        tab.locator(".faces select").select_option(str(held))
        agrees(tab, plan, np.array(state_of(tab)["belief"]), 0, held)
    tab.locator(".beliefs input >> nth=2").evaluate("e => { e.value = 0.5; e.dispatchEvent(new Event('input')); }")
    at = np.array(state_of(tab)["belief"])
    assert at[2] == 0.5
    assert at.sum() == pytest.approx(1, abs=1e-12)
    tab.locator("svg[role=application]").focus()
    for key in ("ArrowLeft", "ArrowUp", "Shift+ArrowRight", "ArrowDown"):
        before = np.array(state_of(tab)["belief"])
        tab.keyboard.press(key)
        after = np.array(state_of(tab)["belief"])
        assert after[3] == before[3]  # the state held
        moved = (after - before)[:3] @ CORNERS
        assert moved[0] * {"ArrowLeft": -1, "Shift+ArrowRight": 1}.get(key, 0) >= 0
        assert np.abs(after - before).max() > 1e-3
        agrees(tab, plan, after, 0, 3)
    tab.keyboard.press("Tab")
    assert tab.evaluate("document.activeElement.tagName") in ("SELECT", "INPUT", "BUTTON")


def test_dragging_stays_in_the_triangle(opened, plans, page):
    plan, tab = next(iter(plans.values())), opened(page)
    box = tab.locator("svg[role=application]").bounding_box()
    scale = box["width"] / 360
    for x, y in ((180, 200), (20, 20), (350, 310), (180, 40)):
        tab.mouse.move(box["x"] + x * scale, box["y"] + y * scale)
        tab.mouse.down()
        tab.mouse.up()
        belief = np.array(state_of(tab)["belief"])
        assert belief.min() >= 0
        assert belief.sum() == pytest.approx(1, abs=1e-12)
        agrees(tab, plan, belief, 0, 1)
        if (x, y) == (180, 200):
            wanted = np.linalg.solve(np.vstack([CORNERS.T, np.ones(3)]), [180, 200, 1])
            assert np.abs(belief[[0, 2, 3]] / belief[[0, 2, 3]].sum() - wanted).max() < 0.01


def test_three_states_without_faces(opened, three):
    tab = opened(explorer_html(three, unit="points"))
    assert not tab.locator(".faces").is_visible()
    assert not tab.locator(".plans").is_visible()
    start = np.array(state_of(tab)["belief"])
    agrees(tab, three, start, three.model.starts[0], None)
    words = three.vocabulary
    for _ in range(3):
        told = state_of(tab)
        button = tab.locator(".actions button").last
        action, seen = button.get_attribute("aria-label").split(" (")[0].split(": ")
        mode, choice = told["mode"], [a.replace("_", " ") for a in words.actions[told["mode"]]].index(action)
        outcome = three.model.outcomes[mode][choice][-1]
        wanted = three.model.update(mode, np.array(told["belief"]), choice, outcome.observation, outcome.mode)
        button.click()
        agrees(tab, three, wanted, outcome.mode, None)
        assert seen == "nothing is seen" or seen == words.observations[outcome.observation].replace("_", " ")
    assert tab.inner_text(".path").count("→") == 3
    assert " points from here on" in tab.inner_text(".said")


def test_the_ring_glides_to_where_the_belief_is(opened, plans, truth, page):
    tab = opened(page, motion="no-preference")
    tab.locator("button[aria-label^='no help: ']").click()
    after = truth.update(truth.initial, "no_help")[[0, 2, 3]]
    x, y = (after / after.sum()) @ CORNERS
    find = "document.querySelector('.stage svg > circle')"
    tab.wait_for_function(
        f"Math.abs({find}.getAttribute('cx') - {x}) < 1e-2 && Math.abs({find}.getAttribute('cy') - {y}) < 1e-2",
        timeout=10_000,
    )
    assert tab.inner_text(".path") == "Path: 0 start; no help, nothing is seen → 1."
    tab.locator(".again").click()
    assert tab.inner_text(".path") == "Path: 0 start."
    assert np.abs(np.array(state_of(tab)["belief"]) - truth.initial).max() < 1e-12


def test_a_button_names_the_action_where_nothing_is_seen(opened, page):
    tab = opened(page)
    assert tab.locator(".actions button").all_inner_texts() == ["no help: nothing is seen", "help: nothing is seen"]
    tab.locator(".modes select").select_option("1")
    for button in tab.locator(".actions button").all():
        action, seen = button.get_attribute("aria-label").split(": ")
        assert action in ("no signal", "signal")
        assert button.inner_text() == seen


def test_places_visited_again_say_so_once(opened, page):
    """Every visit is named, those at one place together; no two labels cover each other, nor the ring."""
    tab = opened(page)
    for _ in range(5):
        tab.locator("button[aria-label^='no help: ']").click()
        tab.locator("button[aria-label^='signal: no help']").click()
    told = tab.evaluate(
        "() => [...document.querySelectorAll('.stage .visit')].map(e => "
        "[e.textContent, (({x, y, width, height}) => [x, y, x + width, y + height])(e.getBBox())])"
    )
    named = [text for text, _ in told]
    numbers = [int(n) for text in named for n in re.findall(r"\d+", text)]
    assert max(map(len, named)) > 3
    assert len(numbers) == len(set(numbers))
    left_out = set(range(10)) - set(numbers)
    assert not left_out or any("…" in text for text in named)
    ring = tab.evaluate(
        "() => ['cx', 'cy'].map(a => +document.querySelector('.stage svg > circle').getAttribute(a))"
    )
    boxes = [box for _, box in told] + [[ring[0] - 8, ring[1] - 8, ring[0] + 8, ring[1] + 8]]
    for i, (x, y, right, below) in enumerate(boxes):
        assert -1 <= x < right <= 361
        for other in boxes[:i]:
            across = min(right, other[2]) - max(x, other[0])
            down = min(below, other[3]) - max(y, other[1])
            assert across < 2 or down < 4, (told, ring)
