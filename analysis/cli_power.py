"""The commands ``power ...`` by formula, and the group that those by simulation join."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from analysis.cli_options import DEFAULT_SEED, JsonOption, QuietOption, Report, SeedOption, write_output
from analysis.cli_power_options import (
    AlphaOption,
    EffectOption,
    EpsilonOption,
    FigureOption,
    PeopleOption,
    RhoOption,
    TimesOption,
    WantedOption,
    check_figure,
    draw_figure,
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
def fixed_command(
    groups: Annotated[int, typer.Option(min=2, help="Groups, or cells of a factorial design.")],
    df: Annotated[int | None, typer.Option(min=1, help="Numerator df; groups - 1 by default.")] = None,
    f: EffectOption = 0.25,
    alpha: AlphaOption = 0.05,
    wanted: WantedOption = 0.95,
    people: PeopleOption = None,
    figure: FigureOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """One value a person: the effect of groups, or of a factor with that many numerator degrees of freedom.

    Example: prosocial power fixed --groups 4 --df 1 --people 200
    """
    _formula({"kind": "fixed", "groups": groups, "df": df}, f, alpha, wanted, people, figure, Report(json, quiet))


@power.command("between")
def between_command(
    groups: Annotated[int, typer.Option(min=2, help="Groups of people.")],
    times: TimesOption,
    rho: RhoOption,
    f: EffectOption = 0.25,
    alpha: AlphaOption = 0.05,
    wanted: WantedOption = 0.95,
    people: PeopleOption = None,
    figure: FigureOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Repeated measures: the effect of groups on the mean over times.

    Example: prosocial power between --groups 4 --times 5 --rho 0.5
    """
    design = {"kind": "between", "groups": groups, "times": times, "rho": rho}
    _formula(design, f, alpha, wanted, people, figure, Report(json, quiet))


@power.command("within")
def within_command(
    groups: Annotated[int, typer.Option(min=1, help="Groups of people.")],
    times: TimesOption,
    rho: RhoOption,
    epsilon: EpsilonOption = 1.0,
    f: EffectOption = 0.25,
    alpha: AlphaOption = 0.05,
    wanted: WantedOption = 0.95,
    people: PeopleOption = None,
    figure: FigureOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Repeated measures: the effect of time.

    Example: prosocial power within --groups 5 --times 9 --rho 0.5 --epsilon 0.6
    """
    design = {"kind": "within", "groups": groups, "times": times, "rho": rho, "epsilon": epsilon}
    _formula(design, f, alpha, wanted, people, figure, Report(json, quiet))


@power.command("interaction")
def interaction_command(
    groups: Annotated[int, typer.Option(min=2, help="Groups of people.")],
    times: TimesOption,
    rho: RhoOption,
    epsilon: EpsilonOption = 1.0,
    f: EffectOption = 0.25,
    alpha: AlphaOption = 0.05,
    wanted: WantedOption = 0.95,
    people: PeopleOption = None,
    figure: FigureOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Repeated measures: the interaction of groups and time.

    Example: prosocial power interaction --groups 5 --times 2 --rho 0.5
    """
    design = {"kind": "interaction", "groups": groups, "times": times, "rho": rho, "epsilon": epsilon}
    _formula(design, f, alpha, wanted, people, figure, Report(json, quiet))


def _formula(
    design: dict[str, Any], f: float, alpha: float, wanted: float, people: int | None, figure: str | None,
    report: Report,
) -> None:  # fmt: skip
    import pandas as pd

    from analysis.power_formulas import FTestDesign, curve_people, power_curve, sample_size
    from analysis.power_formulas import power as power_of

    check_figure(figure, report)
    own = FTestDesign(**design)
    if people is None:
        n, balanced = sample_size(own, f, alpha, wanted), sample_size(own, f, alpha, wanted, balanced=True)
        told = f"{n} people have power {power_of(own, n, f, alpha):.4f}"
        told += "" if balanced == n else f"; {balanced} with groups of equal size"
    else:
        n, balanced = people, None
        told = f"{n} people have power {power_of(own, n, f, alpha):.4f}"
    at = curve_people(own, n)
    curve = pd.DataFrame({"people": at, "value": power_curve(own, at, f, alpha)})
    df1, df2 = own.degrees_of_freedom(n)
    sentence = f"{own.words}, f = {f:g}, alpha = {alpha:g}: {told}."
    report.say(sentence)
    draw_figure(figure, {own.words: curve}, wanted, {own.words: float(n)} if people is None else {})
    report.finish(
        {
            "n": n, "power": power_of(own, n, f, alpha), "n_balanced": balanced,
            "assumptions": {**vars(own), "df": df1, "f": f, "alpha": alpha, "power_wanted": wanted},
            "df1": df1, "df2": df2, "noncentrality": own.noncentrality(n, f),
            "curve": [{"n": int(r.people), "power": float(r.value)} for r in curve.itertuples()],
            "sentence": sentence, "figure": figure,
        }
    )  # fmt: skip


@power.command("printed")
def printed_command(
    figure: FigureOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """The paper's 200 and 90 people beside the formulas: which settings come closest, and what they assume.

    Example: prosocial power printed
    """
    from analysis.figures.power import printed_beside_formulas
    from analysis.figures.style import to_svg
    from analysis.power_formulas import FTestDesign, curve_people, power_curve
    from analysis.power_printed import printed_sizes

    report = Report(json, quiet)
    check_figure(figure, report)
    result = printed_sizes()
    settings = result.settings.set_index("study")
    rows = []
    for row in result.table.to_dict("records"):
        given = settings.loc[row["study"]]
        df = int(row["df1"]) if row["kind"] == "fixed" else None
        design = FTestDesign(row["kind"], row["groups"], row["times"], row["rho"], row["epsilon"], df)
        at = curve_people(design, max(row["n"], row["printed"]))
        curve = power_curve(design, at, given["f"], given["alpha"])
        rows += [{"study": row["study"], "test": row["test"], "n": int(n), "power": p}
                 for n, p in zip(at, curve, strict=True)]  # fmt: skip
    shown = result.table.drop(columns=["kind", "groups", "times", "rho", "epsilon", "df1"])
    report.say(shown.to_string(index=False, float_format=lambda v: f"{v:.3f}", na_rep="-"))
    report.say(f"\n{result.sentence}")
    if figure is not None:
        write_output("--figure", figure, to_svg(printed_beside_formulas(result.table)).encode())
    report.finish(
        {
            "n": {study: int(value) for study, value in settings["printed"].items()},
            "assumptions": {str(study): dict(row) for study, row in settings.iterrows()},
            "table": result.table.to_dict("records"), "curve": rows, "sentence": result.sentence, "figure": figure,
        }
    )  # fmt: skip
