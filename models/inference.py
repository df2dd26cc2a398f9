"""What a model with known tables says of an event log: likelihood, smoothed states, most probable paths."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from models import forward_backward
from models.errors import located
from models.events import EventLog
from models.histories import HistoryTree
from models.lspomdp import LatentStatePOMDP
from models.parameters import Array


def log_likelihood(model: LatentStatePOMDP, log: EventLog) -> float:
    """Log-likelihood of a log, summed over runs; ``-inf`` if a run is impossible under the model."""
    return float(run_log_likelihoods(model, log).sum())


def run_log_likelihoods(model: LatentStatePOMDP, log: EventLog) -> Array:
    """Log-likelihood of each run of a log; shape ``[runs]``."""
    tree = _tree(model, log)
    values = forward_backward.history_log_likelihoods(tree, *_tables(model))
    return values[np.searchsorted(tree.terminals, tree.run_node)]


def smoothed(model: LatentStatePOMDP, log: EventLog) -> Array:
    """State probabilities of every event given its whole run, ``[events, s]``; NaN in impossible runs."""
    tree = _tree(model, log)
    found = forward_backward.smooth(tree, *_tables(model))
    return found.probability[_event_rows(log, tree, found.offsets)]


def most_probable_path(model: LatentStatePOMDP, log: EventLog) -> tuple[float, NDArray[np.int64]]:
    """Viterbi paths: their joint log-probability summed over runs, and the state of every event."""
    tree = _tree(model, log)
    found = forward_backward.decode(tree, *_tables(model))
    history = np.searchsorted(tree.terminals, tree.run_node)
    return float(found.log_probability[history].sum()), found.state[_event_rows(log, tree, found.offsets)]


def _tree(model: LatentStatePOMDP, log: EventLog) -> HistoryTree:
    if model.protocol != log.protocol:
        raise located("event log, protocol", log.protocol.name, f"that of the model, {model.protocol.name!r}")
    return log.tree()


def _tables(model: LatentStatePOMDP) -> tuple[Array, Array, Array, NDArray[np.int64]]:
    return model.initial, model.transition, model.emission, model.emission_index


def _event_rows(log: EventLog, tree: HistoryTree, offsets: NDArray[np.int64]) -> NDArray[np.int64]:
    """Row of each event of the log among the rows of its distinct history."""
    history = np.searchsorted(tree.terminals, tree.run_node)
    return np.repeat(offsets[history], np.diff(log.offsets)) + log.k
