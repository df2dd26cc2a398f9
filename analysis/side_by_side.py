"""Two data sets or two fits side by side: what each says, each with its own doubt."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from analysis import datasets
from analysis.datasets import DataSet
from analysis.draws_source import NETCDF
from analysis.em_study import EmStudy, parse_states
from analysis.study_selection import select
from analysis.wording import counted
from models.cautions import together
from models.errors import InputError, located
from models.events import EventLog
from models.identification import Identification
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.parameters import Array
from models.protocol import Protocol
from models.unseen import recorded_evidence, unseen_actions

Fit = Callable[[EventLog, Sequence[int], Mapping[str, Array | None]], EmStudy]
"""Baum-Welch over several numbers of states, with a bootstrap of every model."""


@dataclass(frozen=True)
class Side:
    """One of the two.

    Attributes
    ----------
    label : str
        ``A`` or ``B``.
    name : str
        As the user gave it.
    title : str
    kind : str
        Of its data: ``real``, ``simulated`` or ``unstated``.
    digest : str
        Of its content; empty if a fit does not say.
    facts : mapping of str to str
        What there is to say of it, for a table.
    estimates : mapping of int to LatentStatePOMDP
        By number of states: maximum likelihood, or the posterior mean.
    draws : mapping of int to ModelDraws
        Its doubt: bootstrap replicates, or posterior draws.
    doubt : str
        What the draws are, in words.
    log : EventLog, optional
        None for a fit.
    study : EmStudy, optional
        Fits of a data set.
    warnings : tuple of str
    not_learned : mapping of int to tuple of str
        By number of states, tables that were held fixed or that its data say nothing about, as
        ``transition[help]`` and ``emission[signal]``.
    """

    label: str
    name: str
    title: str
    kind: str
    digest: str
    facts: Mapping[str, str]
    estimates: Mapping[int, LatentStatePOMDP]
    draws: Mapping[int, ModelDraws]
    doubt: str
    log: EventLog | None = None
    study: EmStudy | None = None
    warnings: tuple[str, ...] = ()
    not_learned: Mapping[int, tuple[str, ...]] = field(default_factory=dict)

    @property
    def protocol(self) -> Protocol:
        """Protocol of its models."""
        return next(iter(self.estimates.values())).protocol

    def cautions(self, states: int) -> tuple[str, ...]:
        """Why its estimate or draws are not to be relied on (`models.cautions`), each once."""
        return together(self.estimates[states].cautions, self.draws[states].cautions)


def is_fit(source: str | DataSet) -> bool:
    """Whether a side is a file with a stored posterior (netCDF)."""
    if isinstance(source, DataSet):
        return False
    try:
        with Path(source).open("rb") as stream:
            return stream.read(4) in NETCDF
    except OSError:
        return False


def name_of(source: str | DataSet) -> str:
    """What a side is called: as the user gave it, or by the card of a data set."""
    return source.card.name if isinstance(source, DataSet) else source


def stated_kinds(a: str | DataSet, b: str | DataSet, kinds: Sequence[str]) -> tuple[str | None, str | None]:
    """Of each side, the kind that the user states for it, where nothing else does.

    Parameters
    ----------
    a, b : str or DataSet
    kinds : sequence of str
        ``real`` or ``simulated``: one for every side that does not say itself, or one of each side, A's first.

    Raises
    ------
    InputError
        On another word or more than two, and where it is known what a side is: a card says it.
    """
    for kind in kinds:
        check_kind(kind)
    if len(kinds) > 2:
        raise located("--kind", ", ".join(kinds), "one for both sides, or two: A's, then B's")
    if not kinds:
        return None, None
    known = [_known_kind(source) for source in (a, b)]
    if len(kinds) == 1 and not all(known):
        return None if known[0] else kinds[0], None if known[1] else kinds[0]
    for label, source, kind in zip("AB", (a, b), known, strict=True):
        if kind:
            wanted = "no value" if all(known) else "one value, for the other side"
            raise located(
                "--kind", ", ".join(kinds), f"{wanted}: {label}, {name_of(source)}, is {kind} by its card"
            )
    return kinds[0], kinds[1]


def check_kind(kind: str) -> None:
    """Refuse what is no kind that a user can state.

    Raises
    ------
    InputError
        On anything but ``real`` and ``simulated``.
    """
    if kind not in ("real", "simulated"):
        raise located("--kind", kind, "real or simulated")


def word_of_user(kind: str) -> str:
    """The remark that stands beside everything whose kind is the user's word."""
    return f"That these people are {kind} is the word of whoever made this report (--kind)."


def _known_kind(source: str | DataSet) -> str:
    """The kind of a side that a card states; empty if none does."""
    if isinstance(source, DataSet):
        return "" if source.card.kind == "unstated" else source.card.kind
    if is_fit(source):
        from models.posterior_files import read_posterior

        source = str(read_posterior(source).settings.get("provenance", {}).get("data", ""))
    return datasets.card(source).kind if source in datasets.names() else ""


def data_side(
    label: str, source: str | DataSet, fit: Fit, *, states: str | None, condition: Sequence[str] | None = None,
    pins: Sequence[str] | None = None, protocol: Protocol | None = None, kind: str | None = None,
) -> Side:  # fmt: skip
    """A data set as one side.

    Parameters
    ----------
    label : str
    source : str or DataSet
        A name, an event file, or a data set as it is, with its card.
    fit : callable
    states, condition, pins
        As options of commands; the card's by default.
    protocol : Protocol, optional
        For reading; a data set has been read.
    kind : str, optional
        What the user says its people are, where no card does (`stated_kinds`).

    Raises
    ------
    InputError
        On what cannot be read, unknown conditions or actions, a data set that follows another protocol.
    """
    name = name_of(source)
    if isinstance(source, DataSet):
        if protocol is not None and protocol != source.log.protocol:
            raise located(
                f"--compare, {label}, protocol", protocol.name, f"{source.log.protocol.name!r}, as the data"
            )
        return _data_side(label, name, _of_kind(source, kind), fit, states, condition, pins)
    if Path(name).suffix.lower() == ".json":
        raise located(f"--compare, {label}", name, "a data set, an event file or a fit (.nc)")
    try:
        dataset = datasets.load(name) if protocol is None else datasets.load(name, protocol)
    except InputError as error:
        raise InputError(f"--compare, {label}: {error}") from None
    return _data_side(label, name, _of_kind(dataset, kind), fit, states, condition, pins)


def _of_kind(dataset: DataSet, kind: str | None) -> DataSet:
    if kind is None:
        return dataset
    return replace(
        dataset, card=replace(dataset.card, kind=kind), notes=(*dataset.notes, word_of_user(kind))
    )  # fmt: skip


def _data_side(
    label: str, name: str, dataset: DataSet, fit: Fit, states: str | None, condition: Sequence[str] | None,
    pins: Sequence[str] | None,
) -> Side:  # fmt: skip
    chosen = select(dataset, condition, states, pins)
    log = chosen.log
    study = fit(log, chosen.states, dict.fromkeys(chosen.pins))
    bootstraps = {
        k: ModelDraws(
            log.protocol, b.initial, b.transition, b.emission, np.full(b.replicates, 1 / b.replicates),
            {"source": name}, study.fits[k].model.state_names, study.fits[k].model.reward,
            study.fits[k].model.cautions,
        )
        for k, b in study.bootstraps.items()
    }  # fmt: skip
    kinds = sorted({b.kind for b in study.bootstraps.values()})
    facts = {
        "what it is": dataset.card.what or "not stated", "source": dataset.card.source,
        "conditions": ", ".join(log.conditions), "actions held fixed": ", ".join(chosen.pins) or "none",
        "people": f"{log.n_participants:,}", "runs": f"{log.n_runs:,}", "events": f"{log.n_events:,}",
        "responses": f"{log.n_responses_recorded:,}", "numbers of states": ", ".join(map(str, study.states)),
    }  # fmt: skip
    return Side(
        label, name, dataset.card.title, dataset.card.kind, dataset.digest, facts,
        {k: f.model for k, f in study.fits.items()}, bootstraps, ", ".join(kinds), log, study,
        tuple(dataset.notes), {k: _not_learned(found) for k, found in study.identifications.items()},
    )  # fmt: skip


def _not_learned(found: Identification) -> tuple[str, ...]:
    moves = (*found.pinned, *found.silent_transitions)
    return (*(f"transition[{a}]" for a in moves), *(f"emission[{a}]" for a in found.silent_emissions))


def fit_side(label: str, name: str, protocol: Protocol | None = None, kind: str | None = None) -> Side:
    """A stored posterior as one side: its draws, and their mean as the estimate.

    Parameters
    ----------
    label, name : str
    protocol : Protocol, optional
        Has to be the fit's own.
    kind : str, optional
        What the user says its people are, where its data have no card (`stated_kinds`).

    Raises
    ------
    InputError
        On what cannot be read, a fit whose tables differ between groups or people, or one of another protocol.
    """
    from models.posterior_files import read_posterior
    from models.robust.candidates import posterior_mean

    fit = read_posterior(name)
    if fit.groups or fit.people_differ:
        found = "one whose tables differ between groups" if fit.groups else "one in which people differ"
        raise located(f"--compare, {name}", found, "a fit with one set of tables")
    if protocol is not None and protocol != fit.protocol:
        raise located("--protocol", protocol.name, f"none: {name} has its own, {fit.protocol.name!r}")
    draws = fit.draws()
    origin = fit.settings.get("provenance", {})
    data = str(origin.get("data", "not stated"))
    known = datasets.card(data).kind if data in datasets.names() else "unstated"
    pinned = tuple(fit.settings.get("pins", ()))
    evidence = recorded_evidence(fit.settings, fit.protocol)
    silent = () if evidence is None else unseen_actions(evidence, fit.protocol)
    facts = {
        "what it is": f"posterior of the model with {counted(fit.n_states, 'state')}", "source": data,
        "draws": f"{draws.n_draws:,}", "gate": fit.gate.sentence,
        "actions held fixed": ", ".join(pinned) or "none",
    }  # fmt: skip
    warnings = () if fit.gate.passed else (f"{name} failed its gate: {'; '.join(fit.gate.reasons)}",)
    warnings = warnings if kind is None else (*warnings, word_of_user(kind))
    return Side(
        label, name, f"Posterior {Path(name).name}", kind or known, str(origin.get("data_digest", "")), facts,
        {fit.n_states: posterior_mean(draws)}, {fit.n_states: draws}, "posterior", warnings=warnings,
        not_learned={fit.n_states: tuple(f"transition[{a}]" for a in (*pinned, *silent))},
    )  # fmt: skip


def shared_states(a: Side, b: Side) -> tuple[int, ...]:
    """Numbers of states that both sides have.

    Raises
    ------
    InputError
        If there are none, or the sides follow different protocols.
    """
    if a.protocol != b.protocol:
        raise InputError(
            f"--compare: {a.name} follows the protocol {a.protocol.name!r}, {b.name} follows "
            f"{b.protocol.name!r}; two that follow the same one were wanted"
        )
    both = tuple(k for k in a.estimates if k in b.estimates)
    if not both:
        own = [", ".join(map(str, s.estimates)) for s in (a, b)]
        raise located(
            "--compare, numbers of states", f"{own[0]} in {a.name}, {own[1]} in {b.name}", "one that both have"
        )
    return both


def states_for(a: str | DataSet, b: str | DataSet, states: str | None) -> str | None:
    """Numbers of states that a data set has to be fitted with: a fit on the other side decides."""
    from models.posterior_files import read_posterior

    sizes = {read_posterior(one).n_states for one in (a, b) if isinstance(one, str) and is_fit(one)}
    if states is not None:
        missing = sizes - set(parse_states(states))
        if missing:
            raise located("--states", states, f"{', '.join(map(str, sorted(sizes)))}, which the fit has")
        return states
    return ",".join(map(str, sorted(sizes))) if sizes else None
