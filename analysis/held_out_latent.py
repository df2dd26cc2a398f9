"""The latent-state model, changing or static, as a forecaster of people who were left out."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from analysis.causal import expected_responses
from analysis.forecasters import Contender, Gap, never
from analysis.held_out_cells import earlier
from models.events import EventLog
from models.joint_predictive import LETTING_IN, LogPredictive, latent_log_predictive
from models.model_draws import ModelDraws
from models.parameters import Array, DirichletPrior, Layout
from models.person_offset import PersonOffset
from models.posterior import TABLES, Posterior
from models.simulation import simulate_responses
from models.smc import SmcSettings

Fitter = Callable[[EventLog, int, Mapping[str, Array | None], PersonOffset | None], Posterior]
"""Log, number of states, pins, and the offsets where people differ, to a posterior."""


@dataclass(frozen=True)
class LatentForecaster:
    """The latent-state model after learning.

    Attributes
    ----------
    posterior : Posterior
    rest : EventLog
        What it learned from.
    models : ModelDraws
        Draws that expectations and simulated responses use.
    prior : DirichletPrior
    pins : mapping
    moves : SmcSettings
        Of the joint log predictive.
    """

    posterior: Posterior
    rest: EventLog
    models: ModelDraws
    prior: DirichletPrior
    pins: Mapping[str, Array | None]
    moves: SmcSettings = LETTING_IN

    @property
    def n_draws(self) -> int:
        """Draws of its parameters."""
        return self.models.n_draws

    @property
    def gate(self) -> str:
        """Whether its sample passed the convergence gate."""
        return "passed" if self.posterior.gate.passed else "failed"

    @property
    def doubts(self) -> list[str]:
        """The gate, in words."""
        return [] if self.posterior.gate.passed else ["the posterior sample missed the convergence gate"]

    def expected(self, design: EventLog) -> Array:
        r"""Mean over state paths, :math:`b_0^\top (\prod_{j<k} T(a_j)) O(a_k) v`; ``[draw, event]``."""
        out = np.empty((self.n_draws, design.n_events))
        for run in range(design.n_runs):
            one = design.select(runs=np.array([run]))
            out[:, design.offsets[run] : design.offsets[run + 1]], _ = expected_responses(
                self.models, one, one.action
            )
        return out

    def responses(self, design: EventLog, draw: int, rng: np.random.Generator) -> NDArray[np.int8]:
        """New people, with new latent states in every run."""
        return simulate_responses(self.models.model(draw), design, rng)[0].response

    def log_predictive(self, held: EventLog) -> LogPredictive:
        """Joint by letting the people in little by little, by person over all posterior draws."""
        tables = [self.posterior.table(name) for name in TABLES]
        theta = np.concatenate([t.reshape(len(t), -1) for t in tables], axis=1)
        return latent_log_predictive(
            self.rest, held, theta, self.prior, self.pins, self.posterior.n_states, self.moves
        )

    def gaps(self, design: EventLog) -> list[Gap]:
        """Actions whose response table or transition table the rest says nothing about."""
        p = design.protocol
        n = self.posterior.n_states
        informed = Layout(p, n).informed_rows(self.rest)
        moves = informed[1 : 1 + p.n_actions * n : n]
        answers = informed[1 + p.n_actions * n :: n]
        out = []
        for a, name in enumerate(p.action_names):
            taken = design.action == a
            here, later = np.zeros(design.n_events, dtype=bool), np.zeros(design.n_events, dtype=bool)
            if p.emission_index[a] >= 0 and not answers[p.emission_index[a]]:
                here = taken
            if n > 1 and name not in self.pins and not moves[a]:
                later = earlier(design, taken)
            if here.any() or later.any():
                out.append((never(self.rest, name, bool(here.any()), bool(later.any())), here | later))
        return out


def latent(
    name: str,
    kind: str,
    states: int,
    *,
    pins: Mapping[str, Array | None],
    prior: DirichletPrior,
    fitter: Fitter,
    draws: int,
    moves: SmcSettings,
) -> Contender:
    """A latent-state model as a contender."""

    def learn(rest: EventLog) -> LatentForecaster:
        posterior = fitter(rest, states, pins, None)
        return LatentForecaster(posterior, rest, posterior.draws().thin(draws), prior, pins, moves)

    return Contender(name, kind, learn)
