"""Part of the regression's section: how often intervals hold the truth, by quadrature and by Laplace's rule."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import numpy as np
import pandas as pd

from analysis.evidence import Evidence
from analysis.figures.coverage import coverage_by_parameter
from analysis.figures.quadrature import rules_near_ceiling
from analysis.report.context import ReportContext
from analysis.report.section import Block, Drawing, Figure, NotSupported, Origin, Part, Table
from analysis.report.stored import stored

SIMULATED = (Origin.SIMULATED,)
EVIDENCE = "mixed_model"


def coverage(context: ReportContext) -> tuple[Block, ...]:
    """Stored coverage of profile and Wald intervals under both rules, for studies of the design it was made for."""
    if not context.is_published_schedule:
        raise NotSupported("coverage was studied for the published design, and this study has another")
    blocks = stored(EVIDENCE, _shown, "how often intervals hold the truth")
    return (Part("Do its intervals hold what they say?", "regression-coverage-part", blocks),)


def _shown(found: Evidence) -> tuple[Block, ...]:
    content = found.content
    own = content["settings"]
    table, rates = pd.DataFrame(content["table"]), pd.DataFrame(content["rates"])
    panels: list[Drawing] = []
    alt = []
    for i, row in enumerate(rates.itertuples()):
        part = table[table["intercept"] == row.intercept]
        title = f"{row.rate:.0%} of responses are helping"
        panels.append(partial(coverage_by_parameter, part, own["level"], title=title, legend=i == len(rates) - 1))
        told = "; ".join(f"{r.parameter} by {r.rule}, {r.interval} {r.share:.3f}" for r in part.itertuples())
        alt.append(f"Coverage where {title}: {told}.")
    low, high = (table[end].iloc[0] / own["studies"] for end in ("low", "high"))
    figure = Figure(
        "regression-coverage", tuple(panels),
        f"Share of {own['studies']} simulated studies of {own['people']} people whose {own['level']:.0%} interval "
        f"holds the truth. The grey band ({low:.3f} to {high:.3f}) is where an exact interval lies with "
        f"probability {own['bounds']:.1%}. AGHQ: adaptive quadrature with {own['nodes']} nodes.",
        tuple(alt), SIMULATED,
    )  # fmt: skip
    return (figure, Part("Every interval", "regression-coverage-every", (_table(table, rates),), True),
            *_ceiling(content["ceiling"]))  # fmt: skip


def _table(table: pd.DataFrame, rates: pd.DataFrame) -> Table:
    share = dict(zip(rates["intercept"], rates["rate"], strict=True))
    frame = table.assign(
        helping=table["intercept"].map(share), exact=table["exact"].map({True: "", False: "outside"})
    )
    columns = ["helping", "rule", "parameter", "interval", "truth", "median", "width", "share", "exact", "below",
               "above", "without"]  # fmt: skip
    return Table(
        "regression-coverage-table", frame[columns].astype({"median": float, "width": float}),
        "Intervals by the share of responses that are helping: true value, median estimate, median width, share of "
        "studies whose interval holds the truth, and studies whose whole interval lies below or above it or that "
        "have none.", SIMULATED, row_headings=4,
        headings={"median": "estimate", "exact": "of an exact interval", "share": "hold it", "without": "none"},
        formats={"helping": ".0%", "truth": ".2f", "median": ".2f", "width": ".2f", "share": ".3f"},
    )  # fmt: skip


def _ceiling(ceiling: Mapping[str, Any]) -> tuple[Block, ...]:
    summary = pd.DataFrame(ceiling["summary"])
    truth = {"sd": ceiling["sd"], "odds_ratio": float(np.exp(ceiling["effect"]))}
    labels = {"sd": "estimated standard deviation", "odds_ratio": "estimated odds ratio"}
    panels: list[Drawing] = [
        partial(rules_near_ceiling, summary, name, truth=truth[name], ylabel=label, legend=name == "sd")
        for name, label in labels.items()
    ]
    alt = tuple(
        f"Median {label} by share of people who always help: "
        + "; ".join(f"{100 * r.always:.0f}% {r.rule} {getattr(r, name):.2f}" for r in summary.itertuples())
        + f". The truth is {truth[name]:.2f}."
        for name, label in labels.items()
    )
    studies = int(summary["studies"].max())
    return (
        Figure(
            "regression-ceiling", tuple(panels),
            "Laplace's approximation near the ceiling, on the same simulated studies as quadrature "
            f"({ceiling['people']} people with {ceiling['responses']} responses each, {studies} studies a point): "
            f"median; bars hold half of the studies. {ceiling['sentence']}",
            alt, SIMULATED,
        ),
    )  # fmt: skip
