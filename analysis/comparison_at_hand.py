"""A comparison of posteriors at hand: LOO of every one, dearer criteria for those that can be afforded.

LOO costs next to nothing once a posterior is sampled. K-fold over people and the marginal likelihood carry
particles through the model again; they are made for every model if that stays within a bound on work, else for the
*contenders* alone: the best model by LOO, its best rival, and what LOO cannot tell from the best. Work is counted,
not timed, so that the same study always gets the same comparison.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from analysis.comparison import CompareSettings, Comparison, stacked
from analysis.model_criteria import HIGH_K, ModelCriteria, by_posterior, checked, of_rival
from models.baum_welch import BaumWelch
from models.baum_welch_fit import BaumWelchFit
from models.events import EventLog
from models.parameters import Array, DirichletPrior
from models.people_folds import assign_folds
from models.person_offset import PersonOffset
from models.posterior import Posterior
from models.rivals import constant, first_order_markov

CHECK_WORK = 8_000
"""Bound on nodes of the tree of histories x states, summed over models, of k-fold and the marginal likelihood."""

NODES_A_STATE = 4
"""Quadrature nodes of people who differ that cost about as much as one more state."""


@dataclass(frozen=True)
class Candidate:
    """A model with a latent state, or with people who differ, whose posterior is at hand.

    Attributes
    ----------
    name, kind : str
        As in `analysis.model_criteria.ModelCriteria`.
    posterior : Posterior
    em : BaumWelchFit or BaumWelch
        Its point estimate, or how to search for it; where people differ, of the model without them.
    pins : mapping
        Transition tables held fixed (None: the identity).
    people : PersonOffset, optional
    """

    name: str
    kind: str
    posterior: Posterior
    em: BaumWelchFit | BaumWelch
    pins: Mapping[str, Array | None]
    people: PersonOffset | None = None


@dataclass(frozen=True)
class Findings:
    """What a report shows of a comparison, in plain content that can be kept.

    Attributes
    ----------
    table : DataFrame
        As `Comparison.table`.
    choices : dict of criterion to model
    indistinct : dict of criterion to models
        As `Comparison.indistinct`.
    sentence : str
    warnings : tuple of str
        As `Comparison.warnings`, without the convergence gate, which is told at once for all.
    gates : dict of model to (largest r-hat, smallest effective sample size)
        Posterior samples that missed the convergence gate.
    checked : tuple of str
        Models with k-fold and marginal likelihood; empty if there are none.
    folds : int
    stay : float
        Pseudo-counts on staying, of the prior.
    people, responses : int
    """

    table: pd.DataFrame
    choices: dict[str, str]
    indistinct: dict[str, list[str]]
    sentence: str
    warnings: tuple[str, ...]
    gates: dict[str, tuple[float, float]]
    checked: tuple[str, ...]
    folds: int
    stay: float
    people: int
    responses: int

    @classmethod
    def of(cls, result: Comparison) -> Findings:
        """Of a comparison, however it was made."""
        failed = {m.name: m.gate for m in result.models if m.gate is not None and not m.gate.passed}
        told = tuple(w for w in result.warnings if not any(w == f"{n}: {g.sentence}" for n, g in failed.items()))
        gates = {n: (float(g.max_rhat), float(min(g.min_ess_bulk, g.min_ess_tail))) for n, g in failed.items()}
        folded = tuple(m.name for m in result.models if not np.isnan(m.kfold).any())
        return cls(
            result.table, result.choices(), result.indistinct(), result.sentence, told, gates, folded,
            result.settings.folds, float(result.prior.stay), result.people, result.responses,
        )  # fmt: skip

    @property
    def not_checked(self) -> tuple[str, ...]:
        """Models with LOO alone."""
        return tuple(name for name in self.table["model"] if name not in self.checked)


def compare_at_hand(
    log: EventLog,
    candidates: Sequence[Candidate],
    prior: DirichletPrior,
    settings: CompareSettings,
    most_work: float = CHECK_WORK,
) -> Comparison:
    """Compare posteriors at hand with each other and with the two rivals that are counted.

    Parameters
    ----------
    log : EventLog
    candidates : sequence of Candidate
        In the order of the table.
    prior : DirichletPrior
        Of their posteriors.
    settings : CompareSettings
        For the folds, the marginal likelihood and the draws of the counting rivals.
    most_work : float
        Bound on the work of k-fold and marginal likelihood; 0 for LOO alone.

    Raises
    ------
    InputError
        On a log without responses, or fewer people than folds.
    """
    fold = assign_folds(log, settings.folds, settings.seed)
    draws = settings.sampler.draws
    counted = (
        ("constant (1 state)", "constant", constant(log, prior.emission)),
        ("first-order Markov", "markov", first_order_markov(log, prior.emission)),
    )
    models = [of_rival(r, name, kind, log, fold, draws, settings.seed) for name, kind, r in counted]
    for c in candidates:
        em = c.em.fit(log) if isinstance(c.em, BaumWelch) else c.em
        models.append(by_posterior(log, c.name, c.kind, em, c.posterior, prior, c.pins, c.people))
    by_loo = Comparison(
        tuple(models), stacked(models), settings, prior, log.n_participants, log.n_responses_recorded
    )
    by_name = {c.name: c for c in candidates}
    # States beside quadrature over people take longer than all the others together.
    work = {c.name: check_work(log, c) for c in candidates if c.kind != "people"}
    chosen = _affordable(by_loo, work, most_work)

    def more(m: ModelCriteria) -> ModelCriteria:
        if m.name in chosen:
            c = by_name[m.name]
            return checked(
                m, log, c.posterior, prior, c.pins, fold, settings.evidence, settings.moves, c.people
            )  # fmt: skip
        if m.name in by_name or chosen:
            return m
        # Beside no other model that has them, the criteria of the counting rivals compare nothing.
        return replace(m, kfold=np.full(len(fold), np.nan), log_marginal=np.nan, log_marginal_error=np.nan)

    return replace(by_loo, models=tuple(more(m) for m in models))


def findings(
    log: EventLog,
    candidates: Sequence[Candidate],
    prior: DirichletPrior,
    settings: CompareSettings,
    most_work: float = CHECK_WORK,
) -> Findings:
    """What a report shows of `compare_at_hand`, whose parameters these are."""
    return Findings.of(compare_at_hand(log, candidates, prior, settings, most_work))


def check_work(log: EventLog, candidate: Candidate) -> float:
    """Nodes of the tree of histories x states, and more where people differ."""
    points = 0 if candidate.people is None else candidate.people.points(log)
    return float(log.tree().n_nodes * max(candidate.posterior.n_states, 1) * max(points / NODES_A_STATE, 1.0))


def _affordable(result: Comparison, work: Mapping[str, float], most: float) -> frozenset[str]:
    """Candidates for k-fold and marginal likelihood: all, or the contenders that the bound has room for."""
    if sum(work.values()) <= most:
        return frozenset(work)
    by_loo = result.indistinct()["elpd"]
    rivals = [m.kind for m in result.models if not m.is_dynamic]
    order = dict.fromkeys([by_loo[0], result.choices(rivals)["elpd"], *by_loo])
    chosen, left = set(), most
    for name in order:
        if name in work and work[name] <= left:
            chosen.add(name)
            left -= work[name]
    return frozenset(chosen)


def high_k_sentence(table: pd.DataFrame, people: int) -> str:
    """How far importance sampling can be relied on, by the largest Pareto k of all models."""
    worst = float(table["max_pareto_k"].max())
    if worst <= HIGH_K:
        return f"The largest Pareto k of any person under any model is {worst:.2f}, below {HIGH_K}: LOO holds."
    many = table[table["max_pareto_k"] > HIGH_K]
    told = ", ".join(f"{r.model} {r.high_k} of {people}" for r in many.itertuples())
    return f"PARETO K ABOVE {HIGH_K}, where LOO is not to be relied on: {told} people."
