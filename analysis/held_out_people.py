r"""The hierarchical model as a forecaster of people who were left out: each person has an offset of their own.

Without any response known the offset and the path of states are independent, and the offset only tilts the
response tables. So what is expected is that of the plain model under tables averaged over people,

.. math:: \bar O(o \mid e, s) = \int \frac{O(o \mid e, s)\, e^{\sigma z c_o}}{\sum_j O(j \mid e, s)\,
          e^{\sigma z c_j}}\, \varphi(z)\, dz,

while responses hang together within a person: an offset is drawn once and shared by all events of all their runs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.forecasters import Contender
from analysis.held_out_latent import Fitter, LatentForecaster
from analysis.people import spread_warnings
from models.events import EventLog
from models.joint_predictive import LogPredictive, latent_log_predictive
from models.model_draws import ModelDraws
from models.parameters import Array, DirichletPrior
from models.people_kernel import tilt
from models.person_offset import PersonOffset, quadrature
from models.posterior import SPREAD, TABLES, Posterior
from models.predictive import FullTables, predictive_responses, tables_of
from models.protocol import Protocol
from models.smc import SmcSettings

NODES = 101
"""Of the average over people: steps of a tenth of sigma, which integrate the logistic function up to sigma 20."""


@dataclass(frozen=True, kw_only=True)
class PeopleForecaster(LatentForecaster):
    """The hierarchical model after learning.

    Attributes
    ----------
    tables : FullTables
        The draws behind `models`, whose response tables are averaged over people.
    people : PersonOffset
    """

    tables: FullTables
    people: PersonOffset

    @property
    def doubts(self) -> list[str]:
        """Gate, quadrature and prior of the offsets."""
        return [*super().doubts, *spread_warnings(self.posterior)]

    def responses(self, design: EventLog, draw: int, rng: np.random.Generator) -> NDArray[np.int8]:
        """New people, each with one new offset, and new latent states in every run."""
        every = self.tables
        tables = (every.initial, every.transition, every.emission, np.asarray(every.spread))
        one = FullTables(*(part[draw : draw + 1] for part in tables))
        stream = np.random.SeedSequence(rng.integers(2**32, size=4).tolist())
        return predictive_responses(one, design, [stream])[0]

    def log_predictive(self, held: EventLog) -> LogPredictive:
        """Joint by letting the people in little by little, by person over posterior draws."""
        parts = [self.posterior.table(name) for name in TABLES]
        theta = np.concatenate(
            [*(t.reshape(len(t), -1) for t in parts), self.posterior.table(SPREAD)[:, None]], axis=1
        )
        return latent_log_predictive(
            self.rest, held, theta, self.prior, self.pins, self.posterior.n_states, self.moves, self.people
        )


def averaged_emission(emission: Array, spread: Array, protocol: Protocol) -> Array:
    """Response tables averaged over people.

    Parameters
    ----------
    emission : float64[d, e, s, o]
        Of the person without an offset.
    spread : float64[d]
        Standard deviation of the offsets.
    protocol : Protocol
    """
    z, log_weight = quadrature(NODES)
    scores = np.asarray(protocol.scores, dtype=np.float64)
    weight = np.exp(log_weight)
    return np.stack([tilt(table, scores, sigma, z) @ weight for table, sigma in zip(emission, spread, strict=True)])


def people_forecaster(
    posterior: Posterior, rest: EventLog, prior: DirichletPrior, pins: Mapping[str, Array | None],
    people: PersonOffset, draws: int, moves: SmcSettings,
) -> PeopleForecaster:  # fmt: skip
    """From a posterior of the hierarchical model.

    Parameters
    ----------
    posterior : Posterior
    rest : EventLog
        What it learned from.
    prior, pins, people
        Of the model.
    draws : int
        Draws of parameters, at most.
    moves : SmcSettings
        Of the joint log predictive.
    """
    tables = tables_of(posterior, draws)
    assert tables.spread is not None
    n = len(tables.spread)
    models = ModelDraws(
        rest.protocol, tables.initial[:, 0], tables.transition,
        averaged_emission(tables.emission, tables.spread, rest.protocol), np.full(n, 1.0 / n),
    )  # fmt: skip
    return PeopleForecaster(
        posterior=posterior, rest=rest, models=models, prior=prior, pins=pins, moves=moves, tables=tables,
        people=people,
    )  # fmt: skip


def hierarchical(
    states: int,
    *,
    people: PersonOffset,
    pins: Mapping[str, Array | None],
    prior: DirichletPrior,
    fitter: Fitter,
    draws: int,
    moves: SmcSettings,
) -> Contender:
    """The hierarchical model as a contender; with one state only people differ."""

    def learn(rest: EventLog) -> PeopleForecaster:
        return people_forecaster(fitter(rest, states, pins, people), rest, prior, pins, people, draws, moves)

    if states == 1:
        return Contender("people differ, no states", "traits", learn)
    return Contender(f"{states} states, people differ", "people", learn)
