"""Plots for the number of states: criteria over K, and where the restarts of a search ended."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from analysis.figures.style import COLOURS, FAINT, INK, PRINTED_COLOUR, PRINTED_MARKER, axes, styled
from models.baum_welch_fit import BaumWelchFit, Optimum


@styled
def log_likelihoods(
    own: Mapping[int, float],
    published_procedure: Mapping[int, float],
    printed: tuple[int, float] | None,
    *,
    ax: Axes | None = None,
) -> Axes:
    """Log-likelihood over the number of states: own search, published procedure, and the printed number apart.

    Parameters
    ----------
    own, published_procedure : mapping of int to float
    printed : tuple of (states, log-likelihood), optional
        Of other data: it shares the axis, never the line.
    ax : Axes, optional
    """
    ax = axes(4.4, 3.1) if ax is None else ax
    ax.plot(list(own), list(own.values()), color=COLOURS[0], marker="o", markersize=6.5, label="longer search")
    if published_procedure:
        ax.plot(
            list(published_procedure), list(published_procedure.values()), color=COLOURS[1], marker="x",
            linestyle="--", markersize=7, markeredgewidth=1.8, label="published procedure, same data",
        )  # fmt: skip
    if printed is not None:
        ax.plot(
            [printed[0]], [printed[1]], color=PRINTED_COLOUR, marker=PRINTED_MARKER, markersize=11,
            linestyle="none", label="printed in the paper (other data)",
        )  # fmt: skip
        ax.annotate(
            f"{printed[1]:.2f}".replace("-", "\N{MINUS SIGN}"), printed, xytext=(0, -7), ha="center", va="top",
            textcoords="offset points", fontsize=8.5,
        )  # fmt: skip
    ax.set(xlabel="number of states", ylabel="log-likelihood (nats)")
    return _by_states(ax)


@styled
def information_criteria(bic: Mapping[int, float], aic: Mapping[int, float], *, ax: Axes | None = None) -> Axes:
    """BIC and AIC over the number of states, lowest marked."""
    ax = axes(4.4, 3.1) if ax is None else ax
    for values, name, colour, marker, line in (
        (bic, "BIC", COLOURS[0], "o", "-"), (aic, "AIC", COLOURS[2], "D", "--"),
    ):  # fmt: skip
        best = min(values, key=values.__getitem__)
        label = f"{name}, lowest at {best}"
        ax.plot(list(values), list(values.values()), color=colour, marker=marker, linestyle=line, label=label)
        ax.plot([best], [values[best]], "o", markersize=13, markerfacecolor="none", markeredgecolor=INK)
    ax.set(xlabel="number of states", ylabel="criterion (2 × nats; lower is better)")
    return _by_states(ax)


def _by_states(ax: Axes) -> Axes:
    ax.xaxis.set_major_locator(MaxNLocator(integer=True))
    ax.margins(x=0.12, y=0.2)
    ax.grid(axis="y")
    # Above the axes, where no point can hide it.
    ax.legend(loc="lower left", bbox_to_anchor=(0, 1.0), borderaxespad=0.2, ncols=1)
    return ax


@styled
def optima(own: BaumWelchFit, published: BaumWelchFit | None, *, bins: int = 24, ax: Axes | None = None) -> Axes:
    """Where restarts ended, as log-likelihood below the best that either search found.

    Own finalists stand above the line, restarts of the published procedure hang below it.
    """
    ax = axes(3.6, 2.6) if ax is None else ax
    searches = [own] if published is None else [own, published]
    best = max(fit.optima[0].log_likelihood for fit in searches)
    worst = max(best - fit.optima[-1].log_likelihood for fit in searches)
    edges = np.linspace(0.0, max(worst, 1.0) * 1.0001, bins + 1)
    tallest = 1.0
    for fit, colour, hatch, sign in zip(searches, COLOURS, (None, "////"), (1, -1), strict=False):
        counts = _histogram(fit.optima, best, edges)
        tallest = max(tallest, counts.max())
        ax.bar(
            edges[:-1], sign * counts, width=np.diff(edges), align="edge", facecolor=colour, edgecolor="white",
            hatch=hatch, linewidth=0.6,
        )  # fmt: skip
    ax.axhline(0, color=INK, linewidth=0.8)
    top = 1.38 * tallest
    ax.set_ylim(-top if published is not None else 0, top)
    ax.yaxis.set_major_locator(MaxNLocator(integer=True, nbins=6))
    ax.yaxis.set_major_formatter(lambda value, _: f"{abs(value):.0f}")
    ax.set(
        xlabel="log-likelihood below the best found (nats)", ylabel="restarts",
        title=f"{own.n_states} state{'s' * (own.n_states > 1)}",
    )  # fmt: skip
    note = {"ha": "right", "fontsize": 8, "color": FAINT, "transform": ax.transAxes}
    ax.text(0.99, 0.97, f"longer search: {own.runs_in_final_stage} finalists", va="top", **note)  # type: ignore[arg-type]
    if published is not None:
        text = f"published procedure: {published.runs_in_final_stage} restarts"
        ax.text(0.99, 0.03, text, va="bottom", **note)  # type: ignore[arg-type]
    return ax


def _histogram(found: Sequence[Optimum], best: float, edges: np.ndarray) -> np.ndarray:
    below = np.clip([best - o.log_likelihood for o in found], 0.0, None)
    return np.histogram(below, edges, weights=[o.restarts for o in found])[0]
