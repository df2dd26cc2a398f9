"""What the commands ``power ...`` share: options, and the figure that each can draw."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated

import typer

from analysis.cli_options import Report, check_output, distinct_files, write_output

if TYPE_CHECKING:
    import pandas as pd

EffectOption = Annotated[float, typer.Option("--f", help="Cohen's f: sd of cell means over sd within.")]
AlphaOption = Annotated[float, typer.Option("--alpha", help="Level of the test.")]
WantedOption = Annotated[float, typer.Option("--power", help="Power wanted.")]
PeopleOption = Annotated[
    int | None, typer.Option("--people", min=2, help="Give the power of that many people instead.")
]
FigureOption = Annotated[str | None, typer.Option("--figure", metavar="FILE.svg", help="Also draw the curve.")]
TimesOption = Annotated[int, typer.Option(min=2, help="Measurements a person.")]
RhoOption = Annotated[float, typer.Option(help="Correlation between two measurements of a person; no default.")]
EpsilonOption = Annotated[
    float, typer.Option(help="Sphericity, from 1/(times - 1) to 1; below 1 where correlations differ.")
]


def check_figure(figure: str | None, report: Report, read: str | None = None) -> None:
    """Refuse a figure that cannot be written, or that another file of the command would be written over."""
    if figure is not None:
        check_output("--figure", figure)
    distinct_files({"FILE": read, "--figure": figure, "--json": report.json_path})


def draw_figure(
    figure: str | None,
    series: Mapping[str, pd.DataFrame],
    wanted: float,
    reached: Mapping[str, float],
    ylabel: str = "power",
    log_x: bool = False,
) -> None:
    """Draw the curves into the file of ``--figure``, if one is asked for."""
    if figure is None:
        return
    from analysis.figures.power import power_by_people
    from analysis.figures.style import to_svg

    ax = power_by_people(series, wanted, reached=reached, ylabel=ylabel, log_x=log_x)
    write_output("--figure", figure, to_svg(ax).encode())
