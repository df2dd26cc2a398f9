"""The one style of all plots: colours that survive colour blindness, grey print and any machine's fonts.

Plots never touch pyplot or the global settings: `styled` runs a plot function inside this style, and `to_svg`
writes the same bytes for the same figure.
"""

from __future__ import annotations

import contextlib
import functools
import io
import re
import warnings
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING, Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.transforms import ScaledTranslation

if TYPE_CHECKING:
    from analysis.figures.several import Panels

type Drawn = Axes | Panels | Figure
"""What a plot function returns."""

INK = "#1b1f24"
FAINT = "#5b6470"
RULE = "#d5dae1"

OKABE_ITO = {
    "blue": "#0072B2",
    "vermillion": "#D55E00",
    "green": "#009E73",
    "purple": "#AA4499",
    "sky": "#56B4E9",
    "orange": "#E69F00",
    "black": "#000000",
}
"""Okabe and Ito's palette without its yellow, which is too light on white; the purple is a little darker."""

COLOURS = tuple(OKABE_ITO.values())
MARKERS = ("o", "s", "^", "D", "v", "P", "X")
LINES = ("-", "--", "-.", ":", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 1)), (0, (8, 2)))
PRINTED_COLOUR, PRINTED_MARKER = "#000000", "*"
"""How a number printed in the paper is drawn, and nothing else ever is."""

SEQUENTIAL: Colormap = LinearSegmentedColormap.from_list(
    "prosocial", ["#ffffff", "#d6e6f4", "#9cc6e4", "#4b97cb", "#0f5f9f", "#08335e"]
)
GREYS: Colormap = LinearSegmentedColormap.from_list("held", ["#ffffff", "#dcdcdc", "#8c8c8c", "#4d4d4d"])

SETTINGS: dict[str, Any] = {
    "font.family": ["DejaVu Sans"],  # shipped with matplotlib: the same letters on every machine
    "font.size": 9.0,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.labelsize": 9.0,
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.unicode_minus": True,
    "text.color": INK,
    "text.parse_math": False,  # names of conditions may hold dollar signs
    "xtick.color": FAINT,
    "ytick.color": FAINT,
    "xtick.labelcolor": INK,
    "ytick.labelcolor": INK,
    "xtick.labelsize": 8.5,
    "ytick.labelsize": 8.5,
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "legend.handlelength": 2.6,
    "grid.color": RULE,
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.6,
    "lines.markersize": 5.0,
    "hatch.linewidth": 0.6,
    "hatch.color": FAINT,
    "figure.facecolor": "white",
    "savefig.facecolor": "white",
    "svg.fonttype": "path",  # text as outlines: no font has to be present, nothing shifts
    "svg.hashsalt": "prosocial-workbench",
    "path.simplify": True,
}

_MACHINE = ("backend", "interactive", "toolbar", "timezone", "datapath", "keymap", "webagg", "tk.", "macosx")


@contextlib.contextmanager
def style() -> Iterator[None]:
    """Context in which plots are drawn: matplotlib's defaults plus `SETTINGS`, whatever the user's file says.

    Letters that the font lacks are drawn as boxes without a warning, which would name files of this machine.
    """
    defaults: dict[Any, Any] = {k: v for k, v in mpl.rcParamsDefault.items() if not k.startswith(_MACHINE)}
    with mpl.rc_context(defaults | SETTINGS), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"Glyph .* missing from font", category=UserWarning)
        yield


def axes(width: float = 4.4, height: float = 3.0) -> Axes:
    """Axes on a figure of their own; sizes in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure.add_subplot()


def styled[**P, R](draw: Callable[P, R]) -> Callable[P, R]:
    """Run a plot function inside `style`, whoever calls it."""

    @functools.wraps(draw)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> R:
        with style():
            return draw(*args, **kwargs)

    return wrapped


TITLE_POINTS = 21.0
"""Room that a title takes above its axes."""


def above(ax: Axes, title: str = "", left: float = 0.0) -> dict[str, Any]:
    """Where a legend stands above the axes, over the title if there is one.

    In points, not in parts of the axes: where these are low, a part of them is less than a title is high.

    Parameters
    ----------
    ax : Axes
    title : str
    left : float
        Left end, in parts of the axes.
    """
    figure = ax.get_figure()
    assert figure is not None
    shift = ScaledTranslation(0, (TITLE_POINTS if title else 0.0) / 72, figure.dpi_scale_trans)
    return {
        "loc": "lower left", "bbox_to_anchor": (left, 1.0), "bbox_transform": ax.transAxes + shift,
        "borderaxespad": 0.2,
    }  # fmt: skip


def figure_of(drawn: Drawn) -> Figure:
    """The whole figure that a plot is on."""
    if isinstance(drawn, Figure):
        return drawn
    first: Axes = drawn if isinstance(drawn, Axes) else drawn.flat[0]
    figure = first.get_figure(root=True)
    assert figure is not None
    return figure


def to_svg(drawn: Drawn) -> str:
    """Write a figure as an SVG element: deterministic, without a date, metadata or XML declaration."""
    figure = figure_of(drawn)
    buffer = io.StringIO()
    with style():
        figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>\s*", "", text, flags=re.DOTALL)
    # A style element would reach beyond its figure once this is part of a page.
    text = re.sub(r"<defs>\s*<style.*?</style>\s*</defs>\s*", "", text, flags=re.DOTALL)
    text = text.replace("<svg ", '<svg style="stroke-linejoin: round; stroke-linecap: butt" ', 1)
    # A thousandth of a point is more than any printer shows; six decimals are a third of the file.
    text = re.sub(r"(\d+\.\d{3})\d+", r"\1", text)
    return re.sub(r"\n\s*", "\n", text).strip()


def to_png(drawn: Drawn, dpi: float = 200.0) -> bytes:
    """Write a figure as a PNG picture: the same bytes for the same figure, no date or program named."""
    figure = figure_of(drawn)
    buffer = io.BytesIO()
    with style():
        figure.savefig(buffer, format="png", dpi=dpi, metadata={"Software": None})
    return buffer.getvalue()


def short_state(name: str, index: int) -> str:
    """Label of a state for ticks.

    Examples
    --------
    >>> short_state("high-prosocial", 3), short_state("s1", 1)
    ('s3 high', 's1')
    """
    return name if name == f"s{index}" else f"s{index} {name.removesuffix('-prosocial')}"


def spoken(name: str) -> str:
    """Name of an action, mode or response as it is read.

    Examples
    --------
    >>> spoken("no_signal")
    'no signal'
    """
    return name.replace("_", " ")
