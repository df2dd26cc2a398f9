r"""The compiled expectation-maximisation loop on a prefix tree.

One parameter vector ``theta = [initial, transition, emission]`` (flattened) is mapped by
:math:`F(\theta)`: expected counts ``theta * gradient`` plus prior pseudo-counts, normalised by row. Rows without
any count stay where they are. `em` iterates `F` and, where asked, extrapolates it with SQUAREM (Varadhan & Roland
2008, scheme S3); a step that would lower the objective is not taken, so the trace never decreases either way.
"""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.forward_backward import sweep


@kernel
def objective_and_step(  # type: ignore[no-untyped-def]
    theta, new, tree, sizes, emission_index, pseudo, free, gradient, work, scale
):
    """Write F(theta) into `new`; return the log-likelihood at `theta` and the log-prior of its free rows.

    `sizes` is (states, actions, emission tables, responses), `pseudo` the Dirichlet parameters minus one in the
    layout of theta, `free` marks the entries that may move.
    """
    states, actions, tables, responses = sizes
    first, second = states, states + actions * states * states
    gradient[:] = 0.0
    value = sweep(
        tree,
        theta[:first].reshape(1, states),
        theta[first:second].reshape(actions, states, states),
        theta[second:].reshape(tables, states, responses),
        emission_index,
        gradient[:first].reshape(1, states),
        gradient[first:second].reshape(actions, states, states),
        gradient[second:].reshape(tables, states, responses),
        work,
        scale,
    )
    prior = 0.0
    start = 0
    for row in range(1 + actions * states + tables * states):
        width = responses if row >= 1 + actions * states else states
        total = 0.0
        for i in range(start, start + width):
            if free[i]:
                if pseudo[i] != 0.0:
                    prior += pseudo[i] * np.log(theta[i])
                new[i] = theta[i] * gradient[i] + pseudo[i]
                total += new[i]
        for i in range(start, start + width):
            if not free[i] or not total > 0.0:
                new[i] = theta[i]
            else:
                new[i] /= total
        start += width
    return value, prior


@kernel
def _extrapolate(theta, one, two, out, sizes, free):  # type: ignore[no-untyped-def]
    """SQUAREM step from three consecutive iterates, kept inside the simplexes; False if it is plain EM."""
    r2, v2 = 0.0, 0.0
    for i in range(len(theta)):
        r = one[i] - theta[i]
        v = two[i] - one[i] - r
        r2 += r * r
        v2 += v * v
    if not v2 > 0.0:
        return False
    length = np.sqrt(r2 / v2)
    if not length > 1.0:
        return False
    for i in range(len(theta)):
        r = one[i] - theta[i]
        v = two[i] - one[i] - r
        value = theta[i] + 2.0 * length * r + length * length * v
        # Stepping outside would pin an entry to zero for good: stay a little inside instead.
        out[i] = value if value > 0.0 or not free[i] else 0.01 * two[i]
    states, actions, tables, responses = sizes
    start = 0
    for row in range(1 + actions * states + tables * states):
        width = responses if row >= 1 + actions * states else states
        total = 0.0
        moved = False
        for i in range(start, start + width):
            total += out[i]
            moved = moved or out[i] != theta[i]
        if moved:  # pinned rows and rows without evidence keep every bit, even where they sum to 1 - 1e-16
            for i in range(start, start + width):
                out[i] /= total
        start += width
    return True


@kernel
def em(  # type: ignore[no-untyped-def]
    theta, tree, sizes, emission_index, pseudo, free, cap, tolerance, patience, accelerate, stop
):
    """Iterate to convergence or to the cap.

    Returns the final theta, the trace of the objective (one entry an accepted iterate), the final
    log-likelihood, the gradient there, the number of EM maps computed and whether the gain stayed below
    `tolerance` for `patience` accepted iterates in a row. Another thread ends the run by setting ``stop[0]``.
    """
    nodes = len(tree.action)
    states = sizes[0]
    work = np.empty((2, nodes, states))
    scale = np.empty((2, nodes))
    gradient = np.empty(len(theta))
    spare = np.empty(len(theta))
    current = theta.copy()
    one = np.empty(len(theta))
    two = np.empty(len(theta))
    far = np.empty(len(theta))
    trace = np.empty(cap + 1)
    maps, entries, quiet = 0, 0, 0
    value, prior = objective_and_step(
        current, one, tree, sizes, emission_index, pseudo, free, gradient, work, scale
    )
    objective = value + prior
    trace[entries] = objective
    entries += 1
    converged = False
    # Invariant: `one` is F(current), `objective` is the objective at `current`.
    while maps < cap and objective > -np.inf and stop[0] == 0:
        value, prior = objective_and_step(
            one, two, tree, sizes, emission_index, pseudo, free, gradient, work, scale
        )
        maps += 1
        reached = value + prior
        taken = False
        if accelerate and maps < cap and _extrapolate(current, one, two, far, sizes, free):
            far_value, far_prior = objective_and_step(
                far, spare, tree, sizes, emission_index, pseudo, free, gradient, work, scale
            )
            maps += 1
            if far_value + far_prior >= reached:
                current, far = far, current
                one, spare = spare, one
                reached = far_value + far_prior
                taken = True
        if not taken:
            current, one, two = one, two, current
        gain = reached - objective
        objective = reached
        trace[entries] = objective
        entries += 1
        quiet = quiet + 1 if gain < tolerance else 0
        if quiet >= patience:
            converged = True
            break
    value, prior = objective_and_step(
        current, one, tree, sizes, emission_index, pseudo, free, gradient, work, scale
    )
    return current, trace[:entries].copy(), value, gradient, maps, converged
