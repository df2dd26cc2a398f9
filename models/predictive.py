"""New people under the design of a log: responses drawn from many models, groups and person offsets included."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from models.compiled import kernel
from models.errors import located
from models.events import EventLog
from models.groups import Groups
from models.histories import UNSEEN
from models.parameters import Array
from models.person_offset import person_of_run
from models.posterior import SPREAD, TABLES, Posterior
from models.simulation import pick


class FullTables(NamedTuple):
    """Tables of many models, of every group.

    Attributes
    ----------
    initial : float64[d, g, s]
    transition : float64[d, g * a, s, s']
    emission : float64[d, g * e, s, o]
    spread : float64[d] or None
        Standard deviation of the people's offsets; None where people do not differ.
    """

    initial: Array
    transition: Array
    emission: Array
    spread: Array | None = None


def tables_of(posterior: Posterior, draws: int | None = None) -> FullTables:
    """Tables of some draws of a posterior, of every group.

    Parameters
    ----------
    posterior : Posterior
    draws : int, optional
        How many, evenly spaced; all of them if there are fewer, or if not given.
    """
    parts = {name: posterior.table(name) for name in TABLES}
    n = len(parts["initial"])
    wanted = n if draws is None else min(n, draws)
    if wanted < 1:
        raise located("draws", wanted, "at least 1")
    kept = np.floor((np.arange(wanted) + 0.5) * n / wanted).astype(int)
    groups = max(1, len(posterior.groups))
    full = {}
    for name, table in parts.items():
        some = table[kept]
        if not posterior.differs(name):
            some = np.repeat(some[:, None], groups, axis=1)
        full[name] = some if name == "initial" else some.reshape(wanted, -1, *some.shape[3:])
    return FullTables(**full, spread=posterior.table(SPREAD)[kept] if posterior.people_differ else None)


def predictive_responses(
    tables: FullTables, design: EventLog, streams: list[np.random.SeedSequence], groups: Groups | None = None
) -> NDArray[np.int8]:
    """One simulated study a model: new people, with new states and new offsets, take the places of the log's.

    Parameters
    ----------
    tables : FullTables
    design : EventLog
        Its people, actions and missing records are kept; a response is drawn exactly where it records one.
    streams : list of SeedSequence
        One a model, so that a draw's responses do not depend on the other draws.
    groups : Groups, optional
        Group of each run, where tables differ.

    Returns
    -------
    int8[d, events]
        `UNSEEN` where the design records no response.
    """
    protocol = design.protocol
    group = np.zeros(design.n_runs, dtype=np.int64) if groups is None else groups.run_group
    index = np.asarray(protocol.emission_index, dtype=np.int64)
    scores = np.asarray(protocol.scores, dtype=np.float64)
    person = person_of_run(design)
    out = np.empty((len(streams), design.n_events), dtype=np.int8)
    for d, stream in enumerate(streams):
        rng = np.random.default_rng(stream)
        uniform = rng.random((design.n_events, 2))
        offset = np.zeros(design.n_participants)
        if tables.spread is not None:
            offset = tables.spread[d] * rng.standard_normal(design.n_participants)
        _draw_people(
            design.offsets, design.action, design.response, group, offset[person], scores, index, tables.initial[d],
            tables.transition[d], tables.emission[d], uniform, out[d],
        )  # fmt: skip
    return out


@kernel
def _draw_people(  # type: ignore[no-untyped-def]
    offsets, action, recorded, group, person_offset, scores, emission_index, initial, transition, emission, uniform,
    response,
):  # fmt: skip
    actions = len(emission_index)
    tables = len(emission) // len(initial)
    tilted = np.empty(emission.shape[2])
    for run in range(len(group)):
        g = group[run]
        row = initial[g]
        for event in range(offsets[run], offsets[run + 1]):
            s = pick(row, uniform[event, 0])
            if recorded[event] == UNSEEN:
                response[event] = UNSEEN
            else:
                total, largest = 0.0, -np.inf
                plain = emission[g * tables + emission_index[action[event]], s]
                for o in range(len(plain)):
                    if plain[o] > 0.0:
                        largest = max(largest, person_offset[run] * scores[o])
                for o in range(len(plain)):
                    tilted[o] = 0.0
                    if plain[o] > 0.0:
                        tilted[o] = plain[o] * np.exp(person_offset[run] * scores[o] - largest)
                    total += tilted[o]
                for o in range(len(plain)):
                    tilted[o] /= total
                response[event] = pick(tilted, uniform[event, 1])
            row = transition[g * actions + action[event], s]
