"""The entries of a posterior: every number it is about, named with states, actions, responses and groups."""

from __future__ import annotations

import numpy as np
import xarray as xr

from models.parameters import Array
from models.protocol import Protocol

TABLES = ("initial", "transition", "emission")

SPREAD = "person_sd"
"""Name of sigma, the standard deviation of the people's offsets, where people differ."""


def entry_names(draws: xr.Dataset, protocol: Protocol) -> list[str]:
    """Names of the entries, in the order of `entries`.

    ``transition[help,s0,s1]``; ``initial[s0 | older]`` where the table differs between groups. With two responses
    the emission table is named by the response with the higher score: ``help_probability[signal,s1]``.

    Parameters
    ----------
    draws : xarray.Dataset
        Tables of a posterior (`models.fit_tree.named`).
    protocol : Protocol
    """
    n, p = draws.sizes["state"], protocol
    own = {
        "initial": ("initial", [f"s{s}" for s in range(n)]),
        "transition": (
            "transition", [f"{a},s{s},s{t}" for a in p.action_names for s in range(n) for t in range(n)]
        ),
        "emission": (
            "emission", [f"{a},s{s},{o}" for a in p.emission_actions for s in range(n) for o in p.response_names]
        ),
    }  # fmt: skip
    if p.n_responses == 2:
        top = p.response_names[int(np.argmax(p.scores))]
        own["emission"] = (f"{top}_probability", [f"{a},s{s}" for a in p.emission_actions for s in range(n)])
    names = []
    for table in TABLES:
        name, places = own[table]
        of = [f" | {g}" for g in draws["group"].to_numpy()] if "group" in draws[table].dims else [""]
        names += [f"{name}[{place}{g}]" for g in of for place in places]
    return [*names, SPREAD] if SPREAD in draws else names


def entries(draws: xr.Dataset, protocol: Protocol) -> Array:
    """Draws of every entry, ``[chain, draw, entry]``."""
    parts = [np.asarray(draws[name].to_numpy()) for name in TABLES]
    if protocol.n_responses == 2:
        parts[2] = parts[2][..., int(np.argmax(protocol.scores))]
    if SPREAD in draws:
        parts.append(np.asarray(draws[SPREAD].to_numpy()))
    return np.concatenate([p.reshape(*p.shape[:2], -1) for p in parts], axis=-1)
