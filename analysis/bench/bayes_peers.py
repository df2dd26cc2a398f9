"""The Bayesian model as one writes it in PyMC without a kernel of one's own: three ways to sum over the states.

All have the variables and priors of `models.bayesian_hmm.build_model`, hence the same density and, in the same
order, the same unconstrained coordinates; labels are free. They take runs of equal length and two responses, as
the published design has them.
"""

# Only the environment of the benchmarks has pymc-extras.
# mypy: disable-error-code="import-not-found"

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pymc as pm
import pytensor.tensor as pt
from numpy.typing import NDArray
from pytensor.scan.basic import scan
from pytensor.tensor.special import logsumexp

from models.events import EventLog
from models.histories import UNSEEN
from models.parameters import STICKY, DirichletPrior, Layout


def rectangles(log: EventLog) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Actions and responses as ``int64[run, round]``, for runs of equal length.

    Raises
    ------
    ValueError
        If the runs are of different lengths.
    """
    lengths = np.unique(np.diff(log.offsets))
    if len(lengths) != 1:
        raise ValueError(f"runs of {lengths.tolist()} events; the peers are written for runs of one length")
    shape = (log.n_runs, int(lengths[0]))
    return log.action.astype(np.int64).reshape(shape), log.response.astype(np.int64).reshape(shape)


def distinct(log: EventLog) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Distinct rows of `rectangles` and how many runs have each, ``float64[row]``."""
    action, response = rectangles(log)
    rows, counts = np.unique(np.concatenate([action, response], axis=1), axis=0, return_counts=True)
    return *np.split(rows, 2, axis=1), counts.astype(np.float64)  # type: ignore[return-value]


def help_name(log: EventLog) -> str:
    """Name of the variable of the emission tables, as in `build_model`."""
    names = log.protocol.response_names
    if len(names) != 2:
        raise ValueError(f"{len(names)} responses; the peers are written for two")
    return f"{names[int(np.argmax(log.protocol.scores))]}_probability"


def _priors(log: EventLog, states: int, prior: DirichletPrior) -> tuple[Any, Any, Any]:
    """Register the variables of the open model; the third holds the probability of the higher response."""
    layout = Layout(log.protocol, states)
    initial, transition, emission = layout.unpack(1.0 + prior.pseudo_counts(layout))
    top = int(np.argmax(log.protocol.scores))
    return (
        pm.Dirichlet("initial", initial),
        pm.Dirichlet("transition", transition),
        pm.Beta(help_name(log), emission[..., top], emission[..., 1 - top]),
    )


def _evidence(
    log: EventLog, action: NDArray[np.int64], response: NDArray[np.int64], high: Any
) -> tuple[NDArray[np.bool_], Any]:
    """Mask of recorded responses, and the probability of what was recorded, ``[run, round, state]``."""
    seen = response != UNSEEN
    table = np.where(seen, np.asarray(log.protocol.emission_index)[action], 0)
    top = int(np.argmax(log.protocol.scores))
    probability = high[table]
    return seen, pt.where((response == top)[..., None], probability, 1.0 - probability)


def scan_model(log: EventLog, states: int, prior: DirichletPrior = STICKY) -> pm.Model:
    """Forward recursion in logarithms by `pytensor.scan` over rounds, one row a run: the textbook way."""
    action, response = rectangles(log)
    with pm.Model() as model:
        initial, transition, high = _priors(log, states, prior)
        seen, evidence = _evidence(log, action, response, high)
        shown = pt.where(seen[..., None], pt.log(evidence), 0.0)
        log_transition = pt.log(transition)

        def step(acted: Any, shown_k: Any, alpha: Any, tables: Any) -> Any:
            return logsumexp(alpha[:, :, None] + tables[acted], axis=1) + shown_k

        path = scan(
            step,
            sequences=[pt.as_tensor_variable(action[:, :-1].T), pt.moveaxis(shown, 1, 0)[1:]],
            outputs_info=[pt.log(initial)[None, :] + shown[:, 0]],
            non_sequences=[log_transition],
            return_updates=False,
        )
        pm.Potential("log_likelihood", pt.sum(logsumexp(path[-1], axis=-1)))
    return model


def unrolled_model(log: EventLog, states: int, prior: DirichletPrior = STICKY) -> pm.Model:
    """Forward recursion in probabilities, rounds written out, distinct histories with counts: the fastest graph."""
    action, response, counts = distinct(log)
    with pm.Model() as model:
        initial, transition, high = _priors(log, states, prior)
        seen, evidence = _evidence(log, action, response, high)
        shown = pt.where(seen[..., None], evidence, 1.0)
        pm.Potential("log_likelihood", pt.sum(counts * pt.log(unrolled(pt, initial, transition, shown, action))))
    return model


def unrolled(xp: Any, initial: Any, transition: Any, shown: Any, action: NDArray[np.int64]) -> Any:
    """Probability of every row, ``[row]``, in the array library `xp`; `shown` is ``[row, round, state]``."""
    alpha = initial * shown[:, 0]
    for k in range(1, action.shape[1]):
        alpha = xp.sum(alpha[:, :, None] * transition[action[:, k - 1]], axis=1) * shown[:, k]
    return xp.sum(alpha, axis=1)


def marginalised_model(log: EventLog, states: int, prior: DirichletPrior = STICKY) -> pm.Model:
    """Chains of pymc-extras, one a run, their transition tables varying by round, summed out by `marginalize`.

    Rounds without a recorded response count as certain successes: help probability 1, response 1.
    """
    from pymc_extras import DiscreteMarkovChain, marginalize

    action, response = rectangles(log)
    top = int(np.argmax(log.protocol.scores))
    seen = response != UNSEEN
    table = np.where(seen, np.asarray(log.protocol.emission_index)[action], 0)
    with pm.Model() as model:
        initial, transition, high = _priors(log, states, prior)
        chain = DiscreteMarkovChain(
            "state", P=transition[action[:, :-1]], init_dist=pm.Categorical.dist(p=initial), time_varying_P=True,
            shape=action.shape,
        )  # fmt: skip
        probability = _by_state(chain, [high[:, s][table] for s in range(states)])
        pm.Bernoulli("response", p=pt.where(seen, probability, 1.0), observed=np.where(seen, response == top, True))
    return marginalize(model, [chain])


def _by_state(chain: Any, values: list[Any]) -> Any:
    """The value of each element's state. Element by element, which `marginalize` asks for; no table look-up."""
    chosen = values[-1]
    for s in range(len(values) - 2, -1, -1):
        chosen = pt.where(pt.eq(chain, s), values[s], chosen)
    return chosen


PYMC_PEERS: dict[str, Callable[[EventLog, int, DirichletPrior], pm.Model]] = {
    "scan": scan_model,
    "unrolled": unrolled_model,
    "marginalised": marginalised_model,
}
