"""Letters drawn once a page: the same outlines in the same places, with fewer bytes."""

import re
import xml.etree.ElementTree as ET

import pytest

from analysis.figures.style import axes, styled, to_svg
from analysis.report.letters import Letters, each_with_its_own, slim
from tests.analysis.test_figures import GRAPHS, PLOTS

LINK = "{http://www.w3.org/1999/xlink}href"


def letters_of(svg, outlines=None):
    """Every letter that is seen: its outline, how far it is moved along, and the transforms around it."""
    root = ET.fromstring(svg)
    paths = {e.get("id"): e for e in root.iter() if e.get("transform") == "scale(0.015)"}
    known = {name: re.sub(r"\s+", " ", e.get("d") or "").strip() for name, e in paths.items()} | (outlines or {})
    seen = []

    def walk(element, around):
        name = (element.get(LINK) or element.get("href") or "#")[1:]
        if element.tag.endswith("use") and known.get(name):
            moved = element.get("transform", "translate(0 0)")
            shift = float(element.get("x", 0)) + float(re.search(r"\((-?[\d.]+)", moved)[1])
            seen.append((known[name], shift, around))
        for child in element:
            walk(child, (*around, element.get("transform")))

    walk(root, ())
    return seen


def shared(letters):
    return {e.get("id"): e.get("d") for e in ET.fromstring(str(letters.markup())).iter() if e.get("d")}


@pytest.mark.parametrize("name", [*PLOTS, *GRAPHS])
def test_the_same_letters_in_the_same_places(name):
    drawn = to_svg((PLOTS | GRAPHS)[name]())
    letters = Letters()
    slim = letters.take(drawn)
    before, after = letters_of(drawn), letters_of(slim, shared(letters))
    assert before
    assert [(o, around) for o, _, around in before] == [(o, around) for o, _, around in after]
    assert [s for _, s, _ in after] == pytest.approx([s for _, s, _ in before], abs=0.051)
    assert len(slim) < 0.62 * len(drawn)
    # What is not a letter stays: markers, areas, hatches and clips still find what they refer to.
    used = set(re.findall(r'xlink:href="#([^"]+)"|url\(#([^)]+)\)', slim))
    assert {one or other for one, other in used} == set(re.findall(r' id="([^"]+)"', slim))
    count = [len(re.findall("<use xlink:", text)) for text in (drawn, slim)]
    spaces = sum(text.count('-3"') for text in re.findall(r"<use xlink[^>]*>", drawn))
    assert count[0] - count[1] == len(before) + spaces


@pytest.mark.parametrize("name", [*PLOTS, *GRAPHS])
def test_a_figure_by_itself_has_the_same_letters(name):
    drawn = to_svg((PLOTS | GRAPHS)[name]())
    alone = slim(drawn)
    before, after = letters_of(drawn), letters_of(alone)
    assert before
    assert [(o, around) for o, _, around in before] == [(o, around) for o, _, around in after]
    assert [s for _, s, _ in after] == pytest.approx([s for _, s, _ in before], abs=0.051)
    assert len(alone) < 0.85 * len(drawn)


def test_figures_on_one_page_never_take_a_letter_for_another():
    """The first of two elements with the same id counts for both: it has to hold the same outline."""
    figures = [slim(to_svg(PLOTS[name]())) for name in ("still going", "rate by round")]
    outlines = [{e.get("id"): e.get("d") for e in ET.fromstring(f).iter() if e.get("id", "").startswith("g")}
                for f in figures]  # fmt: skip
    shared_names = outlines[0].keys() & outlines[1].keys()
    assert len(shared_names) > 10
    assert all(outlines[0][name] == outlines[1][name] for name in shared_names)
    assert len(set(outlines[0].values())) == len(outlines[0])


def test_an_outline_is_there_once_for_all_figures():
    letters = Letters()
    first, second = (letters.take(to_svg(PLOTS[name]())) for name in ("still going", "rate by round"))
    outlines = shared(letters)
    assert len(set(outlines.values())) == len(outlines)
    both = [set(re.findall(r'href="#(g\d+)"', svg)) for svg in (first, second)]
    assert both[0] & both[1]
    assert both[0] | both[1] == set(outlines)
    assert letters.take(to_svg(PLOTS["still going"]())) == first
    assert shared(letters) == outlines


@styled
def wordless():
    ax = axes()
    ax.axis("off")
    ax.plot([0, 1], [0, 1])
    return ax


def test_figures_without_a_letter():
    letters = Letters()
    assert "<path" in letters.take(to_svg(wordless()))
    assert letters.markup() == ""
    assert each_with_its_own("<p>no figure</p>") == "<p>no figure</p>"


def test_each_figure_gets_its_copies_back():
    letters = Letters()
    drawn = [to_svg(PLOTS[name]()) for name in ("still going", "reward")]
    page = "<p>a < b</p>".join([*(letters.take(svg) for svg in drawn), str(letters.markup())])
    whole = each_with_its_own(page)
    found = re.findall(r"<svg .*?</svg>", whole, flags=re.DOTALL)
    assert len(found) == 2
    assert 'class="letters"' not in whole
    assert whole.count("<p>a < b</p>") == 2
    for svg, original in zip(found, drawn, strict=True):
        outlines = [outline for outline, _, _ in letters_of(svg)]
        assert outlines == [outline for outline, _, _ in letters_of(original)]
        assert svg.count('transform="scale(0.015)"') == len(set(outlines))
