"""What Baum-Welch found: the best optimum in canonical order, how it was found, and what can be asked of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from models import inference
from models.events import EventLog
from models.lspomdp import LatentStatePOMDP
from models.model_draws import ModelDraws
from models.notebook_view import NotebookView, View
from models.parameters import Array
from models.simulation import simulate_responses

if TYPE_CHECKING:
    from models.baum_welch import BaumWelch


@dataclass(frozen=True)
class Optimum:
    """One bar of the optima histogram: restarts that ended within `SAME_OPTIMUM` of each other."""

    log_likelihood: float
    restarts: int
    converged: int


@dataclass(frozen=True)
class BaumWelchFit(NotebookView):
    """The best optimum found, in canonical state order, and how it was found.

    Attributes
    ----------
    model : LatentStatePOMDP
        With a caution unless the search converged.
    log_likelihood : float
        Natural log, summed over runs.
    trace : float64[iterates]
        Objective (log-likelihood plus log-prior) of the winning run's final stage; never decreases.
    converged : bool
        False if the cap on EM maps was reached before the gain stayed below the tolerance.
    maps : int
        EM maps computed by the winning run's final stage.
    optima : tuple of Optimum
        Histogram of where the runs of the final stage ended, best first.
    screened : float64[restarts]
        Log-likelihoods after the screening stage (empty for a single stage).
    n_parameters : int
        Free parameters of the tables the data can inform; pinned and unused tables are not counted.
    n_responses : int
        Recorded responses: the sample size in `bic`.
    n_runs : int
    restarts : int
        Random starts made, over all rounds.
    initial_count, transition_count, emission_count : arrays
        Expected counts at the optimum, in the shapes of the tables.
    stationarity : float
        Largest ``max_i g_i - p . g`` over free rows: zero at a stationary point of the likelihood.
    emission_weights : float64[e]
        Weights of the canonical order (recorded responses under each action).
    pins : mapping
        Transition tables that were held fixed, in canonical state order.
    settings : BaumWelch
    """

    model: LatentStatePOMDP
    log_likelihood: float
    trace: Array
    converged: bool
    maps: int
    optima: tuple[Optimum, ...]
    screened: Array
    n_parameters: int
    n_responses: int
    n_runs: int
    restarts: int
    initial_count: Array
    transition_count: Array
    emission_count: Array
    stationarity: float
    emission_weights: Array
    pins: Mapping[str, Array]
    settings: BaumWelch

    def __post_init__(self) -> None:
        # What is planned with the model alone must tell of it too.
        cautions = tuple(filter(None, (self.caution,)))
        if self.model.cautions != cautions:
            object.__setattr__(self, "model", replace(self.model, cautions=cautions))

    @property
    def caution(self) -> str:
        """What everything made from the model repeats (`models.cautions`); empty if the search converged."""
        if self.converged:
            return ""
        return f"Baum-Welch did not converge within {self.settings.max_maps:,} EM maps"

    @property
    def n_states(self) -> int:
        """Number of latent states."""
        return self.model.n_states

    @property
    def aic(self) -> float:
        """Akaike's criterion, ``2 n_parameters - 2 log_likelihood``."""
        return 2.0 * self.n_parameters - 2.0 * self.log_likelihood

    @property
    def bic(self) -> float:
        """Bayesian criterion, ``log(n_responses) n_parameters - 2 log_likelihood``: log of *recorded responses*."""
        return float(np.log(self.n_responses)) * self.n_parameters - 2.0 * self.log_likelihood

    @property
    def runs_in_final_stage(self) -> int:
        """Restarts that were run to convergence or to the cap."""
        return sum(o.restarts for o in self.optima)

    @property
    def gap_to_second(self) -> float:
        """Log-likelihood between the best optimum and the next one found; NaN if all runs agree."""
        if len(self.optima) < 2:
            return float("nan")
        return self.optima[0].log_likelihood - self.optima[1].log_likelihood

    @property
    def best_is_doubtful(self) -> bool:
        """Whether fewer than three runs agree on the best optimum although there were more."""
        return self.optima[0].restarts < min(3, self.runs_in_final_stage)

    @property
    def sentence(self) -> str:
        """What was found and how far to trust the search, in one sentence (two where it is doubtful)."""
        best = self.optima[0]
        state = "converged" if self.converged else f"did NOT converge within {self.settings.max_maps} EM maps"
        runs = "final runs" if self.settings.finalists is not None else "restarts"
        text = (
            f"{self.n_states} state{'s' if self.n_states > 1 else ''}: log-likelihood {self.log_likelihood:.2f}, "
            f"{state}; {best.restarts} of {self.runs_in_final_stage} {runs} ended at this optimum"
        )
        if len(self.optima) > 1:
            text += f", the next lies {self.gap_to_second:.2f} below"
        if self.best_is_doubtful:
            text += (
                f". WARNING: reached by only {best.restarts}; another seed or more restarts may find a better one"
            )
        return text + "."

    def score(self, log: EventLog) -> float:
        """Log-likelihood of a log under the fitted model."""
        return inference.log_likelihood(self.model, log)

    def run_log_likelihoods(self, log: EventLog) -> Array:
        """Log-likelihood of each run of a log; shape ``[runs]``."""
        return inference.run_log_likelihoods(self.model, log)

    def predict_proba(self, log: EventLog) -> Array:
        """Smoothed state probabilities of every event of a log; shape ``[events, s]``."""
        return inference.smoothed(self.model, log)

    def decode(self, log: EventLog) -> tuple[float, NDArray[np.int64]]:
        """Most probable state path: its joint log-probability summed over runs, and the state of every event."""
        return inference.most_probable_path(self.model, log)

    def sample(self, design: EventLog, rng: np.random.Generator) -> tuple[EventLog, NDArray[np.int8]]:
        """Draw responses and states under the actions of a log (`models.simulation`)."""
        return simulate_responses(self.model, design, rng)

    def draws(self) -> ModelDraws:
        """The fit as a single draw, for everything that consumes `ModelDraws`."""
        provenance = {"learner": "Baum-Welch", "seed": self.settings.seed, "log_likelihood": self.log_likelihood}
        return ModelDraws.from_models([self.model], provenance=provenance)

    def _view(self) -> View:
        found, _, doubt = self.sentence.partition(". WARNING: ")
        warnings = [doubt.capitalize()] * bool(doubt)
        if not self.converged:
            warnings.insert(0, f"it did not converge within {self.settings.max_maps:,} EM maps.")
        numbers = (
            f"{self.n_parameters} free parameters, {self.n_responses:,} responses, {self.n_runs:,} runs: "
            f"AIC {self.aic:.2f}, BIC {self.bic:.2f}."
        )
        said = (f"{found.rstrip('.')}.", numbers)
        return View("Baum-Welch fit", "", tuple(warnings), (), said, self.model._view().tables)
