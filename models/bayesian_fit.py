"""Fitting the Bayesian model: sample, put every draw into canonical order, examine, keep what is needed later."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from models.draw_kernels import constrained, history_log_likelihoods
from models.errors import InputError, located
from models.events import EventLog
from models.gate import convergence_gate
from models.hmm_density import HmmDensity
from models.lspomdp import default_state_names
from models.nuts import Chain, NutsSettings, Progress, sample
from models.parameters import STICKY, Array, DirichletPrior, Layout, checked_pins, recorded
from models.posterior import TABLES, Posterior
from models.relabel import exchangeable, exchangeable_prior, relabel_draws

Engine = Literal["direct", "pymc"]

PRIOR_DRAWS = 4_000
"""Draws from the prior, relabelled like the posterior's, that contraction is measured against."""

PRIOR_STREAM = 7_102
"""First element of the spawn key of those draws."""


def fit(
    log: EventLog,
    states: int,
    *,
    prior: DirichletPrior = STICKY,
    pins: Mapping[str, Array | None] | None = None,
    engine: Engine = "direct",
    sampler: NutsSettings | None = None,
    done: Mapping[int, Chain] | None = None,
    finished: Callable[[int, Chain], None] | None = None,
    progress: Progress | None = None,
) -> Posterior:
    """Sample the posterior.

    Parameters
    ----------
    log : EventLog
    states : int
    prior : DirichletPrior
        Sticky by default (two pseudo-counts more on staying).
    pins : mapping, optional
        Transition tables held fixed (None: the identity).
    engine : {"direct", "pymc"}
        The compiled density, or the PyMC model; same posterior.
    sampler : NutsSettings, optional
    done, finished
        Chains of an interrupted run, and what to do with each chain as it completes (engine `direct`).
    progress : callable, optional

    Raises
    ------
    InputError
        On a log without responses, pins that do not fit, or pins or a prior that tell states apart (relabelling
        would then be wrong).
    """
    recorded(log)
    sampler = sampler or NutsSettings()
    layout = Layout(log.protocol, states)
    held = checked_pins(layout, pins or {})
    if not exchangeable(held):
        raise InputError(
            "pinned tables tell the states apart, so draws must not be relabelled: hold a table at the identity, "
            "or sample your own model and keep its labels"
        )
    alpha = 1.0 + prior.pseudo_counts(layout)
    if not exchangeable_prior(*layout.unpack(alpha)):
        raise InputError(
            "the prior tells the states apart, so draws must not be relabelled: sample your own model and keep its "
            "labels"
        )
    density = HmmDensity(log.tree(), layout, alpha, held)
    started = (time.process_time(), time.perf_counter())
    if engine == "direct":
        chains = sample(density, sampler, done=done, finished=finished, progress=progress)
        theta = constrained(density, np.stack([c.x for c in chains.values()]))
        stats = {k: np.stack([c.stats[k] for c in chains.values()]) for k in next(iter(chains.values())).stats}
    elif engine == "pymc":
        theta, stats = _sample_pymc(log, states, prior, held, layout, sampler)
    else:
        raise located("engine", engine, "direct or pymc")
    seconds = time.perf_counter() - started[1]
    posterior = _labelled(theta, layout, log)
    settings = {
        "states": states, "prior": vars(prior), "pins": {a: t.tolist() for a, t in held.items()}, "engine": engine,
        "sampler": vars(sampler),
    }  # fmt: skip
    flat_theta = np.concatenate([t.reshape(*t.shape[:2], -1) for t in posterior], axis=-1)
    by_history = history_log_likelihoods(density.tree, layout, flat_theta)
    rng = np.random.default_rng(np.random.SeedSequence(sampler.seed, spawn_key=(PRIOR_STREAM, states)))
    prior_theta = _prior_draws(density, PRIOR_DRAWS, rng)
    data = _tree(log, posterior, _labelled(prior_theta[None], layout, log), stats, by_history, density)
    names, quantities = _gate_quantities(layout, posterior, by_history, density, log)
    gate = convergence_gate(quantities, names, int(stats["diverging"].sum()))
    return Posterior(
        data, log.protocol, gate, settings, log.emission_weights, time.process_time() - started[0], seconds
    )


def _prior_draws(density: HmmDensity, n: int, rng: np.random.Generator) -> Array:
    theta = np.tile(density.template, (n, 1))
    for start, width, *_ in zip(*density.plan, strict=True):
        row = slice(start, start + width)
        theta[:, row] = rng.dirichlet(density.alpha[row], size=n)
    return theta


def _labelled(theta: Array, layout: Layout, log: EventLog) -> tuple[Array, Array, Array]:
    s, a, e, o = layout.sizes
    lead = theta.shape[:-1]
    first, second = s, s + a * s * s
    return relabel_draws(
        theta[..., :first],
        theta[..., first:second].reshape(*lead, a, s, s),
        theta[..., second:].reshape(*lead, e, s, o),
        log.protocol.scores,
        log.emission_weights,
    )


def _gate_quantities(
    layout: Layout, tables: tuple[Array, Array, Array], by_history: Array, density: HmmDensity, log: EventLog
) -> tuple[list[str], NDArray[np.float64]]:
    """Every entry after relabelling, and label-invariant quantities: log-likelihood in all and by condition."""
    s, a, e, o = layout.sizes
    names = [f"initial[{i}]" for i in range(s)]
    names += [f"transition[{i},{j},{k}]" for i in range(a) for j in range(s) for k in range(s)]
    names += [f"emission[{i},{j},{k}]" for i in range(e) for j in range(s) for k in range(o)]
    history = np.searchsorted(density.tree.terminals, density.tree.run_node)
    columns = [t.reshape(*t.shape[:2], -1) for t in tables]
    for c, name in enumerate(log.conditions):
        counts = np.bincount(history[log.condition == c], minlength=density.tree.n_histories)
        columns.append((by_history @ counts)[..., None])
        names.append(f"log-likelihood of condition {name}")
    columns.append(np.sum(columns[-len(log.conditions) :], axis=0))
    names.append("log-likelihood")
    return names, np.concatenate(columns, axis=-1)


def _tree(
    log: EventLog, posterior: tuple[Array, ...], prior: tuple[Array, ...], stats: Mapping[str, NDArray],
    by_history: Array, density: HmmDensity,
) -> xr.DataTree:  # fmt: skip
    p = log.protocol
    n = posterior[0].shape[-1]
    names = list(default_state_names(n))
    coords = {
        "state": names, "state_next": names, "action": list(p.action_names),
        "emission_action": list(p.emission_actions), "response": list(p.response_names),
    }  # fmt: skip
    dims = {
        "initial": ("state",), "transition": ("action", "state", "state_next"),
        "emission": ("emission_action", "state", "response"),
    }  # fmt: skip

    def group(tables: tuple[Array, ...]) -> xr.Dataset:
        return xr.Dataset(
            {k: (("chain", "draw", *dims[k]), t) for k, t in zip(TABLES, tables, strict=True)}, coords=coords
        )

    history = np.searchsorted(density.tree.terminals, density.tree.run_node)
    people, person = np.unique(log.participant, return_inverse=True)
    by_run = by_history[..., history]
    starts = np.flatnonzero(np.append(True, person[1:] != person[:-1]))
    by_person = np.add.reduceat(by_run, starts, axis=-1)
    return xr.DataTree.from_dict(
        {
            "posterior": group(posterior),
            "prior": group(prior),
            "sample_stats": xr.Dataset({k: (("chain", "draw"), v) for k, v in stats.items()}),
            "log_likelihood": xr.Dataset(
                {"participant": (("chain", "draw", "person"), by_person)}, coords={"person": people}
            ),
        }
    )


def _sample_pymc(
    log: EventLog, states: int, prior: DirichletPrior, pins: Mapping[str, Array], layout: Layout,
    sampler: NutsSettings,
) -> tuple[Array, dict[str, NDArray]]:  # fmt: skip
    import pymc as pm

    from models.bayesian_hmm import build_model  # loads PyMC, which the direct engine does without

    model = build_model(log, states, prior, pins)
    with model:
        trace = pm.sample(
            sampler.draws, tune=sampler.tune, chains=sampler.chains, random_seed=sampler.seed, progressbar=False,
            nuts={"target_accept": sampler.target_accept}, compute_convergence_checks=False,
        )  # fmt: skip
    group = trace["posterior"].to_dataset()
    p = log.protocol
    if p.n_responses == 2:
        top = int(np.argmax(p.scores))
        high = group[f"{p.response_names[top]}_probability"].to_numpy()
        pair = (1 - high, high)
        emission = np.stack(pair if top == 1 else pair[::-1], axis=-1)
    else:
        emission = group["emission"].to_numpy()
    tables = (group["initial"].to_numpy(), group["transition"].to_numpy(), emission)
    theta = np.concatenate([t.reshape(*t.shape[:2], -1) for t in tables], axis=-1)
    own = trace["sample_stats"].to_dataset()
    names = {"diverging": "diverging", "n_steps": "n_steps", "energy": "energy", "lp": "logp"}
    return theta, {k: own[v].to_numpy() for k, v in names.items() if v in own}
