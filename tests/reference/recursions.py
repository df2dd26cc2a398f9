"""The forward-backward recursions of the model page on one plain run, and Viterbi's.

`log_likelihood` also takes complex tables, so that a derivative can be read off its imaginary part.
"""

import numpy as np


def evidence(run, emission, emission_index):
    """e_k(s) = O(o_k | s, a_k) where a response was seen, else 1; shape ``[k, s]``."""
    silent = np.ones(emission.shape[1])
    return [emission[emission_index[a], :, o] if o >= 0 else silent for a, o in run]


def log_likelihood(run, initial, transition, emission, emission_index):
    """Log of sum_s w_{K-1}(s), each step divided by its total."""
    alpha, logarithm = initial, 0.0
    for (a, _), e in zip(run, evidence(run, emission, emission_index), strict=True):
        weighted = alpha * e
        total = weighted.sum()
        if total == 0:
            return -np.inf
        logarithm = logarithm + np.log(total)
        alpha = (weighted / total) @ transition[a]
    return logarithm


def gradient_entry(runs, weights, tables, emission_index, which, position):
    """Derivative with respect to one entry by a complex step: exact to rounding, also at zero."""
    step = 1e-200
    moved = [table.astype(complex) for table in tables]
    moved[which][position] += 1j * step
    values = [log_likelihood(run, *moved, emission_index) for run in runs]
    return sum(w * np.imag(v) for w, v in zip(weights, values, strict=True)) / step


def smoothed(run, initial, transition, emission, emission_index):
    """gamma[k, s] and xi[k, s, s'] (k < K - 1), normalised."""
    e = evidence(run, emission, emission_index)
    forward, alpha = [], initial
    for (a, _), seen in zip(run, e, strict=True):
        forward.append(alpha)
        alpha = (alpha * seen) @ transition[a]
        alpha = alpha / alpha.sum()
    beta, gamma, xi = e[-1], [], []
    for k in range(len(run) - 1, -1, -1):
        if k < len(run) - 1:
            joint = (forward[k] * e[k])[:, None] * transition[run[k][0]] * beta
            xi.append(joint / joint.sum())
            beta = e[k] * (transition[run[k][0]] @ beta)
        beta = beta / beta.max()
        gamma.append(forward[k] * beta / (forward[k] @ beta))
    return np.array(gamma[::-1]), np.array(xi[::-1]).reshape(-1, len(initial), len(initial))


def log_space_likelihood(run, initial, transition, emission, emission_index):
    """The same number by log-sum-exp, which cannot underflow."""
    with np.errstate(divide="ignore"):
        log_transition = np.log(transition)
        log_alpha = np.log(initial)
        log_e = [np.log(e) for e in evidence(run, emission, emission_index)]
    for k, (a, _) in enumerate(run):
        weighted = log_alpha + log_e[k]
        log_alpha = np.logaddexp.reduce(weighted[:, None] + log_transition[a], axis=0)
    return np.logaddexp.reduce(weighted)


def viterbi(run, initial, transition, emission, emission_index):
    """Most probable path and its joint log-probability."""
    with np.errstate(divide="ignore"):
        log_transition = np.log(transition)
        score = np.log(initial)
        log_e = [np.log(e) for e in evidence(run, emission, emission_index)]
    pointers = []
    for k, e in enumerate(log_e):
        if k > 0:
            candidates = score[:, None] + log_transition[run[k - 1][0]]
            pointers.append(candidates.argmax(axis=0))
            score = candidates.max(axis=0)
        score = score + e
    path = [int(score.argmax())]
    for pointer in pointers[::-1]:
        path.append(int(pointer[path[-1]]))
    return path[::-1], float(score.max())
