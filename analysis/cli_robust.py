"""The command ``robust``: what the robot should do over a schedule given everything that is believed."""

from __future__ import annotations

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
    check_tail,
    draws_asked,
)
from analysis.cli_workers import SchedulerOption, WorkersOption, workers_of
from analysis.wording import counted

if TYPE_CHECKING:
    from analysis.robust_study import RobustStudy
    from models.robust.cautious import CautiousPlan

SHOWN_PLANS = 3
"""Plans of a mixture that are written out, the most frequent ones."""


def robust_command(
    fit: FitArgument,
    schedule: Annotated[
        str, typer.Option(help="Letters of the rounds, H: the human may help.")
    ] = STUDY_SCHEDULE,
    criterion: Annotated[
        str,
        typer.Option(help="bayes (mean), cvar, gain-cvar (over never helping), regret (the largest), regret-cvar."),
    ] = "bayes",
    alpha: Annotated[float, typer.Option(help="Share of the draws that cautious criteria look at.")] = 0.1,
    mean_share: Annotated[float, typer.Option(help="With cvar only: share of the plain mean in it.")] = 0.0,
    no_lots: Annotated[
        bool, typer.Option("--no-lots", help="The best single plan found; drawing one of several may be better.")
    ] = False,
    frontier: Annotated[
        bool, typer.Option("--frontier", help="Ten levels of caution, also at costs where decisions flip.")
    ] = False,
    evsi: Annotated[
        list[str] | None,
        typer.Option(metavar="CONDITION:SCHEDULE:N", help="Value a further study, as help+signal:HRHRH:100,200."),
    ] = None,
    participant_cost: Annotated[
        float, typer.Option(help="Cost of one participant, in the unit of the reward.")
    ] = 0.0,
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
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
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
    from analysis.next_studies import next_studies
    from analysis.robust_study import robust_fields, robust_study
    from models.cautions import told_once
    from models.model_files import read_model
    from models.planning.schedule import Schedule
    from models.work_clock import WorkClock

    report = Report(json, quiet)
    if policy is not None:
        check_output("--policy", policy)
    distinct_files({"FIT": fit, "--plug-in": plug_in, "--policy": policy, "--json": json})
    check_tail(alpha)
    source = draws_asked(
        fit, draws=draws, allow_unseen=allow_unseen, force=force, group=group, person=person, people=True, r=r,
        cost_help=cost_help, cost_signal=cost_signal, cost=cost, protocol=protocol,
    )  # fmt: skip
    known = Schedule.of(source.draws, schedule, discount)
    asked = next_studies(evsi or (), known.protocol)
    estimate = read_model(plug_in, load_protocol(protocol) if protocol else None) if plug_in else None
    clock = WorkClock()
    with progress.shown(quiet) as watch, workers_of(workers, scheduler) as executor:
        study = robust_study(
            known, criterion=criterion, alpha=alpha, mean_share=mean_share, lots=not no_lots, plug_in=estimate,
            asked=asked, with_frontier=frontier, chains=source.chains, kinds=source.kinds,
            sampled=source.fit is not None, served=served,
            cost=participant_cost, seed=seed, executor=executor, progress=watch,
        )  # fmt: skip
    seconds = clock.wall()
    report.say(f"{source.sentence}. Schedule {known.letters}, discount {known.discount:g}.")
    for line in told_once(_lines(study), study.cautions):
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
    chosen = study.chosen
    out = [study.sentence[0].upper() + study.sentence[1:], ""]
    out.append(f"{_how_good(study)}, mean {chosen.mean:.6g}.")
    out += _what_it_does(chosen)
    if not chosen.deterministic:
        worth = f"{study.told(study.single.worth):.6g}"
        out.append(
            f"The best single plan (--no-lots): {worth}." if study.single.proven else
            f"The best of {study.single.looked:,} single plans looked at (--no-lots): {worth}."
        )  # fmt: skip
    out += ["", *_prices(study), "", *_decisions(study), ""]
    out += [study.perfect.sentence, study.partial.sentence]
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
    if sum(len(s.studies) for s in study.samples) > 1:
        out += [s.sentence for s in study.samples]
    out += [f"At {name}: {found.sentence}" for name, found in study.frontiers.items()]
    out += [flip.sentence for flip in study.flips]
    return out


def _how_good(study: RobustStudy) -> str:
    """The criterion of the chosen plan, and how sure it is that no other plan is better."""
    chosen, single = study.chosen, study.single
    what, value = study.criterion_words, f"{study.value:.6g}"
    if chosen.certified:
        return f"Best {what}: {value} (gap {chosen.gap:.2g}, certified)"
    if not chosen.deterministic:
        return f"Best {what}: {value} (gap {chosen.gap:.2g}, not certified)"
    lots = f"drawing lots may gain {chosen.gap:.2g} at most"
    if single.proven:
        return f"Best {what} without lots: {value} (all {single.looked:,} plans looked at; {lots})"
    return f"{what[0].upper()}{what[1:]}, the best of {single.looked:,} single plans looked at: {value} ({lots})"


def _what_it_does(chosen: CautiousPlan) -> list[str]:
    """The plan, or the most frequent plans of the mixture, event by event."""
    from models.robust.cautious import acting_words

    out = []
    rows = sorted(zip(chosen.share.tolist(), chosen.plans, strict=True), key=lambda x: -x[0])
    for share, plan in rows[:SHOWN_PLANS]:
        often = "Where it acts, by the responses before" if len(rows) == 1 else f"In {share:.0%} of the cases"
        out.append(f"{often}:")
        out += [f"  {words}" for words in acting_words(chosen.schedule, plan)]
    if len(rows) > SHOWN_PLANS:
        rest = sum(share for share, _ in rows[SHOWN_PLANS:])
        further = counted(len(rows) - SHOWN_PLANS, "further plan")
        out.append(
            f"In the other {rest:.0%} {'one of ' if len(rows) > SHOWN_PLANS + 1 else ''}{further} (see --json)."
        )
    return out


def _prices(study: RobustStudy) -> list[str]:
    """Plans side by side."""
    tail = f"worst {100 * study.alpha:.3g}%"
    named = {
        "name": "plan", "mean": "mean", "held_out_mean": "held out", "cvar": tail, "worst": "worst",
        "gain_mean": "gain", "gain_cvar": f"gain, {tail}", "gain_probability": "P(gain > 0)",
        "cvar_regret": f"regret, {tail}", "max_regret": "max regret",
    }  # fmt: skip
    table = study.prices.table[list(named)].rename(columns=named)
    return [
        table.to_string(index=False, float_format=lambda v: f"{v:.2f}"),
        "Held out: chosen and scored on different draws. Gain: over never helping in the same draw. "
        f"{tail[0].upper()}{tail[1:]}: mean over that share of the draws, by what stands before it.",
    ]


def _decisions(study: RobustStudy) -> list[str]:
    """How many of the draws agree with the Bayes-adaptive plan along its histories."""
    named = {
        "event": "event", "mode": "mode", "agree": "agree", "least_sure": "least sure", "after": "after",
        "least_agree": "agree there", "wrong_costs": "being wrong costs", "bits": "bits told",
    }  # fmt: skip
    table = study.stability.by_event[list(named)].rename(columns=named)
    shares = {"agree": lambda v: f"{v:.0%}", "agree there": lambda v: f"{v:.0%}"}
    return [
        "Share of the draws that agree with the Bayes-adaptive plan along its histories, at "
        f"{study.stability.beliefs} belief:",
        table.to_string(index=False, formatters=shares, float_format=lambda v: f"{v:.2g}"),
        study.stability.weakest,
    ]


def _write(study: RobustStudy, path: str | None) -> None:
    if path is None:
        return
    from models.planning.mixed_policy import MixedPolicy
    from models.planning.policy_files import write_policy

    chosen = study.chosen
    made = MixedPolicy.of(study.schedule, chosen.plans, chosen.share, f"robust ({study.criterion})")
    write_policy(made, path, study.cautions)
