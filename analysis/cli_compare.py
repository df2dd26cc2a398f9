"""The command ``compare``: how many states, and whether a latent state is needed at all."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from analysis.cli_em import ConditionOption, DataArgument, PinOption
from analysis.cli_options import (
    DEFAULT_SEED,
    JsonOption,
    ProtocolOption,
    QuietOption,
    Report,
    SeedOption,
    load_protocol,
)
from analysis.cli_people_options import PeopleDifferOption, PersonNodesOption, PersonScaleOption, person_offset
from analysis.cli_stream_options import held_sentence
from analysis.cli_workers import SchedulerOption, WorkersOption, workers_of

if TYPE_CHECKING:
    from analysis.held_out import HeldOut

SHOWN = (
    "model", "n_parameters", "elpd_diff", "dse", "p_worse", "weight", "max_pareto_k", "kfold_diff", "kfold_dse",
    "log_marginal", "log_marginal_error", "log_likelihood", "aic", "bic", "gate",
)  # fmt: skip
"""Columns printed for people; the JSON has all."""

RANKED = (
    "contender", "log_score", "log_score_error", "log_score_diff", "dse", "error", "crps", "round_crps", "inside",
    "cells", "rounds_inside", "rounds", "prior", "gate",
)  # fmt: skip
PREDICTED = (
    "cell", "contender", "people", "observed", "expected", "low", "high", "error", "inside", "crps", "prior",
)  # fmt: skip
"""The same for what was left out: models ranked, and the rates of every cell."""


def compare_command(
    data: DataArgument,
    condition: ConditionOption = None,
    states: Annotated[
        str | None, typer.Option("--states", metavar="1-5", help="Numbers of states: 4, 1-5 or 2,4.")
    ] = None,
    pin: PinOption = None,
    kappa: Annotated[float, typer.Option(min=0, help="Stickiness: pseudo-counts on staying.")] = 2.0,
    folds: Annotated[int, typer.Option(min=2, help="Folds of people held out in turn.")] = 10,
    leave_out: Annotated[
        str | None,
        typer.Option(
            "--held-out",
            metavar="WHAT",
            help="Also leave out every condition, schedule or condition+schedule in turn and predict it.",
        ),
    ] = None,
    people_differ: PeopleDifferOption = False,
    person_scale: PersonScaleOption = None,
    person_nodes: PersonNodesOption = None,
    quick: Annotated[
        bool, typer.Option("--quick", help="Less work: ranks models, does not settle close calls.")
    ] = (False),
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
    protocol: ProtocolOption = None,
) -> None:
    """Compare numbers of states with each other and with models that need no latent state.

    With --held-out each part of the study is also left out in turn, and its response rates are predicted from the
    rest, also by a logistic mixed model. With --people-differ every model also has its hierarchical version; what
    is left out is predicted by that of none and of the fewest states.

    A file is read at once, for people are left out one by one; em and bayes read large files in parts.

    Example: prosocial compare simulated_study1 --states 1-5 --held-out condition --json reports/build/compare.json
    """
    import sys
    import time
    from collections.abc import Mapping

    from analysis import datasets, progress
    from analysis.comparison import CompareSettings, compare
    from analysis.fits import stored_fit
    from analysis.held_out import held_out
    from analysis.held_out_cells import BY, cells_of
    from analysis.held_out_contenders import standard_contenders
    from analysis.study_selection import select
    from models.errors import located
    from models.events import EventLog
    from models.parameters import Array, DirichletPrior
    from models.person_offset import PersonOffset
    from models.posterior import Posterior

    report = Report(json, quiet)
    if note := held_sentence(data, "compare"):
        report.say(note)
    chosen = select(datasets.load(data, load_protocol(protocol)), condition, states, pin, default_states="1-5")
    settings = CompareSettings.of(quick, folds=folds, seed=seed)
    prior = DirichletPrior(stay=kappa)
    people = person_offset(people_differ, person_scale, person_nodes)
    digest = datasets.log_digest(chosen.log)
    if leave_out is not None:
        if leave_out not in BY:
            raise located("--held-out", leave_out, f"one of {', '.join(BY)}")
        if leave_out == "condition" and len(chosen.conditions) == 1 < len(chosen.dataset.log.conditions):
            raise located("--held-out condition, selected", chosen.conditions[0], "several, or --condition all")
        cells_of(chosen.log, leave_out)  # refused before minutes of work, not after
    started = (time.process_time(), time.perf_counter())
    with progress.shown(quiet) as watch, workers_of(workers, scheduler) as executor:

        def fitted(
            log: EventLog, k: int, held: Mapping[str, Array | None], offsets: PersonOffset | None
        ) -> Posterior:
            return stored_fit(
                log, datasets.log_digest(log), k, prior=prior, pins=held, people=offsets, sampler=settings.sampler
            ).posterior

        def learn(k: int, held: Mapping[str, Array | None], offsets: PersonOffset | None) -> Posterior:
            return fitted(chosen.log, k, held, offsets)

        pins = dict.fromkeys(chosen.pins)
        result = compare(
            chosen.log,
            chosen.states,
            pins=pins,
            prior=prior,
            people=people,
            settings=settings,
            learn=learn,
            executor=executor,
            progress=watch,
        )
        left_out = None
        if leave_out is not None:
            contenders = standard_contenders(
                chosen.log, chosen.states, types=settings.types, pins=pins, prior=prior, fitter=fitted,
                people=people, seed=seed,
            )  # fmt: skip
            left_out = held_out(
                chosen.log, contenders, leave_out, seed=seed, kind=chosen.dataset.card.kind, progress=watch
            )
    cpu, wall = time.process_time() - started[0], time.perf_counter() - started[1]
    report.say(f"{data} ({chosen.dataset.card.kind}): {chosen.sentence}; kappa {kappa:g}; seed {seed}")
    report.say(result.table[list(SHOWN)].to_string(index=False, float_format=lambda v: f"{v:.2f}"))
    report.say(result.sentence)
    for warning in result.warnings:
        print(f"prosocial: {warning}", file=sys.stderr)
    if left_out is not None:
        report.say(f"\nLeft out by {left_out.by} and predicted from the rest:")
        report.say(left_out.ranking[list(RANKED)].to_string(index=False, float_format=lambda v: f"{v:.3f}"))
        report.say(left_out.overall[list(PREDICTED)].to_string(index=False, float_format=lambda v: f"{v:.3f}"))
        report.say(left_out.sentence)
        for warning in left_out.warnings:
            print(f"prosocial: {warning}", file=sys.stderr)
    report.finish(
        {
            "data": data, "kind": chosen.dataset.card.kind, "digest": digest, "conditions": chosen.conditions,
            "pins": chosen.pins, "states": chosen.states, "kappa": kappa, "folds": folds, "quick": quick,
            "people_differ": None if people is None else people.to_dict(),
            "seed": seed, "people": result.people, "responses": result.responses, "choices": result.choices(),
            "indistinct": result.indistinct(), "table": result.table.to_dict("records"),
            "sentence": result.sentence, "warnings": result.warnings, "cpu_seconds": cpu, "seconds": wall,
            "held_out": None if left_out is None else held_out_to_dict(left_out),
        }
    )  # fmt: skip


def held_out_to_dict(result: HeldOut) -> dict[str, Any]:
    """Prediction of what was left out as the command's JSON gives it; `analysis.held_out` defines the columns."""
    return {
        "by": result.by, "level": result.level, "measure": result.measure, "draws": result.draws,
        "actions_may_answer_responses": result.answering,
        "ranking": result.ranking.to_dict("records"), "scores": result.scores.to_dict("records"),
        "rows": result.rates.to_dict("records"), "skipped": [list(pair) for pair in result.skipped],
        "absent": [list(pair) for pair in result.absent],
        "sentence": result.sentence, "warnings": result.warnings,
    }  # fmt: skip
