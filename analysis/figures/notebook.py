"""Figures in a notebook: several panels in one, and under each whose data it shows."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.figures.style import FAINT, Drawn, figure_of, style, styled, to_svg
from analysis.report.letters import slim
from analysis.report.section import Origin

TRUTH = ("simulated truth", "Numbers chosen by this project: no people, no data.")
"""Badge of the tables behind simulated data."""


@styled
def panels(*widths: float, height: float = 2.9) -> list[Axes]:
    """Axes side by side in one figure, for plot functions that take an `ax`; sizes in inches.

    Examples
    --------
    >>> len(panels(3, 3, 2, height=2.5))
    3
    """
    figure = Figure(figsize=(sum(widths), height), layout="constrained")
    made = figure.subplots(1, len(widths), width_ratios=list(widths), squeeze=False)
    return list(np.ravel(made))


def show(drawn: Drawn, kind: str, caption: str) -> None:
    """Display a figure as SVG, with where it comes from inside it and the caption below.

    Parameters
    ----------
    drawn : Axes, Panels or Figure
        What a plot function returned.
    kind : str
        Of the data: ``real``, ``simulated`` or ``unstated`` as on a card; ``definition`` or ``truth`` where there
        are none.
    caption : str
        Markdown.
    """
    from IPython.display import SVG, Markdown, display

    shown: Any = display
    origin = Origin.DEFINITION if kind == "definition" else Origin.of_kind(kind)
    label, meaning = TRUTH if kind == "truth" else (origin.label, origin.meaning)
    figure = figure_of(drawn)
    with style():
        words = f"{label.upper()}. {meaning}"
        figure.supxlabel(words, x=0.01, ha="left", fontsize=7.5, color=FAINT)
    shown(SVG(slim(to_svg(figure)).replace("\n", " ")))  # one line: nbformat stores a string for each
    shown(Markdown(f"*{label.capitalize()}.* {caption}"))
