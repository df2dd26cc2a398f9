r"""Rivals without a latent state as forecasters: run forward from what they learned.

Both are one table: the probability of a response given the action and the last response recorded before in the run,
:math:`\theta_{a l o}`; the constant rival's does not depend on l. With :math:`q_k(l)` the probability that l was
recorded last before round k (*none* at the start), what is expected in round k and the step to the next round are

.. math:: \sum_l q_k(l) \sum_o \theta_{a_k l o} v_o, \qquad q_{k+1}(o) = \sum_l q_k(l)\, \theta_{a_k l o},

the step only where a response is recorded. Log predictives are exact.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from analysis import response_rates as rates
from analysis.forecasters import Contender, Gap, never
from analysis.held_out_cells import earlier
from models.events import EventLog
from models.histories import UNSEEN
from models.joint_predictive import LogPredictive
from models.parameters import Array
from models.rivals import CountingRival, constant, first_order_markov

STREAM = 301
"""First element of the spawn keys of the rivals' draws; the second is the number of cells."""

Count = Callable[[EventLog, float], CountingRival]


@dataclass(frozen=True)
class CountingForecaster:
    """A counting rival after learning.

    Attributes
    ----------
    rival : CountingRival
        Of the rest.
    count : callable
        Log and Dirichlet parameter to the same rival of another log.
    rest : EventLog
    table : float64[draw, emission action, last, response]
        Draws; `last` is 0 for none, then the responses.
    """

    rival: CountingRival
    count: Count
    rest: EventLog
    table: Array

    @property
    def n_draws(self) -> int:
        """Draws of its parameters."""
        return len(self.table)

    @property
    def gate(self) -> str:
        """Draws are independent."""
        return "exact"

    @property
    def doubts(self) -> list[str]:
        """None: counts have a closed form."""
        return []

    def expected(self, design: EventLog) -> Array:
        """Mean over everything that may have been recorded before; ``[draw, event]``."""
        value = rates.value_of_response(design.protocol)
        out = np.zeros((self.n_draws, design.n_events))
        last = np.zeros((self.n_draws, design.n_runs, self.table.shape[2]))
        last[:, :, 0] = 1.0
        for run, event, e in _rounds(design):
            response = np.einsum("drl,drlo->dro", last[:, run], self.table[:, e])
            out[:, event] = response @ value
            last[:, run, 0], last[:, run, 1:] = 0.0, response
        return out

    def responses(self, design: EventLog, draw: int, rng: np.random.Generator) -> NDArray[np.int8]:
        """New people; one uniform number an event."""
        uniform = rng.random(design.n_events)
        edges = np.cumsum(self.table[draw], axis=-1)[..., :-1]
        out = np.full(design.n_events, UNSEEN, dtype=np.int8)
        last = np.zeros(design.n_runs, dtype=np.int64)
        for run, event, e in _rounds(design):
            out[event] = (uniform[event, None] >= edges[e, last[run]]).sum(axis=1)
            last[run] = out[event] + 1
        return out

    def log_predictive(self, held: EventLog) -> LogPredictive:
        r"""Exact: :math:`\log p(y_F, y_{-F}) - \log p(y_{-F})`, and each person given the rest."""
        counts = self.count(held, self.rival.alpha).counts
        both = replace(self.rival, counts=np.concatenate([self.rival.counts, counts]))
        joint = both.log_marginal_likelihood - self.rival.log_marginal_likelihood
        inside = np.arange(len(both.counts)) >= len(self.rival.counts)
        return LogPredictive(joint, 0.0, both.log_predictive(inside))

    def gaps(self, design: EventLog) -> list[Gap]:
        """Actions never answered in the rest, and for the Markov rival what was never recorded before an answer."""
        p = design.protocol
        filled = self.rival.total.sum(axis=-1).reshape(len(p.emission_actions), -1) > 0
        answered = earlier(design, design.response != UNSEEN)
        out = []
        for e, name in enumerate(p.emission_actions):
            taken = (design.action == p.action(name)) & (design.response != UNSEEN)
            if not filled[e].any():
                out.append((never(self.rest, name, True, False), taken))
                continue
            for last, known in enumerate(filled[e]):
                before = "at first" if last == 0 else f"after {p.response_names[last - 1]}"
                text = f"no response to action {name} {before} was recorded in the rest: it is the prior"
                if not known:
                    out.append((text, taken & (answered == (last > 0))))
        return [(text, mask) for text, mask in out if mask.any()]


def rivals(alpha: float, draws: int, seed: int) -> list[Contender]:
    """Contenders that need no latent state.

    Parameters
    ----------
    alpha : float
        Dirichlet parameter of every probability.
    draws : int
    seed : int
    """

    def learner(count: Count) -> Callable[[EventLog], CountingForecaster]:
        def learn(rest: EventLog) -> CountingForecaster:
            rival = count(rest, alpha)
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, len(rival.cells))))
            p = rest.protocol
            table = rival.draws(1, draws, rng)[0].reshape(draws, len(p.emission_actions), -1, p.n_responses)
            whole = np.broadcast_to(table, (*table.shape[:2], p.n_responses + 1, p.n_responses))
            return CountingForecaster(rival, count, rest, whole)

        return learn

    return [
        Contender("constant", "constant", learner(constant)),
        Contender("first-order Markov", "markov", learner(first_order_markov)),
    ]


def _rounds(design: EventLog) -> list[tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]]:
    """By round: runs with a recorded response in it, those events, and the emission table of each."""
    table = np.asarray(design.protocol.emission_index)[design.action]
    seen = np.flatnonzero(design.response != UNSEEN)
    return [
        (design.run_of_event[event], event, table[event])
        for k in np.unique(design.k[seen])
        for event in (seen[design.k[seen] == k],)
    ]
