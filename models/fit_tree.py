"""A posterior sample as a DataTree: named draws, prior draws, predictive responses, log-likelihood of people.

Of a log that was compressed there are neither people nor events: log-likelihoods are by distinct history, with how
many runs have each, and nothing is predicted event by event.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from models.entries import SPREAD
from models.histories import UNSEEN
from models.labels import canonical_order
from models.lspomdp import default_state_names
from models.parameters import Array
from models.predictive import FullTables, predictive_responses
from models.study_density import StudyDensity

PREDICTIVE_DRAWS = 200
"""Simulated studies kept with a fit, before and after the data."""

PREDICTIVE_STREAM = 7_107
"""First element of the spawn keys of simulated studies; the second is 0 before the data and 1 after."""


MOST_VALUES = 1 << 24
"""Log-likelihoods of histories kept with a fit (128 MB); of draws evenly spaced where all would be more."""


def canonical_tables(study: StudyDensity, theta: Array) -> FullTables:
    """Learned vectors ``[..., p]`` to tables of every group, each draw in canonical order.

    States are put in order by one permutation for all groups: their mean score, groups weighted by responses.
    """
    layout, scores = study.layout, study.log.protocol.scores
    spread = theta[..., -1] if study.density.people_differ else None
    initial, transition, emission = layout.unpack(theta[..., : layout.size])
    if layout.n_groups == 1:
        initial = initial.reshape(*theta.shape[:-1], 1, layout.n_states)
    order = canonical_order(emission, scores, study.emission_weights)
    rows = order[..., None, :, None]
    transition = np.take_along_axis(transition, rows, axis=-2)
    return FullTables(
        np.take_along_axis(initial, order[..., None, :], axis=-1),
        np.take_along_axis(transition, order[..., None, None, :], axis=-1),
        np.take_along_axis(emission, rows, axis=-2),
        spread,
    )


def build_tree(
    study: StudyDensity, posterior: FullTables, prior: FullTables, stats: Mapping[str, NDArray],
    log_likelihood: xr.Dataset, seed: int,
) -> xr.DataTree:  # fmt: skip
    """All groups of a stored fit; each has the coordinates ``chain`` and ``draw``, as ArviZ wants them.

    Parameters
    ----------
    study : StudyDensity
    posterior : FullTables
        With leading axes chain and draw.
    prior : FullTables
        The same, one chain.
    stats : mapping of str to arrays [chain, draw]
    log_likelihood : xarray.Dataset
        `by_person`, or `by_history`.
    seed : int
        Of the simulated studies.
    """
    chains, draws = posterior.initial.shape[:2]
    groups = {
        "posterior": named(study, posterior),
        "prior": named(study, prior),
        "sample_stats": xr.Dataset(
            {k: (("chain", "draw"), v) for k, v in stats.items()}, coords=_numbered(chains, draws)
        ),
        "log_likelihood": log_likelihood,
    }
    if not study.compressed:
        response = study.events.response
        groups |= {
            "prior_predictive": _predictive(study, prior, seed, 0),
            "posterior_predictive": _predictive(study, posterior, seed, 1),
            "observed_data": _events(study, response[response != UNSEEN], ()),
        }
    return xr.DataTree.from_dict(groups)


def by_person(study: StudyDensity, values: Array) -> xr.Dataset:
    """Log-likelihoods ``[chain, draw, person]`` with names."""
    return xr.Dataset(
        {"participant": (("chain", "draw", "person"), values)},
        coords={**_numbered(*values.shape[:2]), "person": np.unique(study.events.participant)},
    )


def by_history(study: StudyDensity, theta: Array) -> xr.Dataset:
    """Log-likelihood of every distinct history, of some draws, and how many runs have each (``runs``).

    Parameters
    ----------
    study : StudyDensity
    theta : float64[chain, draw, p]
    """
    tree = study.density.tree
    chains, draws = theta.shape[:2]
    each = min(draws, max(1, MOST_VALUES // (chains * tree.n_histories)))
    kept = np.linspace(0, draws - 1, each).round().astype(np.int64)
    return xr.Dataset(
        {"history": (("chain", "draw", "distinct"), study.history_log_likelihoods(theta[:, kept]))},
        coords={
            "chain": np.arange(chains), "draw": kept, "runs": ("distinct", tree.arrays.ends[tree.terminals]),
        },
    )  # fmt: skip


def named(study: StudyDensity, tables: FullTables) -> xr.Dataset:
    """Tables with names; those that differ between groups have the dimension ``group``, the others do not."""
    p, layout = study.log.protocol, study.layout
    lead, groups = tables.initial.shape[:-2], layout.n_groups
    names = list(default_state_names(layout.n_states))
    coords = {
        **_numbered(*lead), "state": names, "state_next": names, "action": list(p.action_names),
        "emission_action": list(p.emission_actions), "response": list(p.response_names),
    }  # fmt: skip
    differ: tuple[str, ...] = ()
    if study.spec.groups is not None:
        differ = study.spec.groups.differ
        coords["group"] = list(study.spec.groups.labels)
    dims = {
        "initial": ("state",), "transition": ("action", "state", "state_next"),
        "emission": ("emission_action", "state", "response"),
    }  # fmt: skip
    variables = {}
    for name, own in dims.items():
        table = getattr(tables, name)
        by_group = table.reshape(
            *lead, groups, *((-1, *table.shape[len(lead) + 1 :]) if name != "initial" else (-1,))
        )
        if name in differ:
            variables[name] = (("chain", "draw", "group", *own), by_group)
        else:
            variables[name] = (("chain", "draw", *own), by_group[:, :, 0])
    if tables.spread is not None:
        variables[SPREAD] = (("chain", "draw"), tables.spread)
    return xr.Dataset(variables, coords=coords)


def _predictive(study: StudyDensity, tables: FullTables, seed: int, which: int) -> xr.Dataset:
    chains, draws = tables.initial.shape[:2]
    each = min(draws, max(1, PREDICTIVE_DRAWS // chains))
    kept = np.linspace(0, draws - 1, each).round().astype(np.int64)
    some = [None if t is None else t[:, kept].reshape(chains * each, *t.shape[2:]) for t in tables]
    streams = [np.random.SeedSequence(seed, spawn_key=(PREDICTIVE_STREAM, which, d)) for d in range(chains * each)]
    log = study.events
    responses = predictive_responses(FullTables(*some), log, streams, study.spec.groups)  # type: ignore[arg-type]
    seen = responses[:, log.response != UNSEEN].reshape(chains, each, -1)
    return _events(study, seen, ("chain", "draw")).assign_coords(chain=np.arange(chains), draw=kept)


def _numbered(chains: int, draws: int) -> dict[str, Any]:
    return {"chain": np.arange(chains), "draw": np.arange(draws)}


def _events(study: StudyDensity, values: NDArray[np.int8], lead: tuple[str, ...]) -> xr.Dataset:
    log = study.events
    seen = log.response != UNSEEN
    run = log.run_of_event[seen]
    coords = {
        "participant": ("event", log.participant[run]), "sequence": ("event", log.sequence[run]),
        "k": ("event", log.k[seen]),
    }  # fmt: skip
    return xr.Dataset({"response": ((*lead, "event"), values)}, coords=coords)
