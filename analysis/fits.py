"""The store of fits: posteriors found again by what determined them, and the chains of interrupted runs.

A fit lies under the hash of model, prior, data digest, seed, sampler and versions, below `PROSOCIAL_CACHE` or
`.cache/` in the checkout. Chains are kept as they complete, so that an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import json
import os
import warnings
from collections.abc import Callable, Mapping
from contextlib import nullcontext, suppress
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from analysis.kept_chains import KeptChains, NotKeptWarning
from analysis.source_digest import source_digest
from models.bayesian_fit import EDITED, Engine, fit
from models.chains import NutsSettings, Progress
from models.design_facts import Study
from models.errors import InputError, Phrase, located
from models.events import EventLog
from models.file_lock import alone
from models.groups import Groups
from models.parameters import STICKY, Array, DirichletPrior, Layout, checked_pins
from models.person_offset import PersonOffset
from models.posterior import Posterior
from models.posterior_files import SCHEMA, read_posterior, versions, write_posterior
from models.study_density import ModelSpec, StudyDensity

if TYPE_CHECKING:
    import pymc as pm

ENGINE = "models.bayesian_fit"
"""A fit depends on all source code that this module reaches: priors, layouts and labels as much as kernels."""


def store_folder() -> Path:
    """Where fits are kept."""
    root = os.environ.get("PROSOCIAL_CACHE")
    return (Path(root) if root else Path(__file__).resolve().parent.parent / ".cache") / "fits"


@dataclass(frozen=True)
class StoredFit:
    """A fit and where it came from: `reused` says whether it was found rather than sampled."""

    posterior: Posterior
    path: Path
    key: str
    reused: bool


def maker() -> dict[str, Any]:
    """What code and which versions make fits now: those of another maker are never found again."""
    return {"sources": source_digest(ENGINE), "versions": versions(), "schema": SCHEMA}


def fit_key(data_digest: str, settings: Mapping[str, Any]) -> str:
    """Hash of everything that determines a fit.

    Numbers of the prior count as floats, so that a kappa of 2 and one of 2.0 have the same key; tables held fixed
    are expected as `models.parameters.checked_pins` gives them.
    """
    prior = {
        name: float(value) if isinstance(value, Real) and not isinstance(value, bool) else value
        for name, value in settings.get("prior", {}).items()
    }
    content = {"data": data_digest, **maker(), **settings, "prior": prior}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:24]


def stored_fit(
    log: Study,
    data_digest: str,
    states: int,
    *,
    prior: DirichletPrior = STICKY,
    pins: Mapping[str, Array | None] | None = None,
    groups: Groups | None = None,
    people: PersonOffset | None = None,
    engine: Engine = "direct",
    sampler: NutsSettings | None = None,
    progress: Progress | None = None,
) -> StoredFit:
    """Find a fit in the store or sample and keep it.

    Parameters
    ----------
    log : EventLog, or CompressedLog
        What is learned from: the selected part of the data. A fit of a compressed log keeps less, and has a key of
        its own.
    data_digest : str
        Digest of that part (`analysis.datasets.log_digest`).
    states, prior, pins, groups, people, engine, sampler, progress
        As in `models.bayesian_fit.fit`.

    Warns
    -----
    NotKeptWarning
        If a fit in the store is damaged (it is sampled anew) or the store cannot be written (the fit is returned
        all the same), by the name of the file.
    """
    sampler = sampler or NutsSettings()
    spec = ModelSpec(states, prior, dict(pins or {}), groups, people)
    spec = replace(spec, pins=checked_pins(Layout(log.protocol, spec.states), spec.pins))
    study = StudyDensity(log, spec)
    settings = {**study.to_dict(), "engine": engine, "sampler": vars(sampler)}
    key = fit_key(data_digest, settings)

    def columns() -> int:
        return study.density.dimension if engine == "direct" else study.layout.size + study.density.people_differ

    def sample(kept: KeptChains) -> Posterior:
        return fit(
            log, spec.states, prior=prior, pins=spec.pins, groups=groups, people=people, engine=engine,
            sampler=sampler, done=kept.found(), finished=kept.keep, progress=progress,
        )  # fmt: skip

    # Only groups are asked of its runs, and a compressed log has none of them.
    return _found_or_made(key, cast("EventLog", log), data_digest, settings, groups, columns, sample)


def stored_fit_model(
    model: pm.Model,
    log: EventLog,
    data_digest: str,
    states: int,
    *,
    groups: Groups | None = None,
    people: PersonOffset | None = None,
    sampler: NutsSettings | None = None,
    progress: Progress | None = None,
) -> StoredFit:
    """Find a fit of an edited model in the store, or sample and keep it; an interrupted run goes on.

    Its key is a digest of the model itself (`models.model_digest`): one that is built again the same way is found,
    any edit makes it another.

    Parameters
    ----------
    model, log, states, groups, people, sampler, progress
        As in `models.edited_model.fit_model`.
    data_digest : str
        As in `stored_fit`.

    Raises
    ------
    InputError
        As `fit_model` does.
    """
    from models.added_variables import EditedTarget
    from models.edited_model import fit_model
    from models.edited_prior import check_tables
    from models.model_digest import model_digest

    sampler = sampler or NutsSettings()
    study = StudyDensity(log, ModelSpec(states, groups=groups, people=people))
    check_tables(model, study)
    prior = {"class": EDITED, "digest": model_digest(model)}
    settings = {**study.spec.to_dict(), "prior": prior, "engine": "pymc", "sampler": vars(sampler)}

    def sample(kept: KeptChains) -> Posterior:
        return fit_model(
            model, log, states, groups=groups, people=people, sampler=sampler, done=kept.found(),
            finished=kept.keep, progress=progress,
        )  # fmt: skip

    key = fit_key(data_digest, settings)
    return _found_or_made(key, log, data_digest, settings, groups, lambda: EditedTarget(study, model).width, sample)


def _found_or_made(
    key: str, log: EventLog, data_digest: str, settings: Mapping[str, Any], groups: Groups | None,
    columns: Callable[[], int], sample: Callable[[KeptChains], Posterior],
) -> StoredFit:  # fmt: skip
    path = store_folder() / f"{key}.nc"
    # Another process may be sampling it now: then it is waited for, and found.
    with nullcontext() if path.is_file() else alone(path):
        if path.is_file():
            try:
                found = read_posterior(path)
            except InputError as error:
                warnings.warn(f"{error}; sampled anew in its place", NotKeptWarning, stacklevel=3)
            else:
                if groups is not None:
                    groups.warn_of_thin_ones(log)
                return StoredFit(found, path, key, True)
        about = {"study": log.study, **settings, "made_by": maker()}
        kept = KeptChains(store_folder() / f"{key}.chains", about, columns)
        posterior = sample(kept)
        try:
            _write(posterior, path, log, data_digest)
        except InputError as error:
            # Sampling may have taken an hour: its result is not to be lost with the store.
            warnings.warn(f"{error}; the result is not in the store", NotKeptWarning, stacklevel=3)
        else:
            kept.forget()
            # What later runs will read: results computed from it are then found by the same key
            # (`analysis.stored_results`), which counts its names and settings with their types.
            with suppress(InputError):
                posterior = read_posterior(path)
        return StoredFit(posterior, path, key, False)


def keep_edited(posterior: Posterior, log: EventLog, data_digest: str) -> StoredFit:
    """Keep a fit of an edited model (`models.edited_model.fit_model`) in the store.

    For a fit of somebody's own trace, which nobody can sample again: read it by its path. What `fit_model` is to
    sample, `stored_fit_model` keeps and finds again. It is kept until it is cleared away by age, or with
    everything.

    Raises
    ------
    InputError
        On a fit of a model that was not edited: `stored_fit` keeps these.
    """
    if posterior.settings["prior"].get("class") != EDITED:
        raise located("fit to be kept", Phrase("a model that was not edited"), "one of fit_model; see stored_fit")
    draws = hashlib.sha256(np.ascontiguousarray(posterior.flat()).tobytes()).hexdigest()
    key = fit_key(data_digest, {**posterior.settings, "draws": draws})
    path = store_folder() / f"{key}.nc"
    _write(posterior, path, log, data_digest)
    return StoredFit(posterior, path, key, False)


def _write(posterior: Posterior, path: Path, log: EventLog, data_digest: str) -> None:
    write_posterior(
        posterior,
        path,
        {"data_digest": data_digest, "study": log.study, "key": path.stem, "sources": source_digest(ENGINE)},
    )
