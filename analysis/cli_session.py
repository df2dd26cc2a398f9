"""The command ``session``: a robot's policy at a terminal or a pipe."""

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
    distinct_files,
    load_protocol,
)
from analysis.cli_planning_options import CostOption
from analysis.wording import counted
from models.errors import InputError, located

if TYPE_CHECKING:
    from analysis.session_talk import Talk
    from models.planning.policies import Policy
    from models.protocol import Protocol
    from models.runtime import Session


def session_command(
    policy_file: Annotated[
        str | None, typer.Argument(metavar="[POLICY_FILE]", help="A policy file, as `solve --policy` writes it.")
    ] = None,
    log: Annotated[
        str | None, typer.Option(metavar="FILE", help="New log, in which every decision is before it is answered.")
    ] = None,
    restore: Annotated[
        str | None, typer.Option(metavar="LOG", help="Go on with the session of a log; needs no policy file.")
    ] = None,
    budget: Annotated[
        float | None,
        typer.Option(help="Most that actions may cost in all, in the unit of the reward; put around the policy."),
    ] = None,
    cost: CostOption = None,
    fallback: Annotated[
        list[str] | None,
        typer.Option(metavar="MODE=ACTION", help="What is done without consent; null actions by default."),
    ] = None,
    no_consent: Annotated[
        bool, typer.Option("--no-consent", help="The person did not agree: the fallback acts from the start.")
    ] = False,
    durable: Annotated[
        bool, typer.Option("--durable", help="Force every line of the log to disk: survives a power cut too.")
    ] = False,
    protocol: ProtocolOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
    seed: SeedOption = DEFAULT_SEED,
) -> None:
    """Run a policy as a robot would: modes (names or letters) and responses in, actions and reasons out.

    One command a line: a mode; then `RESPONSE`, `missing`, or `RESPONSE performed ACTION` if something else was
    done than decided (after a mode that shows no response the next mode may follow at once); `withdraw`, `hash`,
    `help`, `quit`. In a pipe every line is answered by one line, and lines that cannot be used by
    `refused: ...`; exit status 2 if there was one. A session that was killed goes on with --restore.

    Example: prosocial session policy.json --log person-7.log --budget 45
    """
    from analysis.session_talk import Talk
    from models.cautions import caution_line
    from models.runtime_setting import protocol_of

    report = Report(json, quiet)
    distinct_files(
        {"POLICY_FILE": policy_file, "--log": log, "--restore": restore, "--protocol": protocol, "--json": json}
    )
    given = None if protocol is None else load_protocol(protocol)
    if restore is not None:
        if cost or fallback or policy_file or log or no_consent or budget is not None:
            raise InputError(
                "--restore: found options of a new session, wanted none: policy, safeguards, fallback and consent "
                "are those of the log"
            )
        session = _restored(restore, durable)
    else:
        session = _begun(policy_file, log, budget, cost, fallback, not no_consent, durable, given, seed)
    known = protocol_of(session.policy, given)
    talk = Talk(session, known, person=sys.stdin.isatty())
    place = restore or log
    if session.cautions:
        print(f"prosocial: {policy_file or place}: {caution_line(session.cautions)}", file=sys.stderr)
    try:
        with session:
            _converse(talk, report, place, restored=restore is not None)
    except KeyboardInterrupt:
        raise KeyboardInterrupt(*([f"go on with --restore {place}"] if place else [])) from None
    changes = sum(talk.changed.values())
    report.say(
        f"{counted(session.event, 'event')}, {counted(talk.actions.total(), 'decision')}"
        + (f", {changes} changed by safeguards" if changes else "")
        + (f"; last hash {session.last_hash} (keep it elsewhere: it vouches for {place})" if place else "")
    )
    report.finish(
        {"policy": session.policy.name, "log": place, "seed": session.seed, "restored": restore is not None,
         "events": session.event, "decisions": talk.actions.total(), "actions": dict(talk.actions),
         "changed": dict(talk.changed), "consent": session.consent.value, "refused": talk.refused,
         "last_hash": session.last_hash, "cautions": list(session.cautions)}
    )  # fmt: skip
    if talk.refused and not sys.stdin.isatty():
        raise InputError(f"{counted(talk.refused, 'line')} could not be used")


def _restored(log: str, durable: bool) -> Session:
    from models.runtime import Session

    return Session.restore(log, durable=durable)


def _begun(
    policy_file: str | None, log: str | None, budget: float | None, cost: list[str] | None,
    fallback: list[str] | None, consent: bool, durable: bool, protocol: Protocol | None, seed: int,
) -> Session:  # fmt: skip
    from models.planning.policy_files import read_policy
    from models.runtime import Session
    from models.runtime_setting import declared_fallback, protocol_of

    if policy_file is None:
        raise located("POLICY_FILE", None, "a policy file, or --restore LOG")
    policy = read_policy(policy_file)
    known = protocol_of(policy, protocol)
    acts = declared_fallback(policy, _by_mode(fallback, policy, known), protocol)
    if budget is not None:
        policy = _with_budget(policy, budget, cost, known, acts)
    elif cost:
        raise located("--cost", ", ".join(cost), "--budget with it: it is what the budget is charged")
    return Session(
        policy, log, seed=seed, consent=consent, fallback=acts, protocol=protocol, durable=durable
    )  # fmt: skip


def _with_budget(
    policy: Policy, budget: float, cost: list[str] | None, protocol: Protocol | None, fallback: Policy
) -> Policy:  # fmt: skip
    """The policy with a hard limit on what it spends, beside the safeguards that it has already."""
    from analysis.cli_planning_options import costs_of
    from models.safeguards.budget import CostBudget
    from models.safeguards.guarded import Guarded

    if protocol is None:
        raise located("--budget", budget, "--protocol FILE.toml with it: nothing says what actions cost")
    if not 0 <= budget < float("inf"):
        raise located("--budget", budget, "a finite number from 0 on")
    charges = {**protocol.costs, **{name: value for name, value in costs_of(cost).items() if value is not None}}
    limit = CostBudget.of(protocol, budget, charges)
    if isinstance(policy, Guarded):
        made = Guarded(
            policy.policy, (*policy.safeguards, limit), fallback, policy.worth_source, policy.name
        )  # fmt: skip
        # Its file may say more against it than the policy inside does.
        made.cautions = policy.cautions
        return made
    return Guarded(policy, (limit,), fallback)


def _by_mode(options: list[str] | None, policy: Policy, protocol: Protocol | None) -> dict[str, str] | None:
    """Actions of the fallback by mode; modes by name or letter."""
    letters = {} if protocol is None else {m.letter: m.name for m in protocol.modes}
    out: dict[str, str] = {}
    for option in options or ():
        mode, sign, action = option.partition("=")
        if not sign:
            raise located("--fallback", option, "MODE=ACTION")
        name = letters.get(mode, mode)
        policy.vocabulary.choice(policy.vocabulary.mode(name), action)
        if name in out:
            raise located("--fallback", option, f"one action for {name}")
        out[name] = action
    return out or None


def _converse(talk: Talk, report: Report, place: str | None, *, restored: bool) -> None:
    """Read lines to the end of the input, or to `quit`."""
    watching = sys.stdin.isatty()
    if watching:
        session = talk.session
        report.say(
            f"{session.policy.name}, seed {session.seed}; " + (f"log {place}" if place else "no log (--log)")
        )
        report.say(talk.introduction)
    if restored and talk.session.pending is not None:
        note = f"note: {talk.session.pending.action} was decided, and nothing is known of what came of it"
        print(note, file=sys.stderr)
    reconfigure = getattr(sys.stdin, "reconfigure", None)
    if reconfigure is not None:
        reconfigure(errors="replace")
    while True:
        if watching and not report.quiet:
            print(talk.prompt, end="", file=sys.stderr if report.json_path == "-" else sys.stdout, flush=True)
        line = sys.stdin.readline()
        if not line:
            return
        reply = talk.answer(line)
        if reply.text:
            report.say(reply.text)
            sys.stdout.flush()
        if reply.over:
            return
