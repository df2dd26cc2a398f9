"""The best choice by upper bounds, worked out only as far as needed.

Bounds of choices only fall. So what was last known of a choice still bounds it, and it is looked at again only
while it comes out on top: once the highest is one that has just been looked at, no other can be better.
"""

from __future__ import annotations

from models.compiled import kernel
from models.planning.arrays import Array


@kernel
def highest(bounds: Array, i: int, offered: int) -> int:
    """The choice of node `i` with the highest bound, the first of equals."""
    best = 0
    for j in range(1, offered):
        if bounds[i, j] > bounds[i, best]:
            best = j
    return best


@kernel
def next_to_look_at(bounds: Array, i: int, offered: int, fresh: int, value: float) -> int:
    """Note the value of the choice just looked at; returns the one on top now, `fresh` itself at the end.

    The least of the old bound and the new one is kept: rounding must not let two choices take turns for ever.
    """
    bounds[i, fresh] = min(bounds[i, fresh], value)
    return highest(bounds, i, offered)
