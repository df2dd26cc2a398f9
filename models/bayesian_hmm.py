"""The Bayesian hidden Markov model in PyMC, latent states marginalised: the front door and the reference.

``build_model`` returns a plain `pymc.Model`: an analyst reads its priors, changes them, adds to it. The likelihood
is one Op around the compiled kernel (`models.likelihood_op`); `models.hmm_density` is the same without PyMC.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pymc as pm
import pytensor.tensor as pt
import xarray as xr

from models.events import EventLog
from models.groups import Groups
from models.likelihood_op import log_likelihood
from models.lspomdp import default_state_names
from models.parameters import STICKY, Array, DirichletPrior, checked_pins
from models.person_offset import PersonOffset
from models.posterior import SPREAD
from models.simplex_op import rows_transform
from models.study_density import ModelSpec, StudyDensity


def build_model(
    log: EventLog,
    states: int,
    prior: DirichletPrior = STICKY,
    pins: Mapping[str, Array | None] | None = None,
    groups: Groups | None = None,
    people: PersonOffset | None = None,
) -> pm.Model:
    r"""Build the model of one study.

    Priors: ``initial ~ Dirichlet``, ``transition[a, s] ~ Dirichlet(1 + kappa e_s)``; with two responses
    ``<response>_probability[e, s] ~ Beta`` for the response with the higher score, ``emission[e, s] ~ Dirichlet``
    otherwise. Where people differ, ``person_sd ~ HalfNormal``. The likelihood enters as the potential
    ``log_likelihood``.

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
    groups : Groups, optional
        The tables that differ have a first dimension ``group``.
    people : PersonOffset, optional
        The hierarchical version.

    Returns
    -------
    pymc.Model
        Labels are free: relabel draws before reading them (`models.relabel`).

    Raises
    ------
    InputError
        On a log without responses, or pins or groups that do not fit.
    """
    return model_of(StudyDensity(log, ModelSpec(states, prior, dict(pins or {}), groups, people)))


def model_of(study: StudyDensity) -> pm.Model:
    """`build_model` of a study put together already."""
    spec, protocol, density = study.spec, study.log.protocol, study.density
    held = checked_pins(study.layout.base, spec.pins)
    free = [a for a in protocol.action_names if a not in held]
    names = list(default_state_names(spec.states))
    coords = {
        "state": names, "state_next": names, "action": list(protocol.action_names), "learned_action": free,
        "emission_action": list(protocol.emission_actions), "response": list(protocol.response_names),
    }  # fmt: skip
    differ: tuple[str, ...] = ()
    if spec.groups is not None:
        coords["group"] = list(spec.groups.labels)
        differ = spec.groups.differ
    a_initial, a_transition, a_emission = study.layout.base.unpack(density.alpha)
    n = study.layout.n_groups

    def own(table: str, alpha: Array, *dims: str) -> tuple[Array, tuple[str, ...]]:
        """Parameters and dimensions of a table, once a group if it differs between groups."""
        if table not in differ:
            return alpha, dims
        return np.broadcast_to(alpha, (n, *alpha.shape)), ("group", *dims)

    rows = rows_transform(spec.states)
    with pm.Model(coords=coords) as model:
        alpha, dims = own("initial", a_initial, "state")
        initial = pm.Dirichlet("initial", alpha, dims=dims, default_transform=rows)
        if not held:
            alpha, dims = own("transition", a_transition, "action", "state", "state_next")
            transition = pm.Dirichlet("transition", alpha, dims=dims, default_transform=rows)
        else:
            transition = _with_pins(study, held, free, own)
        if protocol.n_responses == 2:
            top = int(np.argmax(protocol.scores))
            alpha, dims = own("emission", a_emission, "emission_action", "state", "response")
            high = pm.Beta(
                f"{protocol.response_names[top]}_probability", alpha[..., top], alpha[..., 1 - top], dims=dims[:-1]
            )
            up = np.arange(2) == top
            # One elementwise operation; stacking takes several, each to be compiled.
            emission = np.where(up, 0.0, 1.0) + np.where(up, 1.0, -1.0) * high[..., None]
        else:
            alpha, dims = own("emission", a_emission, "emission_action", "state", "response")
            emission = pm.Dirichlet(
                "emission", alpha, dims=dims, default_transform=rows_transform(protocol.n_responses)
            )
        spread = None if spec.people is None else pm.HalfNormal(SPREAD, spec.people.scale)
        value = log_likelihood(
            density.tree, study.layout,
            _for_kernel(initial, "initial" in differ, n, True),
            _for_kernel(transition, "transition" in differ, n, False),
            _for_kernel(emission, "emission" in differ, n, False),
            spread, density.people,
        )  # fmt: skip
        pm.Potential("log_likelihood", value)
    return model


def learned_names(study: StudyDensity) -> list[str]:
    """Variables of the PyMC model that hold what is learned: the tables, and sigma where people differ."""
    protocol = study.log.protocol
    emission = "emission"
    if protocol.n_responses == 2:
        emission = f"{protocol.response_names[int(np.argmax(protocol.scores))]}_probability"
    return ["initial", "transition", emission, *([SPREAD] if study.density.people_differ else [])]


def learned_vector(study: StudyDensity, draws: xr.Dataset) -> Array:
    """Draws of the PyMC model as vectors ``[chain, draw, p]``, sigma last where people differ."""
    layout, protocol = study.layout, study.log.protocol
    differ = () if study.spec.groups is None else study.spec.groups.differ
    if protocol.n_responses == 2:
        top = int(np.argmax(protocol.scores))
        high = draws[f"{protocol.response_names[top]}_probability"].to_numpy()
        pair = (1 - high, high)
        emission = np.stack(pair if top == 1 else pair[::-1], axis=-1)
    else:
        emission = draws["emission"].to_numpy()
    tables = {
        "initial": draws["initial"].to_numpy(),
        "transition": draws["transition"].to_numpy(),
        "emission": emission,
    }
    full = []
    for name, table in tables.items():
        lead = table.shape[:2]
        if name not in differ:
            table = np.repeat(table[:, :, None], layout.n_groups, axis=2)
        full.append(table.reshape(*lead, -1))
    theta = np.empty((*full[0].shape[:2], layout.size))
    theta[..., layout.index] = np.concatenate(full, axis=-1)
    if study.density.people_differ:
        theta = np.concatenate([theta, draws[SPREAD].to_numpy()[..., None]], axis=-1)
    return theta


def _with_pins(study, held, free, own):  # type: ignore[no-untyped-def]
    """The deterministic ``transition``: held tables, and the learned ones where there are any."""
    protocol = study.log.protocol
    a_transition = study.layout.base.unpack(study.density.alpha)[1]
    grouped = study.spec.groups is not None and "transition" in study.spec.groups.differ
    tables = {a: pt.as_tensor_variable(table) for a, table in held.items()}
    if grouped:
        n = study.layout.n_groups
        tables = {a: pt.stack([table] * n) for a, table in tables.items()}
    if free:
        index = [protocol.action(a) for a in free]
        alpha, dims = own("transition", a_transition[index], "learned_action", "state", "state_next")
        learned = pm.Dirichlet(
            "transition_learned", alpha, dims=dims, default_transform=rows_transform(study.spec.states)
        )
        tables.update({a: learned[..., i, :, :] for i, a in enumerate(free)})
    stacked = pt.stack([tables[a] for a in protocol.action_names], axis=-3)
    dims = ("action", "state", "state_next")
    return pm.Deterministic("transition", stacked, dims=("group", *dims) if grouped else dims)


def _for_kernel(table, differs: bool, groups: int, is_initial: bool):  # type: ignore[no-untyped-def]
    """A table as the kernel wants it: groups joined with the actions; repeated where it is shared."""
    if groups == 1:
        return table
    if is_initial:
        return table if differs else pt.stack([table] * groups)
    if not differs:
        return pt.concatenate([table] * groups, axis=0)
    return table.reshape((groups * table.shape[1], table.shape[2], table.shape[3]))
