"""The command ``em``: Baum-Welch over several numbers of states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from analysis.cli_options import (
    DEFAULT_SEED,
    JsonOption,
    ProtocolOption,
    QuietOption,
    Report,
    SeedOption,
    check_output_folder,
    distinct_files,
    load_protocol,
    write_output,
)
from analysis.cli_stream_options import StreamOption, in_parts, reading_sentence, select_in_parts
from analysis.cli_workers import SchedulerOption, WorkersOption, workers_of
from analysis.wording import counted

if TYPE_CHECKING:
    from analysis.cli_stream_options import SelectionInParts
    from analysis.em_study import EmStudy
    from analysis.study_selection import Selection
    from models.baum_welch_fit import BaumWelchFit

DataArgument = Annotated[str, typer.Argument(metavar="DATA", help="A registered data set, or an event file.")]
ConditionOption = Annotated[
    list[str] | None,
    typer.Option("--condition", metavar="C", help="Condition to learn from (repeatable; all: every one)."),
]
StatesOption = Annotated[
    str | None, typer.Option("--states", metavar="2-5", help="Numbers of states: 4, 2-5 or 2,4.")
]
PinOption = Annotated[
    list[str] | None,
    typer.Option("--pin", metavar="ACTION", help="Hold its transition table at the identity (repeatable; none)."),
]


def em_command(
    data: DataArgument,
    condition: ConditionOption = None,
    states: StatesOption = None,
    restarts: Annotated[
        int | None, typer.Option(min=1, help="Random starts; by default 200, up to three times over.")
    ] = None,
    paper: Annotated[
        bool,
        typer.Option(
            "--paper", help="The published way: one stage, 30 restarts, 1,000 iterations, tolerance 1e-5."
        ),
    ] = False,
    pin: PinOption = None,
    bootstrap: Annotated[int, typer.Option(min=0, help="Replicates of the bootstrap.")] = 0,
    out: Annotated[
        str | None, typer.Option("--out", metavar="DIR", help="Write a model file for each number of states.")
    ] = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
    protocol: ProtocolOption = None,
    stream: StreamOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
) -> None:
    """Learn transition and observation tables by Baum-Welch.

    A large file is read in parts, in bounded memory; estimates are the same.

    Example: prosocial em simulated_study1 --states 2-5 --out reports/build/models
    """
    from dataclasses import replace
    from pathlib import Path

    from analysis import datasets, progress
    from analysis.em_study import run_em
    from analysis.study_selection import select
    from models.baum_welch import BaumWelch
    from models.errors import located

    report = Report(json, quiet)
    if paper and restarts is not None:
        raise located("--restarts", restarts, "nothing beside --paper, which is 30 restarts by definition")
    if bootstrap == 1:
        raise located("--bootstrap", 1, "0 for none, or at least 2 replicates")
    files: dict[str, str | Path | None] = {"DATA": data, "--protocol": protocol, "--out": out, "--json": json}
    if out is not None:
        check_output_folder("--out", out)
    distinct_files(files)
    rules = load_protocol(protocol)
    chosen: Selection | SelectionInParts
    if parts := in_parts(data, stream, "--bootstrap" if bootstrap else ""):
        with progress.shown(quiet) as watch:
            chosen, resorted = select_in_parts(data, rules, condition, states, pin, watch)
        report.say(reading_sentence(data, resorted, stream))
        report.say(f"{data}: {chosen.log._view().sentences[0]}")
        for note in chosen.notes:
            report.say(f"note: {note}")
    else:
        chosen = select(datasets.load(data, rules), condition, states, pin)
    if out is not None:
        names = [_model_name(k) for k in chosen.states]
        distinct_files(files | {f"--out, {name}": Path(out) / name for name in names})
    pins = dict.fromkeys(chosen.pins)

    def settings(k: int) -> BaumWelch:
        if paper:
            return BaumWelch.paper(k, pins=pins, seed=seed)
        own = BaumWelch(k, pins=pins, seed=seed)
        return own if restarts is None else replace(own, restarts=restarts, rounds=1)

    with workers_of(workers, scheduler) as executor, progress.shown(quiet) as watch:
        study = run_em(
            chosen.log, chosen.states, settings=settings, seed=seed,
            bootstrap=dict.fromkeys(chosen.states, bootstrap), progress=watch,
            executor=executor,
        )  # fmt: skip
    written = {}
    if out is not None:
        written = _write_models(study, Path(out), data, chosen.digest, seed)
    report.say(f"{data} ({chosen.kind}): {chosen.sentence}; seed {seed}")
    report.say(next(iter(study.fits.values())).settings.sentence)
    for k, fit in study.fits.items():
        report.say(fit.sentence + f" BIC {fit.bic:.1f}.")
        for sentence in study.identifications[k].sentences():
            report.say(f"  - {sentence}")
    report.finish(
        {
            "data": data, "kind": chosen.kind, "digest": chosen.digest, "seed": seed,
            "conditions": chosen.conditions, "pins": chosen.pins, "procedure": "paper" if paper else "two-stage",
            "in_parts": parts,
            "compile_seconds": study.compile_seconds,
            "fits": [
                {**fit_to_dict(fit), "seconds": study.seconds[k],
                 "identification": study.identifications[k].sentences(),
                 "bootstrap": _intervals(study, k), "model_file": written.get(k)}
                for k, fit in study.fits.items()
            ],
        }
    )  # fmt: skip


def fit_to_dict(fit: BaumWelchFit) -> dict[str, Any]:
    """Content of one entry of ``fits`` in the command's JSON."""
    from models.model_files import model_to_dict

    tables = model_to_dict(fit.model)
    own = fit.settings
    return {
        "states": fit.n_states,
        "log_likelihood": fit.log_likelihood,
        "n_parameters": fit.n_parameters,
        "n_responses": fit.n_responses,
        "aic": fit.aic,
        "bic": fit.bic,
        "converged": fit.converged,
        "restarts": fit.restarts,
        "settings": {
            "finalists": fit.runs_in_final_stage, "screening_maps": own.screening_maps, "max_maps": own.max_maps,
            "tolerance": own.tolerance, "patience": own.patience, "accelerate": own.accelerate,
        },
        "maps": fit.maps,
        "optima": [
            {"log_likelihood": o.log_likelihood, "restarts": o.restarts, "converged": o.converged}
            for o in fit.optima
        ],
        "gap_to_second": fit.gap_to_second,
        **{key: tables[key] for key in ("initial", "transition", "emission")},
        **({"help_probability": tables["help_probability"]} if "help_probability" in tables else {}),
    }  # fmt: skip


def _model_name(k: int) -> str:
    return f"model_{k}_states.json"


def _write_models(study: EmStudy, folder: Any, data: str, digest: str, seed: int) -> dict[int, str]:
    import json as json_text

    from models.model_files import model_to_dict

    files = {}
    for k, fit in study.fits.items():
        path = folder / _model_name(k)
        content = {
            "what": f"Baum-Welch estimate with {counted(k, 'state')}; {fit.sentence}",
            **model_to_dict(fit.model),
            "provenance": {"data": data, "data_digest": digest, "seed": seed,
                           "log_likelihood": fit.log_likelihood, "converged": fit.converged},
        }  # fmt: skip
        write_output("--out", path, (json_text.dumps(content, indent=1) + "\n").encode())
        files[k] = str(path)
    return files


def _intervals(study: EmStudy, k: int) -> dict[str, Any] | None:
    boot = study.bootstraps.get(k)
    if boot is None:
        return None
    out: dict[str, Any] = {
        "resampled": boot.kind,
        "replicates": boot.replicates,
        "level": 0.9,
        "kind": "percentile",
        "seed": boot.seed,
    }
    for table in ("initial", "transition", "emission"):
        low, high = boot.interval(table)
        out[table] = {"low": low, "high": high}
    return out
