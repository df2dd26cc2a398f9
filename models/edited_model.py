"""Fitting a PyMC model that an analyst edited: the same order of states, gate and posterior as every other fit.

`models.bayesian_hmm.build_model` gives a plain `pymc.Model`. Its priors may be changed in any way PyMC knows:
terms added (`pymc.Potential`), variables held (`pymc.do`), or a model written anew with the same names for the same
tables and the same ``log_likelihood``. The posterior is that of the edited model, and contraction is measured
against its own prior.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib.util import find_spec
from typing import Any

import numpy as np
import pymc as pm
import xarray as xr
from numpy.typing import NDArray
from pymc.model.fgraph import clone_model

from models.added_variables import EditedTarget, check_probabilities, in_order
from models.bayesian_fit import EDITED, PRIOR_DRAWS, PRIOR_STREAM, examined, stacked
from models.chains import Chain, NutsSettings, Progress, sample
from models.edited_prior import LIKELIHOOD, check_labels_are_free, check_likelihood, check_tables, free_points
from models.edited_starts import tried_out
from models.errors import InputError, Phrase, located
from models.events import EventLog
from models.groups import Groups
from models.parameters import Array
from models.person_offset import PersonOffset
from models.posterior import Posterior
from models.pymc_engine import ModelTarget, sampled_by_pymc, statistics_of
from models.study_density import ModelSpec, StudyDensity
from models.work_clock import WorkClock

TERMS_STREAM = 7_111
"""First element of the spawn keys of chains that sample a prior with added terms."""


def fit_model(
    model: pm.Model,
    log: EventLog,
    states: int,
    *,
    groups: Groups | None = None,
    people: PersonOffset | None = None,
    trace: xr.DataTree | None = None,
    sampler: NutsSettings | None = None,
    done: Mapping[int, Chain] | None = None,
    finished: Callable[[int, Chain], None] | None = None,
    progress: Progress | None = None,
) -> Posterior:
    """Sample an edited model, or take a trace of it, and examine it like any other fit.

    Parameters
    ----------
    model : pymc.Model
        From `models.bayesian_hmm.build_model` of the same log, states, groups and people, and edited. Tables that
        were pinned there are constants of the model. What has one value for every state needs the dimension
        ``state`` (``state_next``), or the labels of the states cannot be seen to be free.
    log, states, groups, people
        What the model was built for.
    trace : xarray.DataTree, optional
        Of this model, sampled already; by default it is sampled here, with nutpie, chain by chain. Axes are told
        by their names. Without statistics of the sampler the gate is shut: nobody knows of divergences.
    sampler : NutsSettings, optional
        With a trace only its seed is used: for prior draws and simulated studies.
    done, finished, progress
        As in `models.bayesian_fit.fit`.

    Returns
    -------
    Posterior
        Its settings say that priors were edited, and what PyMC says of them: never those of a fit with priors of
        the house, so never mistaken for one in the store (`analysis.fits.stored_fit_model`). Free variables that
        were added, and deterministics that are not large, lie beside the tables, one value a state in canonical
        order; the free ones count in the gate. `cpu_seconds` is that of everything done here but compilation.

    Raises
    ------
    InputError
        If a table is missing or has other dimensions, a variable is discrete or improper, the likelihood is not
        that of the log, no chain can start, a trace is not of this model, or the edited prior tells states apart:
        draws must not be relabelled then, the labels are the prior's. Whether it does is tried out with its
        density at random points, states swapped and not.
    """
    clock = WorkClock()
    sampler = sampler or NutsSettings()
    study = StudyDensity(log, ModelSpec(states, groups=groups, people=people))
    with clock.preparing():
        examine(model, study, sampler.seed)
    if groups is not None:
        groups.warn_of_thin_ones(log)
    start = clock.wall()
    chains: dict[int, Chain] = {}
    target = EditedTarget(study, model)
    if trace is None:
        if find_spec("nutpie") is not None:
            chains = sample(target, sampler, done=done, finished=finished, progress=progress, clock=clock)
        else:
            chains = sampled_by_pymc(target, sampler)
        x, stats = np.stack([c.x for c in chains.values()]), stacked(chains)
    else:
        x, stats = _of_trace(target, trace)
    theta, added = target.split(x)
    seconds = clock.wall() - start
    settings: dict[str, Any] = {
        **study.spec.to_dict(),
        "prior": {"class": EDITED, "model": model.str_repr()},
        "pins": held_tables(study, theta),
        "engine": "pymc",
        "sampler": {**vars(sampler), "draws": theta.shape[1], "chains": theta.shape[0]},
    }
    posterior = examined(
        study, theta, prior_draws(model, study, sampler.seed, clock), stats, settings, added, target.gated
    )
    return replace(
        posterior,
        cpu_seconds=clock.cpu() + sum(c.cpu_seconds for i, c in (done or {}).items() if i in chains),
        sampling_seconds=seconds,
        compile_seconds=clock.compile_seconds,
    )


def examine(model: pm.Model, study: StudyDensity, seed: int) -> None:
    """All that is asked of an edited model before it is fitted.

    Raises
    ------
    InputError
        As `fit_model` says.
    """
    check_tables(model, study)
    points = free_points(model, seed)
    check_likelihood(model, study, points[0])
    check_labels_are_free(model, study, points)


def _of_trace(target: EditedTarget, trace: xr.DataTree) -> tuple[Array, dict[str, NDArray]]:
    if not isinstance(trace, xr.DataTree):
        raise located("trace", Phrase(f"a {type(trace).__name__}"), "an xarray.DataTree, as pm.sample gives it")
    if "posterior" not in trace.children:
        raise InputError("trace: has no group posterior")
    draws = trace["posterior"].to_dataset()
    missing = [name for name in target.sampled_names if name not in draws]
    if missing:
        raise InputError(f"trace: lacks {', '.join(missing)}, which the fit is about")
    x = target.joined(in_order(target, draws))
    check_probabilities(target.study, target.split(x)[0])
    stats = statistics_of(trace, len(x))
    return x, {name: np.stack([s[name] for s in stats]) for name in stats[0]}


def held_tables(study: StudyDensity, theta: Array) -> dict[str, list[list[float]]]:
    """Transition tables that are the same in every draw, by action: those the model holds.

    Parameters
    ----------
    study : StudyDensity
    theta : float64[chain, draw, p]
    """
    flat = theta[..., : study.layout.size].reshape(-1, study.layout.size)
    names = study.log.protocol.action_names
    shape = (len(flat), study.layout.n_groups, len(names), study.spec.states, study.spec.states)
    tables = study.layout.unpack(flat)[1].reshape(shape)
    return {
        name: tables[0, 0, a].tolist()
        for a, name in enumerate(names)
        if study.spec.states > 1 and np.all(tables[:, :, a] == tables[0, 0, a])
    }


def prior_draws(model: pm.Model, study: StudyDensity, seed: int, clock: WorkClock | None = None) -> Array:
    """Draws from the edited prior, as learned vectors ``[draw, p]``.

    Drawn forwards. Where terms were added to the density (potentials besides the likelihood) nobody can draw
    forwards: the model without its likelihood is sampled.
    """
    clock = clock or WorkClock()
    with clock.preparing():
        bare = without_likelihood(model)
    spawned = np.random.SeedSequence(seed, spawn_key=(PRIOR_STREAM, study.spec.states))
    target = _PriorTarget(study, bare)
    if not bare.potentials:
        with clock.preparing():
            drawn = pm.draw(
                [bare[name] for name in target.sampled_names], draws=PRIOR_DRAWS,
                random_seed=int(spawned.generate_state(1)[0]),
            )  # fmt: skip
        variables = dict(zip(target.sampled_names, drawn, strict=True))
        return target.columns(xr.Dataset({n: (_dims(n, v), v[None]) for n, v in variables.items()}))
    settings = NutsSettings(PRIOR_DRAWS // 4, 500, 4, seed)
    if find_spec("nutpie") is not None:
        chains = sample(target, settings, clock=clock)
    else:
        chains = sampled_by_pymc(target, settings)
    return np.concatenate([c.x for c in chains.values()])


def _dims(name: str, draws: Array) -> list[str]:
    return ["chain", "draw", *(f"{name}_{i}" for i in range(draws.ndim - 1))]


class _PriorTarget(ModelTarget):
    """The prior alone; chains start where PyMC says, not near what the data say."""

    stream = TERMS_STREAM

    def starts(self, compiled: Any) -> Callable[[int], Array]:
        return tried_out(self.frozen, compiled)


def without_likelihood(model: pm.Model) -> pm.Model:
    """A copy of the model whose density is its prior's."""
    copy = clone_model(model)
    copy.potentials = [p for p in copy.potentials if p.name != LIKELIHOOD]
    return copy
