"""Fitting the Bayesian model: sample, put every draw into canonical order, examine, keep what is needed later."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib.util import find_spec
from itertools import product
from typing import Any, Literal

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from models.chains import Chain, NutsSettings, Progress
from models.chains import sample as sample_target
from models.design_facts import Study
from models.draw_kernels import constrained
from models.entries import entries, entry_names
from models.errors import Phrase, located
from models.fit_tree import build_tree, by_history, by_person, canonical_tables
from models.gate import convergence_gate
from models.groups import Groups
from models.nuts import sample
from models.parameters import STICKY, Array, DirichletPrior, Layout, checked_pins
from models.person_offset import PersonOffset
from models.posterior import Posterior
from models.smc import prior_particles
from models.study_density import ModelSpec, StudyDensity
from models.unseen import EVIDENCE, evidence_of_actions
from models.work_clock import WorkClock

Engine = Literal["direct", "pymc"]

PRIOR_DRAWS = 4_000
"""Draws from the prior, relabelled like the posterior's, that contraction is measured against."""

EDITED = "edited"
"""Class of prior in the settings of a fit whose PyMC model was edited: no other fit has it."""

PRIOR_STREAM = 7_102
"""First element of the spawn key of those draws."""


def fit(
    log: Study,
    states: int,
    *,
    prior: DirichletPrior = STICKY,
    pins: Mapping[str, Array | None] | None = None,
    groups: Groups | None = None,
    people: PersonOffset | None = None,
    engine: Engine = "direct",
    sampler: NutsSettings | None = None,
    done: Mapping[int, Chain] | None = None,
    finished: Callable[[int, Chain], None] | None = None,
    progress: Progress | None = None,
) -> Posterior:
    """Sample the posterior.

    Parameters
    ----------
    log : EventLog, or CompressedLog
        Of one that was compressed, by condition, the tables are the same bit for bit. What a fit keeps of people
        and events is left out then (`models.fit_tree`), and neither groups nor people who differ can be had.
    states : int
    prior : DirichletPrior
        Sticky by default (two pseudo-counts more on staying). A prior of any other form is a PyMC model's:
        `models.edited_model.fit_model`.
    pins : mapping, optional
        Transition tables held fixed (None: the identity).
    groups : Groups, optional
        Tables that differ between groups of people.
    people : PersonOffset, optional
        The hierarchical version: each person has an offset on the helping log-odds.
    engine : {"direct", "pymc"}
        The compiled density, or the PyMC model; same posterior. Both sample with nutpie, chain by chain. Where it
        is not installed, PyMC's own sampler is used for either, with a warning for `direct`.
    sampler : NutsSettings, optional
    done, finished
        Chains of an interrupted run of the same engine, and what to do with each chain as it completes.
    progress : callable, optional

    Raises
    ------
    InputError
        On a log without responses, pins that do not fit, or pins or a prior that tell states apart (relabelling
        would then be wrong).
    """
    clock = WorkClock()
    sampler = sampler or NutsSettings()
    spec = ModelSpec(states, prior, {} if pins is None else pins, groups, people)
    spec = replace(spec, pins=checked_pins(Layout(log.protocol, spec.states), spec.pins))
    study = StudyDensity(log, spec)
    study.check_labels_are_free()
    if groups is not None:
        groups.warn_of_thin_ones(study.events)
    if engine == "direct" and find_spec("nutpie") is None:
        warnings.warn(
            "nutpie is not installed: PyMC's own sampler takes its place, which is much slower (engine pymc)",
            stacklevel=2,
        )
        engine = "pymc"
    start = clock.wall()
    if engine == "direct":
        chains = sample(study.density, sampler, done=done, finished=finished, progress=progress, clock=clock)
        theta = constrained(study.density, np.stack([c.x for c in chains.values()]))
    elif engine == "pymc":
        chains = _sample_pymc(study, sampler, done, finished, progress, clock)
        theta = np.stack([c.x for c in chains.values()])
    else:
        raise located("engine", engine, "direct or pymc")
    seconds = clock.wall() - start
    stats = stacked(chains)
    if engine == "direct":
        stats["lp"] = stats["lp"] + study.density.constant
    rng = np.random.default_rng(np.random.SeedSequence(sampler.seed, spawn_key=(PRIOR_STREAM, states)))
    prior_theta = constrained(study.density, prior_particles(study.density, PRIOR_DRAWS, rng))
    settings = {**study.to_dict(), "engine": engine, "sampler": vars(sampler)}
    posterior = examined(study, theta, prior_theta, stats, settings)
    return replace(
        posterior,
        cpu_seconds=clock.cpu() + sum(c.cpu_seconds for i, c in (done or {}).items() if i in chains),
        sampling_seconds=seconds,
        compile_seconds=clock.compile_seconds,
    )


def stacked(chains: Mapping[int, Chain]) -> dict[str, NDArray]:
    """Statistics of several chains, ``[chain, draw]``."""
    each = list(chains.values())
    return {name: np.stack([c.stats[name] for c in each]) for name in each[0].stats}


def examined(
    study: StudyDensity, theta: Array, prior_theta: Array, stats: Mapping[str, NDArray],
    settings: Mapping[str, Any], added: xr.Dataset | None = None, gated: tuple[str, ...] = (),
) -> Posterior:  # fmt: skip
    """Put draws into canonical order and through the gate, and keep what is needed later.

    Parameters
    ----------
    study : StudyDensity
    theta : float64[chain, draw, p]
        Learned vectors, sigma last where people differ.
    prior_theta : float64[draw, p]
        Draws from the prior, which contraction is measured against.
    stats : mapping of str to arrays [chain, draw]
        Of the sampler; ``diverging`` counts in the gate, which is shut without it.
    settings : mapping
        What determined the sample, with ``sampler`` (its seed is that of the predictive responses).
    added : xarray.Dataset, optional
        What else was drawn, states in canonical order: kept beside the tables.
    gated : tuple of str
        Names of added variables that the gate examines too.

    Raises
    ------
    InputError
        On draws that are not finite.
    """
    if not np.isfinite(theta).all():
        raise located("posterior draws", Phrase("numbers that are not finite"), "finite draws: nothing is stored")
    settings = {**settings, EVIDENCE: evidence_of_actions(study.log, study.spec.pins)}
    posterior, prior = canonical_tables(study, theta), canonical_tables(study, prior_theta[None])
    kept = by_history(study, theta) if study.compressed else by_person(study, study.log_likelihoods(theta))
    data = build_tree(study, posterior, prior, stats, kept, settings["sampler"]["seed"])
    draws = data["posterior"].to_dataset()
    names, likelihoods = _likelihoods(study, theta, kept)
    columns, named = [entries(draws, study.log.protocol)], entry_names(draws, study.log.protocol)
    if added is not None:
        data["posterior"] = xr.DataTree(draws.merge(added))
        for name in gated:
            columns.append(added[name].to_numpy().reshape(*theta.shape[:2], -1))
            named += places(added[name])
    diverging = stats.get("diverging")
    gate = convergence_gate(
        np.concatenate([*columns, likelihoods], axis=-1), [*named, *names],
        None if diverging is None else int(np.sum(diverging)),
    )  # fmt: skip
    if study.density.people_differ:
        some = theta[:, :: max(1, theta.shape[1] // 10)].reshape(-1, theta.shape[-1])
        settings = {**settings, "node_check": study.node_check(some)}
    return Posterior(data, study.log.protocol, gate, settings, study.log.emission_weights, 0.0, 0.0)


def places(variable: xr.DataArray) -> list[str]:
    """Names of the entries of a variable, dims chain and draw first: ``mean[s0]``, by its labels."""
    dims = variable.dims[2:]
    labels = [
        [str(v) for v in variable[d].to_numpy()]
        if d in variable.coords
        else list(map(str, range(variable.sizes[d])))
        for d in dims
    ]
    return [f"{variable.name}[{','.join(place)}]" if place else str(variable.name) for place in product(*labels)]


def _likelihoods(
    study: StudyDensity, theta: Array, kept: xr.Dataset
) -> tuple[list[str], NDArray[np.float64]]:  # fmt: skip
    """Label-invariant quantities: log-likelihood by condition and in all, ``[chain, draw, quantity]``."""
    if not study.density.people_differ:
        names = [f"log-likelihood of condition {name}" for name in study.log.conditions]
        return [*names, "log-likelihood"], study.condition_log_likelihoods(theta)
    log, values = study.events, kept["participant"].to_numpy()
    names, columns = [], []
    first = np.unique(study.person, return_index=True)[1]
    for c, name in enumerate(log.conditions):
        members = log.condition[first] == c
        if members.any():
            names.append(f"log-likelihood of condition {name}")
            columns.append(values[..., members].sum(axis=-1))
    return [*names, "log-likelihood"], np.stack([*columns, values.sum(axis=-1)], axis=-1)


def _sample_pymc(
    study: StudyDensity, sampler: NutsSettings, done: Mapping[int, Chain] | None,
    finished: Callable[[int, Chain], None] | None, progress: Progress | None, clock: WorkClock,
) -> dict[int, Chain]:  # fmt: skip
    with clock.preparing():
        from models.pymc_engine import ModelTarget, sampled_by_pymc  # loads PyMC; the direct engine does without

        target = ModelTarget.of(study)
    if find_spec("nutpie") is not None:
        return sample_target(target, sampler, done=done, finished=finished, progress=progress, clock=clock)
    return sampled_by_pymc(target, sampler)
