"""One model under every criterion of the comparison: likelihood, information criteria, LOO, k-fold, evidence."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import xarray as xr
from numpy.typing import NDArray
from scipy.special import logsumexp

from models.baum_welch_fit import BaumWelchFit
from models.events import EventLog
from models.gate import Gate
from models.parameters import Array, DirichletPrior
from models.people_folds import held_out_log_predictive
from models.people_maximum import people_maximum
from models.person_offset import PersonOffset, person_of_run
from models.posterior import SPREAD, TABLES, Posterior
from models.quiet import without_warnings
from models.rivals import CountingRival
from models.smc import SmcSettings, log_marginal_likelihood
from models.study_density import ModelSpec, StudyDensity

HIGH_K = 0.7
"""Pareto k above which a person's LOO term is not to be relied on."""


@dataclass(frozen=True)
class ModelCriteria:
    """A model with its criteria.

    Attributes
    ----------
    name : str
    kind : str
        ``states`` (a latent state that changes), ``people`` (the same, and people differ), ``types`` (a state that
        does not change), ``markov``, ``constant``.
    size : int
        Number of states or types; 1 for counting rivals.
    log_likelihood : float
        Maximised: the paper's criterion.
    n_parameters : int
    aic, bic : float
    loo : arviz_stats.ELPDDataLOO
        PSIS-LOO by participant, pointwise.
    log_marginal, log_marginal_error : float
        Log marginal likelihood and its Monte Carlo error (0 where it is exact); NaN where it was not estimated.
    kfold : float64[person]
        Log predictive of each person by a model that has not seen their fold; NaN where no fold was held out.
    gate : Gate or None
        Convergence of the posterior sample; None where draws are independent.
    converged : bool
        Whether the maximisation converged.
    """

    name: str
    kind: str
    size: int
    log_likelihood: float
    n_parameters: int
    aic: float
    bic: float
    loo: Any
    log_marginal: float
    log_marginal_error: float
    kfold: Array
    gate: Gate | None = None
    converged: bool = True

    @property
    def is_dynamic(self) -> bool:
        """Whether the model has a latent state that changes."""
        return self.kind in ("states", "people")

    @property
    def high_k(self) -> int:
        """People whose Pareto k is above `HIGH_K`."""
        return int(np.count_nonzero(self.loo.pareto_k.values > HIGH_K))


def alike(log: EventLog) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """People with the same histories: one person of each kind, and the kind of every person.

    Their log-likelihoods are equal under every draw, so importance sampling is done once a kind.
    """
    tree, person = log.tree(), person_of_run(log)
    history = tree.run_node[np.lexsort((tree.run_node, person))]
    pieces = np.split(history, np.cumsum(np.bincount(person))[:-1])
    _, first, kind = np.unique([piece.tobytes() for piece in pieces], return_index=True, return_inverse=True)
    return first.astype(np.int64), kind.astype(np.int64)


def loo_by_person(log_likelihood: Array, kinds: tuple[NDArray[np.int64], NDArray[np.int64]]) -> Any:
    """PSIS-LOO with people as the unit.

    Parameters
    ----------
    log_likelihood : float64[chain, draw, person]
    kinds : (first, kind)
        As from `alike`.

    Returns
    -------
    arviz_stats.ELPDDataLOO
        One value a person. A person whose log-likelihood never varies (no response recorded) has Pareto k 0 and
        their log-likelihood as elpd: importance sampling has nothing to do there, and ArviZ refuses to.
    """
    import arviz as az

    first, kind = kinds
    values = log_likelihood[..., first]
    chains, draws, _ = values.shape
    varies = np.ptp(values.reshape(chains * draws, -1), axis=0) > 1e-12
    if not varies.any():
        raise ValueError("the log-likelihood is the same under every draw: there is nothing to leave out")
    unit = xr.DataArray(values[..., varies], dims=("chain", "draw", "person"))
    # Efficiency from the likelihoods themselves: they know no labels and no held tables.
    likelihood = xr.Dataset({"participant": np.exp(unit - unit.max(("chain", "draw")))})
    with without_warnings():  # ArviZ swaps the process's filters in there
        ess = az.ess(xr.DataTree.from_dict({"posterior": likelihood}), method="mean")
    efficiency = float(np.clip(np.nanmean(ess["participant"].values) / (chains * draws), 0.01, 1.0))
    # Not `az.loo`, which is these terms and a warning of high Pareto k. They are counted and reported with the
    # comparison, and a warning that is not given cannot get out while other threads change the filters.
    with np.errstate(all="ignore"):
        elpd_i, pareto_k, _ = unit.azstats.loo(sample_dims=["chain", "draw"], r_eff=efficiency)
    elpd, k = values[0, 0].copy(), np.zeros(len(first))
    elpd[varies], k[varies] = elpd_i.values, pareto_k.values
    in_sample = logsumexp(values, axis=(0, 1)) - np.log(chains * draws)
    by_person = elpd[kind]
    n = len(kind)
    good_k = float(min(1 - 1 / np.log10(chains * draws), HIGH_K))  # Vehtari et al. 2024, as `az.loo` has it
    return az.ELPDDataLOO(
        elpd=float(by_person.sum()), se=float(np.sqrt(n * by_person.var())),
        p=float((in_sample[kind] - by_person).sum()), n_samples=chains * draws, n_data_points=n, scale="log",
        warning=bool(np.any(k > good_k)), good_k=good_k,
        elpd_i=xr.DataArray(by_person, dims="person"), pareto_k=xr.DataArray(k[kind], dims="person"),
    )  # fmt: skip


def of_rival(
    rival: CountingRival, name: str, kind: str, log: EventLog, fold: NDArray[np.int64], draws: int, seed: int
) -> ModelCriteria:
    """Criteria of a counting rival: exact but for LOO, which is done as for the others."""
    sample = rival.tree(4, draws, seed)["log_likelihood"]["participant"].to_numpy()
    kfold = np.empty(len(fold))
    for number in np.unique(fold):
        kfold[fold == number] = rival.log_predictive(fold == number)
    return ModelCriteria(
        name, kind, 1, rival.log_likelihood, rival.n_parameters, rival.aic, rival.bic,
        loo_by_person(sample, alike(log)), rival.log_marginal_likelihood, 0.0, kfold,
    )  # fmt: skip


def by_posterior(
    log: EventLog,
    name: str,
    kind: str,
    em: BaumWelchFit,
    posterior: Posterior,
    prior: DirichletPrior,
    pins: Mapping[str, Array | None],
    people: PersonOffset | None = None,
) -> ModelCriteria:
    """What a posterior and a point estimate at hand say at once: no k-fold and no marginal likelihood, both NaN.

    Parameters
    ----------
    log, name, kind, em, posterior, prior, pins, people
        As in `of_latent`.
    """
    value, parameters, converged = em.log_likelihood, em.n_parameters, em.converged
    if people is not None:
        density = StudyDensity(log, ModelSpec(posterior.n_states, prior, pins, people=people)).density
        highest = people_maximum(density, em)
        value, parameters, converged = highest.log_likelihood, parameters + 1, highest.converged
    sample = posterior.person_log_likelihoods()
    return ModelCriteria(
        name, kind, posterior.n_states, value, parameters, 2.0 * parameters - 2.0 * value,
        float(np.log(log.n_responses_recorded)) * parameters - 2.0 * value, loo_by_person(sample, alike(log)),
        np.nan, np.nan, np.full(sample.shape[-1], np.nan), posterior.gate, converged,
    )  # fmt: skip


def checked(
    found: ModelCriteria,
    log: EventLog,
    posterior: Posterior,
    prior: DirichletPrior,
    pins: Mapping[str, Array | None],
    fold: NDArray[np.int64],
    evidence: SmcSettings,
    moves: SmcSettings,
    people: PersonOffset | None = None,
    executor: Executor | None = None,
) -> ModelCriteria:
    """The same with what needs more sampling: k-fold over people and the marginal likelihood.

    Parameters
    ----------
    found : ModelCriteria
        As from `by_posterior`.
    log, posterior, prior, pins, fold, evidence, moves, people, executor
        As in `of_latent`.
    """
    density = StudyDensity(log, ModelSpec(posterior.n_states, prior, pins, people=people)).density
    marginal = log_marginal_likelihood(density, evidence)
    tables = [posterior.table(t) for t in TABLES]
    theta = np.concatenate([t.reshape(len(t), -1) for t in tables], axis=1)
    if people is not None:
        theta = np.concatenate([theta, posterior.table(SPREAD)[:, None]], axis=1)
    left_out = held_out_log_predictive(log, density, theta, fold, moves, executor=executor)
    return replace(found, log_marginal=marginal.estimate, log_marginal_error=marginal.error, kfold=left_out)


def of_latent(
    log: EventLog,
    name: str,
    kind: str,
    em: BaumWelchFit,
    posterior: Posterior,
    prior: DirichletPrior,
    pins: Mapping[str, Array | None],
    fold: NDArray[np.int64],
    evidence: SmcSettings,
    moves: SmcSettings,
    people: PersonOffset | None = None,
    executor: Executor | None = None,
) -> ModelCriteria:
    """Criteria of a model with a latent state, changing or not.

    Parameters
    ----------
    log : EventLog
    name, kind : str
    em : BaumWelchFit
    posterior : Posterior
        Of the same states and pins.
    prior : DirichletPrior
        Of `posterior`.
    pins : mapping
    fold : int64[person]
    evidence, moves : SmcSettings
        For the marginal likelihood and for the folds.
    people : PersonOffset, optional
        Where `posterior` is of the hierarchical version; `em` is then where the search for its maximum starts.
    executor : concurrent.futures.Executor, optional
        What folds are spread over; threads of this process by default. The result does not depend on it.
    """
    found = by_posterior(log, name, kind, em, posterior, prior, pins, people)
    return checked(found, log, posterior, prior, pins, fold, evidence, moves, people, executor)
