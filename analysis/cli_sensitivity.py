"""The command ``sensitivity``: what the robot's decisions depend on."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from analysis.cli_options import (
    DEFAULT_SEED,
    JsonOption,
    ProtocolOption,
    QuietOption,
    Report,
    SeedOption,
    distinct_files,
)
from analysis.cli_planning_options import (
    AllowUnseenOption,
    CostHelpOption,
    CostOption,
    CostSignalOption,
    DrawsOption,
    ForceOption,
    GroupOption,
    PersonOption,
    RewardSteepness,
    draws_asked,
)
from analysis.cli_workers import SchedulerOption, WorkersOption, workers_of
from models.errors import InputError, Phrase, located

if TYPE_CHECKING:
    from analysis.draws_source import DrawsSource
    from analysis.progress import Progress
    from analysis.sensitivity import SensitivityStudy
    from analysis.sensitivity_variants import Beside
    from models.sensitivity.flips import Flips
    from models.sensitivity.reward_grid import GridDecisions


def sensitivity_command(
    source: Annotated[
        str, typer.Argument(metavar="MODEL|FIT", help="Model file (JSON), list of weighted models, or fit (.nc).")
    ],
    reading: Annotated[
        list[str] | None,
        typer.Option(help="infinite, two-step or two-step-terminal; may be repeated. All three by default."),
    ] = None,
    discount: Annotated[
        float | None,
        typer.Option(help="Of all readings; 0.95 without a horizon and 1 for two steps by default."),
    ] = None,
    r_grid: Annotated[
        str | None, typer.Option("--r-grid", metavar="R,R,...", help="Values of r; the paper's by default.")
    ] = None,
    cost_grid: Annotated[
        str | None,
        typer.Option("--cost-grid", metavar="C,...", help="Costs of every costly action; the paper's by default."),
    ] = None,
    beside: Annotated[
        list[str] | None,
        typer.Option(metavar="FILE", help="Another model or fit to stand beside; may be repeated."),
    ] = None,
    stored: Annotated[
        bool,
        typer.Option("--stored", help="Also beside: stored fits of the same data, other states and priors."),
    ] = False,
    endless_draws: Annotated[
        int,
        typer.Option(
            metavar="N",
            help="Evenly spaced draws asked without a horizon; a quarter of them about flips, a fifth about "
            "certainty of a state.",
        ),
    ] = 100,
    draws: DrawsOption = None,
    r: RewardSteepness = None,
    cost_help: CostHelpOption = None,
    cost_signal: CostSignalOption = None,
    cost: CostOption = None,
    allow_unseen: AllowUnseenOption = False,
    force: ForceOption = False,
    group: GroupOption = None,
    person: PersonOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
    protocol: ProtocolOption = None,
) -> None:  # fmt: skip
    """What decisions depend on: the paper's grid of r and costs in three readings, and where decisions flip.

    The steps are the protocol's modes in order, from the model's own initial belief. Options of the reward (--r,
    --cost-help, ...) set what stays fixed where something else is varied. Without a horizon a decision is made only
    where bounds prove it; else it is undecided. Nothing is random, whatever the seed. The first run on a machine
    compiles, which takes minutes.

    Example: prosocial sensitivity model.json --r-grid .04,.06,.08
    """
    from analysis import progress
    from analysis.sensitivity import READINGS, SensitivityEffort, discounts_of, sensitivity_study
    from analysis.sensitivity_variants import game_scores
    from models.cautions import told_once
    from models.work_clock import WorkClock

    report = Report(json, quiet)
    distinct_files({"MODEL|FIT": source, "--protocol": protocol, "--json": json})
    readings = tuple(dict.fromkeys(reading or READINGS))
    try:
        discounts_of(readings, discount)
    except InputError as error:
        raise InputError(f"--{error}") from None
    if endless_draws < 1:
        raise located("--endless-draws", endless_draws, "at least 1")
    grids = [
        None if text is None else _numbers(option, text)
        for option, text in (("--r-grid", r_grid), ("--cost-grid", cost_grid))
    ]
    asked = draws_asked(
        source, draws=draws, allow_unseen=allow_unseen, force=force, group=group, person=person, people=False, r=r,
        cost_help=cost_help, cost_signal=cost_signal, cost=cost, protocol=protocol,
    )  # fmt: skip
    others = _others(asked, beside or [], stored, draws, protocol, allow_unseen=allow_unseen, force=force)
    effort = SensitivityEffort(
        endless_draws=endless_draws, endless_variants=endless_draws,
        endless_critical=min(endless_draws, max(2, -(-endless_draws // 4))),
        endless_certain=min(endless_draws, max(2, -(-endless_draws // 5))),
    )  # fmt: skip
    clock = WorkClock()
    with progress.shown(quiet) as watch, workers_of(workers, scheduler) as executor:
        told = None if watch is None else _after_compiling(watch)
        study = sensitivity_study(
            asked.draws, r=grids[0], costs=grids[1], readings=readings, discount=discount, beside=others,
            scores=game_scores(asked.draws.n_states), effort=effort, executor=executor,
            progress=told,
        )  # fmt: skip
    seconds = clock.wall()
    report.say(f"{asked.sentence}. {_discounts(study)}")
    for line in told_once(_lines(study), study.cautions):
        report.say(line)
    report.finish({
        **sensitivity_fields(study, asked.left_out), **asked.to_dict(), "seconds": seconds,
        "compile_seconds": clock.compile_seconds, "seed": seed,
    })  # fmt: skip


def _after_compiling(watch: Progress) -> Progress:
    """Progress that says at once what the first minutes may go by with."""
    first = "compiling, the first time on a machine"
    watch(first, 0, 1)

    def told(step: str, done: int, total: int) -> None:
        watch(first, 1, 1)
        watch(step, done, total)

    return told


def _numbers(option: str, text: str) -> tuple[float, ...]:
    """Numbers of a list such as ``.04,.06``, each once.

    Raises
    ------
    InputError
        On what is no number, one that is named twice, or one below 0.
    """
    out: list[float] = []
    for part in text.split(","):
        try:
            value = float(part)
        except ValueError:
            raise located(option, part.strip(), "numbers with commas between them") from None
        if not -1e308 < value < 1e308:
            raise located(option, part.strip(), "finite numbers")
        if value < 0:
            raise located(option, value, "numbers of at least 0")
        if value in out:
            raise located(option, part.strip(), "every number once")
        out.append(value)
    return tuple(out)


def _others(
    asked: DrawsSource, paths: list[str], stored: bool, draws: int | None, protocol: str | None, *,
    allow_unseen: bool, force: bool,
) -> list[Beside]:  # fmt: skip
    """Models and fits that stand beside, without the actions that are left out."""
    from analysis.sensitivity_stored import stored_beside
    from analysis.sensitivity_variants import Beside
    from models.unseen import without_actions

    out = []
    for path in paths:
        other = draws_asked(
            path, draws=draws, allow_unseen=True, force=force, group=None, person=None, people=False, r=None,
            cost_help=None, cost_signal=None, cost=None, protocol=protocol,
        )  # fmt: skip
        if (
            other.draws.protocol.action_names
            != (asked.fit.protocol if asked.fit else asked.draws.protocol).action_names
        ):
            raise located(f"--beside {path}, actions", ", ".join(other.draws.protocol.action_names), "the same")
        out.append(Beside(Path(path).name, without_actions(other.draws, asked.left_out)))
    if stored:
        if asked.fit is None:
            raise located("--stored", Phrase(f"{asked.path}, which holds models"), "a fit")
        found, failed = stored_beside(asked.fit, asked.left_out, draws)
        if failed:
            print(f"prosocial: --stored: left aside, gate failed: {'; '.join(failed)}", file=sys.stderr)
        if not found:
            print("prosocial: --stored: no other fits of these data in the store", file=sys.stderr)
        out += found
    return out


def sensitivity_fields(study: SensitivityStudy, left_out: tuple[str, ...] = ()) -> dict[str, Any]:
    """The study as the command gives it in its JSON.

    Parameters
    ----------
    study : SensitivityStudy
    left_out : tuple of str
        Actions without evidence: cells name their cost too, as null.
    """
    from analysis.sensitivity_variants import CURRENCIES

    missing = {f"cost_{a}": None for a in left_out}
    cells = [{**row, **missing} for row in study.rows()]
    fields = {kind: list(rows) for kind, rows in study.variants.items()}
    note = CURRENCIES if len({row["states"] for row in fields["beside"]}) > 1 else None
    return {
        "cells": cells, "critical": [flips_to_dict(f) for f in study.critical],
        "findings": [f.to_dict() for f in study.findings], **fields, "beside_note": note,
        "discounts": dict(study.discounts), "asked": {r: m.n_draws for r, m in study.maps.items()},
        "grid": {
            "r": list(study.grid.r),
            **{f"cost_{a.name}": list(c) for a, c in zip(study.grid.axes, study.grid.costs, strict=True)},
        },
        "sentence": study.sentence,
    }  # fmt: skip


def flips_to_dict(found: Flips) -> dict[str, Any]:
    """Critical values of one number at one step, as the command gives them in its JSON."""
    nodes = found.nodes
    levels = dict(zip(("q05", "q25", "q50", "q75", "q95"), found.quantiles(), strict=True))
    flips = [
        {
            "low": float(found.low[i]), "high": float(found.high[i]),
            "before": nodes.words(found.step, int(found.before[i])),
            "after": nodes.words(found.step, int(found.after[i])), "closed": bool(found.closed[i]),
        }
        for i in range(len(found.draw))
    ] if len(found.weight) == 1 else None  # fmt: skip
    return {
        "reading": found.reading, "parameter": found.parameter, "k": found.step,
        "mode": nodes.protocol.modes[nodes.modes[found.step]].name, "from": float(found.scan[0]),
        "to": float(found.scan[-1]), "scan_points": len(found.scan), "spacing": found.spacing, "flips": flips,
        "draws": len(found.weight), "quantiles": levels, "share_without": found.share_without,
        "always": found.always, "share_several": found.share_several, "undecided": found.undecided,
        "sentence": found.sentence,
    }  # fmt: skip


def _discounts(study: SensitivityStudy) -> str:
    from analysis.sensitivity import READING_WORDS

    return f"Discounts: {', '.join(f'{g:g} for {READING_WORDS[r]}' for r, g in study.discounts.items())}."


def _lines(study: SensitivityStudy) -> list[str]:
    """What is shown to a person."""
    from analysis.sensitivity import READING_WORDS
    from analysis.sensitivity_variants import CURRENCIES

    out = [
        f"Where cost_{axis.name} is varied, {' and '.join(axis.actions)} cost the same."
        for axis in study.grid.axes if len(axis.actions) > 1
    ]  # fmt: skip
    for reading, found in study.maps.items():
        asked = "" if found.n_draws == 1 else f", {found.n_draws:,} draws"
        out += ["", f"{READING_WORDS[reading].capitalize()} (--reading {reading}){asked}:"]
        for k in range(found.n_steps):
            out += _map_lines(found, k)
        own = [f for f in study.critical if f.reading == reading]
        out += [f"  flips: {f.sentence}" for f in own if len(f.draw)]
        none = dict.fromkeys(
            f"{f.parameter} {f.scan[0]:g} to {f.scan[-1]:g}"
            for f in own if not any(len(g.draw) for g in own if g.parameter == f.parameter)
        )  # fmt: skip
        out += [f"  no flip of any step: {', '.join(none)}"] if none else []
    out += ["", _missed(study)]
    if study.findings:
        out += ["", "Printed in the paper, and found here:"]
        for printed in dict.fromkeys(f.printed for f in study.findings):
            out.append(f"  {printed}")
            out += [f"    {f.reading}: {f.sentence}" for f in study.findings if f.printed == printed]
    for kind, title in (("discount", "Discount"), ("x", "Scores of the states"), ("belief", "Initial belief"),
                        ("beside", "Beside")):  # fmt: skip
        rows = study.variants[kind]
        if rows:
            out += ["", f"{title}, everything else as given:", *_variant_lines(rows)]
    if len({row["states"] for row in study.variants["beside"]}) > 1:
        out.append(f"  {CURRENCIES}")
    return out


def _missed(study: SensitivityStudy) -> str:
    """How flips were looked for, and which would not be seen."""
    text = (
        "Flips: looked for at evenly spaced points, then by bisection; two that undo each other between "
        "neighbouring points are missed."
    )
    if "infinite" in study.discounts:
        text += " Without a horizon the decisions at both ends of a bracket are proven."
    return text


def _map_lines(found: GridDecisions, k: int) -> list[str]:
    """One line a value of `r`: in how many cells most draws act, and where that is a toss."""
    from models.sensitivity.reward_grid import ENOUGH

    nodes = found.answers.nodes
    mode = nodes.protocol.modes[nodes.modes[k]]
    rows = [row for row in found.rows() if row["k"] == k]
    out = [f"  step {k}, {mode.name}:"]
    for r in found.grid.r:
        own = [row for row in rows if row["r"] == r]
        acts = [row for row in own if row["action"] not in (mode.null_action, "undecided")]
        line = f"    r {r:g}: acts in {len(acts)} of {len(own)} cells"
        paid = [
            f"costs up to {max(row[f'cost_{axis.name}'] for row in acts):g}"
            for axis in found.grid.axes
            if axis.mode == nodes.modes[k] and acts
        ]
        line += f" ({', '.join(paid)})" if paid else ""
        if found.n_draws > 1:
            line += f"; least agreed on {min(own, key=lambda row: row['share'])['agree']}"
            if found.n_draws >= ENOUGH:
                toss = sum(row["verdict"] in ("coin toss", "undecided") for row in own)
                line += f", {toss} a toss"
        elif any(row["action"] == "undecided" for row in own):
            line += f"; {sum(row['action'] == 'undecided' for row in own)} undecided"
        out.append(line)
    return out


def _variant_lines(rows: tuple[dict[str, Any], ...]) -> list[str]:
    """One line a reading and step: which variants do what."""
    out = []
    for reading, k in dict.fromkeys((row["reading"], row["k"]) for row in rows):
        own = [row for row in rows if (row["reading"], row["k"]) == (reading, k)]
        asked = {row["draws"] for row in own}
        same = len(asked) == 1
        parts = []
        for action in dict.fromkeys(row["action"] for row in own):
            names = [
                row["variant"] + ("" if row["draws"] == 1 else f" {_agree(row, same)}")
                for row in own if row["action"] == action
            ]  # fmt: skip
            everywhere = len(names) == len(own) and asked == {1}
            parts.append(f"{action}: {'all of them' if everywhere else ', '.join(names)}")
        among = f" ({own[0]['draws']:,} draws)" if same and asked != {1} else ""
        out.append(f"  {reading}, step {k}{among}: {'; '.join(parts)}")
    return out


def _agree(row: dict[str, Any], counted: bool) -> str:
    """The share behind an action, without the number of draws where that stands in front."""
    text = str(row["agree"])
    return text.removesuffix(f" of {row['draws']:,} draws") if counted else text
