r"""The logistic mixed model as a forecaster of people who were left out.

.. math:: \operatorname{logit} P(y_{ij} = 1 \mid u_i) = x_{ij}'\beta + \sigma u_i, \qquad u_i \sim N(0, 1)

with the factors of `analysis.held_out_factors` and one intercept a person, shared by all their runs. It knows no
rounds and no states. Doubt about the parameters is the normal approximation with the model's covariance
(`models.mixed_predictive`); new people draw new intercepts. A factor that never varied in the rest has no estimable
effect: it is left out of the fit, so none is assumed, and where it matters that is flagged.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import expit

from analysis import response_rates as rates
from analysis.forecasters import CannotTakePart, Contender, Gap
from analysis.held_out_factors import Factor, design_of, factors_of
from models.errors import InputError
from models.events import EventLog
from models.glmm import LogisticMixedModel
from models.glmm_data import Patterns, Rule
from models.glmm_marginal import mean_probability
from models.glmm_results import LogisticMixedResults
from models.glmm_warnings import ConvergenceWarning, SeparationWarning
from models.histories import UNSEEN
from models.joint_predictive import LogPredictive
from models.mixed_predictive import NormalBelief, mixed_log_predictive
from models.parameters import Array
from models.person_offset import person_of_run
from models.protocol import Protocol

NAME = "mixed model"
"""Of the contender."""


@dataclass(frozen=True)
class MixedForecaster:
    """The mixed model after learning.

    Attributes
    ----------
    results : LogisticMixedResults
        Of the rest.
    factors : tuple of Factor
        In the fit.
    dropped : tuple of (Factor, float)
        Never varied in the rest, with the value they had.
    belief : NormalBelief
    theta : float64[draw, 2 + factor]
        Draws: intercept, effects, standard deviation.
    seed : int
    """

    results: LogisticMixedResults
    factors: tuple[Factor, ...]
    dropped: tuple[tuple[Factor, float], ...]
    belief: NormalBelief
    theta: Array
    seed: int

    @property
    def n_draws(self) -> int:
        """Draws of its parameters."""
        return len(self.theta)

    @property
    def gate(self) -> str:
        """Whether a maximum was found and all coefficients are finite."""
        grave = (SeparationWarning, ConvergenceWarning)
        return "failed" if any(issubclass(note.category, grave) for note in self.results.notes) else "passed"

    @property
    def doubts(self) -> list[str]:
        """The notes of the fit."""
        return [note.text for note in self.results.notes]

    def expected(self, design: EventLog) -> Array:
        r"""Averaged over people, :math:`\int \operatorname{expit}(x'\beta + \sigma u)\varphi(u)du`."""
        rows, back = np.unique(design_of(design, self.factors), axis=0, return_inverse=True)
        p = np.stack([mean_probability(rows @ t[:-1], float(t[-1])) for t in self.theta])
        low, high = _values(design.protocol)
        return np.asarray(low + (high - low) * p[:, back.ravel()])

    def responses(self, design: EventLog, draw: int, rng: np.random.Generator) -> NDArray[np.int8]:
        """New people, with one new intercept each for all their runs."""
        theta = self.theta[draw]
        person = theta[-1] * rng.standard_normal(design.n_participants)
        eta = design_of(design, self.factors) @ theta[:-1] + person[person_of_run(design)][design.run_of_event]
        high = success_of(design.protocol)
        hit = rng.random(design.n_events) < expit(eta)
        response = np.where(hit, high, 1 - high).astype(np.int8)
        return np.where(design.response == UNSEEN, np.int8(UNSEEN), response)

    def log_predictive(self, held: EventLog) -> LogPredictive:
        """Joint by importance sampling, by person over the draws."""
        seen = held.response != UNSEEN
        person = person_of_run(held)[held.run_of_event[seen]]
        present, code = np.unique(person, return_inverse=True)
        n = int(np.count_nonzero(seen))
        success = (held.response[seen] == success_of(held.protocol)).astype(np.float64)
        patterns = Patterns.from_rows(
            design_of(held, self.factors)[seen], np.zeros(n), success, np.ones(n), np.ones(n), code.astype(np.int64)
        )
        rule: Rule = self.results.model.rule
        found = mixed_log_predictive(self.belief, self.theta, patterns, rule, self.seed)
        by_person = np.zeros(held.n_participants)  # nothing was recorded of the others
        by_person[present] = found.by_person
        return LogPredictive(found.joint, found.error, by_person)

    def gaps(self, design: EventLog) -> list[Gap]:
        """Factors that never varied in the rest and do in the design."""
        out = []
        for factor, value in self.dropped:
            mask = factor.column(design) != value
            if mask.any():
                out.append((f"factor {factor.name} never varied in the rest: no effect is assumed", mask))
        return out


def mixed(log: EventLog, draws: int, seed: int) -> Contender:
    """The mixed model as a contender.

    Parameters
    ----------
    log : EventLog
        The whole study, for its design.
    draws : int
    seed : int
    """
    factors = factors_of(log)

    def learn(rest: EventLog) -> MixedForecaster:
        return _learned(rest, factors, draws, seed)

    return Contender(NAME, "mixed", learn)


def success_of(protocol: Protocol) -> int:
    """Of two responses the one with the higher score."""
    return int(np.argmax(protocol.scores))


def _values(protocol: Protocol) -> tuple[float, float]:
    value, high = rates.value_of_response(protocol), success_of(protocol)
    return float(value[1 - high]), float(value[high])


def _learned(rest: EventLog, factors: tuple[Factor, ...], draws: int, seed: int) -> MixedForecaster:
    p = rest.protocol
    if p.n_responses != 2:
        raise CannotTakePart(f"it is for two responses, and protocol {p.name!r} has {p.n_responses}")
    seen = rest.response != UNSEEN
    columns = [(f, f.column(rest)[seen]) for f in factors]
    kept = tuple(f for f, column in columns if np.ptp(column) > 0)
    dropped = tuple((f, float(column[0])) for f, column in columns if np.ptp(column) == 0)
    design = design_of(rest, kept)[seen]
    if np.linalg.matrix_rank(design) < design.shape[1]:
        raise CannotTakePart(
            f"of {', '.join(f.name for f in kept)} at least one is determined by the others in the rest, so their "
            "effects cannot be told apart"
        )
    names = ["Intercept", *(f.name for f in kept)]
    try:
        model = LogisticMixedModel(
            (rest.response[seen] == success_of(p)).astype(np.float64),
            pd.DataFrame(design, columns=names),
            groups=rest.participant[rest.run_of_event[seen]],
            group_name="participant",
        )
        results = model.fit(warn=False)._results
        belief = NormalBelief.of(results.maximum)
    except InputError as error:
        raise CannotTakePart(str(error)) from error
    except ValueError as error:
        raise CannotTakePart(f"its fit failed: {error}") from error
    return MixedForecaster(results, kept, dropped, belief, belief.draws(draws, seed), seed)
