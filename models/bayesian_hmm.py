"""The Bayesian hidden Markov model in PyMC, latent states marginalised: the front door and the reference.

``build_model`` returns a plain `pymc.Model`: an analyst reads its priors, changes them, adds to it. The likelihood
is one Op around the compiled kernel (`models.likelihood_op`); `models.hmm_density` is the same without PyMC.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pymc as pm
import pytensor.tensor as pt

from models.events import EventLog
from models.likelihood_op import log_likelihood
from models.lspomdp import default_state_names
from models.parameters import STICKY, Array, DirichletPrior, Layout, checked_pins, recorded


def build_model(
    log: EventLog, states: int, prior: DirichletPrior = STICKY, pins: Mapping[str, Array | None] | None = None
) -> pm.Model:
    r"""Build the model of one study.

    Priors: ``initial ~ Dirichlet``, ``transition[a, s] ~ Dirichlet(1 + kappa e_s)``; with two responses
    ``<response>_probability[e, s] ~ Beta`` for the response with the higher score, ``emission[e, s] ~ Dirichlet``
    otherwise. The likelihood enters as the potential ``log_likelihood``.

    Parameters
    ----------
    log : EventLog
        Missing responses and runs of different lengths are fine.
    states : int
    prior : DirichletPrior
        ``DirichletPrior(stay=kappa)`` is the sticky prior.
    pins : mapping, optional
        Transition tables held fixed (None: the identity). The others are then the free variable
        ``transition_learned`` and ``transition`` is a deterministic that holds all tables.

    Returns
    -------
    pymc.Model
        Labels are free: relabel draws before reading them (`models.relabel`).

    Raises
    ------
    InputError
        On a log without responses, or pins that do not fit.
    """
    recorded(log)
    layout = Layout(log.protocol, states)
    held = checked_pins(layout, pins or {})
    protocol = log.protocol
    free = [a for a in protocol.action_names if a not in held]
    names = list(default_state_names(states))
    coords = {
        "state": names, "state_next": names, "action": list(protocol.action_names), "learned_action": free,
        "emission_action": list(protocol.emission_actions), "response": list(protocol.response_names),
    }  # fmt: skip
    a_initial, a_transition, a_emission = layout.unpack(1.0 + prior.pseudo_counts(layout))
    with pm.Model(coords=coords) as model:
        initial = pm.Dirichlet("initial", a_initial, dims="state")
        if not held:
            transition = pm.Dirichlet("transition", a_transition, dims=("action", "state", "state_next"))
        else:
            tables = {a: pt.as_tensor_variable(table) for a, table in held.items()}
            if free:
                index = [protocol.action(a) for a in free]
                dims = ("learned_action", "state", "state_next")
                learned = pm.Dirichlet("transition_learned", a_transition[index], dims=dims)
                tables.update({a: learned[i] for i, a in enumerate(free)})
            stacked = pt.stack([tables[a] for a in protocol.action_names])
            transition = pm.Deterministic("transition", stacked, dims=("action", "state", "state_next"))
        if protocol.n_responses == 2:
            top = int(np.argmax(protocol.scores))
            high = pm.Beta(
                f"{protocol.response_names[top]}_probability", a_emission[..., top], a_emission[..., 1 - top],
                dims=("emission_action", "state"),
            )  # fmt: skip
            emission = pt.stack([1 - high, high] if top == 1 else [high, 1 - high], axis=-1)
        else:
            emission = pm.Dirichlet("emission", a_emission, dims=("emission_action", "state", "response"))
        pm.Potential("log_likelihood", log_likelihood(log.tree(), layout, initial, transition, emission))
    return model
