r"""What a latent state must beat: models that explain responses without one, or with one that never changes.

*Counting rivals* give every recorded response a probability that depends on what was seen, its *cell*. With
independent rows :math:`\theta_c \sim \mathrm{Dirichlet}(\alpha)` and counts :math:`n_{co}` all is closed form:

.. math::
    \hat\theta_{co} = n_{co} / n_c, \qquad \theta_c \mid y \sim \mathrm{Dirichlet}(\alpha + n_c), \qquad
    \log p(y) = \sum_c \log B(\alpha + n_c) - \log B(\alpha)

- *constant*: the cell is the robot's action. It is also the latent-state model with one state.
- *first-order Markov*: the cell is the action and the last response recorded before in the same run (or none).

The third rival, a *static mixture of types*, is the latent-state model with every transition table held at the
identity: `static_pins`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import gammaln

from models.errors import located
from models.events import EventLog
from models.histories import UNSEEN
from models.parameters import Array, recorded
from models.protocol import Protocol

STREAM = 7_104
"""First element of the spawn keys of posterior draws."""


@dataclass(frozen=True)
class CountingRival:
    """A rival whose responses are counted by cell.

    Attributes
    ----------
    name : str
    cells : tuple of str
        What each cell stands for.
    counts : float64[person, cell, response]
        Recorded responses of each person, people in the order of their ids.
    alpha : float
        Dirichlet parameter of every entry; 1 is uniform, and the emission prior of the latent-state models.
    """

    name: str
    cells: tuple[str, ...]
    counts: Array
    alpha: float = 1.0

    def __post_init__(self) -> None:
        if not (np.isfinite(self.alpha) and self.alpha > 0):
            raise located(f"rival {self.name}, alpha", self.alpha, "a positive number")

    @cached_property
    def total(self) -> Array:
        """Counts over all people, ``[cell, response]``."""
        return self.counts.sum(axis=0)

    @property
    def n_parameters(self) -> int:
        """Free parameters of the cells in which a response was recorded."""
        filled = int(np.count_nonzero(self.total.sum(axis=1)))
        return filled * (self.total.shape[1] - 1)

    @property
    def n_responses(self) -> int:
        """Recorded responses."""
        return int(self.total.sum())

    @property
    def probability(self) -> Array:
        """Maximum-likelihood estimate ``[cell, response]``; NaN in cells without responses."""
        with np.errstate(invalid="ignore"):
            return self.total / self.total.sum(axis=1, keepdims=True)

    @property
    def log_likelihood(self) -> float:
        """Maximum of the log-likelihood."""
        seen = self.total > 0
        return float(self.total[seen] @ np.log(self.probability[seen]))

    @property
    def aic(self) -> float:
        """Akaike's criterion, as for Baum-Welch fits."""
        return 2.0 * self.n_parameters - 2.0 * self.log_likelihood

    @property
    def bic(self) -> float:
        """Bayesian criterion with the number of recorded responses as sample size, as for Baum-Welch fits."""
        return float(np.log(self.n_responses)) * self.n_parameters - 2.0 * self.log_likelihood

    @property
    def log_marginal_likelihood(self) -> float:
        """Exact ``log p(y)``."""
        return float(
            _log_beta(self.alpha + self.total).sum() - _log_beta(np.full_like(self.total, self.alpha)).sum()
        )

    def draws(self, chains: int, draws: int, rng: np.random.Generator) -> Array:
        """Independent posterior draws ``[chain, draw, cell, response]``."""
        gamma = rng.gamma(self.alpha + self.total, size=(chains, draws, *self.total.shape))
        return gamma / gamma.sum(axis=-1, keepdims=True)

    def person_log_likelihoods(self, theta: Array) -> Array:
        """Log-likelihood of each person under each draw, ``[chain, draw, person]``."""
        flat = np.log(theta).reshape(*theta.shape[:-2], -1)
        return flat @ self.counts.reshape(len(self.counts), -1).T

    def log_predictive(self, held_out: NDArray[np.bool_]) -> Array:
        r"""Exact log predictive of each held-out person given everybody who is not held out, ``[held out]``.

        .. math:: \log p(y_i \mid y_{-F}) = \sum_c \log B(\alpha + n_c^{-F} + n_c^i) - \log B(\alpha + n_c^{-F})
        """
        learned = self.alpha + self.total - self.counts[held_out].sum(axis=0)
        return (_log_beta(learned + self.counts[held_out]) - _log_beta(learned)).sum(axis=-1)

    def exact_loo(self) -> Array:
        """Exact leave-one-person-out log predictive of each person."""
        learned = self.alpha + self.total - self.counts
        return (_log_beta(learned + self.counts) - _log_beta(learned)).sum(axis=-1)

    def tree(self, chains: int, draws: int, seed: int) -> xr.DataTree:
        """Posterior draws and log-likelihoods by participant, as ArviZ wants them."""
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(STREAM, len(self.cells))))
        theta = self.draws(chains, draws, rng)
        dims = ("chain", "draw")
        return xr.DataTree.from_dict(
            {
                "posterior": xr.Dataset({"probability": ((*dims, "cell", "response"), theta)}),
                "log_likelihood": xr.Dataset(
                    {"participant": ((*dims, "person"), self.person_log_likelihoods(theta))}
                ),
            }
        )


def constant(log: EventLog, alpha: float = 1.0) -> CountingRival:
    """Response probabilities that depend on the robot's action alone.

    Raises
    ------
    InputError
        On a log without recorded responses.
    """
    recorded(log)
    index = np.asarray(log.protocol.emission_index)[log.action]
    return _counted("constant", log.protocol.emission_actions, index, log, alpha)


def first_order_markov(log: EventLog, alpha: float = 1.0) -> CountingRival:
    """Response probabilities that depend on the action and on the last recorded response of the run.

    Raises
    ------
    InputError
        On a log without recorded responses.
    """
    recorded(log)
    p = log.protocol
    index = np.asarray(p.emission_index)[log.action] * (p.n_responses + 1) + last_response(log) + 1
    before = ("at first", *(f"after {r}" for r in p.response_names))
    cells = tuple(f"{a}, {b}" for a in p.emission_actions for b in before)
    return _counted("first-order Markov", cells, index, log, alpha)


def last_response(log: EventLog) -> NDArray[np.int64]:
    """Response recorded last before each event in its run; `UNSEEN` where there is none."""
    seen = np.where(log.response != UNSEEN, np.arange(log.n_events), -1)
    upto = np.maximum.accumulate(seen)
    before = np.append(-1, upto[:-1])
    inside = before >= np.repeat(log.offsets[:-1], np.diff(log.offsets))
    return np.where(inside, log.response[before], UNSEEN).astype(np.int64)


def static_pins(protocol: Protocol) -> dict[str, Array | None]:
    """Pins that turn the latent-state model into a static mixture: a run keeps the type it was given."""
    return dict.fromkeys(protocol.action_names)


def _counted(
    name: str, cells: tuple[str, ...], cell: NDArray[np.int64], log: EventLog, alpha: float
) -> CountingRival:
    person = np.unique(log.participant, return_inverse=True)[1][log.run_of_event]
    seen = log.response != UNSEEN
    shape = (log.n_participants, len(cells), log.protocol.n_responses)
    place = np.ravel_multi_index((person[seen], cell[seen], log.response[seen]), shape)
    counts = np.bincount(place, minlength=int(np.prod(shape))).reshape(shape)
    return CountingRival(name, cells, counts.astype(np.float64), alpha)


def _log_beta(a: Array) -> Array:
    """Logarithm of the multivariate beta function over the last axis."""
    return gammaln(a).sum(axis=-1) - gammaln(a.sum(axis=-1))
