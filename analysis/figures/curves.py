"""Plot of named curves over one number: growth, convergence, error."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.ticker import LogFormatter, MaxNLocator
from numpy.typing import NDArray

from analysis.figures.style import COLOURS, LINES, MARKERS, axes, styled


@styled
def curves(
    series: Mapping[str, tuple[Sequence[float] | NDArray[np.float64], Sequence[float] | NDArray[np.float64]]],
    *,
    xlabel: str,
    ylabel: str,
    log_x: bool = False,
    log_y: bool = False,
    title: str = "",
    ax: Axes | None = None,
) -> Axes:
    """Draw one line a series; up to twenty points carry markers.

    Parameters
    ----------
    series : mapping of name to (x, y)
    xlabel, ylabel : str
    log_x, log_y : bool
    title : str
    ax : Axes, optional
    """
    ax = axes(5.0, 3.1) if ax is None else ax
    for i, (name, (x, y)) in enumerate(series.items()):
        marker = MARKERS[i % len(MARKERS)] if len(x) <= 20 else None
        ax.plot(x, y, color=COLOURS[i % len(COLOURS)], linestyle=LINES[i % len(LINES)], marker=marker, label=name)
    if log_x:
        ax.set_xscale("log")
        _plain_numbers(ax.xaxis)
    elif all(float(v).is_integer() for x, _ in series.values() for v in x):
        ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    if log_y:
        ax.set_yscale("log")
        _plain_numbers(ax.yaxis)
    ax.set(xlabel=xlabel, ylabel=ylabel, title=title)
    ax.grid(axis="y")
    if len(series) > 1:
        ax.legend()
    return ax


def _plain_numbers(axis: Axis) -> None:
    """Label a logarithmic axis without mathtext, which the style turns off."""
    axis.set_major_formatter(LogFormatter())
    axis.set_minor_formatter(LogFormatter())
