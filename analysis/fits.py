"""The store of fits: posteriors found again by what determined them, and the chains of interrupted runs.

A fit lies under the hash of model, prior, data digest, seed, sampler and versions, below `PROSOCIAL_CACHE` or
`.cache/` in the checkout. Chains are kept as they complete, so that an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
import warnings
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from numbers import Real
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from models.bayesian_fit import EDITED, Engine, fit
from models.chains import Chain, NutsSettings, Progress
from models.compiled import kernel_digest
from models.errors import Phrase, located
from models.events import EventLog
from models.groups import Groups
from models.model_files import write_bytes, write_text
from models.parameters import STICKY, Array, DirichletPrior, Layout, checked_pins
from models.person_offset import PersonOffset
from models.posterior import Posterior
from models.posterior_files import SCHEMA, read_posterior, versions, write_posterior
from models.study_density import ModelSpec

ABOUT = "about.json"
"""In the folder of an interrupted run: study, settings and maker, for whoever lists and clears the store."""


ENGINE = "models.bayesian_fit"
"""A fit depends on the kernels that this module reaches."""


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
    return {"kernels": kernel_digest(ENGINE), "versions": versions(), "schema": SCHEMA}


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
    log: EventLog,
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
    log : EventLog
        What is learned from: the selected part of the data.
    data_digest : str
        Digest of that part (`analysis.datasets.log_digest`).
    states, prior, pins, groups, people, engine, sampler, progress
        As in `models.bayesian_fit.fit`.
    """
    sampler = sampler or NutsSettings()
    spec = ModelSpec(states, prior, dict(pins or {}), groups, people)
    spec = replace(spec, pins=checked_pins(Layout(log.protocol, spec.states), spec.pins))
    settings = {**spec.to_dict(), "engine": engine, "sampler": vars(sampler)}
    key = fit_key(data_digest, settings)
    path = store_folder() / f"{key}.nc"
    if path.is_file():
        if groups is not None:
            groups.warn_of_thin_ones(log)
        return StoredFit(read_posterior(path), path, key, True)
    about = {"study": log.study, **settings, "made_by": maker()}
    done, keep, forget = _chains(store_folder() / f"{key}.chains", about)
    posterior = fit(
        log, spec.states, prior=prior, pins=spec.pins, groups=groups, people=people, engine=engine, sampler=sampler,
        done=done, finished=keep, progress=progress,
    )  # fmt: skip
    _write(posterior, path, log, data_digest)
    forget()
    return StoredFit(posterior, path, key, False)


def keep_edited(posterior: Posterior, log: EventLog, data_digest: str) -> StoredFit:
    """Keep a fit of an edited model (`models.edited_model.fit_model`) in the store.

    Nothing says whether another edit is the same, so it is never found again by itself: read it by its path. It is
    kept until it is cleared away by age, or with everything.

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
        {"data_digest": data_digest, "study": log.study, "key": path.stem, "kernels": kernel_digest(ENGINE)},
    )


def _chains(
    folder: Path, about: Mapping[str, Any]
) -> tuple[dict[int, Chain], Callable[[int, Chain], None], Callable[[], None]]:
    """Chains of an interrupted run, how to keep another one (saying what about), and how to clear them away."""
    warned = False

    def keep(number: int, chain: Chain) -> None:
        nonlocal warned
        content = io.BytesIO()
        arrays = {"x": chain.x, "cpu_seconds": np.float64(chain.cpu_seconds), **chain.stats}
        np.savez(content, **arrays)  # type: ignore[arg-type]
        try:
            if not (folder / ABOUT).is_file():
                write_text(folder / ABOUT, json.dumps(about))
            write_bytes(folder / f"{number}.npz", content.getbuffer())
        except OSError as error:
            # The chain is still in memory: a full disk must not end the run that could do without it.
            if not warned:
                warned = True
                reason = f"{folder}: {error.strerror or error}; an interruption would lose it"
                warnings.warn(f"chain {number} could not be kept: {reason}", stacklevel=2)

    def forget() -> None:
        # Another run of the same fit may be clearing the same folder, or writing into it.
        with suppress(OSError):
            for path in folder.iterdir():
                path.unlink(missing_ok=True)
            folder.rmdir()

    done = {}
    if folder.is_dir():
        for path in sorted(folder.glob("*.npz")):
            try:
                with path.open("rb") as stream, np.load(stream, allow_pickle=False) as content:
                    stats = {k: content[k] for k in content.files if k not in ("x", "cpu_seconds")}
                    done[int(path.stem)] = Chain(content["x"], stats, float(content["cpu_seconds"]))
            except (OSError, ValueError, KeyError, EOFError, BadZipFile):
                path.unlink(missing_ok=True)  # damaged: this chain is sampled again
    return done, keep, forget
