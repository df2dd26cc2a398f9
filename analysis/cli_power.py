"""The commands ``power ...`` by formula, and the group that those by simulation join."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from analysis.cli_options import write_output
from analysis.cli_power_options import (
    EpsilonOption,
    FormulaOptions,
    OutputOptions,
    RhoOption,
    TimesOption,
    with_options,
)
from analysis.cli_power_simulation import contraction_command, mixed_model_command

power = typer.Typer(
    help="How many people a study needs, by formula or by simulation; every assumption is named.\n\n"
    "Example: prosocial power interaction --groups 5 --times 2 --rho 0.5",
    no_args_is_help=True,
    rich_markup_mode=None,
)

power.command("mixed-model")(mixed_model_command)
power.command("contraction")(contraction_command)


@power.command("fixed")
@with_options
def fixed_command(
    groups: Annotated[int, typer.Option(min=2, help="Groups, or cells of a factorial design.")],
    df: Annotated[int | None, typer.Option(min=1, help="Numerator df; groups - 1 by default.")] = None,
    *,
    options: FormulaOptions,
) -> None:
    """One value a person: the effect of groups, or of a factor with that many numerator degrees of freedom.

    Example: prosocial power fixed --groups 4 --df 1 --people 200
    """
    _formula({"kind": "fixed", "groups": groups, "df": df}, options)


@power.command("between")
@with_options
def between_command(
    groups: Annotated[int, typer.Option(min=2, help="Groups of people.")],
    times: TimesOption,
    rho: RhoOption,
    *,
    options: FormulaOptions,
) -> None:
    """Repeated measures: the effect of groups on the mean over times.

    Example: prosocial power between --groups 4 --times 5 --rho 0.5
    """
    design = {"kind": "between", "groups": groups, "times": times, "rho": rho}
    _formula(design, options)


@power.command("within")
@with_options
def within_command(
    groups: Annotated[int, typer.Option(min=1, help="Groups of people.")],
    times: TimesOption,
    rho: RhoOption,
    epsilon: EpsilonOption = 1.0,
    *,
    options: FormulaOptions,
) -> None:
    """Repeated measures: the effect of time.

    Example: prosocial power within --groups 5 --times 9 --rho 0.5 --epsilon 0.6
    """
    design = {"kind": "within", "groups": groups, "times": times, "rho": rho, "epsilon": epsilon}
    _formula(design, options)


@power.command("interaction")
@with_options
def interaction_command(
    groups: Annotated[int, typer.Option(min=2, help="Groups of people.")],
    times: TimesOption,
    rho: RhoOption,
    epsilon: EpsilonOption = 1.0,
    *,
    options: FormulaOptions,
) -> None:
    """Repeated measures: the interaction of groups and time.

    Example: prosocial power interaction --groups 5 --times 2 --rho 0.5
    """
    design = {"kind": "interaction", "groups": groups, "times": times, "rho": rho, "epsilon": epsilon}
    _formula(design, options)


def _formula(design: dict[str, Any], options: FormulaOptions) -> None:
    import pandas as pd

    from analysis.power_formulas import FTestDesign, curve_people, power_curve, sample_size
    from analysis.power_formulas import power as power_of

    report = options.report()
    f, alpha, wanted = options.f, options.alpha, options.wanted
    own = FTestDesign(**design)
    if options.people is None:
        n, balanced = sample_size(own, f, alpha, wanted), sample_size(own, f, alpha, wanted, balanced=True)
        told = f"{n} people have power {power_of(own, n, f, alpha):.4f}"
        told += "" if balanced == n else f"; {balanced} with groups of equal size"
    else:
        n, balanced = options.people, None
        told = f"{n} people have power {power_of(own, n, f, alpha):.4f}"
    at = curve_people(own, n)
    curve = pd.DataFrame({"people": at, "value": power_curve(own, at, f, alpha)})
    df1, df2 = own.degrees_of_freedom(n)
    sentence = f"{own.words}, f = {f:g}, alpha = {alpha:g}: {told}."
    report.say(sentence)
    options.draw({own.words: curve}, wanted, {own.words: float(n)} if options.people is None else {})
    report.finish(
        {
            "n": n, "power": power_of(own, n, f, alpha), "n_balanced": balanced,
            "assumptions": {**vars(own), "df": df1, "f": f, "alpha": alpha, "power_wanted": wanted},
            "df1": df1, "df2": df2, "noncentrality": own.noncentrality(n, f),
            "curve": [{"n": int(r.people), "power": float(r.value)} for r in curve.itertuples()],
            "sentence": sentence, "figure": options.figure,
        }
    )  # fmt: skip


@power.command("printed")
@with_options
def printed_command(options: OutputOptions) -> None:
    """The paper's 200 and 90 people beside the formulas: which settings come closest, and what they assume.

    Example: prosocial power printed
    """
    from analysis.figures.power import printed_beside_formulas
    from analysis.figures.style import to_svg
    from analysis.power_printed import printed_sizes

    report = options.report()
    result = printed_sizes()
    settings = result.settings.set_index("study")
    shown = result.table.drop(columns=["kind", "groups", "times", "rho", "epsilon", "df1"])
    report.say(shown.to_string(index=False, float_format=lambda v: f"{v:.3f}", na_rep="-"))
    report.say(f"\n{result.sentence}")
    if options.figure is not None:
        write_output("--figure", options.figure, to_svg(printed_beside_formulas(result.table)).encode())
    report.finish(
        {
            "n": {study: int(value) for study, value in settings["printed"].items()},
            "assumptions": {str(study): dict(row) for study, row in settings.iterrows()},
            "table": result.table.to_dict("records"),
            "curve": result.curves().rename(columns={"people": "n"}).to_dict("records"),
            "sentence": result.sentence, "figure": options.figure,
        }
    )  # fmt: skip
