"""Plots of several panels: their axes made, or taken as they are given; what belongs to all of them.

Where a plot makes its own figure, the words and the legend of all panels stand at its edges. Where axes are given,
the figure may hold other plots too: then every panel at the foot has the words, and the first one the legend.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from analysis.figures.style import FAINT, above, figure_of
from models.errors import Phrase, located


class Panels(np.ndarray[Any, np.dtype[Any]]):
    """The axes of a plot with several panels, in the shape that its function names; an array of objects."""

    @property
    def figure(self) -> Figure:
        """The whole figure that they are on."""
        return figure_of(self)

    @property
    def axes(self) -> list[Axes]:
        """All axes of the whole figure, a colour bar's included."""
        return self.figure.axes


def panels(
    place: str, ax: Any, shape: tuple[int, ...], size: tuple[float, float], **subplots: Any
) -> tuple[Panels, Figure | None]:
    """Axes of a plot: those that are given, or new ones on a figure of their own.

    Parameters
    ----------
    place : str
        The plot's name, for errors.
    ax : array of Axes, or None
    shape : tuple of int
        Of the plot's panels; axes of length 1 may be left out of what is given, as `matplotlib` does.
    size : tuple of float
        Width and height of a new figure, inches.
    **subplots
        For `Figure.subplots`, where a figure is made.

    Returns
    -------
    panels : Panels
        Of that shape.
    own : Figure or None
        The new figure; None where axes were given.

    Raises
    ------
    InputError
        If what is given is no array of axes, or one of another shape.
    """
    if ax is None:
        own = Figure(figsize=size, layout="constrained")
        rows, columns = shape if len(shape) == 2 else (1, *shape)
        return own.subplots(rows, columns, squeeze=False, **subplots).reshape(shape).view(Panels), own
    given: NDArray[np.object_] = np.asarray(ax, dtype=object)
    wanted = f"an array of {' x '.join(map(str, shape))} Axes"
    if not all(isinstance(one, Axes) for one in given.flat):
        kinds = ", ".join(sorted({type(one).__name__ for one in given.flat}))
        raise located(f"{place}, ax", Phrase(kinds or "nothing"), wanted)
    if [n for n in given.shape if n != 1] != [n for n in shape if n != 1]:
        found = " x ".join(map(str, given.shape)) or "a single one"
        raise located(f"{place}, ax", Phrase(found), wanted)
    if len({id(one) for one in given.flat}) < given.size:
        raise located(f"{place}, ax", Phrase("the same axes twice"), wanted)
    return given.reshape(shape).view(Panels), None


def words_below(made: Panels, own: Figure | None, text: str) -> None:
    """Say what lies across, once for all panels, or below every panel at the foot."""
    if own is not None:
        own.supxlabel(text, fontsize=8.5, color=FAINT)
        return
    for ax in np.atleast_2d(np.asarray(made))[-1]:
        ax.set_xlabel(text)


def legend_of_all(made: Panels, own: Figure | None, handles: Sequence[Artist], place: Any, *, ncols: int) -> None:
    """One legend for all panels: at the figure's edge, where `place` says, or above the first panel."""
    if own is not None:
        own.legend(handles=list(handles), loc=place, ncols=ncols)
        return
    first = made.flat[0]
    first.legend(handles=list(handles), ncols=ncols, **above(first, first.get_title(loc="left")))
