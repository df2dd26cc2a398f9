"""Ways in which a search for tables misleads: few restarts, flat designs, few people, estimates in corners."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from numpy.typing import ArrayLike

from analysis.figures.notebook import panels
from analysis.figures.recovered import beside_truth
from analysis.figures.style import spoken
from analysis.simulate import simulate_study1
from models.baum_welch import BaumWelch
from models.bootstrap import Bootstrap
from models.errors import located
from models.events import EventLog
from models.identification import score_rank
from models.lspomdp import LatentStatePOMDP
from models.parameters import Array, Layout


def chance_ahead(left: ArrayLike, right: ArrayLike, restarts: Sequence[int]) -> Array:
    r"""Chance that the best of `n` climbs of one kind ends above the best of `n` of another, for each `n`.

    Climbs are drawn with replacement from those at hand: with :math:`F` and :math:`G` the shares of left and right
    climbs that end at or below (below, for `G`) a value, :math:`\sum_v [F(v)^n - F(v^-)^n]\, G(v^-)^n`.

    Parameters
    ----------
    left, right : float64[climb]
        Where climbs ended.
    restarts : sequence of int
        Values of `n`.

    Returns
    -------
    float64[len(restarts)]

    Raises
    ------
    InputError
        If there are no climbs of a kind.

    Examples
    --------
    >>> chance_ahead([1.0, 3.0], [0.0, 2.0], [1, 2]).round(4).tolist()
    [0.75, 0.8125]
    """
    ours, theirs = np.sort(np.ravel(left)), np.sort(np.ravel(right))
    if len(ours) == 0 or len(theirs) == 0:
        raise located("chance ahead, climbs", (len(ours), len(theirs)), "at least one of each kind")
    n = np.asarray(restarts, dtype=np.int64)
    share = np.arange(len(ours) + 1)[:, None] / len(ours)
    best_is = np.diff(share**n, axis=0)
    below = (np.searchsorted(theirs, ours)[:, None] / len(theirs)) ** n
    return np.asarray((best_is * below).sum(axis=0))


def climb_ends(log: EventLog, states: int, climbs: int, most_maps: int, seed: int = 1) -> Array:
    """Log-likelihoods at which single climbs of the published procedure end, rising.

    Climbs that end at the same optimum count as equal.

    Parameters
    ----------
    log : EventLog
    states, climbs, most_maps, seed : int
        Climbs are stopped after `most_maps` steps.

    Returns
    -------
    float64[climbs]
        In nats.
    """
    fit = replace(BaumWelch.paper(states, seed=seed), restarts=climbs, max_maps=most_maps).fit(log)
    return np.sort(np.repeat([o.log_likelihood for o in fit.optima], [o.restarts for o in fit.optima]))


def schedule_ranks(log: EventLog, states: Sequence[int], seed: int = 1) -> pd.DataFrame:
    """How many directions of the tables each schedule of a log tells apart, of how many there are.

    Parameters
    ----------
    log : EventLog
        With enough people that every history occurs.
    states : sequence of int
    seed : int

    Returns
    -------
    DataFrame
        One row for all schedules together and one for each; "r of n" for each number of states.
    """
    names = log.schedules()
    designs = {"all together": log} | {str(s): log.select(runs=names == s) for s in sorted(set(names))}
    rows = []
    for name, part in designs.items():
        row = {"schedules": name}
        for k in states:
            layout = Layout(log.protocol, k)
            informed = zip(layout.rows, layout.informed_rows(part), strict=True)
            free = sum(r.stop - r.start - 1 for r, ok in informed if ok)
            row[f"{k} states"] = f"{score_rank(part, layout, {}, seed=seed)} of {free}"
        rows.append(row)
    return pd.DataFrame(rows).set_index("schedules")


def error_by_people(
    truths: Mapping[str, LatentStatePOMDP], people: Sequence[int], search: BaumWelch, seed: int = 1
) -> dict[str, Array]:
    """Mean absolute error of all transition entries by number of people, one simulated study for each.

    Parameters
    ----------
    truths : mapping of str to LatentStatePOMDP
    people : sequence of int
    search : BaumWelch
        Its number of states is taken from each truth.
    seed : int
        Of the studies.

    Returns
    -------
    dict of str to float64[len(people)]
    """
    out = {}
    for name, truth in truths.items():
        own = replace(search, n_states=truth.n_states)
        fits = (own.fit(simulate_study1(truth=truth, participants=n, seed=seed)) for n in people)
        out[name] = np.array([np.abs(fit.model.transition - truth.transition).mean() for fit in fits])
    return out


def bootstrap_beside_truth(
    estimate: LatentStatePOMDP, bootstrap: Bootstrap, truth: LatentStatePOMDP, level: float = 0.9
) -> Axes:
    """Two panels: the chance of the best-scored response, and that of staying in a state, by action and state.

    Parameters
    ----------
    estimate : LatentStatePOMDP
    bootstrap : Bootstrap
        Of the estimate.
    truth : LatentStatePOMDP
        Of as many states, in canonical order.
    level : float
        Of the percentile intervals.

    Returns
    -------
    Axes
        The left ones; both are on one figure.

    Raises
    ------
    InputError
        If truth and estimate have different numbers of states.
    """
    if truth.n_states != estimate.n_states:
        raise located("bootstrap beside truth, states of the truth", truth.n_states, f"{estimate.n_states}")
    protocol, n = estimate.protocol, estimate.n_states
    response = int(np.argmax(protocol.scores))
    axes = panels(4.4, 4.6, height=max(2.6, 1.0 + 0.26 * n * len(protocol.action_names) * 0.9))
    low, high = (bound[..., response].ravel() for bound in bootstrap.interval("emission", level))
    names = protocol.emission_actions, protocol.action_names
    first, second = ([f"{spoken(a)}, s{i}" for a in own for i in range(n)] for own in names)
    beside_truth(
        first, estimate.emission[..., response].ravel(), (low, high), truth.emission[..., response].ravel(),
        measure=f"probability to {spoken(protocol.response_names[response])}", ax=axes[0],
    )  # fmt: skip
    tables = (estimate.transition, *bootstrap.interval("transition", level), truth.transition)
    stay, low, high, known = (np.diagonal(t, axis1=1, axis2=2).ravel() for t in tables)
    beside_truth(second, stay, (low, high), known, measure="probability to stay in the state", ax=axes[1])
    return axes[0]


def shares_inside(bootstrap: Bootstrap, truth: LatentStatePOMDP, level: float = 0.9) -> dict[str, float]:
    """Share of the entries of each table whose interval holds the truth: `emission`, `transition`."""
    out = {}
    for table in ("emission", "transition"):
        low, high = bootstrap.interval(table, level)
        known = getattr(truth, table)
        out[table] = float(np.mean((low <= known) & (known <= high)))
    return out
