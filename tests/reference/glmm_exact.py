"""The exact likelihood on an even grid: slow, and plainly right."""

import numpy as np
from scipy.optimize import brentq
from scipy.special import expit, log_expit, logsumexp

from models.glmm_exact import CLOSE, GROWTH, MARKS, WIDTHS


def exact_log_likelihood(patterns, theta):
    """Trapezoidal rule around the mode, where each integrand falls by at least half the squared distance.

    Poles lie at pi / sd from the real line, so a step of 0.5 / sd leaves 1e-16; no integrand is narrower than
    one over the root of its highest possible curvature.
    """
    eta, sd = patterns.offset + patterns.design @ theta[:-1], abs(theta[-1])
    total = patterns.constant
    for i in range(patterns.n_patterns):
        rows = slice(patterns.start[i], patterns.start[i + 1])
        hits, trials = patterns.successes[rows], patterns.trials[rows]
        slope = lambda u, x=eta[rows], y=hits, m=trials: sd * np.sum(y - m * expit(x + sd * u)) - u  # noqa: E731
        most = 1.0 + sd * trials.sum()
        mode = brentq(slope, -most, most, xtol=1e-9)
        step = min(0.05, 0.5 / max(sd, 1e-12), 0.5 / np.sqrt(1.0 + sd**2 * trials.sum() / 4))
        u = mode + np.arange(-12.0, 12.0, step)
        x = eta[rows, None] + sd * u
        log_p = np.sum(hits[:, None] * log_expit(x) + (trials - hits)[:, None] * log_expit(-x), axis=0)
        total += patterns.multiplicity[i] * (logsumexp(log_p - 0.5 * u * u) + np.log(step / np.sqrt(2 * np.pi)))
    return total


def cut_line(eta, hits, trials, s, mode, width, below, above):
    """Where the line is cut: all that is wanted in order, without what is too near to the last that was kept.

    Wanted are the ends, the mode, steps from it of its own width that grow up to one standard deviation, and marks
    around the edge of every row's probability of so many successes, and of so many failures.
    """
    steps = np.concatenate([np.full(WIDTHS, width), np.minimum(width * GROWTH ** np.arange(1.0, 120.0), 1.0)])
    away = np.cumsum(steps)
    wanted = [mode, *(mode + away[away < above]), *(mode - away[away < -below])]
    finest = width
    if s != 0:
        finest = min(width, 1 / abs(s))
        edges = [np.log(np.maximum(hits, 1)) - eta, -np.log(np.maximum(trials - hits, 1)) - eta]
        marks = np.add.outer(MARKS, np.concatenate(edges)).ravel() / s
        wanted += [u for u in marks if below < u - mode < above]
    first, last = mode + below, mode + above
    kept = [first]
    for u in sorted(wanted):
        if min(u - kept[-1], last - u) > CLOSE * finest:
            kept.append(u)
    return np.array([*kept, last])
