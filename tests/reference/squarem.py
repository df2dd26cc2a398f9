"""EM with SQUAREM (Varadhan & Roland 2008, scheme S3) on one vector of probability rows, step by step."""

import numpy as np


def extrapolated(theta, one, two, rows, free):
    """The point that three iterates point to, kept inside the simplexes; None where it is no more than plain EM."""
    r, v = one - theta, two - 2 * one + theta
    if not v @ v > 0 or (r @ r) / (v @ v) <= 1:
        return None
    length = np.sqrt((r @ r) / (v @ v))
    far = theta + 2 * length * r + length**2 * v
    far = np.where(free & (far <= 0), 0.01 * two, far)
    for row in rows:
        if np.any(far[row] != theta[row]):
            far[row] /= far[row].sum()
    return far


def climb(theta, step, rows, free, *, cap, tolerance, patience, accelerate):
    """Iterate ``step(theta) -> (F(theta), objective at theta)``.

    Returns the last theta, the objective at every accepted iterate, the number of maps after the first, and whether
    the last `patience` gains were all below `tolerance`.
    """
    one, objective = step(theta)
    trace, gains, maps = [objective], [], 0
    while maps < cap and np.isfinite(objective):
        two, reached = step(one)
        maps += 1
        following = one, two
        far = extrapolated(theta, one, two, rows, free) if accelerate and maps < cap else None
        if far is not None:
            beyond, value = step(far)
            maps += 1
            if value >= reached:
                following, reached = (far, beyond), value
        theta, one = following
        gains.append(reached - objective)
        objective = reached
        trace.append(objective)
        if len(gains) >= patience and max(gains[-patience:]) < tolerance:
            return theta, trace, maps, True
    return theta, trace, maps, False
