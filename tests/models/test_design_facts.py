"""Facts of a design, held to their words person by person; the same from events, and from parts of them."""

from itertools import pairwise

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from models.compressed_log import LogTally
from models.events import EventLog
from models.histories import UNSEEN
from tests.random_cases import protocols, random_run


@st.composite
def logs(draw):
    protocol = draw(protocols())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    runs = [random_run(rng, protocol, int(rng.integers(1, 6)), 0.3) for _ in range(draw(st.integers(1, 9)))]
    codes = np.array([event for run in runs for event in run], dtype=np.int8)
    person = np.sort(rng.integers(0, 4, len(runs)))
    sequence = np.arange(len(runs))
    condition = rng.integers(0, 2, len(runs)).astype(np.int32)
    condition = np.unique(condition, return_inverse=True)[1].astype(np.int32)
    names = ("a", "b")[: condition.max() + 1]
    action, response = np.ascontiguousarray(codes.T)
    offsets = np.cumsum([0, *map(len, runs)])
    return EventLog(protocol, "s", offsets, person, sequence, condition, names, action, response)


def by_words(log):
    """The facts from sets of actions, run by run and person by person."""
    p, n = log.protocol, log.protocol.n_actions
    shows = [i >= 0 for i in p.emission_index]
    followed, repeats, around = set(), False, False
    met, responded = {}, {}
    for r in range(log.n_runs):
        own = slice(log.offsets[r], log.offsets[r + 1])
        actions, responses = log.action[own].tolist(), log.response[own].tolist()
        followed |= set(actions[:-1])
        modes = [p.mode_of_action[a] for a in actions]
        repeats |= any(a == b for a, b in pairwise(modes))
        around |= any(
            shows[a] and not shows[b] and shows[c]
            for a, b, c in zip(actions, actions[1:], actions[2:], strict=False)
        )
        person = int(log.participant[r])
        met.setdefault(person, set()).update(actions)
        seen = {a for a, o in zip(actions, responses, strict=True) if o != UNSEEN}
        responded.setdefault(person, set()).update(seen)

    def pairs(one, other):
        return [[any(a in one[i] and b in other[i] for i in one) for b in range(n)] for a in range(n)]

    return (
        [a in followed for a in range(n)], around and not repeats, pairs(met, met), pairs(responded, responded),
        pairs(responded, met),
    )  # fmt: skip


@given(logs(), st.integers(1, 7))
def test_facts_and_counts_in_parts_equal_their_words(log, size):
    for found, wanted in zip(log.design, by_words(log), strict=True):
        assert np.array_equal(found, wanted)
    tally = LogTally(log.protocol)
    person, condition = log.participant[log.run_of_event], log.condition[log.run_of_event]
    starts = log.offsets[:-1]
    for low in range(0, log.n_events, size):
        part = slice(low, low + size)
        own = starts[(starts >= low) & (starts < low + size)] - low
        tally.add(own, person[part], condition[part], log.conditions, log.action[part], log.response[part])
    found = tally.finish("s")
    for one, other in zip(found.design, log.design, strict=True):
        assert np.array_equal(one, other)
    assert (found.n_participants, found.n_runs, found.n_events) == (log.n_participants, log.n_runs, log.n_events)
    assert found.n_missing == log.n_missing
    assert np.array_equal(found.emission_weights, log.emission_weights)
