"""The command ``robust``: what the robot should do over a schedule given everything that is believed."""

from __future__ import annotations

import sys
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
    load_protocol,
    plain,
)
from analysis.cli_plan import (
    STUDY_SCHEDULE,
    CostHelpOption,
    CostOption,
    CostSignalOption,
    RewardSteepness,
    costs_of,
)
from analysis.cli_solve_draws import AllowUnseenOption, DrawsOption, ForceOption, GroupOption, PersonOption

if TYPE_CHECKING:
    from analysis.robust_study import RobustStudy


def robust_command(
    fit: Annotated[
        str, typer.Argument(metavar="FIT", help="A fit (.nc), or JSON: a list of models, each with a weight.")
    ],
    schedule: Annotated[
        str, typer.Option(help="Letters of the rounds, H: the human may help.")
    ] = STUDY_SCHEDULE,
    criterion: Annotated[
        str, typer.Option(help="bayes (the mean), cvar, regret (the largest) or regret-cvar.")
    ] = "bayes",
    alpha: Annotated[float, typer.Option(help="Share of the draws that cautious criteria look at.")] = 0.1,
    mean_share: Annotated[float, typer.Option(help="With cvar: share of the plain mean in the criterion.")] = 0.0,
    frontier: Annotated[
        bool, typer.Option("--frontier", help="Ten levels of caution, also at costs where decisions flip.")
    ] = False,
    evsi: Annotated[
        list[str] | None,
        typer.Option(metavar="CONDITION:SCHEDULE:N", help="Value a further study, as help+signal:HRHRH:100,200."),
    ] = None,
    participant_cost: Annotated[float, typer.Option(help="Cost of one participant, in reward units.")] = 0.0,
    served: Annotated[float | None, typer.Option(help="People whom the plan will serve.")] = None,
    plug_in: Annotated[
        str | None, typer.Option(metavar="MODEL", help="Point estimate (model file) to compare with.")
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
        str | None, typer.Option("--policy", metavar="FILE", help="Write the chosen plan, for the robot to run.")
    ] = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
    protocol: ProtocolOption = None,
) -> None:  # fmt: skip
    """Plan under doubt: the plan of a criterion with its certificate, shortcuts priced, what data would be worth.

    Where people differ and no --person is named, every kind of person counts and the plan learns whom it faces.

    Example: prosocial robust fit.nc --criterion cvar --alpha .1 --evsi help+signal:HRHRH:100,200
    """
    from analysis import progress
    from analysis.draws_source import read_draws
    from analysis.next_studies import next_studies
    from analysis.robust_study import robust_fields, robust_study
    from models.model_files import read_model
    from models.planning.schedule import Schedule
    from models.work_clock import WorkClock

    report = Report(json, quiet)
    if policy is not None:
        check_output("--policy", policy)
    distinct_files({"FIT": fit, "--plug-in": plug_in, "--policy": policy, "--json": json})
    own = load_protocol(protocol) if protocol else None
    source = read_draws(
        fit, draws=draws, allow_unseen=allow_unseen, force=force, group=group, person=person, people=True, r=r,
        costs={"help": cost_help, "signal": cost_signal, **costs_of(cost)}, protocol=own,
    )  # fmt: skip
    for warning in source.warnings:
        print(f"prosocial: {warning}", file=sys.stderr)
    known = Schedule.of(source.draws, schedule, discount)
    asked = next_studies(evsi or (), known.protocol)
    estimate = read_model(plug_in, own) if plug_in else None
    clock = WorkClock()
    with progress.shown(quiet) as watch:
        study = robust_study(
            known, criterion=criterion, alpha=alpha, mean_share=mean_share, plug_in=estimate, asked=asked,
            with_frontier=frontier, chains=source.chains, kinds=source.kinds,
            sampled=source.fit is not None, served=served,
            cost=participant_cost, seed=seed, progress=watch,
        )  # fmt: skip
    seconds = clock.wall()
    report.say(f"{source.sentence}. Schedule {known.letters}, discount {known.discount:g}.")
    for line in _lines(study):
        report.say(line)
    _write(study, policy)
    report.finish(
        plain({
            **robust_fields(study), **source.to_dict(), "schedule": known.letters, "discount": known.discount,
            "seconds": seconds, "compile_seconds": clock.compile_seconds, "seed": seed, "policy": policy,
        })
    )  # fmt: skip


def _lines(study: RobustStudy) -> list[str]:
    """What is shown to a person."""
    chosen, prices = study.chosen, study.prices
    out = [study.sentence[0].upper() + study.sentence[1:], ""]
    kind = "follows one plan" if chosen.deterministic else f"draws one of {len(chosen.plans)} plans"
    sure = "certified" if chosen.certified else "NOT certified"
    out.append(
        f"Best {study.criterion_words}: {study.value:.6g} (gap {chosen.gap:.1g}, {sure}), mean {chosen.mean:.6g}; "
        f"{kind}."
    )
    if not chosen.deterministic:
        single = chosen.best_single()[1] * (-1 if study.criterion.startswith("regret") else 1)
        shares = ", ".join(f"{100 * s:.0f}%" for s in sorted(chosen.share, reverse=True))
        out.append(f"Shares of the plans: {shares}. Of all plans looked at, the best single one: {single:.6g}.")
    columns = ["name", "mean", "cvar", "worst", "max_regret", "gain_mean", "gain_probability", "held_out_mean"]
    named = {
        "name": "plan", "cvar": f"worst {100 * study.alpha:.3g}%", "max_regret": "max regret", "gain_mean": "gain",
        "gain_probability": "P(gain > 0)", "held_out_mean": "held out",
    }  # fmt: skip
    table = prices.table[columns].rename(columns=named)
    out += ["", table.to_string(index=False, float_format=lambda v: f"{v:.2f}"), ""]
    out.append("Gain: over never helping in the same draw. Held out: chosen and scored on different draws.")
    out += [study.stability.weakest, study.perfect.sentence, study.partial.sentence]
    out.append(
        f"Listening to responses is worth {study.adaptivity:.3g} over the best fixed sequence of actions; learning "
        f"which draw it faces at most {study.learning:.3g}, over the best plan found for one model."
    )
    if study.personal is not None:
        out.append(
            f"{study.personal.sentence} A plan is worth the mean over the people in a draw: what is doubtful is "
            "the draw, not who comes next."
        )
    out += [line for s in study.samples for line in s.sentences]
    out += [f"At {name}: {found.sentence}" for name, found in study.frontiers.items()]
    out += [flip.sentence for flip in study.flips]
    return out


def _write(study: RobustStudy, path: str | None) -> None:
    if path is None:
        return
    from models.planning.mixed_policy import MixedPolicy
    from models.planning.policy_files import write_policy

    chosen = study.chosen
    write_policy(MixedPolicy.of(study.schedule, chosen.plans, chosen.share, f"robust ({study.criterion})"), path)
