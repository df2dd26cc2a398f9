"""How many states, and does a latent state beat what needs none? One table, one figure, one sentence.

Criteria that answer different questions: LOO and k-fold over people ask who predicts the next *person* best, the
marginal likelihood which model (with its prior) made the data likelier, BIC approximates that without a prior, AIC
predicts like LOO where no entry sits on its boundary, and the maximised log-likelihood is the paper's criterion,
which cannot fall as states are added.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pandas as pd

from analysis.model_criteria import HIGH_K, ModelCriteria, of_latent, of_rival
from models.baum_welch import BaumWelch
from models.bayesian_fit import fit
from models.errors import located
from models.events import EventLog
from models.notebook_view import NotebookView
from models.nuts import NutsSettings
from models.parameters import STICKY, Array, DirichletPrior
from models.people_folds import MOVES, assign_folds
from models.person_offset import PersonOffset
from models.posterior import Posterior
from models.quiet import without_warnings
from models.rivals import constant, first_order_markov, static_pins
from models.smc import SmcSettings

Progress = Callable[[str, int, int], None]
Learn = Callable[[int, Mapping[str, Array | None], PersonOffset | None], Posterior]

CRITERIA = {
    "elpd": "LOO", "kfold": "k-fold over people", "log_marginal": "marginal likelihood", "bic": "BIC", "aic": "AIC",
    "log_likelihood": "log-likelihood",
}  # fmt: skip
"""Columns that choose a model, and their names; of AIC and BIC the smallest is best, of the others the largest."""

CLOSE = 4.0
"""Nats of elpd below which a difference says nothing, whatever its standard error (Sivula et al. 2025)."""


@dataclass(frozen=True)
class CompareSettings:
    """How much work goes into a comparison.

    Attributes
    ----------
    restarts, finalists : int
        Of Baum-Welch.
    sampler : NutsSettings
    evidence : SmcSettings
    moves : SmcSettings
        Of the held-out folds.
    folds : int
    types : tuple of int
        Numbers of types of the static mixtures.
    seed : int
    """

    restarts: int = 200
    finalists: int = 30
    sampler: NutsSettings = field(default_factory=NutsSettings)
    evidence: SmcSettings = field(default_factory=SmcSettings)
    moves: SmcSettings = MOVES
    folds: int = 10
    types: tuple[int, ...] = (2, 3)
    seed: int = 1

    def __post_init__(self) -> None:
        if any(isinstance(n, bool) or n < 2 for n in self.types):
            raise located(
                "comparison, types", list(self.types), "numbers of types from 2 (1 is the constant model)"
            )

    @classmethod
    def of(cls, quick: bool = False, *, folds: int = 10, seed: int = 1) -> CompareSettings:
        """Full or quick settings; the quick ones rank models, they do not settle close calls."""
        if quick:
            return cls(
                60, 10, NutsSettings(draws=450, tune=350, seed=seed), SmcSettings(200, 2, moves=2, seed=seed),
                SmcSettings(200, moves=3, seed=seed), folds, (2,), seed,
            )  # fmt: skip
        return cls(
            sampler=NutsSettings(seed=seed), evidence=SmcSettings(seed=seed),
            moves=SmcSettings(MOVES.particles, moves=MOVES.moves, seed=seed), folds=folds, seed=seed,
        )  # fmt: skip


@dataclass(frozen=True)
class Comparison(NotebookView):
    """Models side by side under every criterion.

    Attributes
    ----------
    models : tuple of ModelCriteria
        Rivals first, then the latent-state models by number of states.
    stacking : DataFrame
        `arviz.compare` as it came, unrounded, indexed by model name.
    settings : CompareSettings
    prior : DirichletPrior
        Of the Bayesian criteria.
    people, responses : int
    """

    models: tuple[ModelCriteria, ...]
    stacking: pd.DataFrame
    settings: CompareSettings
    prior: DirichletPrior
    people: int
    responses: int

    @cached_property
    def table(self) -> pd.DataFrame:
        """One row a model.

        Columns ``model, kind, size, n_parameters``; then by criterion, differences always to the best model by that
        criterion (0 for it, worse is negative, for AIC and BIC positive):

        - ``elpd, se, p, elpd_diff, dse, p_worse, diag_diff, diag_elpd, weight``: PSIS-LOO by participant as
          `arviz.compare` gives it. Do not rely on ``p_worse`` where ``diag_diff`` says something, nor read
          ``weight`` (stacking) as a probability: among models that predict alike it picks one.
        - ``max_pareto_k, high_k``: largest Pareto k, and people above 0.7.
        - ``kfold, kfold_diff, kfold_dse``: k-fold over people.
        - ``log_marginal, log_marginal_error, log_marginal_diff``: depends on the prior.
        - ``log_likelihood, aic, bic, aic_diff, bic_diff``.
        - ``gate``: ``passed``, ``failed`` or ``exact`` (independent draws).

        K-fold and marginal likelihood are NaN where they were not made.
        """
        rows = []
        folded = [m.kfold for m in self.models if not np.isnan(m.kfold).any()]
        best_fold = max(folded, key=np.sum, default=np.full(self.people, np.nan))
        for m in self.models:
            own = self.stacking.loc[m.name]
            apart = m.kfold - best_fold
            rows.append(
                {
                    "model": m.name, "kind": m.kind, "size": m.size, "n_parameters": m.n_parameters,
                    "elpd": own["elpd"], "se": own["se"], "p": own["p"], "elpd_diff": own["elpd_diff"],
                    "dse": own["dse"], "p_worse": own["p_worse"], "diag_diff": own["diag_diff"],
                    "diag_elpd": own["diag_elpd"], "weight": own["weight"],
                    "max_pareto_k": float(m.loo.pareto_k.max()), "high_k": m.high_k,
                    "kfold": float(m.kfold.sum()), "kfold_diff": float(apart.sum()),
                    "kfold_dse": float(np.sqrt(len(apart) * apart.var())),
                    "log_marginal": m.log_marginal, "log_marginal_error": m.log_marginal_error,
                    "log_likelihood": m.log_likelihood, "aic": m.aic, "bic": m.bic,
                    "gate": "exact" if m.gate is None else "passed" if m.gate.passed else "failed",
                }
            )  # fmt: skip
        frame = pd.DataFrame(rows)
        frame["log_marginal_diff"] = frame["log_marginal"] - frame["log_marginal"].max()
        for name in ("aic", "bic"):
            frame[f"{name}_diff"] = frame[name] - frame[name].min()
        return frame

    def choices(self, kinds: Sequence[str] | None = None) -> dict[str, str]:
        """Best model by each criterion, among models of some kinds (all by default) for which it was made.

        A criterion made for none of them chooses nothing and is left out.
        """
        some = self.table if kinds is None else self.table[self.table["kind"].isin(kinds)]
        height = {c: (-1 if c in ("aic", "bic") else 1) * some[c].to_numpy(float) for c in CRITERIA}
        return {
            column: str(some["model"].iloc[int(np.nanargmax(values))])
            for column, values in height.items()
            if not np.isnan(values).all()
        }

    def indistinct(self, kinds: Sequence[str] | None = None) -> dict[str, list[str]]:
        """Models that a criterion cannot tell from its best, which comes first.

        LOO and k-fold: within 4 nats or two standard errors of the difference. Marginal likelihood: within 1 nat (a
        Bayes factor below 3) or twice the Monte Carlo error. BIC and AIC: within 2. The log-likelihood: no other.
        """
        some = [m for m in self.models if kinds is None or m.kind in kinds]
        chosen = self.choices(kinds)
        by_name = {m.name: m for m in some}
        out = {}
        for column, name in chosen.items():
            best = by_name[name]
            out[column] = [name, *(m.name for m in some if m is not best and _close(column, best, m))]
        return out

    def elpd_difference(self, one: str, other: str) -> tuple[float, float]:
        """Difference in elpd by LOO between two models and its standard error, person by person."""
        pointwise = {m.name: m.loo.elpd_i.values for m in self.models}
        return _paired(pointwise[one] - pointwise[other])

    @property
    def sentence(self) -> str:
        """Which conclusions agree and which do not."""
        from analysis.comparison_words import sentence

        return sentence(self)

    @property
    def warnings(self) -> list[str]:
        """Why numbers should not be relied on; empty if nothing was met."""
        out = [f"{m.name}: {m.gate.sentence}" for m in self.models if m.gate is not None and not m.gate.passed]
        out += [
            f"{m.name}: {m.high_k} of {self.people} people have a Pareto k above {HIGH_K}, so LOO is not to be "
            "relied on there; read the k-fold column"
            for m in self.models
            if m.high_k
        ]
        out += [f"{m.name}: Baum-Welch did not converge" for m in self.models if not m.converged]
        return out


def compare(
    log: EventLog,
    states: Sequence[int] = (1, 2, 3, 4, 5),
    *,
    pins: Mapping[str, Array | None] | None = None,
    prior: DirichletPrior = STICKY,
    people: PersonOffset | None = None,
    settings: CompareSettings | None = None,
    learn: Learn | None = None,
    executor: Executor | None = None,
    progress: Progress | None = None,
) -> Comparison:
    """Compare latent-state models with each other and with their rivals.

    Parameters
    ----------
    log : EventLog
    states : sequence of int
        One state is the constant model, which is always among the rivals.
    pins : mapping, optional
        Transition tables held fixed in the latent-state models (None: the identity).
    prior : DirichletPrior
        Of the latent-state models; its emission parameter is also the rivals'.
    people : PersonOffset, optional
        Compare the hierarchical version at every number of states too, and at one state, where only people differ.
    settings : CompareSettings, optional
    learn : callable, optional
        States, pins and person offset to a posterior, where a store of fits is at hand;
        `models.bayesian_fit.fit` by default.
    executor : concurrent.futures.Executor, optional
        Does restarts of Baum-Welch and fits without a fold; threads of this process by default. The result does
        not depend on it.
    progress : callable, optional
        Called with (what is running, done, total).

    Raises
    ------
    InputError
        On a log without responses, fewer people than folds, or pins that do not fit.
    """
    settings = settings or CompareSettings()
    pins = dict(pins or {})
    dynamic = sorted({int(k) for k in states if k > 1})
    fold = assign_folds(log, settings.folds, settings.seed)
    tell = progress or (lambda label, done, total: None)

    def sampled(k: int, held: Mapping[str, Array | None], offset: PersonOffset | None) -> Posterior:
        return fit(log, k, prior=prior, pins=held, people=offset, sampler=settings.sampler)

    draws = settings.sampler.draws
    models = [
        of_rival(constant(log, prior.emission), "constant (1 state)", "constant", log, fold, draws, settings.seed),
        of_rival(
            first_order_markov(log, prior.emission), "first-order Markov", "markov", log, fold, draws, settings.seed
        ),
    ]
    still = static_pins(log.protocol)
    wanted: list[tuple[str, int, Mapping[str, Array | None], PersonOffset | None]]
    wanted = [*(("types", n, still, None) for n in settings.types), *(("states", k, pins, None) for k in dynamic)]
    if people is not None:
        wanted += [("traits", 1, pins, people), *(("people", k, pins, people) for k in dynamic)]
    for done, (kind, k, held, offset) in enumerate(wanted):
        tell("comparing models", done, len(wanted))
        em = BaumWelch(
            k, restarts=settings.restarts, finalists=settings.finalists, pins=held, seed=settings.seed
        ).fit(log, executor=executor)
        posterior = (learn or sampled)(k, held, offset)
        name = {"traits": "people differ, no states", "people": f"{k} states, people differ"}.get(
            kind, f"{k} {kind}"
        )
        models.append(
            of_latent(
                log, name, kind, em, posterior, prior, held, fold, settings.evidence, settings.moves, offset,
                executor,
            )
        )  # fmt: skip
    tell("comparing models", len(wanted), len(wanted))
    return Comparison(tuple(models), stacked(models), settings, prior, log.n_participants, log.n_responses_recorded)


def _close(column: str, best: ModelCriteria, other: ModelCriteria) -> bool:
    """Whether a criterion cannot tell a model from its best one."""
    if column in ("elpd", "kfold"):
        apart = best.kfold - other.kfold if column == "kfold" else best.loo.elpd_i.values - other.loo.elpd_i.values
        gap, error = _paired(apart)
        return gap < max(CLOSE, 2 * error)
    if column == "log_marginal":
        noise = float(np.hypot(best.log_marginal_error, other.log_marginal_error))
        return best.log_marginal - other.log_marginal < max(1.0, 2 * noise)
    if column in ("aic", "bic"):
        return bool(getattr(other, column) - getattr(best, column) < 2.0)
    return False


def _paired(apart: Array) -> tuple[float, float]:
    """Sum over people and its standard error."""
    return float(apart.sum()), float(np.sqrt(len(apart) * apart.var()))


def stacked(models: Sequence[ModelCriteria]) -> pd.DataFrame:
    """`arviz.compare` of the models with stacking weights, unrounded, every column kept."""
    import arviz as az

    with without_warnings():
        frame: pd.DataFrame = az.compare({m.name: m.loo for m in models}, method="stacking", round_to="none")
    return frame
