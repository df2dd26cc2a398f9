"""Plots of the value of information: what single tables would be worth, and what further participants would be."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, NullFormatter, NullLocator

from analysis.figures.axis_names import a_person, with_unit
from analysis.figures.style import COLOURS, FAINT, INK, LINES, MARKERS, above, axes, styled
from models.robust.block_smoother import block_words
from models.robust.block_worth import PartialInformation
from models.robust.study_worth import SampleInformation


@styled
def information_by_block(found: PartialInformation, *, title: str = "", ax: Axes | None = None) -> Axes:
    """Draw one bar a block of the tables, the largest first, beside what perfect knowledge would be worth.

    Bars are the cross-fitted estimate with twice its standard error, diamonds the one that is scored on the draws
    that the plans were chosen with. With too few draws there are diamonds only; where the draws are all that is
    believed there is one exact number, a bar.

    Parameters
    ----------
    found : PartialInformation
    title : str
    ax : Axes, optional
    """
    rows = sorted(found.rows, key=lambda r: (-np.nan_to_num(r.worth), -r.in_sample))
    ax = axes(6.2, 1.6 + 0.3 * len(rows)) if ax is None else ax
    at = np.arange(len(rows))
    known = np.array([r.probabilities > 0 for r in rows])
    told = known & np.array([not np.isnan(r.worth) for r in rows])
    worth = np.array([max(np.nan_to_num(r.worth), 0.0) for r in rows])
    se = np.array([np.nan_to_num(r.se) for r in rows])
    if told.any() or not known.any():
        ax.barh(at[told], worth[told], height=0.62, color=COLOURS[4], edgecolor=COLOURS[0], linewidth=0.8,
                label="exact" if found.exact else "cross-fitted, ±2 standard errors", zorder=2)  # fmt: skip
    optimistic = np.array([r.in_sample for r in rows])
    if not found.exact:
        if told.any() or not known.any():
            ax.errorbar(worth[told], at[told], xerr=2 * se[told], linestyle="none", color=INK, capsize=2.5,
                        elinewidth=1.0, zorder=3)  # fmt: skip
        ax.plot(optimistic[known], at[known], "D", color=COLOURS[1], markersize=4.5, markeredgecolor="white",
                markeredgewidth=0.6, label="scored on the draws that plans were chosen with", zorder=4)  # fmt: skip
    for i in at[~known]:
        ax.annotate("the same in all" if found.exact else "held fixed", (0, i), xytext=(4, 0),
                    textcoords="offset points", va="center", fontsize=8, color=FAINT, style="italic")  # fmt: skip
    ax.axvline(found.perfect, color=INK, linewidth=1.2, linestyle=LINES[1], label="all tables (perfect knowledge)")
    widest = max(found.perfect, float(np.max(worth + 2 * se)), float(optimistic.max()))
    ax.set_xlim(0, 1.06 * widest if widest > 0 else 1.0)
    ax.set_yticks(at, [block_words(r.block) for r in rows])
    ax.tick_params(axis="y", length=0)
    ax.set_ylim(len(rows) - 0.45, -0.55)
    ax.set(xlabel=with_unit("worth of knowing", a_person(found.unit)), title=title)
    ax.grid(axis="x")
    ax.legend(**above(ax, title))
    return ax


@styled
def information_by_people(
    found: SampleInformation | Sequence[SampleInformation], *, title: str = "", ax: Axes | None = None
) -> Axes:
    """Draw the worth of every study by its participants, and what perfect knowledge would be worth above them.

    Bars are twice the standard error. Bands reach down to the estimate for plans scored on draws that did not
    choose them. Hollow markers: too few draws are left after such data to say.

    Parameters
    ----------
    found : SampleInformation, or sequence of them
        By what is believed today of the same schedule; studies of other sizes may come apart.
    title : str
    ax : Axes, optional
    """
    several = (found,) if isinstance(found, SampleInformation) else tuple(found)
    ax = axes(6.2, 3.5) if ax is None else ax
    perfect = max(f.perfect for f in several)
    ax.axhline(perfect, color=INK, linewidth=1.2, linestyle=LINES[1])
    ax.annotate("perfect knowledge", (1, perfect), xycoords=("axes fraction", "data"), xytext=(-3, -10),
                textcoords="offset points", ha="right", fontsize=8, color=FAINT)  # fmt: skip
    studies = [(f, j) for f in several for j in range(len(f.studies))]
    top, hollow = perfect, False
    for i, (one, j) in enumerate(studies):
        rows = one.rows[j * len(one.sizes) : (j + 1) * len(one.sizes)]
        worth, se = np.array([r.worth for r in rows]), np.array([r.se for r in rows])
        enough = np.array([r.enough for r in rows])
        colour, marker = COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]
        # Neighbours are moved apart a little, so that intervals at the same number of people can be told apart.
        x = np.array(one.sizes, dtype=np.float64) * 1.025 ** (i - (len(studies) - 1) / 2)
        ax.errorbar(x, worth, 2 * se, color=colour, linestyle=LINES[i % len(LINES)], marker=marker, capsize=2.5,
                    linewidth=1.4, elinewidth=1.0, label=one.studies[j])  # fmt: skip
        held_out = np.array([r.held_out for r in rows])
        if not np.isnan(held_out).any():
            ax.fill_between(
                x, np.clip(held_out, 0.0, worth), worth, color=colour, alpha=0.15, linewidth=0, zorder=1
            )
        if not enough.all():
            hollow = True
            ax.plot(x[~enough], worth[~enough], marker=marker, linestyle="none", markerfacecolor="white",
                    markeredgecolor=colour, zorder=5)  # fmt: skip
        top = max(top, float((worth + 2 * se).max()))
    people = sorted({n for one in several for n in one.sizes})
    ax.set_xscale("log")
    ax.set_xticks(people, [f"{n:,}" for n in people])
    ax.xaxis.set_minor_locator(NullLocator())
    ax.xaxis.set_minor_formatter(NullFormatter())
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.set_ylim(0, 1.08 * top if top > 0 else 1.0)
    bound = "" if all(one.exact for one in several) else ", at least"
    worth_of_data = with_unit(f"worth of the data{bound}", a_person(several[0].unit), lines=True)
    ax.set(xlabel="further people", ylabel=worth_of_data, title=title)
    ax.grid(axis="y")
    ax.legend(
        loc="upper left", bbox_to_anchor=(1.01, 1.0), borderaxespad=0.0, alignment="left",
        title="hollow: too few draws left" if hollow else None, title_fontsize=8,
    )  # fmt: skip
    return ax
