"""The command ``plan``: what the robot should do over a known schedule or without horizon, beside baselines."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from math import prod
from typing import TYPE_CHECKING, Annotated, Any

import typer

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
from analysis.cli_planning_options import (
    CostHelpOption,
    CostOption,
    CostSignalOption,
    PrecisionOption,
    RewardSteepness,
    costs_of,
)
from analysis.cli_solve import TimeLimitOption, gap_shown
from models.errors import InputError, Phrase, located

if TYPE_CHECKING:
    from models.lspomdp import LatentStatePOMDP
    from models.planning.mode_process import ModeProcess
    from models.protocol import Protocol

STUDY_SCHEDULE = "HRHRHRHRH"
"""Schedule of the paper's second study, planned for unless another one is named."""

MANY_RESPONSES = 30_000
"""Sequences of responses from which on evaluating policies takes so long that it is said beforehand."""


def plan_command(
    model: Annotated[str, typer.Argument(metavar="MODEL", help="Model file (JSON).")],
    schedule: Annotated[
        str | None,
        typer.Option(help=f"Letters of the rounds, H: the human may help; {STUDY_SCHEDULE} by default."),
    ] = None,
    infinite: Annotated[bool, typer.Option("--infinite", help="Without horizon instead of a schedule.")] = False,
    start_mode: Annotated[
        str | None, typer.Option(help="With --infinite: first mode, name or letter; else the protocol's first.")
    ] = None,
    mode_process: Annotated[
        str | None,
        typer.Option(metavar="PROCESS", help="With --infinite: alternating, or bernoulli:p, p for the first mode."),
    ] = None,
    discount: Annotated[
        float | None, typer.Option(help="1 for a schedule and 0.95 without horizon by default.")
    ] = None,
    r: RewardSteepness = None,
    cost_help: CostHelpOption = None,
    cost_signal: CostSignalOption = None,
    cost: CostOption = None,
    precision: PrecisionOption = 1e-3,
    time_limit: TimeLimitOption = 60.0,
    policy: Annotated[
        str | None, typer.Option("--policy", metavar="FILE", help="Write the policy, for the robot to run.")
    ] = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
    protocol: ProtocolOption = None,
) -> None:  # fmt: skip
    """What the robot should do: the exact best plan of a schedule, or a policy without horizon with its bounds.

    Example: prosocial plan model.json --schedule HRHRHRHRH
    """
    from analysis.stakes import stakes_of_fit
    from models.model_files import model_from_dict, read_json

    report = Report(json, quiet)
    if policy is not None:
        check_output("--policy", policy)
    distinct_files({"MODEL": model, "--policy": policy, "--json": json})
    if infinite and schedule is not None:
        raise located("--infinite", Phrase(f"--schedule {schedule} beside it"), "one of the two")
    given = {"--start-mode": start_mode, "--mode-process": mode_process}
    for option, value in given.items():
        if not infinite and value is not None:
            raise located(option, value, "no value: it belongs to --infinite")
    costs = costs_of(cost, {"help": cost_help, "signal": cost_signal})
    file = read_json(model)
    own = rewarded(model_from_dict(file, model, load_protocol(protocol) if protocol else None), r, costs)
    stakes = "" if own.reward.stated else stakes_of_fit(file.get("provenance"))
    if infinite:
        process = mode_process_of(own.protocol, mode_process or "alternating", start_mode)
        if start_mode is None and (hint := _other_start(own.protocol, process)):
            report.say(hint)
        content = _infinite(own, process, discount, precision, time_limit, seed, policy, report)
    else:
        content = _schedule(own, STUDY_SCHEDULE if schedule is None else schedule, discount, policy, report)
    if stakes:
        report.say(stakes)
    reward = {"r": own.reward.r, "x": list(own.reward.x), "costs": _costs(own)}
    report.finish(
        {**content, "reward": reward, "states": list(own.state_names), "seed": seed, "policy": policy,
         "cautions": list(own.cautions), "stakes": stakes}
    )  # fmt: skip


def _schedule(
    model: LatentStatePOMDP, schedule: str, discount: float | None, out: str | None, report: Report
) -> dict[str, Any]:
    from models.planning.baselines import baselines
    from models.planning.evaluation import evaluate_schedule
    from models.planning.exact import solve_schedule
    from models.planning.plan_policy import PlanPolicy
    from models.planning.schedule import Schedule
    from models.work_clock import WorkClock

    known = Schedule.of(model, schedule, 1.0 if discount is None else discount)
    sequences = prod(known.n_outcomes(k) for k in range(known.n_events))
    clock = WorkClock()
    plan = solve_schedule(known)
    if sequences > MANY_RESPONSES and not report.quiet:
        print(f"prosocial: following {sequences:,} sequences of responses takes a while", file=sys.stderr)
    best = PlanPolicy.of(plan, "optimal")
    results = {p.name: evaluate_schedule(p, known) for p in (best, *baselines(model))}
    seconds = clock.wall()
    own = results["optimal"]
    report.say(plan.sentence)
    report.say(_rows({name: _measures(v) for name, v in results.items()}))
    report.say(best.reason(best.begin(known.modes[0])))
    report.say(_unit(model))
    _write(best, out, model.cautions)
    return {
        "value": plan.value, "first_action": plan.first_action, "help_rate": own.help_rate,
        "costly_actions": own.costly_actions, "policies": {name: _measures(v) for name, v in results.items()},
        "schedule": known.letters, "discount": known.discount,
        "first_action_values": dict(
            zip([a.name for a in known.mode(0).actions], plan.first_values.tolist(), strict=True)
        ),
        "plan": plan.rows(), "state_path": own.state_path, "sentence": plan.sentence, "seconds": seconds,
        "compile_seconds": clock.compile_seconds,
    }  # fmt: skip


def _infinite(
    model: LatentStatePOMDP, process: ModeProcess, discount: float | None, precision: float, time_limit: float,
    seed: int, out: str | None, report: Report,
) -> dict[str, Any]:  # fmt: skip
    from analysis.policy_study import infinite_baselines
    from models.planning.latent import DISCOUNT, latent_problem
    from models.planning.solver import solve

    problem = latent_problem(model, process, DISCOUNT if discount is None else discount)
    with gap_shown(report.quiet) as progress:
        solution = solve(problem, precision, time_limit=time_limit, progress=progress)
    policy = solution.policy
    by_mode = {name: policy.action(policy.model.initial[x], x) for x, name in enumerate(problem.modes)}
    values = infinite_baselines(model, problem, seed)
    report.say(f"{process.words}; discount {problem.discount:g}. {solution.sentence}")
    report.say("At the initial belief: " + ", ".join(f"{a} in {m}" for m, a in by_mode.items()) + ".")
    shown = {"ls-POMDP": {"value": solution.lower, "low": solution.lower, "high": solution.upper}, **values}
    report.say(_rows(shown))
    for name, v in values.items():
        if v["value"] != v["value"]:
            report.say(f"{name} would have to be simulated, which takes too long at discount {problem.discount:g}.")
        elif v["low"] < v["high"]:
            report.say(f"{name} is simulated (seed {seed}), with its 95% interval.")
    first = next(iter(problem.starts()))[0]
    report.say(policy.reason(policy.begin(first)))
    report.say(_unit(model))
    _write(policy, out, model.cautions)
    return {
        "lower": solution.lower, "upper": solution.upper, "gap": solution.gap,
        "relative_gap": solution.relative_gap, "status": solution.status, "seconds": solution.seconds,
        "compile_seconds": solution.compile_seconds, "alpha_vectors": solution.alpha_vectors,
        "beliefs": solution.beliefs, "action_by_mode": by_mode, "policies": shown, "discount": problem.discount,
        "mode_process": process.words, "sentence": solution.sentence,
    }  # fmt: skip


# -- what the options say --------------------------------------------------------------------------
def rewarded(model: LatentStatePOMDP, r: float | None, costs: dict[str, float | None]) -> LatentStatePOMDP:
    """The model with another reward, as far as options say one.

    Raises
    ------
    InputError
        On an action that the protocol does not have, or rewards too large for a number.
    """
    from dataclasses import replace

    from analysis.reward_options import reward_asked

    return replace(model, reward=reward_asked(model.reward, model.protocol, r, costs))


def mode_process_of(protocol: Protocol, words: str, start: str | None) -> ModeProcess:
    """How the mode moves, from ``alternating`` or ``bernoulli:p``."""
    from models.planning.mode_process import alternating, bernoulli

    kind, _, number = words.partition(":")
    if words == "alternating":
        return alternating(protocol, start)
    try:
        if kind == "bernoulli":
            return bernoulli(protocol, float(number), start)
    except InputError:
        raise
    except ValueError:
        pass
    raise located("--mode-process", words, "alternating, or bernoulli:p with a probability p")


# -- what is printed -------------------------------------------------------------------------------
def _other_start(protocol: Protocol, process: ModeProcess) -> str:
    """That the rounds planned for without ``--infinite`` start in another mode, where they do; else nothing."""
    first = [m for m, share in zip(protocol.modes, process.start, strict=True) if share > 0]
    letter = STUDY_SCHEDULE[0]
    if letter not in [m.letter for m in protocol.modes] or letter in [m.letter for m in first]:
        return ""
    return (
        f"The first round is one of {first[0].name}; {STUDY_SCHEDULE}, planned for without --infinite, starts with "
        f"{protocol.modes_from_letters(letter)[0].name} (--start-mode {letter})."
    )


def _measures(value: Any) -> dict[str, float]:
    return {
        "value": value.value, "help_rate": value.help_rate, "costly_actions": value.costly_actions,
        "cost": value.cost,
    }  # fmt: skip


def _rows(rows: dict[str, dict[str, float]]) -> str:
    import pandas as pd

    return str(pd.DataFrame.from_dict(rows, orient="index").to_string(float_format=lambda v: f"{v:.3f}"))


def _costs(model: LatentStatePOMDP) -> dict[str, float]:
    return {a: model.reward.costs.get(a, c) for a, c in model.protocol.costs.items()}


def _unit(model: LatentStatePOMDP) -> str:
    costs = ", ".join(f"{a} {c:g}" for a, c in _costs(model).items() if c)
    steep = "" if model.reward.stated else f"r = {model.reward.r:g}; "
    return f"Values in {model.reward.unit} ({steep}costs: {costs or 'none'})."


def _write(policy: Any, out: str | None, cautions: Sequence[str]) -> None:
    if out is not None:
        from models.planning.policy_files import write_policy

        try:
            write_policy(policy, out, cautions)
        except OSError as error:
            raise InputError(f"--policy {out}: cannot be written: {error.strerror}") from None
