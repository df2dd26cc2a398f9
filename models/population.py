r"""Models of all people together, where people differ: the offset becomes part of the latent state.

A person's offset never changes, so a population in which it varies is again a latent-state model, whose state is
the pair (offset, state): it starts by the weights of the offsets, moves within each offset, and responds by the
tilted tables. Everything that plans for or predicts a new person can use it as it is.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtri

from models.errors import InputError, located
from models.event_rules import one_of
from models.model_draws import ModelDraws
from models.parameters import Array
from models.person_offset import quadrature
from models.posterior import SPREAD, TABLES, Posterior


def offsets(kinds: int) -> tuple[Array, Array]:
    """Representative standardised offsets and their weights, with variance one.

    Parameters
    ----------
    kinds : int
        How many kinds of people, in equal shares; 1 is the median person. From 15 on the trapezoid rule of the
        likelihood, whose kinds have normal weights.
    """
    if isinstance(kinds, bool) or not isinstance(kinds, int | np.integer) or kinds < 1:
        raise located("kinds of people", kinds, "an integer of at least 1")
    if kinds >= 15:
        z, log_weight = quadrature(int(kinds))
        return z, np.exp(log_weight)
    z = ndtri((np.arange(kinds) + 0.5) / kinds)
    if kinds > 1:
        z /= np.sqrt(np.mean(z**2))
    return z, np.full(kinds, 1.0 / kinds)


def population(posterior: Posterior, kinds: int = 7) -> ModelDraws:
    """Every draw as a model of the whole population, state ``(offset, state)``.

    Parameters
    ----------
    posterior : Posterior
        Of the hierarchical version.
    kinds : int
        Kinds of people that the continuous distribution of offsets is replaced by.

    Returns
    -------
    ModelDraws
        With ``kinds * states`` states, named ``s0 (-1.5 sd)`` and so on, those of one kind of person together.
    """
    if not posterior.people_differ:
        raise InputError("people do not differ in this posterior: draws() is the whole population")
    if posterior.groups:
        raise InputError(f"tables differ between groups: pick one with of_group, {one_of(posterior.groups)}")
    z, weight = offsets(kinds)
    spread = posterior.table(SPREAD)
    initial, transition, emission = (posterior.table(name) for name in TABLES)
    d, s = initial.shape
    actions = transition.shape[1]
    scores = np.asarray(posterior.protocol.scores)
    starts = (weight[None, :, None] * initial[:, None, :]).reshape(d, -1)
    moves = np.zeros((d, actions, kinds, s, kinds, s))
    for k in range(kinds):
        moves[:, :, k, :, k, :] = transition
    tilt = np.exp(spread[:, None, None] * z[:, None] * scores)  # [d, kind, response]
    tables = emission[:, :, None] * tilt[:, None, :, None, :]  # [d, e, kind, s, response]
    tables /= tables.sum(axis=-1, keepdims=True)
    names = tuple(f"s{i} ({point:+.1f} sd)" for point in z for i in range(s))
    return ModelDraws(
        posterior.protocol,
        starts,
        moves.reshape(d, actions, kinds * s, kinds * s),
        tables.reshape(d, len(posterior.protocol.emission_actions), kinds * s, -1),
        np.full(d, 1.0 / d),
        {**posterior.settings, "kinds_of_people": kinds},
        names,
        cautions=posterior.draws_cautions,
    )
