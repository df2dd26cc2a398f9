"""A budget without a horizon: what is left of it joins the observed mode.

The amounts left are all that the budget can be reduced to by sums of charges, so there are finitely many however
long the interaction lasts, and `models.planning.solver.solve` plans for the product with a certificate. Once
nothing can be paid for any more, the free actions go on for ever.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from models.errors import Phrase, located
from models.lspomdp import LatentStatePOMDP
from models.planning.charges import Units, charges_of, checked_charges, in_units
from models.planning.latent import latent_problem
from models.planning.mode_process import ModeProcess, alternating
from models.planning.problem import Choice, Problem
from models.planning.product_modes import ProductModes

Index = NDArray[np.int64]

MOST_AMOUNTS = 1_000
"""Amounts left that are told apart."""


def budget_problem(
    model: LatentStatePOMDP, process: ModeProcess | None, discount: float, budget: float,
    charges: ArrayLike | None = None,
) -> tuple[Problem, ProductModes]:  # fmt: skip
    """The repeated interaction with a budget that no path exceeds.

    Parameters
    ----------
    model : LatentStatePOMDP
    process : ModeProcess or None
        How the mode moves; alternating from the protocol's first if None.
    discount : float
    budget : float
        What may be spent at most, for ever, in the unit of the charges.
    charges : float64[a], optional
        What each action is charged (`models.planning.charges.charges_of`): its cost by default.

    Returns
    -------
    problem : Problem
        Its modes are those of the model with every amount left; choices that cannot be paid for are not offered.
    product : ProductModes
        For `models.planning.product_policy.ProductPolicy.of`.

    Raises
    ------
    InputError
        On a budget or charges that are none, or too many amounts left.

    Examples
    --------
    >>> from models.lspomdp import LatentStatePOMDP
    >>> stays = LatentStatePOMDP([.5, .5], [[[1, 0], [0, 1]]] * 4, [[[.9, .1], [.2, .8]]] * 2)
    >>> problem, product = budget_problem(stays, None, .9, 30)
    >>> problem.modes[:2], [len(offered) for offered in problem.choices]
    (('human_needs_help, 0 left', 'human_needs_help, 15 left'), [1, 2, 2, 1, 2, 2])
    """
    protocol = model.protocol
    process = process or alternating(protocol)
    own = charges_of(model) if charges is None else checked_charges(protocol, charges)
    plain = latent_problem(model, process, discount)
    units = in_units(own, budget)
    amounts = _amounts(units)
    n, modes = len(amounts), len(protocol.modes)
    most = max(len(m.actions) for m in protocol.modes)
    follow, allowed = np.full((modes * n, most, modes), -1), np.zeros((modes * n, most), dtype=bool)
    choices, names = [], []
    first = 0
    for m, offered in enumerate(plain.choices):
        for i, left in enumerate(amounts.tolist()):
            x = m * n + i
            names.append(f"{plain.modes[m]}, {units.amount(left):g} left")
            product = []
            for c, choice in enumerate(offered):
                rest = left - int(units.charge[first + c])
                after = int(np.searchsorted(amounts, max(rest, 0), side="right")) - 1
                allowed[x, c] = rest >= 0
                follow[x, c] = np.arange(modes) * n + after
                if rest >= 0:
                    branches = tuple(replace(b, mode=b.mode * n + after) for b in choice.branches)
                    product.append(Choice(choice.action, choice.reward, branches))
            choices.append(tuple(product))
        first += len(offered)
    top = n - 1
    initial = [np.zeros(model.n_states) for _ in range(modes * n)]
    for m, belief in enumerate(plain.initial):
        initial[m * n + top] = belief
    problem = Problem(
        tuple(names), tuple(s for s in plain.states for _ in range(n)), tuple(choices), plain.observations,
        tuple(initial), discount, f"interaction with a budget of {budget:g}", unit=plain.unit,
        cautions=plain.cautions,
    )  # fmt: skip
    start = np.where(process.start > 0, np.arange(modes) * n + top, -1)
    product_modes = ProductModes(
        tuple(names), np.repeat(np.arange(modes), n), follow, np.repeat(process.table, n, axis=0), allowed, start,
        np.tile([units.amount(int(a)) for a in amounts], modes),
    )  # fmt: skip
    return problem, product_modes


def _amounts(units: Units) -> Index:
    """Amounts that matter: sums of charges up to the budget, increasing from 0."""
    steps = sorted({int(c) for c in units.charge if 0 < c <= units.budget})
    if steps and units.budget > 100 * MOST_AMOUNTS * steps[0]:
        found = Phrase("more of the smallest charge than can be told apart")
        raise located("budget", found, f"at most {100 * MOST_AMOUNTS:,} times the smallest charge")
    known, fresh = {0}, {0}
    while fresh:
        fresh = {a + c for a in fresh for c in steps if a + c <= units.budget} - known
        known |= fresh
        if len(known) > MOST_AMOUNTS:
            text = Phrase(f"more than {MOST_AMOUNTS} amounts left")
            raise located("budget", text, "fewer: a smaller budget, or charges with a coarser common unit")
    return np.array(sorted(known), dtype=units.charge.dtype)
