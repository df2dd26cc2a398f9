"""Section: study 2's tests, as printed, and the same tests on the responses of this report's people."""

from __future__ import annotations

from functools import partial

import pandas as pd

from analysis import response_rates as rates
from analysis.anova import MixedAnova, mixed_anova
from analysis.anova_logistic import logistic_twin
from analysis.figures.comparisons import cell_means, compared_groups
from analysis.first_and_last import first_and_last, plain_condition
from analysis.posthoc import Comparisons, PersonValues, dunnett, tukey
from analysis.printed_anova import REFERENCE, anova_consistency, printed_anova, printed_tukey
from analysis.report.context import ReportContext
from analysis.report.section import Block, Figure, NotSupported, Origin, Part, Points, Table, Text, attempt
from analysis.wording import counted
from models.errors import InputError

CAUTIONS = (
    "An effect of time is what everybody does alike, whatever the robot does; what a policy does shows in the "
    "interaction, for before it acts there is nothing to differ.",
    "Tukey's intervals compare all pairs, Dunnett's all groups with one reference. Each is fed one value a person: "
    "all rows as if independent would find differences that are not there.",
    "A difference that is not significant is not shown to be small: the interval says what it may be.",
)


def make(context: ReportContext) -> tuple[Block, ...]:
    """Printed tests of study 2, then mixed ANOVA, logistic twin and comparisons of the study at hand."""
    blocks: list[Block] = []
    if context.is_published_protocol:
        blocks += _printed(context)
    try:
        blocks += _own(context)
    except NotSupported as error:
        if not blocks:
            raise
        blocks += attempt("the same tests on the people of this report", partial(_fail, error.reason))
    blocks.append(Points(CAUTIONS, "What not to conclude"))
    return tuple(blocks)


def _fail(reason: str) -> tuple[Block, ...]:
    raise NotSupported(reason)


# -- as printed --------------------------------------------------------------------------------------
def _printed(context: ReportContext) -> tuple[Block, ...]:
    study = context.published["study2"]
    table, pairs = printed_anova(context.published), printed_tukey(context.published)
    intro = (
        f"Study 2 put {study['participants']} people under {len(study['policies'])} policies "
        f"({', '.join(study['policies'])}) and measured them at the start and at the end. The paper tests each "
        "measure by a mixed analysis of variance, policy between people and time within, and compares policies by "
        "Tukey's method. Its people are not part of this report (the section on study 2 run again simulates "
        "others): this table holds what is printed and what follows from it."
    )
    frame = table.assign(df=[f"{r.df1}, {r.df2}" for r in table.itertuples()])
    anova = Table(
        "anova-printed", frame[["measure", "effect", "df", "f", "p", "p_implied", "partial_eta_squared"]],
        "Study 2's mixed analyses of variance as printed, and p and partial eta squared that follow from the "
        "printed F. A printed p of 0 stands for p < .001.",
        (Origin.PRINTED, Origin.DEFINITION), row_headings=2, printed=("f", "p"),
        headings={"f": "F", "p_implied": "p that F implies", "partial_eta_squared": "partial η²"},
        formats={"f": ".2f", "p": ".4g", "p_implied": ".2g", "partial_eta_squared": ".3f"},
    )  # fmt: skip
    compared = Table(
        "anova-printed-tukey", pairs,
        f"Printed comparisons: mean under the policy less mean under {REFERENCE}, and Tukey's p for all ten pairs.",
        (Origin.PRINTED,), row_headings=2, printed=("difference", "p"), formats={"difference": "+.3f", "p": ".4g"},
    )  # fmt: skip
    # Dunnett's test is the one for comparisons with one reference; without data only its logic can be stated.
    note = (
        f"The paper compares four policies with its own, {REFERENCE}, and adjusts for all ten pairs. Dunnett's "
        "test adjusts for the four comparisons that are made, so it loses less; it needs the data."
    )
    blocks = (Text(intro), anova, Text(anova_consistency(table)), compared, Text(note))
    return (Part("Study 2 as printed", "anova-printed-part", blocks),)


# -- on the data of the report -----------------------------------------------------------------------
def _own(context: ReportContext) -> tuple[Block, ...]:
    try:
        data = first_and_last(context.log)
        result = mixed_anova(data)
        people = PersonValues.at(data)
        pairs = tukey(people)
    except InputError as error:
        raise NotSupported(f"a mixed analysis of variance is not possible here: {error}") from None
    reference = plain_condition(context.log)
    versus = None if reference is None else dunnett(people, reference)
    twin = logistic_twin(data) if data.binary else None
    intro = (
        "The same tests on the people of this report: condition between people, first and last recorded response "
        f"within ({rates.measure_name(context.protocol)}). This is not the paper's analysis of study 2; it shows "
        "the tests on data at hand."
    )
    blocks: list[Block] = [Text(intro), Text(result.sentence), _anova_table(context, result)]
    blocks += [Text(note, "note") for note in result.notes]
    silent = context.log.n_participants - len(data.people) - len(data.left_out)
    if silent:
        blocks.append(Text(f"Left out too: {counted(silent, 'person', 'people')} without any response.", "note"))
    if twin is not None:
        blocks.append(
            Table(
                "anova-logistic", twin.table[["effect", "chi_squared", "df", "p"]],
                f"{twin.title}: the test that fits an outcome of 0 and 1. Standard deviation of people's "
                f"intercepts {twin.sd:.2f} on the logit scale.", (context.origin,),
                headings={"chi_squared": "χ²"},
                formats={"chi_squared": ".2f", "df": "d", "p": ".2g"},
            )
        )  # fmt: skip
        blocks += [Text(note, "note") for note in twin.notes]
    blocks.append(_means(context, result))
    compared = [pairs] if versus is None else [pairs, versus]
    blocks += [Text(found.sentence) for found in compared]
    blocks += [_compared(context, compared, data.dv)]
    blocks.append(Part("Every comparison", "anova-pairs-part", (_pairs(context, compared),), True))
    return (Part("On the people of this report", "anova-own-part", tuple(blocks)),)


def _anova_table(context: ReportContext, result: MixedAnova) -> Table:
    columns = ["effect", "sum_of_squares", "df1", "df2", "f", "p", "partial_eta_squared", "generalized_eta_squared"]
    return Table(
        "anova-table", result.table[columns],
        f"Mixed analysis of variance, Type {'II' if result.ss_type == 2 else 'III'}; with two times sphericity is "
        "trivial.", (context.origin,),
        headings={"sum_of_squares": "sum of squares", "df1": "df", "df2": "residual df", "f": "F",
                  "partial_eta_squared": "partial η²", "generalized_eta_squared": "generalised η²"},
        formats={"sum_of_squares": ".2f", "df1": "d", "df2": "d", "f": ".2f", "p": ".2g",
                 "partial_eta_squared": ".3f", "generalized_eta_squared": ".3f"},
    )  # fmt: skip


def _means(context: ReportContext, result: MixedAnova) -> Figure:
    told = "; ".join(
        f"{r.group}, {r.time} {r.mean:.2f} ({r.low:.2f} to {r.high:.2f})" for r in result.cells.itertuples()
    )
    measure = rates.measure_name(context.protocol)
    return Figure(
        "anova-means",
        (partial(cell_means, result.cells, xlabel="response", ylabel=measure),),
        f"Mean of each condition at the first and the last response, {result.level:.0%} intervals from the "
        "variance pooled over conditions, as the analysis of variance has it.",
        (f"Means: {told}.",), (context.origin,),
    )  # fmt: skip


def _compared(context: ReportContext, compared: list[Comparisons], dv: str) -> Figure:
    panels = tuple(partial(compared_groups, found, xlabel=dv) for found in compared)
    alt = tuple(
        f"{found.method}: "
        + "; ".join(
            f"{r.group} less {r.reference} {r.difference:+.2f} ({r.low:+.2f} to {r.high:+.2f})"
            for r in found.table.itertuples()
        )
        + "."
        for found in compared
    )
    names = " and ".join(found.method for found in compared)
    return Figure(
        "anova-compared", panels,
        f"Differences of {compared[0].what} between conditions by {names}, with simultaneous intervals; filled "
        "where zero is excluded.", alt, (context.origin,),
    )  # fmt: skip


def _pairs(context: ReportContext, compared: list[Comparisons]) -> Table:
    frame = pd.concat([found.table.assign(method=found.method) for found in compared], ignore_index=True)
    columns = ["method", "group", "reference", "difference", "low", "high", "t", "df", "p"]
    return Table(
        "anova-pairs", frame[columns], "Every comparison, p adjusted by its method.", (context.origin,),
        headings={"low": "from", "high": "to"}, row_headings=3,
        formats={"difference": "+.3f", "low": "+.3f", "high": "+.3f", "t": ".2f", "df": "d", "p": ".2g"},
    )  # fmt: skip
