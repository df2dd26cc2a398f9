"""A problem in terms of blocks of its states, matrix by matrix: what `block_arrays` does at once."""

from __future__ import annotations

import numpy as np

from models.planning.observed_part import ObservedPart
from models.planning.problem import Branch, Choice, Problem, csr


def block_problem(part: ObservedPart) -> Problem:
    """The problem whose arrays `part.arrays` is."""
    whole = part.whole
    spread = part.start_mode == len(part.members) - 1 and _covered(part) < len(part.members)
    blocks = part.members[:-1] if spread else part.members
    offered = []
    for rows in part.members:
        row = []
        for choice in whole.choices[0]:
            table = choice.branches[0].transition.toarray()
            emission = choice.branches[0].emission.toarray() * table.any(axis=0)[:, None]
            branches = []
            for k, block in enumerate(blocks):
                if table[np.ix_(rows, block)].any():
                    shown = np.flatnonzero(emission[block].any(axis=0))
                    seen = tuple(choice.branches[0].observations[o] for o in shown)
                    to = csr(table[np.ix_(rows, block)])
                    branches.append(Branch(k, to, seen, csr(emission[np.ix_(block, shown)])))
            row.append(Choice(choice.action, choice.reward[rows], tuple(branches)))
        offered.append(tuple(row))
    initial = [np.zeros(len(rows)) for rows in part.members]
    initial[part.start_mode] = part.start
    names = [f"block {k}" for k in range(len(blocks))] + ["start"] * spread
    states = tuple(tuple(whole.states[0][s] for s in rows) for rows in part.members)
    return Problem(
        tuple(names), states, tuple(offered), whole.observations, tuple(initial), whole.discount, whole.name
    )


def _covered(part: ObservedPart) -> int:
    """Modes that hold all states once, in their order."""
    seen: set[int] = set()
    for k, rows in enumerate(part.members):
        if seen & set(rows.tolist()):
            return k
        seen |= set(rows.tolist())
    return len(part.members)
