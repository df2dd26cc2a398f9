"""The commands about study 2: `study2`, `simulate study2` and `replicate study2`."""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING, Annotated, Any

import typer

from analysis.cli_evidence import OutOption as EvidenceOption
from analysis.cli_evidence import begin_evidence, finish_evidence
from analysis.cli_options import (
    DEFAULT_SEED,
    JsonOption,
    QuietOption,
    Report,
    SeedOption,
    check_output,
    distinct_files,
)
from analysis.cli_workers import SchedulerOption, WorkersOption, workers_of
from analysis.wording import counted
from models.errors import located

if TYPE_CHECKING:
    from analysis.study2 import Study2
    from analysis.study2_policies import Learned
    from models.lspomdp import LatentStatePOMDP

RESTS_ON = (
    "models.baum_welch",
    "models.fit_tree",
    "models.nuts",
    "models.planning.exact",
    "models.planning.solver",
    "models.robust.cautious",
    "models.game.rounds",
)
"""Modules whose kernels the replicates rest on."""

MOST_WORLDS = 25
"""By default; more worlds tell better how much they differ, and each costs a posterior."""

_LOG = "ends in .csv, .csv.gz or .parquet"

ParticipantsOption = Annotated[
    int,
    typer.Option(
        min=2,
        help="Simulated people, at least two under each policy; where they cannot be equally many, the first "
        "policies have one more.",
    ),
]
TruthOption = Annotated[
    str | None,
    typer.Option(metavar="MODEL", help="Model file of what people are like; the calibrated one by default."),
]
LearnedOption = Annotated[
    str,
    typer.Option(
        metavar="MODEL",
        help="What the robot believes: em (Baum-Welch on a study 1 simulated from the truth), bundled (on the "
        "bundled study, which is em with seed 1), truth, or a model file.",
    ),
]
PoliciesOption = Annotated[
    str,
    typer.Option(help="paper (its five), all (also exact plan, Bayes-adaptive, cautious), or names with commas."),
]
StatesOption = Annotated[int, typer.Option(min=1, max=12, help="Latent states that the robot learns.")]


def study2_command(
    participants: ParticipantsOption = 100,
    truth: TruthOption = None,
    learned: LearnedOption = "em",
    policies: PoliciesOption = "paper",
    states: StatesOption = 4,
    alpha: Annotated[float, typer.Option(help="Share of the draws that the cautious plan looks at.")] = 0.1,
    out: Annotated[
        str | None, typer.Option("--out", metavar="FILE", help=f"Also write the events with their tokens; {_LOG}.")
    ] = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Simulate study 2 in the token game and analyse it as the paper does, printed numbers beside.

    Example: prosocial study2 --participants 100 --seed 1
    """
    from analysis.design import published
    from analysis.event_files import write_events
    from analysis.printed_study2 import anova_beside, comparisons_beside
    from analysis.study2_analysis import analyse, anova_rows, comparison_rows
    from analysis.study2_beliefs import belief_spread
    from analysis.study2_claims import CLAIMS, as_printed, check_claims
    from analysis.study2_outcomes import CUMULATIVE, OUTCOMES, SHORT, by_round, means, relative_to
    from analysis.study2_policies import LS_POMDP, MORE, NEVER, PAPER
    from analysis.study2_words import answer, narrow, plain_rows, shown, uneven, wide_means
    from models.work_clock import WorkClock

    report = Report(json, quiet)
    if out is not None:
        check_output("--out", out)
    _distinct(out, truth, learned, json)
    clock = WorkClock()
    study, known = _simulated(participants, truth, learned, policies, states, alpha, seed, quiet, fewest=2)
    found = analyse(study, LS_POMDP if LS_POMDP in study.policies else study.policies[0])
    same = set(PAPER) <= {*study.policies}
    spread = belief_spread(as_printed(study) if same else study, known)
    seconds = clock.wall()
    if out is not None:
        write_events(study.log, out)
    summary, model = means(study), found.help_model
    # Beside the printed numbers stand tests of the policies that the paper compares, and of no others.
    paper = found if study.policies == PAPER else analyse(as_printed(study)) if same else None
    beside = None if paper is None else anova_beside(paper, published())
    pairs = None if paper is None else comparisons_beside(paper, published())
    planners = [p for p in study.policies if p == LS_POMDP or p in MORE] if same else []
    claims = {planner: check_claims(study, planner) for planner in planners}
    report.say(
        f"SIMULATED: {study.n_people} people under {len(study.policies)} policies play {study.n_rounds} rounds "
        f"({study.letters}); the robot's model: {known.words}; seed {seed}.{uneven(study)}"
    )
    for note in study.notes:
        report.say(f"note: {note}")
    report.say(f"\nMeans, one value a person:\n{shown(wide_means(summary))}")
    if paper is not None and beside is not None and pairs is not None:
        what = "the paper's policies; SIMULATED but for the printed columns, where a p of 0 stands for p < .001"
        names = {tukey.what: SHORT[key] for key, tukey in paper.tukey.items()}
        report.say(f"\nMixed ANOVA, first against last round, {what}:\n{shown(narrow(beside))}")
        report.say(spread.sentence)
        report.say(
            f"\nLess {LS_POMDP}, one value a person, {what}:\n"
            f"{shown(narrow(pairs.assign(outcome=pairs['outcome'].replace(names))))}\n"
            "low, high and p are Tukey's."
        )
    if model is not None:
        report.say(f"\n{model.sentence}")
    for sentence in found.sentences:
        report.say(sentence)
    if paper is None:
        report.say(spread.sentence)
    for planner, held in claims.items():
        report.say(f"\nThe paper's conclusions, with {planner} as the planner:")
        report.say("\n".join(f"  {answer(c, held[c.key], study)}" for c in CLAIMS if c.whole))
    report.finish(
        {
            "means": plain_rows(summary), "anova": anova_rows(found.anovas), "tukey": comparison_rows(found.tukey),
            "dunnett": comparison_rows(found.dunnett), "tukey_last": comparison_rows(found.tukey_last),
            "rounds": [{"outcome": key, **row} for key in OUTCOMES for row in plain_rows(by_round(study, key))],
            "cumulative_relative_to_never": (
                plain_rows(relative_to(study, CUMULATIVE)) if NEVER in study.policies else []
            ),
            "logistic": {
                "first_and_last": None if found.twin is None else plain_rows(found.twin.table),
                "tests": None if model is None else plain_rows(model.tests),
                "odds_ratios": None if model is None else plain_rows(model.odds),
                "sd": None if model is None else model.sd, "notes": () if model is None else model.notes,
            },
            "claims": claims, "claims_on_the_robots_scale": [c.key for c in CLAIMS if c.own_scale],
            "belief": {
                "sentence": spread.sentence, "searches": spread.searches, "models": plain_rows(spread.table)
            },
            "printed": {
                "anova": [] if beside is None else plain_rows(beside),
                "comparisons": [] if pairs is None else plain_rows(pairs),
            },
            "reference": found.reference, "left_out": found.left_out, "sentences": found.sentences,
            **_about(study, known, truth, seed), "missed": study.missed, "seconds": seconds,
            "compile_seconds": clock.compile_seconds, "out": out,
        }
    )  # fmt: skip


def simulate_study2_command(
    out: Annotated[str, typer.Option("--out", metavar="FILE", help=f"Event file to write; {_LOG}.")],
    participants: ParticipantsOption = 100,
    truth: TruthOption = None,
    learned: LearnedOption = "em",
    policies: PoliciesOption = "paper",
    states: StatesOption = 4,
    alpha: Annotated[float, typer.Option(help="Share of the draws that the cautious plan looks at.")] = 0.1,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Simulate study 2 in the token game; the events have token columns, the condition is the policy.

    Example: prosocial simulate study2 --out study2.csv.gz --participants 100 --seed 1
    """
    from analysis.event_files import write_events

    report = Report(json, quiet)
    check_output("--out", out)
    _distinct(out, truth, learned, json)
    study, known = _simulated(participants, truth, learned, policies, states, alpha, seed, quiet)
    write_events(study.log, out)
    for note in study.notes:
        report.say(f"note: {note}")
    report.say(
        f"{out}: {counted(study.log.n_events, 'event')}, {counted(study.n_people, 'person', 'people')}, "
        f"{counted(len(study.policies), 'policy', 'policies')}; simulated, the robot's model: {known.words}, "
        f"seed {seed}"
    )
    report.finish({**_about(study, known, truth, seed), "events": study.log.n_events, "out": out})


def replicate_study2_command(
    replicates: Annotated[int, typer.Option(min=2, help="Simulated studies 2; a multiple of --worlds.")] = 1000,
    worlds: Annotated[
        int | None,
        typer.Option(
            min=2, help="Studies 1 that the robot learns from; 25, or the most below that divide --replicates."
        ),
    ] = None,
    people: Annotated[int, typer.Option(min=2, help="People under each policy of a study.")] = 20,
    study1: Annotated[int, typer.Option(min=2, help="People of each study 1.")] = 540,
    states: StatesOption = 4,
    truth: TruthOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    out: EvidenceOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """How often the paper's conclusions from study 2 come out where the truth is known.

    Each is a function of one study; policies that the paper did not have take the place of its own in turn. A robot
    that learned from a study 1 of its own, and one that knows the truth: about ten minutes of processor time.

    Example: prosocial replicate study2 --replicates 1000 --out study2.json
    """
    from analysis import progress
    from analysis.design import published
    from analysis.evidence import record
    from analysis.study2_evidence import shown_claims, study2_evidence
    from analysis.study2_replicates import Study2Replicates

    report = begin_evidence(json, quiet, out, truth=truth)
    if worlds is None:
        worlds = most_worlds(replicates)
    settings = Study2Replicates(
        _truth(truth), replicates=replicates, worlds=worlds, people=people, study1=study1, states=states, seed=seed
    )
    with progress.shown(quiet) as watch, workers_of(workers, scheduler) as executor:
        result = study2_evidence(settings, published(), executor=executor, progress=watch)
    words = ["prosocial", "replicate", "study2", "--replicates", str(replicates), "--worlds", str(worlds)]
    words += ["--people", str(people), "--study1", str(study1), "--states", str(states)]
    words += [*(() if truth is None else ("--truth", truth)), "--seed", str(seed)]
    what = "Study 2 in the token game again and again: simulated people of a known truth."
    content = record(what, shlex.join(words), seed, result.to_dict(), RESTS_ON)
    table = shown_claims(content)
    shown = table[table["whole"]][["learning", "planner", "claim", "share", "low", "high"]]
    report.say(shown.to_string(index=False, float_format=lambda v: f"{v:.3f}", na_rep="-"))
    report.say(f"\n{result.sentence} Seed {seed}.")
    finish_evidence(report, out, content)


# -- what the options say --------------------------------------------------------------------------
def _simulated(
    participants: int, truth: str | None, learned: str, policies: str, states: int, alpha: float, seed: int,
    quiet: bool, fewest: int = 1,
) -> tuple[Study2, Learned]:  # fmt: skip
    from analysis import progress
    from analysis.study2 import check_study, run_study2
    from analysis.study2_learning import learned_from
    from analysis.study2_policies import FROM_DRAWS, make_policies

    names = policy_names(policies, fewest)
    check_study(participants, len(names), seed)
    if not 0 < alpha <= 1:
        raise located("--alpha", alpha, "a share above 0 and up to 1")
    people = _truth(truth)
    with progress.shown(quiet) as watch:
        known = learned_from(
            learned, people, states=states, seed=seed, posterior=any(n in FROM_DRAWS for n in names), progress=watch
        )
        made = make_policies(known, names, alpha=alpha)
        return run_study2(made, people, known, participants, seed=seed, progress=watch), known


def most_worlds(replicates: int) -> int:
    """The most worlds up to 25 that divide the replicates.

    Raises
    ------
    InputError
        If none of at least 2 does.

    Examples
    --------
    >>> [most_worlds(n) for n in (1000, 20, 60, 7)]
    [25, 20, 20, 7]
    """
    for worlds in range(min(MOST_WORLDS, replicates), 1, -1):
        if replicates % worlds == 0:
            return worlds
    raise located(
        "--replicates", replicates, f"a multiple of some number of worlds from 2 to {MOST_WORLDS} (--worlds)"
    )


def policy_names(words: str, fewest: int = 1) -> tuple[str, ...]:
    """Policies asked for.

    Raises
    ------
    InputError
        On a name that is none, one that stands twice, or fewer than are wanted.
    """
    from analysis.study2_policies import MORE, PAPER, check_names

    groups = {"paper": PAPER, "all": PAPER + MORE}
    names = groups.get(words) or tuple(part.strip() for part in words.split(",") if part.strip())
    check_names(names, fewest)
    return names


def _truth(path: str | None) -> LatentStatePOMDP:
    from analysis.simulate import calibrated_truth
    from models.model_files import read_model

    return calibrated_truth() if path is None else read_model(path)


def _distinct(out: str | None, truth: str | None, learned: str, json: str | None) -> None:
    """Nothing that is read is written over."""
    from analysis.study2_learning import SOURCES

    files = {"--out": out, "--json": json, "--truth": truth}
    distinct_files(files)
    if learned not in SOURCES:
        distinct_files({"--out": out, "--json": json, "--learned": learned})


def _about(study: Study2, known: Learned, truth: str | None, seed: int) -> dict[str, Any]:
    return {
        "participants": study.n_people, "policies": study.policies, "schedule": study.letters, "seed": seed,
        "truth": truth or "calibrated_truth", "learned": known.words, "simulated": True, "notes": study.notes,
    }  # fmt: skip
