"""The command ``safeguard``: what safeguards change, cost and protect, and the guarded policy for the robot."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

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
    plain,
)
from analysis.cli_plan import STUDY_SCHEDULE
from analysis.cli_planning_options import (
    AllowUnseenOption,
    CostHelpOption,
    CostOption,
    CostSignalOption,
    DrawsOption,
    FitArgument,
    ForceOption,
    GroupOption,
    PersonOption,
    RewardSteepness,
    draws_asked,
)
from models.errors import located

if TYPE_CHECKING:
    from analysis.safeguard_study import SafeguardStudy

SHOWN = {
    "policy": "policy", "safeguards": "safeguards", "changed": "changed", "value": "value", "lost": "lost",
    "cost": "cost", "most_cost": "at most", "help_rate": "help", "influence": "moved",
}  # fmt: skip
"""Columns that a person is shown."""


def safeguard_command(
    fit: FitArgument,
    schedule: Annotated[str, typer.Option(help="Letters of the rounds, H: the human may help.")] = STUDY_SCHEDULE,
    budget: Annotated[
        float | None, typer.Option("--budget", metavar="X", help="Never spend more than that on a person.")
    ] = None,
    expected_cost: Annotated[
        float | None, typer.Option("--expected-cost", metavar="X", help="Spend no more than that on average.")
    ] = None,
    count: Annotated[
        bool, typer.Option("--count", help="Both count costly actions instead of adding up their costs.")
    ] = False,
    tolerance: Annotated[
        float | None,
        typer.Option("--tolerance", metavar="EPS", help="Least influence among actions worth up to EPS less."),
    ] = None,
    confidence: Annotated[
        float | None,
        typer.Option("--confidence", metavar="P", help="Act only if that pays with a probability above P."),
    ] = None,
    margin: Annotated[
        float, typer.Option("--margin", help="With --confidence: by more than that, in the unit of the reward.")
    ] = 0.0,
    fallback: Annotated[
        list[str] | None,
        typer.Option(metavar="MODE=ACTION", help="Without consent; null actions where nothing is said."),
    ] = None,
    draws: DrawsOption = None,
    discount: Annotated[float, typer.Option(help="From 0 to 1.")] = 1.0,
    r: RewardSteepness = None,
    cost_help: CostHelpOption = None,
    cost_signal: CostSignalOption = None,
    cost: CostOption = None,
    allow_unseen: AllowUnseenOption = False,
    force: ForceOption = False,
    group: GroupOption = None,
    person: PersonOption = None,
    policy: Annotated[
        str | None, typer.Option("--policy", metavar="FILE", help="Write the guarded policy, for the robot to run.")
    ] = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
    protocol: ProtocolOption = None,
) -> None:
    """What safeguards change, cost and protect: limits on cost, least influence, confidence, consent.

    FIT may also be a model file. Nothing asked for: a budget of 30, a tolerance of 5 and a confidence of .9.

    Example: prosocial safeguard fit.nc --budget 30 --confidence .9 --policy guarded.json
    """
    from analysis import progress
    from analysis.safeguard_study import Wanted, safeguard_study, study_fields
    from models.cautions import told_once
    from models.planning.schedule import Schedule
    from models.work_clock import WorkClock

    report = Report(json, quiet)
    if policy is not None:
        check_output("--policy", policy)
    distinct_files({"FIT": fit, "--policy": policy, "--json": json})
    for option, value in (("--budget", budget), ("--expected-cost", expected_cost), ("--tolerance", tolerance)):
        if value is not None and not 0 <= value < float("inf"):
            raise located(option, value, "a number of at least 0")
    if confidence is not None and not 0 <= confidence < 1:
        raise located("--confidence", confidence, "a probability from 0 to below 1")
    if not 0 <= margin < float("inf"):
        raise located("--margin", margin, "a number of at least 0")
    asked = any(x is not None for x in (budget, expected_cost, tolerance))
    if margin > 0 and confidence is None and asked:
        raise located("--margin", margin, "--confidence with it: it is by how much an action must pay")
    acts = fallbacks(fallback)
    source = draws_asked(
        fit, draws=draws, allow_unseen=allow_unseen, force=force, group=group, person=person, people=True, r=r,
        cost_help=cost_help, cost_signal=cost_signal, cost=cost, protocol=protocol,
    )  # fmt: skip
    known = Schedule.of(source.draws, schedule, discount)
    letters = {m.letter: m.name for m in known.protocol.modes}
    acts = fallbacks([f"{letters.get(mode, mode)}={action}" for mode, action in acts.items()])
    wanted = Wanted(budget, expected_cost, tolerance, confidence, margin, acts, count)
    clock = WorkClock()
    with progress.shown(quiet) as watch:
        study = safeguard_study(known, wanted, progress=watch)
    seconds = clock.wall()
    if policy is not None:
        # Before all that is said: whoever reads a few lines only may end the command.
        from models.planning.policy_files import write_policy

        write_policy(study.guarded, policy, study.cautions)
    report.say(f"{source.sentence}. Schedule {known.letters}, discount {known.discount:g}.")
    for line in told_once(lines(study), study.cautions):
        report.say(line)
    if policy is not None:
        report.say(f"{study.guarded.name} is in {policy}.")
    report.finish(
        plain({
            **study_fields(study), **source.to_dict(), "schedule": known.letters, "discount": known.discount,
            "seconds": seconds, "compile_seconds": clock.compile_seconds, "policy": policy,
        })
    )  # fmt: skip


def fallbacks(options: Sequence[str] | None) -> dict[str, str]:
    """Action by mode from ``MODE=ACTION`` options.

    Raises
    ------
    InputError
        On what is no ``MODE=ACTION``, or a mode that is named twice.
    """
    out: dict[str, str] = {}
    for option in options or ():
        mode, sign, action = option.partition("=")
        if not sign or not mode or not action:
            raise located("--fallback", option, "MODE=ACTION, such as human_needs_help=no_help")
        if mode in out:
            raise located("--fallback", option, f"the action of {mode} once")
        out[mode] = action
    return out


def lines(study: SafeguardStudy) -> list[str]:
    """What is shown to a person."""
    from models.safeguards.influence_report import ALL, LEVEL, NONE

    out = list(study.sentences)
    table = study.report.table[list(SHOWN)].rename(columns=SHOWN)
    # The same policy is named once: what follows are its safeguards.
    table["policy"] = table["policy"].where(~table["policy"].duplicated(), "")
    shares = {"changed": lambda v: f"{v:.0%}", "help": lambda v: f"{v:.3f}", "moved": lambda v: f"{v:.2f}"}
    out += ["", table.to_string(index=False, formatters=shares, float_format=lambda v: f"{v:.2f}")]
    out.append(
        "Changed: share of the decisions. Lost: to the same policy without safeguards, negative where they improve "
        "it. At most: the dearest path. "
        "Moved: how many times a person ends up in another state than if left alone."
    )
    who = study.report.who
    who = who[(who["policy"] == study.best) & who["safeguards"].isin([NONE, ALL])]
    shown = who[["safeguards", "by", "who", "influence", "low", "high"]].rename(columns={"influence": "moved"})
    out += ["", f"Whom the {study.best} moves, with the middle {LEVEL:.0%} of the draws:"]
    out.append(shown.to_string(index=False, float_format=lambda v: f"{v:.2f}"))
    curve = study.frontier.table[["cost", "value", "highest_price"]].rename(
        columns={"cost": "expected cost", "highest_price": "worth of a unit before"}
    )
    out += ["", "Best values under a limit on the expected cost (corners of a concave curve):"]
    out.append(curve.to_string(index=False, float_format=lambda v: f"{v:.2f}"))
    hard = study.budgets.table[["budget", "value", "gain_per_unit"]]
    hard = hard[hard["budget"] <= study.budgets.enough].rename(columns={"gain_per_unit": "gain of a unit before"})
    out += ["", "Best values under a hard budget:"]
    out.append(hard.to_string(index=False, float_format=lambda v: f"{v:.2f}", na_rep=""))
    return out
