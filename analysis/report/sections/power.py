"""Section: how many people a study needs, by formula and by simulation, with every assumption named."""

from __future__ import annotations

from functools import partial

import numpy as np
import pandas as pd

from analysis.evidence import Evidence
from analysis.figures.power import power_by_people, printed_beside_formulas
from analysis.power_curves import reached as reached_at
from analysis.power_printed import PrintedSizes, printed_sizes
from analysis.power_simulation import TEST_NAMES
from analysis.report.context import ReportContext
from analysis.report.section import Block, Drawing, Figure, NotSupported, Origin, Part, Points, Table, Text, attempt
from analysis.report.stored import stored

SIMULATED = (Origin.SIMULATED,)
DEFINED = (Origin.DEFINITION, Origin.PRINTED)

CAUTIONS = (
    "Power says how often a test would find an effect of a given size. It says nothing about a study that has been "
    "run: the power at the observed effect is the p value in other words.",
    "The correlation of two measurements of a person decides more than anything else. Where it is not known, the "
    "number of people is a range, not a number.",
    "Formulas of F tests do not know a bounded outcome of two values; the simulations above do.",
)


def make(context: ReportContext) -> tuple[Block, ...]:
    """Printed sizes beside formulas; simulated power of the mixed model; simulated contraction."""
    if not context.is_published_protocol:
        raise NotSupported("the paper's sample sizes belong to its own studies, and this protocol is another")
    sizes = printed_sizes()
    intro = (
        "How many people does a study need? The paper prints an effect size, alpha, power and a minimum of people "
        "for each study, and neither the test nor the correlation between measurements behind it. No data of this "
        "report enter here."
    )
    return (
        Text(intro),
        Part("The printed numbers beside formulas", "power-formulas", _formulas(sizes)),
        *attempt("Power and contraction by simulation", partial(_simulated, context)),
        Points(CAUTIONS, "What not to conclude"),
    )


def _simulated(context: ReportContext) -> tuple[Block, ...]:
    """Stored evidence, for studies of the design it was made for."""
    if not context.is_published_schedule:
        raise NotSupported("they were simulated for the published design, and this study has another")
    return (
        Part(
            "The mixed model, by simulation",
            "power-mixed-model",
            stored("power_mixed_model", _mixed_model, "the mixed model's power"),
        ),
        Part(
            "When is a transition table known?",
            "power-contraction",
            stored("power_contraction", _contraction, "expected contraction by number of people"),
        ),
    )


# -- by formula ------------------------------------------------------------------------------------
def _formulas(sizes: PrintedSizes) -> tuple[Block, ...]:
    told = "; ".join(
        f"{r.study}, {r.test}: {r.n} by formula, {r.printed} printed" for r in sizes.table.itertuples()
    )
    settings = sizes.settings.set_index("study")
    curves = sizes.curves()
    panels: list[Drawing] = []
    alt = []
    for study, part in curves.groupby("study", sort=False):
        given = settings.loc[study]
        own = sizes.table[sizes.table["study"] == study]
        series = {
            str(test): rows.rename(columns={"power": "value"}) for test, rows in part.groupby("test", sort=False)
        }
        reached = {row.test: float(row.n) for row in own.itertuples()}
        panels.append(
            partial(
                power_by_people, series, float(given["power"]), reached=reached, printed=float(given["printed"]),
                title=f"{study}: f = {given['f']:g}, α = {given['alpha']:g}",
            )
        )  # fmt: skip
        alt.append(
            f"Power by people for {study}, {given['power']:g} wanted: "
            + "; ".join(f"{test} reaches it at {n:.0f}" for test, n in reached.items())
            + f"; {given['printed']:.0f} are printed."
        )
    return (
        Text(f"{sizes.sentence}"),
        *_sizes_tables(sizes),
        Figure(
            "power-printed", (partial(printed_beside_formulas, sizes.table),),
            "People by formula for tests that each study could have meant (blue), beside the printed number.",
            (f"People: {told}.",), DEFINED,
        ),
        Figure(
            "power-curves", tuple(panels),
            "Power by number of people for the same tests, each with its correlation ρ and sphericity ε; where "
            "each reaches the power wanted, and the printed number of people.",
            tuple(alt), DEFINED,
        ),
    )  # fmt: skip


def _sizes_tables(sizes: PrintedSizes) -> tuple[Table, Table]:
    table = sizes.table
    took_part = " and ".join(f"{n}" for n in dict.fromkeys(table["participants"]))
    return (
        Table(
            "power-sizes", table[["study", "test", "n", "printed", "power_at_printed"]],
            "People by formula with correlation ρ and sphericity ε as assumed, and power with the printed number.",
            DEFINED, row_headings=2, printed=("printed",),
            headings={"n": "people", "power_at_printed": "power with these"},
            formats={"n": "d", "printed": "d", "power_at_printed": ".3f"},
        ),
        Table(
            "power-matching", table[["study", "test", "matching_rho", "matching_epsilon", "power_at_participants"]],
            "Correlation or sphericity at which the formula asks for exactly the printed number, where there is "
            f"one; power with the {took_part} who took part.",
            DEFINED, row_headings=2,
            headings={"matching_rho": "ρ for printed", "matching_epsilon": "ε for printed",
                      "power_at_participants": "power with those who took part"},
            formats=dict.fromkeys(("matching_rho", "matching_epsilon", "power_at_participants"), ".3f"),
        ),
    )  # fmt: skip


# -- by simulation ---------------------------------------------------------------------------------
def _mixed_model(found: Evidence) -> tuple[Block, ...]:
    given = found.content["assumptions"]
    curve = pd.DataFrame(found.content["curve"]).rename(columns={"n": "people", "power": "value"})
    series = {TEST_NAMES[str(test)]: rows for test, rows in curve.groupby("test", sort=False)}
    wanted = float(given["power_wanted"])
    reached = {name: _reached(rows, wanted) for name, rows in series.items()}
    ratios = ", ".join(
        f"{name} {np.exp(value):.2f}" for name, value in given["coefficients"].items() if name != "Intercept"
    )
    told = "; ".join(f"{r.test} with {r.people} people {r.value:.2f}" for r in curve.itertuples())
    return (
        Figure(
            "power-mixed-model-figure", (partial(power_by_people, series, wanted, reached=reached),),
            f"Power of the logistic mixed model for {', '.join(given['tested'])} ({given['design']}): share of "
            f"{given['studies']} simulated studies with p below {given['alpha']:g}, with 95% intervals of that "
            f"share. True odds ratios {ratios}, as printed; intercept {given['coefficients']['Intercept']:g} and "
            f"standard deviation {given['sd']:g} of people's intercepts are chosen, for the paper prints neither.",
            (f"Power: {told}.",), SIMULATED,
        ),
    )  # fmt: skip


def _contraction(found: Evidence) -> tuple[Block, ...]:
    given = found.content["assumptions"]
    which = given["table"]
    everything = pd.DataFrame(found.content["curve"]).rename(columns={"n": "people", "mean": "value"})
    curve = everything[everything["table"] == which]
    series = {str(design): rows for design, rows in curve.groupby("design", sort=False)}
    told = "; ".join(f"{r.design} with {r.people} people {r.value:.2f}" for r in curve.itertuples())
    wanted = given["contraction_wanted"]
    reached = pd.DataFrame(found.content["reached"])
    people = {str(r.design): _number(r.n) for r in reached[reached["table"] == which].itertuples()}
    return (
        Figure(
            "power-contraction-figure",
            (partial(power_by_people, series, wanted, reached=people, ylabel=f"expected contraction, {which}",
                     log_x=True),),
            f"Expected contraction of the transition tables at {given['states']} states by number of people, for "
            f"study 1's schedules, for strict alternation, and for study 2's nine rounds ({given['studies']} "
            f"simulated studies a point, {given['level']:.0%} intervals of the mean). 1 is a table known exactly, "
            "0 one of which the data say nothing.",
            (f"Expected contraction: {told}.",), SIMULATED,
        ),
        Part(
            "Every table", "power-contraction-every",
            (
                Table(
                    "power-contraction-table", reached[["design", "table", "words"]],
                    f"When the expected contraction of each table reaches {wanted:g}.", SIMULATED, row_headings=2,
                    headings={"words": "reached"},
                ),
            ), True,
        ),
    )  # fmt: skip


def _reached(curve: pd.DataFrame, wanted: float) -> float:
    people, value, low, high = (curve[c].to_numpy(dtype=np.float64) for c in ("people", "value", "low", "high"))
    return reached_at(people, value, low, high, wanted).n


def _number(value: float | None) -> float:
    return float("nan") if value is None else float(value)
