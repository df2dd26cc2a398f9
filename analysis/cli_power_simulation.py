"""The commands ``power mixed-model`` and ``power contraction``: how many people, by simulation."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer

from analysis.cli_power_options import AlphaOption, EvidenceOptions, WantedOption, with_options
from analysis.cli_workers import workers_of

if TYPE_CHECKING:
    import pandas as pd


class Test(StrEnum):
    """A test of the mixed model."""

    __test__ = False  # not one for pytest
    likelihood_ratio = "likelihood-ratio"
    wald = "wald"


@with_options
def mixed_model_command(
    formula: Annotated[
        str | None,
        typer.Option(metavar="FORMULA", help="As for glmm; the paper's regression of study 1 by default."),
    ] = None,
    design: Annotated[
        str | None,
        typer.Option(metavar="FILE.csv", help="Rows of one person of every kind; study 1's design by default."),
    ] = None,
    odds_ratio: Annotated[
        list[str] | None, typer.Option(metavar="NAME=X", help="True odds ratio of a covariate; may be repeated.")
    ] = None,
    intercept: Annotated[float | None, typer.Option(help="Log-odds with all covariates at zero.")] = None,
    sd: Annotated[float | None, typer.Option(min=0, help="Spread of people's intercepts, log-odds.")] = None,
    test: Annotated[
        list[str] | None, typer.Option(metavar="NAME", help="Covariate that is tested; repeated: all together.")
    ] = None,
    by: Annotated[Test, typer.Option("--by", help="The test whose number of people is the answer.")] = (
        Test.likelihood_ratio
    ),
    people: Annotated[str, typer.Option(metavar="100,200,...", help="Sizes of the simulated studies.")] = (
        "100,200,400,800,1600"
    ),
    studies: Annotated[int, typer.Option(min=2, help="Simulated studies of each size.")] = 400,
    alpha: AlphaOption = 0.05,
    wanted: WantedOption = 0.8,
    *,
    options: EvidenceOptions,
) -> None:
    """Power of the logistic mixed model, by simulation from the model itself.

    By default study 1's design and the printed odds ratios, with an intercept and a spread of people that the paper
    does not print; the test of signalling. An odds ratio of 1 gives the size of the test. Takes half a minute.

    Example: prosocial power mixed-model --odds-ratio signal=1.74 --test signal --people 200,540 --studies 200
    """
    from analysis import progress
    from analysis.power_simulation import (
        ENGINE,
        STUDY1_FORMULA,
        STUDY1_SD,
        STUDY1_TRUTH,
        TEST_NAMES,
        MixedModelPower,
        coefficients_from,
        mixed_model_power,
        rows_of_table,
        study1_rows,
    )
    from models.errors import located

    report, seed = options.report(design), options.seed
    _check_wanted(wanted, alpha)
    ratios = {}
    for entry in odds_ratio or []:
        name, _, value = entry.rpartition("=")
        try:
            ratios[name.strip()] = float(value)
        except ValueError:
            raise located("--odds-ratio", entry, "NAME=X with a number X") from None
    if design is None:
        rows = study1_rows(formula or STUDY1_FORMULA)
        start = {name: value for name, value in STUDY1_TRUTH.items() if name in rows.columns}
        spread = STUDY1_SD if sd is None else sd
    else:
        if formula is None:
            raise located("--formula", "", "outcome ~ covariates + (1|person), beside --design")
        if sd is None:
            raise located("--sd", "", "the spread of people's intercepts, beside --design")
        rows = rows_of_table(_numeric(design), formula, design)
        start, spread = {}, sd
    coefficients = start | coefficients_from(rows.columns, ratios, intercept)
    covariates = [name for name in rows.columns if name != "Intercept"]
    tested = tuple(test) if test else ("signal",) if design is None else tuple(covariates)
    if not test and design is not None and len(covariates) != 1:
        raise located("--test", "", f"at least one of {', '.join(covariates) or 'some covariates'}")
    settings = MixedModelPower(rows, coefficients, spread, tested, _sizes(people), studies, alpha, seed=seed)
    with progress.shown(options.quiet) as watch, workers_of(options.workers, options.scheduler) as executor:
        result = mixed_model_power(settings, executor=executor, progress=watch)
    answer = result.reached(wanted, by.name)
    report.say(result.table.to_string(index=False, float_format=lambda v: f"{v:.4f}"))
    truth = ", ".join(f"{name} {value:.3g}" for name, value in coefficients.items())
    sentence = result.sentence(wanted)
    report.say(f"\nTrue coefficients: {truth}; sd {spread:.3g}.\n{sentence} Seed {seed}; {result.seconds:.0f} s.")
    series = {
        TEST_NAMES[str(name)]: part.rename(columns={"power": "value"})
        for name, part in result.table.groupby("test", sort=False)
    }
    marks = {name: result.reached(wanted, test).n for test, name in TEST_NAMES.items()}
    options.draw(series, wanted, marks)
    content = {
        "n": answer.to_dict()["n"], "reached": answer.to_dict(),
        "assumptions": {
            "design": rows.words, "coefficients": coefficients, "sd": spread, "tested": tested,
            "test": by.value, "alpha": alpha, "power_wanted": wanted, "studies": studies,
            "nodes": settings.nodes, "seed": seed,
        },
        "curve": [_with_n(row) for row in result.table.to_dict("records")],
        "sentence": sentence, "seconds": result.seconds, "figure": options.figure,
    }  # fmt: skip
    what = "Power of the logistic mixed model: simulated people, coefficients and spread chosen by this project."
    words = {
        "": "power mixed-model", "--formula": formula, "--design": design, "--odds-ratio": odds_ratio,
        "--intercept": intercept, "--sd": sd, "--test": test, "--by": by.value, "--people": people,
        "--studies": studies, "--alpha": alpha, "--power": wanted,
    }  # fmt: skip
    options.finish(report, content, what, words, ENGINE)


@with_options
def contraction_command(
    truth: Annotated[
        str | None, typer.Option(metavar="MODEL", help="Model file of the truth; the calibrated one by default.")
    ] = None,
    schedules: Annotated[
        list[str] | None,
        typer.Option(
            metavar="HRHRH,HRRHH",
            help="Schedules of a design, drawn at random; repeated: designs compared. Or: published.",
        ),
    ] = None,
    table: Annotated[
        str, typer.Option(metavar="ACTION", help="Transition table asked about; all of them by default.")
    ] = "all",
    wanted: Annotated[float, typer.Option(help="Contraction wanted, below 1.")] = 0.5,
    people: Annotated[str, typer.Option(metavar="100,400,...", help="Sizes of the simulated studies.")] = (
        "100,400,1600,6400"
    ),
    studies: Annotated[int, typer.Option(min=2, help="Simulated studies of each size and design.")] = 5,
    kappa: Annotated[float, typer.Option(min=0, help="Stickiness: pseudo-counts on staying.")] = 2.0,
    *,
    options: EvidenceOptions,
) -> None:
    """With how many people, and which sequences, a transition table becomes known: expected contraction, simulated.

    By default three designs: study 1's six schedules, strict alternation of the same length, and study 2's nine
    rounds. Takes one to two minutes.

    Example: prosocial power contraction --schedules published --schedules HRHRHRHRH --table help --wanted 0.5
    """
    from analysis import progress
    from analysis.design import published, study1_design
    from analysis.evidence import ENGINE as LEARNING
    from analysis.power_contraction import (
        ALL_MOVES,
        ContractionPower,
        contraction_power,
        schedules_design,
    )
    from analysis.simulate import calibrated_truth
    from models.errors import located
    from models.model_files import read_model
    from models.parameters import DirichletPrior
    from models.protocol import PUBLISHED

    report, seed = options.report(truth), options.seed
    if not 0 < wanted < 1:
        raise located("--wanted", wanted, "between 0 and 1")
    if table not in ("all", *PUBLISHED.action_names):
        raise located("--table", table, f"all, or one of {', '.join(PUBLISHED.action_names)}")
    model = calibrated_truth() if truth is None else read_model(truth)
    asked = schedules or ["published", "HRHRH", published()["study2"]["sequence"]]
    designs = {
        name: study1_design() if name == "published" else schedules_design([s.strip() for s in name.split(",")])
        for name in dict.fromkeys(asked)
    }
    settings = ContractionPower(
        model, designs, _sizes(people), studies, prior=DirichletPrior(stay=kappa), seed=seed
    )
    with progress.shown(options.quiet) as watch, workers_of(options.workers, options.scheduler) as executor:
        result = contraction_power(settings, executor=executor, progress=watch)
    which = ALL_MOVES if table == "all" else f"moves: {table}"
    answers = {name: result.reached(wanted, which, name) for name in designs}
    shown = result.table[result.table["table"] == which]
    sentence = result.sentence(wanted, which)
    report.say(shown.to_string(index=False, float_format=lambda v: f"{v:.3f}"))
    report.say(f"\n{sentence} Seed {seed}; {result.seconds:.0f} s.")
    renamed = shown.rename(columns={"mean": "value"})
    series = {str(name): part for name, part in renamed.groupby("design", sort=False)}
    label = f"expected contraction, {which}"
    options.draw(series, wanted, {name: answers[name].n for name in series}, ylabel=label, log_x=True)
    everything = [
        {"design": name, "table": t, **result.reached(wanted, t, name).to_dict()}
        for name in designs
        for t in result.tables
    ]
    content = {
        "n": answers[next(iter(designs))].to_dict()["n"],
        "reached": everything,
        "assumptions": {
            "designs": {name: plan.schedules for name, plan in designs.items()}, "table": which,
            "contraction_wanted": wanted, "states": model.n_states, "truth": truth or "calibrated",
            "kappa": kappa, "studies": studies, "level": result.level, "sampler": vars(settings.sampler),
            "seed": seed,
        },
        "curve": [_with_n(row) for row in result.table.to_dict("records")],
        "share_above": [_with_n(row) for row in result.share_above(wanted, which).to_dict("records")],
        "unsettled": result.unsettled, "sentence": sentence, "seconds": result.seconds,
        "figure": options.figure,
    }  # fmt: skip
    what = "Expected contraction of transition tables by people and schedules: simulated people of a known truth."
    words = {
        "": "power contraction", "--truth": truth, "--schedules": schedules, "--table": table, "--wanted": wanted,
        "--people": people, "--studies": studies, "--kappa": f"{kappa:g}",
    }  # fmt: skip
    options.finish(report, content, what, words, LEARNING)


def _with_n(row: Mapping[Any, Any]) -> dict[str, Any]:
    """A row of a curve, its number of people called n as in every curve."""
    return {"n" if key == "people" else str(key): value for key, value in row.items()}


def _sizes(text: str) -> tuple[int, ...]:
    from models.errors import located

    parts = [part.strip() for part in text.split(",")]
    if not all(part.isdecimal() for part in parts):
        raise located("--people", text, "numbers of people, such as 100,200,400")
    return tuple(sorted({int(part) for part in parts}))


def _numeric(path: str) -> pd.DataFrame:
    """Every column of a file, as numbers where all are."""
    import pandas as pd

    from analysis.table_files import read_table

    frame = read_table(path).reset_index(drop=True)
    numbers = {name: pd.to_numeric(frame[name], errors="coerce") for name in frame.columns}
    return frame.assign(**{name: values for name, values in numbers.items() if values.notna().all()})


def _check_wanted(wanted: float, alpha: float) -> None:
    from models.errors import located

    if not 0 < alpha < 1:
        raise located("--alpha", alpha, "between 0 and 1")
    if not alpha < wanted < 1:
        raise located("--power", wanted, f"above alpha ({alpha:g}) and below 1")
