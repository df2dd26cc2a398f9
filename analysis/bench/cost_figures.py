"""Figures of the cost curves: what was measured, and the fitted model with its interval."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter

from analysis.bench.cost_model import FORMS, WORDS, CostModel, fit_all
from analysis.bench.curves import AXES, Axis
from analysis.figures.style import COLOURS, MARKERS, axes, styled

LABELS = {"seconds": "CPU seconds", "memory": "peak memory in GiB"}
UNITS = {"seconds": 1.0, "memory": 2.0**30}


def tick(value: float, _: object = None) -> str:
    """A label on a logarithmic axis.

    Examples
    --------
    >>> [tick(v) for v in (0.0003, 0.1, 20.0, 3e4, 1e7)]
    ['3e-4', '0.1', '20', '30k', '10M']
    """
    for scale, letter in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if value >= scale:
            return f"{value / scale:g}{letter}"
    return f"{value:g}" if value >= 1e-3 else f"{value:.0e}".replace("e-0", "e-")


@styled
def cost_curve(
    axis: Axis, points: Sequence[Mapping[str, Any]], models: Mapping[str, Mapping[str, CostModel]], quantity: str
) -> Axes:
    """Measured medians with their ranges over one size, and the model of every operation as a line with its band.

    Parameters
    ----------
    axis : Axis
    points : sequence of mapping
        Of this curve.
    models : mapping
        As `analysis.bench.cost_model.fit_all` gives them.
    quantity : str
        ``seconds`` or ``memory``.
    """
    ax = axes(4.6, 3.2)
    unit = UNITS[quantity]
    for i, operation in enumerate(name for name in FORMS if any(p["operation"] == name for p in points)):
        own = sorted((p for p in points if p["operation"] == operation), key=lambda p: float(p[axis.driver]))
        x = np.array([float(p[axis.driver]) for p in own])
        y = np.array([float(p[quantity]) for p in own]) / unit
        found = [models[operation][quantity].predict(p) for p in own]
        colour = COLOURS[i % len(COLOURS)]
        ax.plot(x, [f.value / unit for f in found], color=colour)
        ax.fill_between(
            x, [f.low / unit for f in found], [f.high / unit for f in found], color=colour, alpha=0.12, linewidth=0
        )
        ax.plot(x, y, MARKERS[i % len(MARKERS)], color=colour, label=WORDS[operation])
        if quantity == "seconds":
            ax.vlines(x, [p["low"] for p in own], [p["high"] for p in own], color=colour, linewidth=1.0)
    ax.set_xscale("log")
    ax.set_yscale("log")
    for scale, span in ((ax.xaxis, x), (ax.yaxis, np.array(ax.get_ylim()))):
        scale.set_major_formatter(FuncFormatter(tick))
        # Less than a decade has one label or none: then the small ticks get theirs.
        narrow = span.max() / span.min() < 10
        scale.set_minor_formatter(FuncFormatter(tick) if narrow else NullFormatter())
    ax.set_xlabel(axis.name)
    ax.set_ylabel(LABELS[quantity])
    ax.grid(True, which="major")
    ax.legend(loc="best", fontsize=7.0)
    return ax


def cost_figures(points: Sequence[Mapping[str, Any]]) -> dict[str, tuple[str, Axes]]:
    """Every curve that was measured, time and memory: title and figure by a name that files can have."""
    models = fit_all(points)
    out: dict[str, tuple[str, Axes]] = {}
    for axis in AXES:
        own = [p for p in points if p["axis"] == axis.name]
        if not own:
            continue
        fixed = ", ".join(f"{value:,} {name}" for name, value in axis.fixed.items() if value)
        for quantity in ("seconds", "memory"):
            name = f"{axis.name}-{quantity}".replace(", ", "-").replace(" ", "-")
            words = f"{LABELS[quantity]} by {axis.name}".replace("peak memory in GiB", "Peak memory")
            title = words + (f" ({fixed})" if fixed else "")
            out[name] = (title, cost_curve(axis, own, models, quantity))
    return out
