r"""Study 2 again and again: how often the paper's conclusions come out where the truth is known.

In each *world* the robot learns from a study 1 of its own (or knows the truth), plans, and plays many studies 2
with new people. Studies of one world share what was learned, so the share of studies that lead to a conclusion has
a standard error over worlds. Nothing is tuned towards the printed numbers; what comes out is reported as found.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import CancelledError, Executor
from dataclasses import dataclass, field
from threading import Event
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.replicates import Progress, run_replicates
from analysis.study2 import FEWEST, Study2, run_study2
from analysis.study2_claims import CLAIMS, EFFECTS, MEASURED, Facts, as_printed
from analysis.study2_learning import EM, STATES, TRUTH, learned_anew, learned_from
from analysis.study2_outcomes import OBSERVED, OUTCOMES, TEAM
from analysis.study2_policies import ALPHA, FROM_DRAWS, LS_POMDP, MORE, PAPER, make_policies
from models.errors import located
from models.lspomdp import LatentStatePOMDP
from models.nuts import NutsSettings

Array = NDArray[np.float64]

STREAM = 7_206
"""First element of the spawn keys; kind of learning and world follow."""

KINDS = (EM, TRUTH)
"""How the robot learned: from a study 1, or perfectly."""

COMPARED = tuple(p for p in PAPER if p != LS_POMDP)


@dataclass(frozen=True)
class Study2Replicates:
    """One such simulation.

    Attributes
    ----------
    truth : LatentStatePOMDP
    kind : {"em", "truth"}
        How the robot learned.
    replicates : int
        Studies 2; a multiple of `worlds`.
    worlds : int
        Times that the robot learns.
    people : int
        Under each policy of a study.
    study1 : int
        People of each study 1.
    states : int
        That are fitted.
    sampler : NutsSettings
        Of the posteriors; its seed is not used: every world has its own.
    alpha : float
        Share of the draws that the cautious plan looks at.
    seed : int
    """

    truth: LatentStatePOMDP
    kind: str = EM
    replicates: int = 1000
    worlds: int = 25
    people: int = 20
    study1: int = 540
    states: int = STATES
    sampler: NutsSettings = field(default_factory=lambda: NutsSettings())
    alpha: float = ALPHA
    seed: int = 1

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise located("replicates of study 2, kind of learning", self.kind, f"one of {', '.join(KINDS)}")
        least = {"replicates": 2, "worlds": 2, "people": FEWEST, "study1": 2, "states": 1, "seed": 0}
        for name, low in least.items():
            if getattr(self, name) < low:
                raise located(f"replicates of study 2, {name}", getattr(self, name), f"at least {low}")
        if self.replicates % self.worlds:
            raise located(
                "replicates of study 2, replicates",
                self.replicates,
                f"a multiple of {self.worlds} worlds (--worlds)",
            )

    @property
    def policies(self) -> tuple[str, ...]:
        """Policies that are compared; with the truth known there is no doubt to plan with."""
        return PAPER + tuple(p for p in MORE if self.kind == EM or p not in FROM_DRAWS)

    @property
    def planners(self) -> tuple[str, ...]:
        """Policies that take the place of the paper's own, which comes first."""
        return (LS_POMDP, *(p for p in self.policies if p in MORE))


@dataclass(frozen=True)
class WorldResult:
    """What came of one world.

    Attributes
    ----------
    claims : dict of str to bool[study, claim]
        By planner, claims in the order of `analysis.study2_claims.CLAIMS`.
    numbers : dict of str to float64[study, quantity]
        By planner, the quantities that the paper prints (`quantities`).
    means : dict of str to float64[policy]
        Means over all people of the world, by measure.
    missed : int
        Willing people who came too late.
    notes : tuple of str
    """

    claims: Mapping[str, NDArray[np.bool_]]
    numbers: Mapping[str, Array]
    means: Mapping[str, Array]
    missed: int
    notes: tuple[str, ...]


def quantities(published: Mapping[str, Any]) -> dict[str, float]:
    """Numbers that the paper prints, by name: every F, and every mean under a policy less that under its own."""
    study = published["study2"]
    out = {
        f"F {key}, {effect}": float(row["F"])
        for key in MEASURED
        for effect, row in study["mixed_anova"][key].items()
    }
    for key in (TEAM, OBSERVED):
        rows = study["tukey_minus_lspomdp"][key]
        out |= {f"difference {key}, {policy}": float(rows[policy][0]) for policy in COMPARED}
    return out


def run_world(settings: Study2Replicates, index: int, *, stop: Event | None = None) -> WorldResult:
    """Learn, plan, and run the studies of one world. Depends on its arguments only."""

    def may_go_on(*_: Any) -> None:
        if stop is not None and stop.is_set():
            raise CancelledError

    key = (STREAM, KINDS.index(settings.kind), index)
    learning, playing = (
        int(s) for s in np.random.SeedSequence(settings.seed, spawn_key=key).generate_state(2, np.uint32)
    )
    may_go_on()
    if settings.kind == TRUTH:
        learned = learned_from(TRUTH, settings.truth)
    else:
        learned = learned_anew(
            settings.truth, learning, participants=settings.study1, states=settings.states,
            sampler=settings.sampler, finished=may_go_on,
        )  # fmt: skip
    may_go_on()
    policies = make_policies(learned, settings.policies, alpha=settings.alpha)
    studies = settings.replicates // settings.worlds
    people = studies * settings.people * len(settings.policies)
    all_people = run_study2(
        policies, settings.truth, learned, people, seed=playing, threads=1, progress=may_go_on
    )  # fmt: skip
    claims: dict[str, list[list[bool]]] = {planner: [] for planner in settings.planners}
    numbers: dict[str, list[list[float]]] = {planner: [] for planner in settings.planners}
    for number in range(studies):
        may_go_on()
        study = _study(all_people, number, settings.people)
        for planner in settings.planners:
            facts = Facts.of(as_printed(study, planner), planner)
            claims[planner].append([bool(c.holds(facts)) for c in CLAIMS])
            numbers[planner].append(_numbers(facts))
    return WorldResult(
        {name: np.array(rows) for name, rows in claims.items()},
        {name: np.array(rows) for name, rows in numbers.items()},
        _means(all_people), all_people.missed, all_people.notes,
    )  # fmt: skip


def _study(everybody: Study2, number: int, people: int) -> Study2:
    """One study: the next people of every policy."""
    own = [everybody.of(p)[number * people : (number + 1) * people] for p in everybody.policies]
    return everybody.some(np.concatenate(own), everybody.policies)


def _numbers(facts: Facts) -> list[float]:
    """The quantities of `quantities`, in its order."""
    out = [facts.f[key, effect] for key in MEASURED for effect in EFFECTS]
    return out + [-facts.difference(key, policy) for key in (TEAM, OBSERVED) for policy in COMPARED]


def _means(study: Study2) -> dict[str, Array]:
    columns = {key: o.of_person(study) for key, o in OUTCOMES.items()}
    columns |= {"costly_actions": study.costly, "reward": study.reward}
    return {
        name: np.array([values[study.of(policy)].mean() for policy in study.policies])
        for name, values in columns.items()
    }


def replicate_study2(
    settings: Study2Replicates, *, executor: Executor | None = None, progress: Progress | None = None
) -> tuple[WorldResult, ...]:
    """Run all worlds.

    Parameters
    ----------
    settings : Study2Replicates
    executor : concurrent.futures.Executor, optional
        Threads of this process by default. No result depends on it.
    progress : callable, optional
        Called with (what is running, worlds done, worlds in all).
    """
    label = "worlds, learned" if settings.kind == EM else "worlds, truth known"
    return run_replicates(run_world, settings, settings.worlds, label=label, executor=executor, progress=progress)
