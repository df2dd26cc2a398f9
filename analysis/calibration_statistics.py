"""What simulation-based calibration ranks: quantities that do not depend on how the states are numbered.

Either they are label-invariant, or they are read after the one canonical relabelling, which truth and draws go
through alike with the same weights.
"""

from __future__ import annotations

import numpy as np
from scipy.special import xlogy

from models.draw_kernels import history_log_likelihoods
from models.events import EventLog
from models.histories import UNSEEN
from models.labels import expected_score, stationary_distribution
from models.parameters import Array, Layout
from models.relabel import relabel_draws


def quantities(log: EventLog, layout: Layout, alpha: Array, theta: Array) -> tuple[list[str], Array]:
    """Names and values of everything that is ranked.

    Parameters
    ----------
    log : EventLog
        The simulated study: its responses enter the log-likelihood, its design everything else.
    layout : Layout
    alpha : float64[theta]
        Dirichlet parameters of the prior.
    theta : float64[..., theta]
        Draws, states in any order.

    Returns
    -------
    names : list of str
    values : float64[..., quantity]
    """
    protocol, lead = log.protocol, theta.shape[:-1]
    tree = log.tree()
    s, a, e, o = layout.sizes
    initial, transition, emission = relabel_draws(
        theta[..., :s],
        theta[..., s : s + a * s * s].reshape(*lead, a, s, s),
        theta[..., s + a * s * s :].reshape(*lead, e, s, o),
        protocol.scores,
        log.emission_weights,
    )
    score = expected_score(emission, protocol.scores, log.emission_weights)
    columns: dict[str, Array] = {
        "log-likelihood": history_log_likelihoods(tree, layout, theta) @ tree.arrays.ends[tree.terminals],
        "log-prior": xlogy(alpha - 1.0, theta).sum(axis=-1),
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
    return list(columns), np.stack(list(columns.values()), axis=-1)


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
