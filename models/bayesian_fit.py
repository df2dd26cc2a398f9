"""Fitting the Bayesian model: sample, put every draw into canonical order, examine, keep what is needed later."""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib.util import find_spec
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from models.draw_kernels import constrained
from models.errors import Phrase, located
from models.events import EventLog
from models.fit_tree import build_tree, canonical_tables
from models.gate import convergence_gate
from models.groups import Groups
from models.nuts import Chain, NutsSettings, Progress, sample
from models.parameters import STICKY, Array, DirichletPrior, Layout, checked_pins
from models.person_offset import PersonOffset
from models.posterior import SPREAD, Posterior
from models.predictive import FullTables
from models.smc import prior_particles
from models.study_density import ModelSpec, StudyDensity

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
    log : EventLog
    states : int
    prior : DirichletPrior
        Sticky by default (two pseudo-counts more on staying).
    pins : mapping, optional
        Transition tables held fixed (None: the identity).
    groups : Groups, optional
        Tables that differ between groups of people.
    people : PersonOffset, optional
        The hierarchical version: each person has an offset on the helping log-odds.
    engine : {"direct", "pymc"}
        The compiled density, or the PyMC model; same posterior. Both sample with nutpie. Where it is not
        installed, PyMC's own sampler is used for either, with a warning for `direct`.
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
    sampler = sampler or NutsSettings()
    spec = ModelSpec(states, prior, {} if pins is None else pins, groups, people)
    spec = replace(spec, pins=checked_pins(Layout(log.protocol, spec.states), spec.pins))
    study = StudyDensity(log, spec)
    study.check_labels_are_free()
    if engine == "direct" and find_spec("nutpie") is None:
        warnings.warn(
            "nutpie is not installed: PyMC's own sampler takes its place, which is much slower (engine pymc)",
            stacklevel=2,
        )
        engine = "pymc"
    started = (time.process_time(), time.perf_counter())
    if engine == "direct":
        chains = sample(study.density, sampler, done=done, finished=finished, progress=progress)
        theta = constrained(study.density, np.stack([c.x for c in chains.values()]))
        stats = {k: np.stack([c.stats[k] for c in chains.values()]) for k in next(iter(chains.values())).stats}
    elif engine == "pymc":
        theta, stats = _sample_pymc(study, sampler)
    else:
        raise located("engine", engine, "direct or pymc")
    seconds = time.perf_counter() - started[1]
    if not np.isfinite(theta).all():
        raise located("posterior draws", Phrase("numbers that are not finite"), "finite draws: nothing is stored")
    stats["lp"] = stats["lp"] + (study.density.constant if engine == "direct" else 0.0)
    posterior = canonical_tables(study, theta)
    rng = np.random.default_rng(np.random.SeedSequence(sampler.seed, spawn_key=(PRIOR_STREAM, states)))
    prior_theta = constrained(study.density, prior_particles(study.density, PRIOR_DRAWS, rng))
    by_person = study.log_likelihoods(theta)
    data = build_tree(
        study, posterior, canonical_tables(study, prior_theta[None]), stats, by_person, sampler.seed
    )  # fmt: skip
    names, quantities = _gate_quantities(study, posterior, by_person)
    gate = convergence_gate(quantities, names, int(stats["diverging"].sum()))
    settings = {**spec.to_dict(), "engine": engine, "sampler": vars(sampler)}
    if people is not None:
        settings["node_check"] = study.node_check(
            theta[:, :: max(1, sampler.draws // 10)].reshape(-1, theta.shape[-1])
        )
    return Posterior(
        data, log.protocol, gate, settings, study.log.emission_weights, time.process_time() - started[0], seconds
    )


def _gate_quantities(
    study: StudyDensity, tables: FullTables, by_person: Array
) -> tuple[list[str], NDArray[np.float64]]:
    """Every entry after relabelling, and label-invariant quantities: log-likelihood in all and by condition."""
    log = study.log
    lead = tables.initial.shape[:2]
    names, columns = [], []
    for name in ("initial", "transition", "emission"):
        table = getattr(tables, name)
        places = [",".join(map(str, place)) for place in np.ndindex(table.shape[2:])]
        names += [f"{name}[{place}]" for place in places]
        columns.append(table.reshape(*lead, -1))
    if tables.spread is not None:
        names.append(SPREAD)
        columns.append(tables.spread[..., None])
    first = np.unique(study.person, return_index=True)[1]
    for c, name in enumerate(log.conditions):
        members = log.condition[first] == c
        if members.any():
            columns.append(by_person[..., members].sum(axis=-1)[..., None])
            names.append(f"log-likelihood of condition {name}")
    columns.append(by_person.sum(axis=-1)[..., None])
    names.append("log-likelihood")
    return names, np.concatenate(columns, axis=-1)


def _sample_pymc(study: StudyDensity, sampler: NutsSettings) -> tuple[Array, dict[str, NDArray]]:
    import pymc as pm
    from pymc.model.transform.optimization import freeze_dims_and_data

    from models.bayesian_hmm import learned_vector, model_of  # loads PyMC, which the direct engine does without

    # Shapes and data as constants, and no checks of parameters that cannot leave their range: less to compile.
    model = freeze_dims_and_data(model_of(study))
    model.check_bounds = False
    with model:
        trace = pm.sample(
            sampler.draws, tune=sampler.tune, chains=sampler.chains, random_seed=sampler.seed, progressbar=False,
            nuts={"target_accept": sampler.target_accept}, compute_convergence_checks=False,
        )  # fmt: skip
    theta = learned_vector(study, trace["posterior"].to_dataset())
    if theta.shape[:2] != (sampler.chains, sampler.draws) or not np.isfinite(theta).all():
        # The samplers behind PyMC swallow Ctrl-C and hand back what they have.
        raise KeyboardInterrupt("nothing of engine pymc is kept: the run starts anew")
    own = trace["sample_stats"].to_dataset()
    # nutpie and PyMC's own sampler call the log-posterior by different names.
    names = {"diverging": ("diverging",), "n_steps": ("n_steps",), "energy": ("energy",), "lp": ("logp", "lp")}
    found = {k: next((own[v] for v in options if v in own), None) for k, options in names.items()}
    return theta, {k: v.to_numpy() for k, v in found.items() if v is not None}
