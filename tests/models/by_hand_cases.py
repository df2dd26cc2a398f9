"""A handful of small fixed runs with tables, for tests of one kernel of the likelihood at a time."""

from functools import cache

import numpy as np

from models.protocol import PUBLISHED
from tests.random_cases import make_protocol, random_run, random_tables

THREE = make_protocol([True, False, True], [2, 1, 1], 3)
"""Two modes that show one of three responses, and a silent one."""


@cache
def case(seed, n_states=3, protocol=PUBLISHED, zeros=0.0):
    """A few runs, some of them alike, and tables."""
    rng = np.random.default_rng(seed)
    runs = [random_run(rng, protocol, int(length), 0.2) for length in (1, 4, 3, 4, 2)]
    runs += [runs[1], runs[2][:2]]
    return runs, random_tables(rng, protocol, n_states, zeros), np.array(protocol.emission_index)
