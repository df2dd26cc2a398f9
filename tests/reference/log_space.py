"""Forward-backward and filtering of one run in log space, which cannot underflow, however long the run."""

import numpy as np

from tests.reference.recursions import evidence


def _logs(run, initial, transition, emission, emission_index):
    with np.errstate(divide="ignore"):
        seen = np.log(np.array(evidence(run, emission, emission_index)))
        return np.log(initial), np.log(transition), seen


def _sum(values, axis):
    with np.errstate(invalid="ignore"):
        return np.logaddexp.reduce(values, axis=axis)


def forward_backward(run, initial, transition, emission, emission_index):
    """Log-likelihood, gamma[k, s], and the expected counts of the three tables."""
    log_initial, log_transition, seen = _logs(run, initial, transition, emission, emission_index)
    n = len(run)
    alpha, beta = np.empty((n, len(initial))), np.zeros((n, len(initial)))
    alpha[0] = log_initial + seen[0]
    for k in range(1, n):
        alpha[k] = _sum(alpha[k - 1][:, None] + log_transition[run[k - 1][0]], 0) + seen[k]
    for k in range(n - 2, -1, -1):
        beta[k] = _sum(log_transition[run[k][0]] + seen[k + 1] + beta[k + 1], 1)
    total = _sum(alpha[-1], 0)
    gamma = np.exp(alpha + beta - total)
    moves, shown = np.zeros_like(transition), np.zeros_like(emission)
    for k, (a, o) in enumerate(run):
        if k + 1 < n:
            moves[a] += np.exp(alpha[k][:, None] + log_transition[a] + seen[k + 1] + beta[k + 1] - total)
        if o >= 0:
            shown[emission_index[a], :, o] += gamma[k]
    return total, gamma, (gamma[0], moves, shown)


def filtered(run, initial, transition, emission, emission_index):
    """Belief before every event, and after the last one; ``[k + 1, s]``."""
    log_initial, log_transition, seen = _logs(run, initial, transition, emission, emission_index)
    belief, rows = log_initial, [initial]
    for (a, _), e in zip(run, seen, strict=True):
        belief = _sum((belief + e)[:, None] + log_transition[a], 0)
        rows.append(np.exp(belief - _sum(belief, 0)))
    return np.array(rows)
