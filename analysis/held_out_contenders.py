"""Who takes part in predicting people who were left out: rivals without a latent state, types, latent states."""

from __future__ import annotations

from collections.abc import Mapping

from analysis.forecasters import Contender
from analysis.held_out_latent import Fitter, latent
from analysis.held_out_rivals import rivals
from models.bayesian_fit import fit
from models.events import EventLog
from models.joint_predictive import LETTING_IN
from models.nuts import NutsSettings
from models.parameters import STICKY, Array, DirichletPrior
from models.posterior import Posterior
from models.rivals import static_pins
from models.smc import SmcSettings


def standard_contenders(
    log: EventLog,
    states: tuple[int, ...] = (2, 3),
    *,
    types: tuple[int, ...] = (2,),
    pins: Mapping[str, Array | None] | None = None,
    prior: DirichletPrior = STICKY,
    sampler: NutsSettings | None = None,
    fitter: Fitter | None = None,
    draws: int = 1000,
    seed: int = 1,
) -> list[Contender]:
    """The rivals without a latent state, static mixtures of types, and the latent-state models.

    Parameters
    ----------
    log : EventLog
        The study, for its protocol.
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
    draws : int
        Draws of parameters, at most.
    seed : int
    """

    def sampled(rest: EventLog, k: int, held: Mapping[str, Array | None]) -> Posterior:
        return fit(rest, k, prior=prior, pins=held, sampler=sampler or NutsSettings(seed=seed))

    moves = SmcSettings(LETTING_IN.particles, LETTING_IN.runs, moves=LETTING_IN.moves, seed=seed)
    wanted = [(f"{n} types", "types", n, static_pins(log.protocol)) for n in types]
    wanted += [(f"{k} states", "states", k, dict(pins or {})) for k in sorted(set(states)) if k > 1]
    made = [
        latent(
            name, kind, k, pins=held, prior=prior, fitter=fitter or sampled, draws=draws, moves=moves
        )
        for name, kind, k, held in wanted
    ]  # fmt: skip
    # The one place where another model joins, such as a mixed model: a Contender with a Forecaster of its own.
    return [*rivals(prior.emission, draws, seed), *made]
