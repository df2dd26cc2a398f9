"""Small posteriors for the tests of the uncertainty views: sampled once, or made of given tables."""

from __future__ import annotations

from functools import cache

import numpy as np
import xarray as xr

from analysis.simulate import simulate_study1
from models.bayesian_fit import fit
from models.gate import Gate
from models.lspomdp import LatentStatePOMDP
from models.nuts import NutsSettings
from models.posterior import Posterior
from models.protocol import PUBLISHED

SHORT = NutsSettings(200, 200, 2)


@cache
def study():
    """The bundled design with fewer people."""
    return simulate_study1(participants=240)


@cache
def sampled(states, people=240):
    """Posterior of a simulated study, shared by all tests of a session."""
    return fit(simulate_study1(participants=people), states, sampler=SHORT)


def posterior_of(models, prior=None, weights=(1.0, 1.0)):
    """Posterior whose draws are given models, all in one chain."""

    def group(given):
        tables = {
            "initial": ("chain", "draw", "state"),
            "transition": ("chain", "draw", "action", "state", "state_next"),
            "emission": ("chain", "draw", "emission_action", "state", "response"),
        }
        return xr.Dataset({k: (d, np.stack([getattr(m, k) for m in given])[None]) for k, d in tables.items()})

    data = xr.DataTree.from_dict({"posterior": group(models), "prior": group(prior or models)})
    gate = Gate(0, 1.0, 1000.0, 1000.0, "nothing")
    return Posterior(data, models[0].protocol, gate, {"pins": {}}, np.array(weights), 0.0, 0.0)


def random_model(rng, states=2, protocol=PUBLISHED):
    """A model drawn uniformly."""
    shape = len(protocol.emission_actions), states
    return LatentStatePOMDP(
        rng.dirichlet(np.ones(states)),
        rng.dirichlet(np.ones(states), (protocol.n_actions, states)),
        rng.dirichlet(np.ones(protocol.n_responses), shape),
        protocol,
    )
