"""Drawings in fewer bytes: the same shapes in the same places, every reference kept."""

import re
import xml.etree.ElementTree as ET

import pytest

from analysis.figures.style import to_svg
from analysis.report.compact import ShortNames, compact
from analysis.report.letters import Letters
from tests.analysis.test_figures import GRAPHS, PLOTS


def shapes(svg):
    """Every path and use: commands, numbers, attributes but names."""
    root = ET.fromstring(svg)
    out = []
    for e in root.iter():
        tag = e.tag.rpartition("}")[2]
        if tag in ("path", "use"):
            data = re.findall(r"[A-Za-z]|-?\d+\.?\d*", e.get("d") or "")
            numbers = [float(t) for t in data if not t.isalpha()]
            places = [float(e.get(a, 0)) for a in ("x", "y")]
            out.append(([t for t in data if t.isalpha()], numbers + places, e.get("style"), e.get("transform")))
    return out


@pytest.mark.parametrize("name", [*PLOTS, *GRAPHS])
def test_the_same_shapes_to_a_hundredth(name):
    svg = Letters().take(to_svg((PLOTS | GRAPHS)[name]()))
    small = compact(svg)
    assert len(small) < len(svg)
    for before, after in zip(shapes(svg), shapes(small), strict=True):
        assert before[0] == after[0]
        assert before[2:] == after[2:]
        assert after[1] == pytest.approx(before[1], abs=0.00501)


@pytest.mark.parametrize("name", [*PLOTS, *GRAPHS])
def test_references_find_what_they_found(name):
    svg = Letters().take(to_svg((PLOTS | GRAPHS)[name]()))
    names = ShortNames()
    first, second = names.rename(svg), names.rename(svg)

    def own(text):
        return re.findall(r' id="([^"]+)"', text)

    def used(text):
        return [n for n in re.findall(r'(?:href="#|url\(#)([^")]+)', text) if not re.fullmatch(r"g\d+", n)]

    assert not set(own(first)) & set(own(second))
    assert set(used(first)) <= set(own(first))
    back = dict(zip(own(first), own(svg), strict=True))
    assert [back[n] for n in used(first)] == used(svg)
