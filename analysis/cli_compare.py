"""The command ``compare``: how many states, and whether a latent state is needed at all."""

from __future__ import annotations

from typing import Annotated

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

SHOWN = (
    "model", "n_parameters", "elpd_diff", "dse", "p_worse", "weight", "max_pareto_k", "kfold_diff", "kfold_dse",
    "log_marginal", "log_marginal_error", "log_likelihood", "aic", "bic", "gate",
)  # fmt: skip
"""Columns printed for people; the JSON has all."""


def compare_command(
    data: DataArgument,
    condition: ConditionOption = None,
    states: Annotated[
        str | None, typer.Option("--states", metavar="1-5", help="Numbers of states: 4, 1-5 or 2,4.")
    ] = None,
    pin: PinOption = None,
    kappa: Annotated[float, typer.Option(min=0, help="Stickiness: pseudo-counts on staying.")] = 2.0,
    folds: Annotated[int, typer.Option(min=2, help="Folds of people held out in turn.")] = 10,
    quick: Annotated[
        bool, typer.Option("--quick", help="Less work: ranks models, does not settle close calls.")
    ] = (False),
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
    protocol: ProtocolOption = None,
) -> None:
    """Compare numbers of states with each other and with models that need no latent state.

    Example: prosocial compare simulated_study1 --states 1-5 --json reports/build/comparison.json
    """
    import sys
    import time
    from collections.abc import Mapping

    from analysis import datasets, progress
    from analysis.comparison import CompareSettings, compare
    from analysis.fits import stored_fit
    from analysis.study_selection import select
    from models.parameters import Array, DirichletPrior
    from models.posterior import Posterior

    report = Report(json, quiet)
    chosen = select(datasets.load(data, load_protocol(protocol)), condition, states, pin, default_states="1-5")
    settings = CompareSettings.of(quick, folds=folds, seed=seed)
    prior = DirichletPrior(stay=kappa)
    digest = datasets.log_digest(chosen.log)
    started = (time.process_time(), time.perf_counter())
    with progress.shown(quiet) as watch:

        def learn(k: int, held: Mapping[str, Array | None]) -> Posterior:
            return stored_fit(
                chosen.log, digest, k, prior=prior, pins=held, sampler=settings.sampler
            ).posterior  # fmt: skip

        result = compare(
            chosen.log, chosen.states, pins=dict.fromkeys(chosen.pins), prior=prior, settings=settings, learn=learn,
            progress=watch,
        )  # fmt: skip
    cpu, wall = time.process_time() - started[0], time.perf_counter() - started[1]
    report.say(f"{data} ({chosen.dataset.card.kind}): {chosen.sentence}; kappa {kappa:g}; seed {seed}")
    report.say(result.table[list(SHOWN)].to_string(index=False, float_format=lambda v: f"{v:.2f}"))
    report.say(result.sentence)
    for warning in result.warnings:
        print(f"prosocial: {warning}", file=sys.stderr)
    report.finish(
        {
            "data": data, "kind": chosen.dataset.card.kind, "digest": digest, "conditions": chosen.conditions,
            "pins": chosen.pins, "states": chosen.states, "kappa": kappa, "folds": folds, "quick": quick,
            "seed": seed, "people": result.people, "responses": result.responses, "choices": result.choices(),
            "indistinct": result.indistinct(), "table": result.table.to_dict("records"),
            "sentence": result.sentence, "warnings": result.warnings, "cpu_seconds": cpu, "seconds": wall,
        }
    )  # fmt: skip
