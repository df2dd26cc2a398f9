"""Who takes part in predicting people who were left out: rivals, types, mixed model, states, people who differ."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from analysis.forecasters import Contender
from analysis.held_out_latent import Fitter, latent
from analysis.held_out_mixed import mixed
from analysis.held_out_people import hierarchical
from analysis.held_out_rivals import rivals
from models.bayesian_fit import fit
from models.events import EventLog
from models.joint_predictive import LETTING_IN
from models.nuts import NutsSettings
from models.parameters import STICKY, Array, DirichletPrior
from models.person_offset import PersonOffset
from models.posterior import Posterior
from models.rivals import static_pins
from models.smc import SmcSettings

HIERARCHICAL_PARTICLES = 150
"""Of a run of the joint log predictive where people differ: half of the plain models', as a gradient costs more."""


def standard_contenders(
    log: EventLog,
    states: tuple[int, ...] = (2, 3),
    *,
    types: tuple[int, ...] = (2,),
    pins: Mapping[str, Array | None] | None = None,
    prior: DirichletPrior = STICKY,
    sampler: NutsSettings | None = None,
    fitter: Fitter | None = None,
    people: PersonOffset | None = None,
    draws: int = 1000,
    seed: int = 1,
) -> list[Contender]:
    """The rivals without a latent state, static mixtures of types, the mixed model, and the latent-state models.

    Parameters
    ----------
    log : EventLog
        The study, for its protocol and its design.
    states : tuple of int
        Numbers of states; one state is the constant rival and is left to it.
    types : tuple of int
        Numbers of types of the static mixtures.
    pins : mapping, optional
        Transition tables held fixed in the latent-state models (None: the identity).
    prior : DirichletPrior
        Its emission parameter is also the rivals'.
    sampler : NutsSettings, optional
        Where no `fitter` is given.
    fitter : callable, optional
        Where a store of fits is at hand; `models.bayesian_fit.fit` by default.
    people : PersonOffset, optional
        Also the hierarchical version, in which people differ, of no state and of the fewest states.
    draws : int
        Draws of parameters, at most.
    seed : int
    """

    def sampled(
        rest: EventLog, k: int, held: Mapping[str, Array | None], offsets: PersonOffset | None
    ) -> Posterior:
        return fit(rest, k, prior=prior, pins=held, people=offsets, sampler=sampler or NutsSettings(seed=seed))

    learn_with = fitter or sampled
    moves = SmcSettings(LETTING_IN.particles, LETTING_IN.runs, moves=LETTING_IN.moves, seed=seed)
    some = sorted({k for k in states if k > 1})

    def plain(name: str, kind: str, k: int, held: Mapping[str, Array | None]) -> Contender:
        return latent(name, kind, k, pins=held, prior=prior, fitter=learn_with, draws=draws, moves=moves)

    made = [
        *rivals(prior.emission, draws, seed),
        *(plain(f"{n} types", "types", n, static_pins(log.protocol)) for n in types),
        mixed(log, draws, seed),
        *(plain(f"{k} states", "states", k, dict(pins or {})) for k in some),
    ]
    if people is not None:
        fewer = replace(moves, particles=HIERARCHICAL_PARTICLES)
        made += [
            hierarchical(
                k, people=people, pins=dict(pins or {}), prior=prior, fitter=learn_with, draws=draws, moves=fewer
            )
            for k in (1, *some[:1])
        ]
    return made
