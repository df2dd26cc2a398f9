"""The command ``glmm``: study 1's regression, or any logistic mixed model of a table."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from analysis.cli_em import ConditionOption
from analysis.cli_options import (
    DEFAULT_SEED,
    JsonOption,
    ProtocolOption,
    QuietOption,
    Report,
    SeedOption,
    check_output,
    distinct_files,
    load_protocol,
    write_output,
)


def glmm_command(
    data: Annotated[
        str, typer.Argument(metavar="DATA", help="A registered data set, an event file, or with --formula a table.")
    ],
    formula: Annotated[
        str | None, typer.Option("--formula", metavar='"y ~ x + (1|g)"', help="Model of a table's columns.")
    ] = None,
    nodes: Annotated[str, typer.Option("--nodes", metavar="25|laplace", help="Quadrature nodes.")] = "25",
    weights: Annotated[
        str | None, typer.Option("--weights", metavar="COL", help="How often each row was observed.")
    ] = None,
    trials: Annotated[
        str | None,
        typer.Option("--trials", metavar="COL", help="Trials of each row; the outcome counts successes."),
    ] = None,
    offset: Annotated[
        str | None, typer.Option("--offset", metavar="COL", help="Added to the linear predictor of each row.")
    ] = None,
    twin: Annotated[
        bool, typer.Option("--twin", help="Also the Bayesian twin of study 1's regression (a minute).")
    ] = False,
    groups: Annotated[
        str | None,
        typer.Option(
            "--groups",
            metavar="FILE.csv",
            help="Also write one row a group: intercept with interval, and how much the fit hangs on the group.",
        ),
    ] = None,
    condition: ConditionOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
    protocol: ProtocolOption = None,
) -> None:
    """Fit a logistic mixed model: people's responses to the robot, or a formula of your own.

    Without --formula DATA is a study, and the model is the paper's, help ~ signal + robot_help + (1|participant),
    with what it is compared with. With --formula DATA is a table; for a registered data set it has the columns
    participant, condition, sequence, round, the response (help), signal, robot_help, robot_help_so_far and
    had_chance. offset(...) may be a term of it, or --offset a column. In the JSON a parameter without a finite
    estimate is null, and "unbounded" says where it runs to; null, too, are the ends of "profile" that are "open".

    Example: prosocial glmm simulated_study1 --json reports/build/glmm.json

    Example: prosocial glmm trial.csv --formula "recovered ~ dose + (1|clinic)"

    Example: prosocial glmm trial.csv --formula "recovered ~ dose + (1 + dose|clinic)" --nodes laplace
    """
    from analysis.mixed_model_table import nodes_of
    from models.errors import located

    report = Report(json, quiet)
    if groups is not None:
        check_output("--groups", groups)
    distinct_files({"DATA": data, "--protocol": protocol, "--json": json, "--groups": groups})
    rule = nodes_of(nodes)
    if formula is None:
        for option, value in (("--weights", weights), ("--trials", trials), ("--offset", offset)):
            if value is not None:
                raise located(option, value, "--formula beside it: a study's responses have none")
        _study(report, data, rule, twin, condition, seed, protocol, groups)
        return
    if twin:
        raise located("--twin", "--formula", "a study without a formula: the twin is study 1's")
    if condition is not None and not _registered(data):
        raise located("--condition", ", ".join(condition), "a registered data set: a table has no conditions")
    columns = {"weights": weights, "trials": trials, "offset": offset}
    _formula(report, data, formula, rule, columns, condition, seed, protocol, groups)


def _registered(data: str) -> bool:
    from analysis import datasets

    return data in datasets.names()


def _formula(
    report: Report, data: str, formula: str, rule: int | str, columns: dict[str, str | None],
    condition: list[str] | None, seed: int, protocol: str | None, groups: str | None,
) -> None:  # fmt: skip
    """Fit a formula to a table and report it."""
    from analysis import datasets
    from analysis.mixed_model_table import (
        as_dict,
        as_text,
        fit_table,
        marginal_contrasts,
        slopes_dict,
        typed_table,
    )
    from analysis.regression_data import response_table
    from analysis.study_selection import select
    from models.errors import InputError
    from models.glmm_slope import LogisticSlopeModel

    kind = None
    if _registered(data):
        chosen = select(datasets.load(data, load_protocol(protocol)), condition)
        frame, kind = response_table(chosen.log).frame, chosen.dataset.card.kind
    else:
        frame = typed_table(data, formula)
    try:
        fit = fit_table(formula, frame, nodes=rule, **columns)
    except InputError as error:
        # The model knows columns and rows, not the file they are from.
        raise error if str(error).startswith("--") else InputError(f"{data}: {error}") from None
    report.say(f"{data}{f' ({kind})' if kind else ''}: {formula}")
    if isinstance(fit.model, LogisticSlopeModel):
        report.say(str(fit.summary()))
        if groups is not None:
            write_output("--groups", groups, fit.random_effects.to_csv().encode())
        _warn(fit)
        _left_out(fit.model)
        plain = {"data": data, "kind": kind, "formula": formula, "seed": seed, "groups_file": groups}
        report.finish({**slopes_dict(fit), **plain})
        return
    report.say(as_text(fit, marginal_contrasts(fit)))
    hangs = _groups(report, fit, groups)
    _warn(fit)
    _left_out(fit.model)
    report.finish({"data": data, "kind": kind, "formula": formula, "seed": seed, **as_dict(fit), **hangs})


def _study(
    report: Report, data: str, rule: int | str, twin: bool, condition: list[str] | None, seed: int,
    protocol: str | None, groups: str | None,
) -> None:  # fmt: skip
    """Fit study 1's regression and report it."""
    from analysis import datasets
    from analysis.bayes_twin import bayes_twin
    from analysis.design import published
    from analysis.mixed_model_table import as_dict, as_text
    from analysis.printed_regression import TERM_OF, consistency
    from analysis.regression import regress
    from analysis.regression_checks import by_condition, residuals
    from analysis.regression_readings import readings
    from analysis.regression_sources import LAPLACE, QUADRATURE, of_fit, of_print, of_twin, side_by_side
    from analysis.regression_words import (
        cautions,
        interaction_sentence,
        main_sentence,
        odds_sentence,
        rules_sentence,
    )
    from analysis.study_selection import select

    chosen = select(datasets.load(data, load_protocol(protocol)), condition)
    regression = regress(chosen.log, rule)
    laplace = regression if rule == "laplace" else regress(chosen.log, "laplace")
    sampled = bayes_twin(regression.table, regression.table.main, seed=seed) if twin else None
    sources = [of_fit(LAPLACE, laplace)]
    if rule != "laplace":
        sources.append(of_fit(QUADRATURE, regression))
    if twin:
        sources.append(of_twin(sampled))
    printed = published()["study1"]
    beside = (
        chosen.log.n_participants == printed["participants"]
        and set(chosen.log.conditions) == set(printed["conditions"])
        and set(regression.terms) == set(TERM_OF.values())
    )
    if beside:
        sources.insert(0, of_print(published()))
    table = side_by_side(sources, regression)
    checked = residuals(regression, chosen.log, seed)
    other = readings(regression, rule)
    sentences = [
        main_sentence(regression), *(odds_sentence(regression, term) for term in regression.terms),
        interaction_sentence(regression), rules_sentence(regression, laplace) if rule != "laplace" else "",
        sampled.sentence if sampled else "", checked.sentence, *map(other.sentence_of, regression.terms),
    ]  # fmt: skip
    sentences = [text for text in sentences if text]
    formula = regression.table.formula(regression.table.main)
    report.say(f"{data} ({chosen.dataset.card.kind}): {formula}; seed {seed}")
    report.say(as_text(regression.main, regression.marginal))
    report.say("\nModels by AIC:")
    report.say(regression.models.to_string(index=False, float_format=lambda v: f"{v:.3f}"))
    report.say("\nLikelihood-ratio tests:")
    report.say(regression.tests.to_string(index=False, float_format=lambda v: f"{v:.4g}"))
    report.say("\nSide by side:")
    report.say(table.to_string(index=False))
    report.say("\n" + "\n".join(sentences))
    hangs = _groups(report, regression.main, groups)
    if beside:
        report.say("\nOn the printed numbers themselves:\n" + "\n".join(consistency(published())))
    report.say("\nWhat not to conclude:\n" + "\n".join(cautions(regression)))
    _warn(regression.main)
    report.finish(
        {
            "data": data, "kind": chosen.dataset.card.kind, "conditions": chosen.conditions, "seed": seed,
            "formula": formula, **as_dict(regression.main), **hangs,
            "models": _records(regression.models), "tests": _records(regression.tests),
            "side_by_side": _records(table), "by_condition": _records(by_condition(regression, chosen.log)),
            "readings": _records(other.table), "residuals": {"ks": checked.check.ks, "ks_p": checked.check.p,
                                                             "by": _records(checked.by)},
            "sentences": sentences, "printed_notes": consistency(published()) if beside else (),
            "cautions": cautions(regression),
        }
    )  # fmt: skip


def _groups(report: Report, fit: Any, path: str | None) -> dict[str, Any]:
    """Say which group the fit hangs on, write the file of ``--groups``; fields for the JSON."""
    from analysis.mixed_model_groups import group_table, influence_of

    found = influence_of(fit)
    if found is not None:
        report.say(found["text"])
    if path is not None:
        write_output("--groups", path, group_table(fit).to_csv().encode())
    return {"influence": found, "groups_file": path}


def _records(frame: Any) -> Any:
    return frame.to_dict("records")


def _warn(fit: Any) -> None:
    """Notes of a fit, by the name of their warning."""
    for note in fit.notes:
        _tell(f"{note.category.__name__}: {note.text}")


def _left_out(model: Any) -> None:
    """Rows with missing values."""
    from analysis.wording import counted

    if empty := model.n_dropped - sum(model.dropped_by_terms.values()):
        _tell(f"{counted(empty, 'row')} with missing values left out")


def _tell(text: str) -> None:
    import sys

    print(f"prosocial: {text}", file=sys.stderr)
