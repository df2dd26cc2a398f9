"""Plot of what Laplace's approximation does near the ceiling, beside quadrature and the truth."""

from __future__ import annotations

import numpy as np
import pandas as pd
from matplotlib.axes import Axes

from analysis.figures.axis_names import with_unit
from analysis.figures.style import COLOURS, FAINT, MARKERS, axes, styled


@styled
def rules_near_ceiling(
    summary: pd.DataFrame, quantity: str, *, truth: float, ylabel: str, title: str = "", legend: bool = True,
    ax: Axes | None = None,
) -> Axes:  # fmt: skip
    """Median estimates of simulated studies by the share of people who always help; bars hold half of the studies.

    Parameters
    ----------
    summary : DataFrame
        ``rule, always``, and the quantity with ``_low`` and ``_high``
        (`analysis.quadrature_study.QuadratureStudy.summary`).
    quantity : str
        ``sd`` or ``odds_ratio``.
    truth : float
    ylabel, title : str
    legend : bool
    ax : Axes, optional
    """
    ax = axes(4.4, 3.0) if ax is None else ax
    ax.axhline(truth, color=FAINT, linewidth=1.0, linestyle=":", label="truth")
    for i, (rule, part) in enumerate(reversed(list(summary.groupby("rule", sort=True)))):
        x = 100 * part["always"].to_numpy() + (i - 0.5) * 0.9
        y, low, high = (part[f"{quantity}{end}"].to_numpy() for end in ("", "_low", "_high"))
        ax.errorbar(
            x, y, np.stack([y - low, high - y]), marker=MARKERS[i], color=COLOURS[1 - i % 2], capsize=2.5,
            elinewidth=1.2, linestyle="-" if i else "--", label=str(rule),
        )  # fmt: skip
    ax.set(xlabel=with_unit("share of people who always help", "%"), ylabel=ylabel, title=title)
    ax.set_ylim(bottom=0)
    ax.grid(axis="y")
    if legend:
        ax.legend(loc="upper left")
    return ax
