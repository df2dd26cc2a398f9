"""The command ``bayes``: the posterior of the latent-state model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, cast

import typer

from analysis.cli_em import ConditionOption, DataArgument, PinOption
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
)
from analysis.cli_people_options import PeopleDifferOption, PersonNodesOption, PersonScaleOption, person_offset
from analysis.cli_stream_options import StreamOption, in_parts, reading_sentence, select_in_parts
from analysis.wording import counted

if TYPE_CHECKING:
    from analysis.cli_stream_options import SelectionInParts
    from analysis.study_selection import Selection
    from models.bayesian_fit import Engine
    from models.posterior import Posterior


def bayes_command(
    context: typer.Context,
    data: DataArgument,
    condition: ConditionOption = None,
    states: Annotated[int, typer.Option(min=1, max=12, help="Number of states.")] = 4,
    kappa: Annotated[float, typer.Option(min=0, max=1e6, help="Stickiness: pseudo-counts on staying.")] = 2.0,
    draws: Annotated[int, typer.Option(min=4, help="Draws a chain after tuning.")] = 1000,
    tune: Annotated[int, typer.Option(min=50, help="Tuning draws a chain.")] = 1000,
    chains: Annotated[int, typer.Option(min=1, help="Chains.")] = 4,
    engine: Annotated[
        str, typer.Option(help="direct: the compiled density; pymc: the PyMC model. Same posterior.")
    ] = "direct",
    pin: PinOption = None,
    people_differ: PeopleDifferOption = False,
    person_scale: PersonScaleOption = None,
    person_nodes: PersonNodesOption = None,
    group: Annotated[
        str | None,
        typer.Option(
            metavar="BY",
            help="Tables differ by condition, or by a covariate FILE.csv:COLUMN of people. Covariates are "
            "categories: every value of the column is a group, so cut numbers into a few classes first.",
        ),
    ] = None,
    differ: Annotated[
        str | None,
        typer.Option(metavar="TABLES", help="Which: initial (the default), transition, emission; not all three."),
    ] = None,
    out: Annotated[str | None, typer.Option("--out", metavar="FIT.nc", help="Write the fit as netCDF.")] = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
    protocol: ProtocolOption = None,
    stream: StreamOption = None,
) -> None:
    """Sample the posterior of the transition and observation tables.

    A large file is read in parts, in bounded memory; the posterior is the same. Nothing of people and events is
    kept then: the fit has log-likelihoods of distinct histories, and no responses predicted event by event. --group
    and --people-differ read the whole file.

    A fit that was made before with the same data and settings is found in the store; a run that was interrupted
    goes on with the chains it had completed.

    A sample that misses the convergence gate is told on standard error, in the JSON ("gate") and in the output; the
    exit status is 0 all the same, for the command did what it was asked.

    Example: prosocial bayes simulated_study1 --states 3 --out reports/build/study1_3.nc

    People who differ: prosocial bayes simulated_study1 --states 2 --people-differ --draws 3000
    """
    import sys

    from analysis.warning_lines import warnings_told

    context.with_resource(warnings_told(quiet))  # loading kernels may warn already
    from analysis import datasets, progress
    from analysis.fits import stored_fit
    from analysis.grouping import groups_from
    from analysis.people import spread_sentence
    from analysis.study_selection import select
    from analysis.uncertainty import contraction
    from models.errors import located
    from models.nuts import NutsSettings
    from models.parameters import DirichletPrior
    from models.posterior_files import write_posterior

    report = Report(json, quiet)
    if engine not in ("direct", "pymc"):
        raise located("--engine", engine, "direct or pymc")
    if out is not None:
        check_output("--out", out)
    distinct_files({"DATA": data, "--protocol": protocol, "--out": out, "--json": json})
    sampler = NutsSettings(draws, tune, chains, seed)
    people = person_offset(people_differ, person_scale, person_nodes)
    if differ is not None and group is None:
        raise located("--differ", differ, "--group with it: there are no groups otherwise")
    rules, groups = load_protocol(protocol), None
    needs_all = "--group" if group is not None else "--people-differ" if people_differ else ""
    chosen: Selection | SelectionInParts
    if parts := in_parts(data, stream, needs_all):
        with progress.shown(quiet) as watch:
            chosen, resorted = select_in_parts(
                data, rules, condition, str(states), pin, watch, for_posterior=True
            )  # fmt: skip
        digest = chosen.digest
        report.say(reading_sentence(data, resorted, stream))
        for note in (f"{data}: {chosen.log._view().sentences[0]}", *(f"note: {note}" for note in chosen.notes)):
            report.say(note)
    else:
        chosen = select(datasets.load(data, rules), condition, str(states), pin)
        digest = datasets.log_digest(chosen.log)
        groups = None if group is None else groups_from(group, differ or "initial", chosen.log)
    with progress.shown(quiet) as watch:
        try:
            stored = stored_fit(
                chosen.log, digest, states, prior=DirichletPrior(stay=kappa), pins=dict.fromkeys(chosen.pins),
                groups=groups, people=people, engine=cast("Engine", engine), sampler=sampler, progress=watch,
            )  # fmt: skip
        except KeyboardInterrupt as stop:
            kept = "completed chains are kept, the same command goes on"
            raise KeyboardInterrupt(*(stop.args or (kept,))) from None
    fit = stored.posterior
    if out is not None:
        write_posterior(fit, out, {"data": data, "data_digest": digest, "key": stored.key})
    report.say(f"{data} ({chosen.kind}): {chosen.sentence}; kappa {kappa:g}; seed {seed}")
    took = f"Sampled in {fit.sampling_seconds:.1f} s, after {fit.compile_seconds:.1f} s of compiling and loading."
    report.say("Found in the store." if stored.reused else took)
    report.say(fit.gate.sentence if fit.gate.passed else "Convergence gate FAILED: see the end.")
    if parts:
        report.say(_kept_sentence(fit))
    report.say(contraction(fit).sentence)
    if people is not None:
        report.say(spread_sentence(fit))
    report.say(fit.summary().to_string(float_format=lambda v: f"{v:.3f}"))
    if not fit.gate.passed:
        print(f"prosocial: {fit.gate.sentence}", file=sys.stderr)
    report.finish(
        {
            "data": data, "kind": chosen.kind, "digest": digest, "conditions": chosen.conditions,
            "states": states, "kappa": kappa, "pins": chosen.pins, "engine": engine, "seed": seed,
            "groups": fit.settings.get("groups"), "people": fit.settings.get("people"),
            "node_check": fit.settings.get("node_check"), "reused": stored.reused, "stored": stored.path,
            "out": out, "in_parts": parts,
            **posterior_to_dict(fit),
        }
    )  # fmt: skip


def _kept_sentence(fit: Posterior) -> str:
    """What a fit of a file that was read in parts keeps in place of people."""
    sizes = fit.data["log_likelihood"].sizes
    every = sizes["draw"] == fit.data["posterior"].sizes["draw"]
    under = "every draw" if every else f"{counted(sizes['draw'], 'draw')} of each chain"
    histories = counted(sizes["distinct"], "distinct history", "distinct histories")
    return (
        f"Kept with the fit: log-likelihoods of {histories} under {under}, and how many runs have each. Leaving "
        "people out and checks by event need --no-stream."
    )


def posterior_to_dict(fit: Posterior) -> dict[str, Any]:
    """Diagnostics, contraction and summary as the command's JSON gives them."""
    from analysis.uncertainty import contraction

    table = fit.summary()
    gate = fit.gate
    return {
        "divergences": gate.divergences,
        "max_rhat": gate.max_rhat,
        "min_ess_bulk": gate.min_ess_bulk,
        "min_ess_tail": gate.min_ess_tail,
        "cpu_seconds": fit.cpu_seconds,
        "sampling_seconds": fit.sampling_seconds,
        "compile_seconds": fit.compile_seconds,
        "gate": {"passed": gate.passed, "reasons": gate.reasons},
        "contraction": dict(zip(table.index, table["contraction"].tolist(), strict=True)),
        "summary": {
            entry: {name: row[name] for name in ("mean", "sd", "q05", "q50", "q95")}
            for entry, row in table.to_dict("index").items()
        },
        "sentence": contraction(fit).sentence,
    }
