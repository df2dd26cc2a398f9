"""What holds for every plot: axes taken and returned, nothing leaked, words from one vocabulary, room for all."""

import importlib
import inspect
import pkgutil
import re
import sys

import matplotlib as mpl
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.collections import Collection
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text
from matplotlib.ticker import NullLocator

import analysis.figures
from analysis.figures import axis_names, style
from analysis.figures.several import Panels
from analysis.figures.style import COLOURS, FAINT, INK, to_svg
from models.errors import InputError
from tests.analysis.plot_cases import CASES

NO_PLOTS = ("style", "several", "notebook", "axis_names")
"""Modules of what plots are made with."""

OWN_WORDS = {"help rate", "probability of help", "score", "time", "sd", "F", "Tukey", "condition", "schedule"}
"""What the cases call their measures and groups."""

GREYS = {"#e9ebee", "#e2f1ea", "#f1f3f5", "#e6e9ed", "#e9eef4", "#eceff3", "#eef1f4", "#f4f5f7", "#d5dae1"}
"""Grounds and rules, which carry no meaning by themselves."""


def plots():
    """Every public plot function by name."""
    found = {}
    for module in pkgutil.iter_modules(analysis.figures.__path__):
        if module.name in NO_PLOTS:
            continue
        own = importlib.import_module(f"analysis.figures.{module.name}")
        for name, value in vars(own).items():
            here = inspect.isfunction(value) and value.__module__ == own.__name__ and not name.startswith("_")
            if here and str(inspect.signature(value).return_annotation) in ("Axes", "Panels", "Figure"):
                found[name] = value
    return found


PLOTS = plots()


def test_every_plot_has_a_case():
    assert set(PLOTS) == set(CASES)
    assert len(PLOTS) > 60


@pytest.mark.parametrize("name", PLOTS)
def test_every_plot_takes_and_returns_axes(name):
    signature = inspect.signature(PLOTS[name])
    assert "ax" in signature.parameters, "no ax="
    assert signature.parameters["ax"].default is None
    assert str(signature.return_annotation) in ("Axes", "Panels")
    assert hasattr(PLOTS[name], "__wrapped__"), "not styled"


def drawn(name):
    """A case drawn once, on a figure of its own, laid out."""
    if name not in MADE:
        made = CASES[name]()
        to_svg(made)
        MADE[name] = made
    return MADE[name]


MADE = {}


def axes_of(made):
    return list(made.flat) if isinstance(made, Panels) else [made]


def given_for(made):
    """Axes like those that a plot has made, on a figure that holds another plot too."""
    with style.style():
        figure = Figure(figsize=(28, 14), layout="constrained")
        left, right = figure.subfigures(1, 2)
        left.add_subplot()
        if isinstance(made, Panels):
            rows, columns = made.shape if made.ndim == 2 else (1, *made.shape)
            return right.subplots(rows, columns, squeeze=False).reshape(made.shape)
        return right.add_subplot()


@pytest.mark.parametrize("name", PLOTS)
def test_draws_where_it_is_told_to_and_nowhere_else(name):
    made = drawn(name)
    given = given_for(made)
    figure = (given.flat[0] if isinstance(given, np.ndarray) else given).get_figure(root=True)
    before, settings = len(figure.axes), dict(mpl.rcParams)
    other = figure.axes[0]
    again = CASES[name](ax=given)
    if isinstance(made, Panels):
        assert all(one is two for one, two in zip(again.flat, given.flat, strict=True))
        assert again.shape == made.shape
    else:
        assert again is given
    assert all(one.has_data() or one.texts or one.patches for one in axes_of(again))
    extra = [ax.get_label() for ax in figure.axes[before:]]
    assert extra in ([], ["<colorbar>"])
    assert not other.has_data()
    assert not figure.texts, "words on a figure that belongs to somebody else"
    assert not figure.legends
    assert dict(mpl.rcParams) == settings
    pyplot = sys.modules.get("matplotlib.pyplot")
    assert pyplot is None or not pyplot.get_fignums()
    to_svg(again)


@pytest.mark.parametrize("name", [name for name in PLOTS if "Panels" in str(inspect.signature(PLOTS[name]))])
def test_what_is_given_for_panels_is_checked(name):
    made = drawn(name)
    wanted = rf"ax: found .*, wanted an array of {' x '.join(map(str, made.shape))} Axes"
    with style.style():
        one = Figure().add_subplot()
    for wrong in ("nonsense", [], [one] * (made.size + 1), [one] * made.size if made.size > 1 else [one, one]):
        with pytest.raises(InputError, match=wanted):
            CASES[name](ax=wrong)


def numbers_on(axis):
    """Whether an axis shows numbers."""
    if not axis.get_visible() or isinstance(axis.get_major_locator(), NullLocator):
        return False
    texts = [t.get_text() for t in axis.get_ticklabels() if t.get_text()]
    return bool(texts) and all(re.fullmatch(r"[\d.,%\u2212<>≤-]+", text.partition("\n")[0]) for text in texts)


@pytest.mark.parametrize("name", PLOTS)
def test_axes_with_numbers_say_of_what_in_one_vocabulary(name):
    made = drawn(name)
    figure = style.figure_of(made)
    below = figure.get_supxlabel()
    for ax in axes_of(made):
        if not ax.axison or not ax.get_visible():
            continue
        for axis, words in ((ax.xaxis, ax.get_xlabel()), (ax.yaxis, ax.get_ylabel())):
            shared = axis is ax.xaxis and below
            beside = any(two.get_xlabel() if axis is ax.xaxis else two.get_ylabel() for two in axes_of(made))
            if numbers_on(axis):
                assert words or shared or beside, f"{axis.axis_name} axis without a label"
            if words and words not in OWN_WORDS and name != "trap_panels":
                assert axis_names.known(words), f"{words!r} is not in the vocabulary"
    if below:
        assert axis_names.known(below)


@pytest.mark.parametrize("name", PLOTS)
def test_words_are_all_on_the_figure(name):
    made = drawn(name)
    figure = style.figure_of(made)
    room = figure.bbox.padded(1.5)
    renderer = figure._get_renderer()
    legends = [ax.get_legend() for ax in figure.axes if ax.get_legend()] + figure.legends
    for legend in legends:
        box = legend.get_window_extent(renderer)
        assert room.x0 <= box.x0 and room.y0 <= box.y0 and box.x1 <= room.x1 and box.y1 <= room.y1, "legend is cut"  # noqa: PT018
        for ax in figure.axes:
            title = ax.title if ax.get_title() else ax._left_title
            if title.get_text():
                assert not title.get_window_extent(renderer).overlaps(box.padded(-1)), "legend over a title"
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip() and not text.get_clip_on():
            box = text.get_window_extent(renderer)
            assert room.x0 - 2 <= box.x0 <= box.x1 <= room.x1 + 2, f"{text.get_text()!r} is cut"


def colours_of(artist):
    """Colours of what is seen of an artist."""
    seen = ["get_edgecolor"]
    if isinstance(artist, Line2D):
        seen = ["get_color"] * (artist.get_linestyle() != "None")
        seen += ["get_markerfacecolor", "get_markeredgecolor"] * (artist.get_marker() not in ("None", None))
    elif not isinstance(artist, Patch) or artist.get_fill():
        seen += ["get_facecolor"]
    for getter in seen:
        value = getattr(artist, getter)()
        for one in np.atleast_2d(value) if isinstance(value, np.ndarray) else [value]:
            if not isinstance(one, str) or one not in ("none", "auto"):
                yield to_hex(one).lower()


@pytest.mark.parametrize("name", PLOTS)
def test_colours_are_those_of_the_palette(name):
    shades = {to_hex(style.SEQUENTIAL(v)).lower() for v in np.linspace(0, 1, 257)}
    shades |= {to_hex(scale(i)).lower() for scale in (style.SEQUENTIAL, style.GREYS) for i in range(256)}
    palette = {c.lower() for c in (*COLOURS, INK, FAINT, "#ffffff")} | GREYS | shades
    for ax in axes_of(drawn(name)):
        for artist in (*ax.lines, *ax.patches, *ax.collections):
            if getattr(artist, "get_cmap", None) and artist.get_array() is not None:
                continue
            strange = set(colours_of(artist)) - palette
            assert not strange, f"{type(artist).__name__}: {strange}"


@pytest.mark.parametrize("name", PLOTS)
def test_legends_tell_more_than_colours(name):
    """Lines, markers, hatching or shade of any two entries differ."""
    figure = style.figure_of(drawn(name))
    legends = [(ax, ax.get_legend()) for ax in figure.axes if ax.get_legend()]
    for ax, legend in [*legends, *((None, own) for own in figure.legends)]:
        words = [text.get_text() for text in legend.get_texts()]
        # The entry of an error bar is its bar; what differs is the line and marker in its middle.
        bars = {own.get_label(): own.lines[0] for own in (ax.containers if ax else []) if hasattr(own, "has_xerr")}
        beside = {text.get_text() for text in ax.texts} if ax else set()
        looks = [
            word.partition(":")[0] if word.partition(":")[0] in beside else look_of(bars.get(word) or handle)
            for word, handle in zip(words, legend.legend_handles, strict=True)
        ]
        same = [(a, b) for i, a in enumerate(looks) for b in looks[i + 1 :] if a == b]
        assert not same, same


def look_of(handle):
    """What is left of a legend's entry in grey print."""
    kind = type(handle).__name__

    def grey(colour):
        r, g, b = mpl.colors.to_rgb(colour)
        return round((0.299 * r + 0.587 * g + 0.114 * b) * 8)

    if hasattr(handle, "get_marker"):
        marker = str(handle.get_marker())
        filled = grey(handle.get_markerfacecolor()) > 6 if marker != "None" else None
        line = str(handle.get_linestyle()), str(getattr(handle, "_unscaled_dash_pattern", ""))
        wide = round(handle.get_linewidth(), 1)
        return kind, marker, filled, line, wide, marker == "None" and grey(handle.get_color())
    if isinstance(handle, Collection):
        dashes = str(handle.get_linestyle())
        return kind, dashes, tuple(handle.get_linewidth()), [grey(c) for c in handle.get_edgecolor()]
    return kind, handle.get_hatch(), grey(handle.get_facecolor()[:3])


def test_nothing_of_the_house_shows_or_sets_anything_globally():
    for module in pkgutil.iter_modules(analysis.figures.__path__):
        source = inspect.getsource(importlib.import_module(f"analysis.figures.{module.name}"))
        assert "pyplot" not in source.replace("Plots never touch pyplot", "")
        assert "rcParams[" not in source
        assert "rcParams.update" not in source


def test_the_vocabulary_speaks_once_of_each_thing():
    assert len(set(axis_names.UNITS)) == len(axis_names.UNITS)
    assert all(axis_names.known(f"{quantity} (nats)") for quantity in axis_names.QUANTITIES if "(" not in quantity)


def test_axes_are_axes():
    assert all(isinstance(ax, Axes) for name in PLOTS for ax in axes_of(drawn(name)))
