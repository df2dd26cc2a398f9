"""What simulation-based calibration ranks: quantities that do not depend on how the states are numbered.

Either they are label-invariant, or they are read after the one canonical relabelling, which truth and draws go
through alike with the same weights.
"""

from __future__ import annotations

import numpy as np
from scipy.special import xlogy

from models.draw_kernels import history_log_likelihoods, person_log_likelihoods
from models.events import EventLog
from models.histories import UNSEEN
from models.labels import expected_score, stationary_distribution
from models.parameters import Array
from models.person_offset import quadrature
from models.relabel import relabel_draws
from models.study_density import StudyDensity

NODES = 21
"""Of the quadrature over people; any number would do, since truth and draws go through the same."""


def quantities(study: StudyDensity, theta: Array) -> tuple[list[str], Array]:
    """Names and values of everything that is ranked.

    Where people differ, what follows from the tables is about the person in the middle, whose offset is zero;
    sigma, the log-likelihood (offsets integrated out) and what is said of all people know of the others.

    Parameters
    ----------
    study : StudyDensity
        The simulated study and its model, tables alike in all groups: its responses enter the log-likelihood, its
        design everything else.
    theta : float64[..., theta]
        Draws, states in any order; sigma last where people differ.

    Returns
    -------
    names : list of str
    values : float64[..., quantity]
    """
    log, layout, density = study.events, study.layout, study.density
    protocol, tree = log.protocol, density.tree
    s, a, _, _ = layout.sizes
    entries = theta[..., : layout.size]
    initial, transition, emission = relabel_draws(*layout.unpack(entries), protocol.scores, log.emission_weights)
    score = expected_score(emission, protocol.scores, log.emission_weights)
    columns: dict[str, Array] = {
        "log-likelihood": history_log_likelihoods(tree, layout, entries) @ tree.arrays.ends[tree.terminals],
        "log-prior": xlogy(density.alpha - 1.0, entries).sum(axis=-1),
        "expected score, first round": np.sum(initial * score, axis=-1),
        "share of the top state at the start": initial[..., -1],
        "probability of staying, mean": np.einsum("...ass->...", transition) / (a * s),
    }
    for c, name in enumerate(log.conditions):
        columns[f"expected score, last response, {name}"] = _last_score(log, c, initial, transition, emission)
    by_action = emission @ np.asarray(protocol.scores)
    for mode in protocol.modes:
        null = protocol.action(mode.null_action)
        for action in mode.actions:
            index = protocol.action(action.name)
            if index == null:
                continue
            to_top = transition[..., index, :, -1] - transition[..., null, :, -1]
            columns[f"{action.name} - {mode.null_action}, to the top state"] = to_top.mean(axis=-1)
            if mode.shows_response:
                own, base = (by_action[..., protocol.emission_index[i], :] for i in (index, null))
                columns[f"{action.name} - {mode.null_action}, score at the start"] = np.sum(
                    initial * (own - base), axis=-1
                )
    for index, name in enumerate(protocol.action_names):
        share = stationary_distribution(transition[..., index, :, :])
        columns[f"expected score after always {name}"] = np.sum(share * score, axis=-1)
    for i in range(s):
        columns[f"expected score of state {i}"] = score[..., i]
    if density.people_differ:
        spread, people = theta[..., -1], density.people
        columns["log-likelihood"] = person_log_likelihoods(density, theta, study.person, people) @ people.weight
        columns["log-prior"] = columns["log-prior"] - 0.5 * (spread / people.prior_scale[0]) ** 2
        columns["sigma"] = spread
        columns |= _between_people(study, initial, emission, spread)
    return list(columns), np.stack(list(columns.values()), axis=-1)


def _between_people(study: StudyDensity, initial: Array, emission: Array, spread: Array) -> dict[str, Array]:
    """How people's expected scores in the first round are distributed."""
    log, (z, log_weight) = study.log, quadrature(NODES)
    scores = np.asarray(log.protocol.scores)

    def first_round(offset: float) -> Array:
        tilted = emission * np.exp(offset * spread[..., None, None, None] * scores)
        tilted /= tilted.sum(axis=-1, keepdims=True)
        return np.sum(initial * expected_score(tilted, log.protocol.scores, log.emission_weights), axis=-1)

    by_person = np.stack([first_round(point) for point in z], axis=-1)
    mean = by_person @ np.exp(log_weight)
    return {
        "expected score, first round, all people": mean,
        "expected score, first round, variance between people": by_person**2 @ np.exp(log_weight) - mean**2,
    }


def _last_score(log: EventLog, condition: int, initial: Array, transition: Array, emission: Array) -> Array:
    """Expected score of the last recorded response of a condition's runs, nothing else of them being known."""
    weights: dict[tuple[int, ...], int] = {}
    for run in np.flatnonzero(log.condition == condition):
        events = slice(log.offsets[run], log.offsets[run + 1])
        seen = np.flatnonzero(log.response[events] != UNSEEN)
        if len(seen):
            actions = tuple(log.action[events][: seen[-1] + 1].tolist())
            weights[actions] = weights.get(actions, 0) + 1
    by_action = emission @ np.asarray(log.protocol.scores)
    total = np.zeros(initial.shape[:-1])
    for actions, count in weights.items():
        belief = initial
        for action in actions[:-1]:
            belief = np.einsum("...s,...st->...t", belief, transition[..., action, :, :])
        total += count * np.sum(belief * by_action[..., log.protocol.emission_index[actions[-1]], :], axis=-1)
    return total / max(sum(weights.values()), 1)
