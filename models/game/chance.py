"""Random numbers as a function of a seed and a counter: splitmix64.

A generator without hidden state lives in the state of a round as two whole numbers, so that a round is a
function of its inputs and a replay needs nothing else.

Source: Steele, Lea & Flood (2014), Fast splittable pseudorandom number generators.
"""

from __future__ import annotations

import numpy as np

from models.compiled import kernel
from models.errors import located
from models.game.parameters import CHANCE_BITS

LARGEST_SEED = 2**64 - 1

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_FIRST = np.uint64(0xBF58476D1CE4E5B9)
_SECOND = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31 = np.uint64(30), np.uint64(27), np.uint64(31)
_DROPPED = np.uint64(64 - CHANCE_BITS)
_ONE = np.uint64(1)


@kernel(_nrt=False)
def mixed(value):  # type: ignore[no-untyped-def]
    """Finisher of splitmix64: 64 bits in, 64 bits out, one to one."""
    value = (value ^ (value >> _S30)) * _FIRST
    value = (value ^ (value >> _S27)) * _SECOND
    return value ^ (value >> _S31)


@kernel(_nrt=False)
def random_bits(values, seed, draws):  # type: ignore[no-untyped-def]
    """Next 64 random bits; `seed` and `draws` are the places of seed and counter in the array `values`."""
    count = np.uint64(values[draws]) + _ONE
    values[draws] += 1
    return mixed(np.uint64(values[seed]) + _GOLDEN * count)


@kernel(_nrt=False)
def random_below(values, seed, draws, limit):  # type: ignore[no-untyped-def]
    """Whole number from 0 to below `limit`, all equally likely (to one part in 2^60)."""
    return np.int64(random_bits(values, seed, draws) % np.uint64(limit))


@kernel(_nrt=False)
def happens(values, seed, draws, chance):  # type: ignore[no-untyped-def]
    """Whether something of the given chance, a number of `CHANCE_BITS` bits, happens."""
    return np.int64(random_bits(values, seed, draws) >> _DROPPED) < chance


def check_seed(seed: object, place: str) -> int:
    """Return a seed as a plain number; what is none is refused, naming `place`."""
    if isinstance(seed, bool) or not isinstance(seed, int | np.integer) or not 0 <= seed <= LARGEST_SEED:
        raise located(place, seed, "a whole number from 0 to 2^64 - 1")
    return int(seed)
