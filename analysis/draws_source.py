"""What plans under doubt are made from: a posterior's draws, or weighted models in a JSON file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.reward_options import reward_asked
from analysis.stakes import stakes_of_fit
from analysis.wording import counted
from models.errors import InputError, Phrase, located
from models.model_draws import ModelDraws
from models.model_files import read_json
from models.reward import Reward, default_x
from models.robust.people_draws import KINDS, people_draws
from models.unseen import evidence_of_actions, recorded_evidence, unseen_actions, without_actions

if TYPE_CHECKING:
    from models.gate import Gate
    from models.posterior import Posterior
    from models.protocol import Protocol

NETCDF = (b"\x89HDF", b"CDF\x01", b"CDF\x02", b"CDF\x05")
"""How netCDF files begin."""


@dataclass(frozen=True)
class DrawsSource:
    """Draws to plan with, and what was done to them.

    Attributes
    ----------
    path : str
    draws : ModelDraws
        With the reward asked for, and without the actions that are left out.
    available : int
        Draws in the file.
    fit : Posterior, optional
        The fit that they are from; None if they are models of a JSON file.
    unseen : tuple of str or None
        Actions that the data behind the fit hold no evidence on; None where nobody can tell.
    left_out : tuple of str
        Those of them that are left out.
    forced : bool
        The fit failed its gate and is used all the same.
    kinds : int
        Kinds of people in each draw of a fit in which people differ, where all of them count: draws of one draw of
        the fit follow each other.
    unused_costs : tuple of str
        Actions left out whose cost was asked for.
    """

    path: str
    draws: ModelDraws
    available: int
    fit: Posterior | None
    unseen: tuple[str, ...] | None
    left_out: tuple[str, ...]
    forced: bool
    kinds: int = 1
    unused_costs: tuple[str, ...] = ()

    @property
    def chains(self) -> int | None:
        """Chains that the draws come from, equally long and one after the other; None if nobody can tell."""
        if self.fit is None:
            return None
        chains = self.fit.gate.chains
        return chains if chains and (self.draws.n_draws // self.kinds) % chains == 0 else None

    @property
    def stakes(self) -> str:
        """What the people behind the fit played for, where it was not what the reward is about; else empty."""
        reward = self.draws.reward
        if self.fit is None or (reward is not None and reward.stated):
            return ""
        return stakes_of_fit(self.fit.settings.get("provenance"))

    @property
    def sentence(self) -> str:
        """What the draws are, in words."""
        d = self.draws
        draws = d.n_draws // self.kinds
        some = f"{counted(draws, 'draw')}"
        if draws < self.available:
            some += f" of {self.available:,}, evenly spaced"
        if self.kinds > 1:
            some += f", {self.kinds} kinds of people in each"
        kind = ("one model" if self.available == 1 else "weighted models") if self.fit is None else "posterior"
        stakes = f". {self.stakes.removesuffix('.')}" if self.stakes else ""
        return f"{self.path} ({kind}): {some}, {counted(d.n_states, 'state')}{stakes}"

    @property
    def warnings(self) -> list[str]:
        """What a reader has to know before believing any plan."""
        out, unseen = [], ", ".join(self.unseen or ())
        if self.forced and self.fit is not None:
            out.append(f"{self.path}: used although {self.fit.gate.sentence}")
        if self.left_out:
            out.append(
                f"{self.path}: left out {unseen}: the data hold no evidence on it, so what follows it is known "
                "from the prior only (--allow-unseen keeps it)"
            )
        elif self.unseen:
            out.append(f"{self.path}: the data hold no evidence on {unseen}: what follows it is the prior")
        elif self.unseen is None and self.fit is not None:
            out.append(
                f"{self.path}: which actions the data hold evidence on is not known (the data are not at hand), so "
                "none is left out"
            )
        if self.unused_costs:
            out.append(
                f"{self.path}: the cost of {', '.join(self.unused_costs)} is not used: the action is left out"
            )
        return out

    def to_dict(self) -> dict[str, Any]:
        """The source as commands give it in their JSON."""
        reward = self.draws.reward
        assert reward is not None
        costs = {a: reward.costs.get(a, c) for a, c in self.draws.protocol.costs.items()}
        return {
            "source": self.path, "draws": self.draws.n_draws, "available": self.available,
            "states": list(self.draws.model(0).state_names),
            "reward": {"r": reward.r, "x": list(reward.x), "costs": costs},
            "actions": list(self.draws.protocol.action_names), "unseen": self.unseen, "left_out": self.left_out,
            "cautions": list(self.draws.cautions), "stakes": self.stakes,
            "gate": None if self.fit is None else {
                "passed": self.fit.gate.passed, "reasons": self.fit.gate.reasons, "forced": self.forced
            },
        }  # fmt: skip


def read_draws(
    path: str | Path, *, draws: int | None = None, allow_unseen: bool = False, force: bool = False,
    group: str | None = None, person: float | None = None, people: bool = False, r: float | None = None,
    costs: Mapping[str, float | None] | None = None, protocol: Protocol | None = None,
) -> DrawsSource:  # fmt: skip
    """Read draws to plan with.

    Parameters
    ----------
    path : str or Path
        A fit (netCDF), or JSON: a list of model objects each with a `weight`, or one model.
    draws : int, optional
        So many evenly spaced draws; all by default.
    allow_unseen : bool
        Keep actions that the data hold no evidence on.
    force : bool
        Use a fit that failed its gate.
    group : str, optional
        Where tables differ between groups: whose.
    person : float, optional
        Where people differ: the person, in standard deviations of the offsets.
    people : bool
        Where people differ and no person is named: all kinds of people (`models.robust.people_draws`).
    r : float, optional
        Steepness of the reward instead of the draws' own, or the published one.
    costs : mapping, optional
        Costs by action; those that are None stay as they are.
    protocol : Protocol, optional
        That models in a JSON file follow if they name none.

    Raises
    ------
    InputError
        Whatever makes the file unusable, by its name: no such file, a fit that failed its gate, models that do not
        fit together, weights that do not sum to one, an unknown group or action.
    """
    path = str(path)
    if draws is not None and draws < 1:
        raise located("--draws", draws, "at least 1")
    fit, kinds = None, 1
    if _is_netcdf(path):
        fit = _fit(path, force, group, protocol)
        everybody = people and fit.people_differ and person is None
        _check_person(fit, person, everybody)
        try:
            own = people_draws(fit, KINDS, thin=draws) if everybody else fit.draws(person)
        except InputError as error:
            raise InputError(f"{path}: {error}") from None
        kinds = KINDS if everybody else 1
    else:
        for option, value in (("--group", group), ("--person", person)):
            if value is not None:
                raise located(option, value, f"no value: {path} holds models, not a fit")
        try:
            own = ModelDraws.from_json(read_json(path), path, protocol)
        except InputError as error:
            text = str(error)
            raise InputError(text if text.startswith(path) else f"{path}: {text}") from None
    available = own.n_draws if fit is None else len(fit.table("initial"))
    own = _rewarded(own if draws is None or kinds > 1 else own.thin(draws), r, costs or {})
    evidence = None if fit is None else _evidence(fit)
    unseen = None if evidence is None else unseen_actions(evidence, own.protocol)
    left_out = () if allow_unseen else (unseen or ())
    unused = tuple(name for name in left_out if (costs or {}).get(name) is not None)
    try:
        own = without_actions(own, left_out)
    except InputError as error:
        raise InputError(f"{path}, evidence: {error} (--allow-unseen plans with them all the same)") from None
    forced = fit is not None and not fit.gate.passed
    return DrawsSource(path, own, available, fit, unseen, left_out, forced, kinds, unused)


def _is_netcdf(path: str) -> bool:
    try:
        with Path(path).open("rb") as stream:
            return stream.read(4) in NETCDF
    except FileNotFoundError:
        raise InputError(f"{path}: no such file") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}") from None


def _fit(path: str, force: bool, group: str | None, protocol: Protocol | None) -> Posterior:
    from models.posterior_files import read_posterior

    fit = read_posterior(path)
    if protocol is not None and protocol != fit.protocol:
        raise located("--protocol", protocol.name, f"none: {path} has its own, {fit.protocol.name!r}")
    if not fit.gate.passed and not force:
        raise located(path, _failed(fit.gate), "a fit that passed its gate, or --force")
    if group is not None:
        try:
            fit = fit.of_group(group)
        except InputError as error:
            raise InputError(f"--group: {error}") from None
    elif fit.groups:
        raise located("--group", Phrase("none"), f"one of {', '.join(fit.groups)}: tables of {path} differ")
    return fit


def _check_person(fit: Posterior, person: float | None, everybody: bool) -> None:
    if fit.people_differ and person is None and not everybody:
        wanted = (
            "a person, in standard deviations of the offsets (0: the median one): people differ in this fit, and a "
            "plan without an end is for one kind of person (`robust` plans for all kinds, and learns whom it faces)"
        )
        raise located("--person", Phrase("none"), wanted)
    if person is not None and (not fit.people_differ or not np.isfinite(person)):
        wanted = "a finite number" if fit.people_differ else "no value: people do not differ in this fit"
        raise located("--person", person, wanted)


def _failed(gate: Gate) -> Phrase:
    return Phrase(f"a fit that failed its gate ({'; '.join(gate.reasons)})")


def _rewarded(draws: ModelDraws, r: float | None, costs: Mapping[str, float | None]) -> ModelDraws:
    """The draws with a reward of their own, changed as far as options say."""
    reward = draws.reward or Reward(default_x(draws.n_states))
    return replace(draws, reward=reward_asked(reward, draws.protocol, r, costs))


def _evidence(fit: Posterior) -> dict[str, int] | None:
    """Evidence on each action in what the fit learned from: as it says, or counted in the data it names."""
    recorded = recorded_evidence(fit.settings, fit.protocol)
    if recorded is not None:
        return recorded
    from analysis import datasets

    origin = fit.settings.get("provenance", {})
    name, digest = origin.get("data"), origin.get("data_digest")
    if not name or not digest or (name not in datasets.names() and not Path(name).is_file()):
        return None
    try:
        log = datasets.load(name, fit.protocol).log
    except InputError:
        return None
    if datasets.log_digest(log) != digest and "observed_data" in fit.data.children:
        # The fit may be of some conditions only: those of the runs that it names.
        named = fit.data["observed_data"].to_dataset()
        columns = (named[name].to_numpy().tolist() for name in ("participant", "sequence"))
        runs = set(zip(*columns, strict=True))
        own = zip(log.participant.tolist(), log.sequence.tolist(), log.condition.tolist(), strict=True)
        held = sorted({c for p, s, c in own if (p, s) in runs})
        if held:
            log = log.select(conditions=[log.conditions[c] for c in held])
    return evidence_of_actions(log, fit.settings.get("pins", ())) if datasets.log_digest(log) == digest else None
